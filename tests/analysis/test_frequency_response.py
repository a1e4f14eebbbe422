"""The full response: structural damping, free bodies, groups of ranks."""

import numpy as np
import pytest
import scipy.linalg
from helpers import close, damped, dense_model, with_columns

import hpcred
from hpcred import Buckens, GivenDamping, Krylov, Modes, SecondOrderKrylov, Structural
from hpcred.analysis import frequency_response
from hpcred.examples import linkage as example
from hpcred.parallel.progress import Progress

pytestmark = pytest.mark.mpi


@pytest.fixture(params=["sparse", "full"])
def matrices(request, monkeypatch):
    """Tiny models by the sparse solvers, and by full matrices where one rank has the model."""
    monkeypatch.setattr(frequency_response, "TINY", 150 if request.param == "full" else 0)


@pytest.mark.usefixtures("matrices")
def test_structural_damping(solid):
    K, M, B = dense_model(solid)
    omega = 2 * np.pi * 900.0
    expected = B.T @ np.linalg.solve((1 + 0.05j) * K - omega**2 * M, B)
    damping = Structural(0.05)
    full = hpcred.frequency_response(solid, [900.0, 0.0], damping=damping)
    assert close(expected, full[0]) < 1e-9
    assert close(B.T @ np.linalg.solve((1 + 0.05j) * K, B), full[1]) < 1e-9
    with hpcred.reduce(solid, [Krylov(900.0, 3), Krylov(0.0, 1)], damping=damping) as rom:
        assert rom.D.max() == 0.0
        assert hpcred.relative_error(full, hpcred.frequency_response(rom, [900.0, 0.0])).max() < 1e-5


@pytest.mark.usefixtures("matrices")
def test_progress_reaches_the_number_of_frequencies(solid):
    """Also where some, such as 0 Hz, are left for the sparse solvers."""
    done = []
    progress = Progress(solid.comm, show=False)
    progress.step = lambda what, count, total: done.append((count, total))
    hpcred.frequency_response(solid, [900.0, 0.0, 50.0], damping=Structural(0.05), groups=1, progress=progress)
    counts, totals = zip(*done, strict=True)
    assert counts[0] == 0 and counts[-1] == 3 and set(totals) == {3}
    assert list(counts) == sorted(counts)


def test_elastic_response_of_a_free_body_with_a_damper_to_ground(comm):
    """D R is not zero: the reference is the body held M-orthogonal to its rigid-body modes."""
    with hpcred.linkage(comm, inputs=(example.LOAD, (1, "x"))) as model:
        K, M, B = dense_model(model)
        D = 1e-5 * K
        D[116, 116] += 40.0
        D[2, 2] += 15.0
        modes = scipy.linalg.eigh(K, M)[1][:, 6:]
        s = 2j * np.pi * 60.0
        small = [modes.T @ mat @ modes for mat in (M, D, K)]
        expected = (B.T @ modes) @ np.linalg.solve(s * s * small[0] + s * small[1] + small[2], modes.T @ B + 0j)
        rows = np.arange(120)
        dofs = hpcred.Dofs(rows // 6 + 1, (rows % 6).astype(np.int8), example.positions()[rows // 6])
        with hpcred.SecondOrderModel.from_scipy(K, M, D, comm, dofs=dofs) as damped_body:
            damped_body = with_columns(damped_body, "input", B)
            full = hpcred.frequency_response(damped_body, [60.0], Buckens(), GivenDamping())
            assert close(expected, full[0]) < 1e-8
            basis = [Modes(count=3), SecondOrderKrylov(60.0, order=1)]
            with hpcred.reduce(damped_body, basis, Buckens(), GivenDamping()) as rom:
                assert close(expected, rom.transfer_function(s)) < 1e-8


@pytest.mark.usefixtures("matrices")
def test_dampers_and_several_inputs_and_outputs(solid):
    """General D, C that is not B^T, more frequencies than go into one call."""
    model, K, M, D, _ = damped(solid, unsymmetric=True)
    random = np.random.default_rng(7)
    B, C = random.normal(size=(len(K), 2)), random.normal(size=(3, len(K)))
    frequencies = np.linspace(0.0, 3000.0, 17)
    with with_columns(with_columns(model, "input", B), "output", C.T) as loaded:
        found = hpcred.frequency_response(loaded, frequencies, damping=GivenDamping())
    for s, response in zip(2j * np.pi * frequencies, found, strict=True):
        assert close(C @ np.linalg.solve(s * s * M + s * D + K, B), response) < 1e-9


@pytest.mark.usefixtures("matrices")
def test_a_pole_that_no_damper_reaches_is_refused(comm):
    omega = 2 * np.pi * 3.0
    K, D = np.diag([omega**2, 500.0, 700.0, 900.0]), np.diag([0.0, 1.0, 1.0, 1.0])
    with hpcred.SecondOrderModel.from_scipy(K, np.eye(4), D, comm) as model:
        model = with_columns(model, "input", np.ones((4, 1)))
        assert hpcred.frequency_response(model, [2.0, 4.0], damping=GivenDamping()).shape == (2, 1, 1)
        with pytest.raises(hpcred.InputError, match="frequency 3 Hz is a pole"):
            hpcred.frequency_response(model, [2.0, 3.0, 4.0], damping=GivenDamping())


@pytest.mark.parametrize("frame", [None, Buckens()])
def test_groups_of_ranks_share_the_frequencies(comm, frame):
    frequencies = [5.0, 60.0, 110.0, 250.0, 290.0]
    with hpcred.linkage(comm, inputs=(example.LOAD, (3, "ry"))) as model:
        model = model.with_outputs([(4, "x"), (17, "rz"), (20, "z")])
        one, each = (
            hpcred.frequency_response(model, frequencies, frame, example.DAMPING, groups=groups)
            for groups in (1, comm.size)
        )
        assert one.shape == (5, 3, 2)
        assert close(one, each) < 1e-9
        if comm.size == 3:
            two = hpcred.frequency_response(model, frequencies, frame, example.DAMPING, groups=2)
            assert close(one, two) < 1e-9
        with pytest.raises(hpcred.InputError, match="groups: found 9"):
            hpcred.frequency_response(model, frequencies, frame, groups=9)


@pytest.mark.parametrize("ratio, loss", [(1e-3, 0.0), (0.0, 2e-3), (1e-6, 0.0), (0.2, 0.0), (0.0, 0.0)])
def test_curves_are_drawn_with_their_peaks(ratio, loss):
    """Of one oscillator, whose dynamic magnification is 1 / (2 zeta sqrt(1 - zeta^2)), without end where undamped."""
    omega = 2 * np.pi * 123.456
    one = np.ones((1, 1))
    rom = hpcred.ReducedModel(one, 2 * ratio * omega * one, omega**2 * one, one, one, np.array([123.456]), loss)
    frequencies = frequency_response.frequencies_to_draw((0, 1000), frequency_response.resonances_of(rom), [0, 77.7])
    assert frequencies[0] == 0 and 77.7 in frequencies and frequencies[-1] == 1000
    highest = np.abs(hpcred.frequency_response(rom, frequencies)).max() * omega**2
    zeta = ratio + loss / 2
    if zeta > 1e-4:
        assert highest == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=0.02)
    else:
        assert 1e3 < highest < 1e6
