"""The compression reaches its goal with few columns, against dense responses."""

import numpy as np
import pytest
from adaptive_models import chain, unit

from hpcred.reduction.compression import compressed, snapshots
from hpcred.reduction.error_estimate import grid
from hpcred.reduction.pseudo_modal import Law, columns, diagonalised, relative, response, restricted

BAND = (0.0, 10.0)


def model_and_ports(kind, law):
    n = 60
    rng = np.random.default_rng(0)
    K = chain(n, rng=rng, spread=0.2)[0]
    L = unit(n, 3, 40, 55)
    D = None
    if "D" in kind:
        D = np.diag(rng.uniform(0, 3, n))
        if "unsymmetric" in kind:
            D[5, 9], D[9, 5] = 4.0, -4.0
    same = np.eye(3)
    other = np.eye(3)[:, :1] * 1e6, np.eye(3)[:, 1:] * 1e-6
    return diagonalised(K, L, D, law), other if "outputs" in kind else (same, same)


@pytest.mark.parametrize("goal", [1e-2, 1e-5])
@pytest.mark.parametrize("kind", ["plain", "outputs", "D", "unsymmetric D, outputs"])
def test_goal_is_reached(kind, goal):
    law = Law() if "D" in kind else Law(eta=2e-3)
    model, ports = model_and_ports(kind, law)
    S = grid([model], law, BAND)
    U = compressed(model, law, S, ports, goal)
    assert np.allclose(U.T @ U, np.eye(U.shape[1]), atol=1e-12)
    assert U.shape[1] < 45
    H = response(model, law, S, ports)

    def error(columns):
        return relative(H - response(restricted(model, columns, law)[0], law, S, ports), H).max()

    assert error(U) <= goal + 1e-9
    # at least as good as the plain singular vectors
    flat = columns(snapshots(model, law, S, ports))
    plain = np.linalg.svd(flat, full_matrices=False)[0]
    assert error(plain[:, : U.shape[1] - 1]) > goal or U.shape[1] == 1
    few = compressed(model, law, S, ports, goal, most=4)
    assert few.shape[1] == 4


def test_no_goal_keeps_everything_and_a_zero_response_harms_nothing():
    law = Law(eta=2e-3)
    model, ports = model_and_ports("plain", law)
    S = grid([model], law, BAND, 30)
    assert compressed(model, law, S, ports, 0.0).shape[1] == 60
    # two bodies without a tie: nothing arrives
    K = np.kron(np.eye(2), chain(10)[0])
    apart = diagonalised(K, unit(20, 2, 13))
    silent = np.eye(2)[:, :1], np.eye(2)[:, 1:]
    S = grid([apart], law, BAND, 30)
    U = compressed(apart, law, S, silent, 1e-3)
    assert np.isfinite(U).all()
