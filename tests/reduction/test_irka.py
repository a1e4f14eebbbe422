"""IRKA: its points are the mirrored poles of what it gives, and its error in the H2 norm is small for its size."""

import numpy as np
import pytest
import scipy.sparse
from helpers import to_dense

import hpcred
from hpcred.parallel.failures import InputError
from hpcred.reduction.irka import IRKA, mirrored

FRAME, DAMPING = hpcred.Chord(nodes=(1, 7, 14), axes="yxz"), hpcred.Rayleigh(alpha=20.0, beta=1e-5)
F = np.linspace(0.5, 400, 800)


def h2(H):
    """The H2 norm over the frequencies F but for a factor."""
    return np.sqrt((np.abs(H) ** 2).sum(axis=(1, 2)).sum())


def complex_of(table):
    return np.array(table) @ [1, 1j]


@pytest.mark.mpi(ranks=(1, 3))
def test_the_points_are_fixed_and_matched(linkage):
    reductor = IRKA(size=8, band=(0, 300), frame=FRAME, damping=DAMPING)
    rom = reductor.reduce(linkage)
    assert rom.size == 8 and not [text for text in rom.record.warnings if "irka" in text]
    used = rom.record.basis[0]
    points, inputs, _ = mirrored(rom, 4)
    assert np.abs(points - complex_of(used.points)).max() < 1e-5 * np.abs(points).max()
    for s, b in zip(complex_of(used.points), complex_of(used.inputs), strict=True):
        full, reduced = exact(linkage, s) @ b, rom.transfer_function(s) @ b
        assert np.abs(full - reduced).max() < 1e-9 * np.abs(full).max()


def exact(model, s):
    """H(s) by dense NumPy in the frame, for C = B^T or not."""
    from hpcred.model.frames import apply_frame

    framed = apply_frame(model, FRAME, DAMPING)
    K, M, D, B = (to_dense(mat) for mat in (framed.model.K, framed.model.M, framed.model.D, framed.model.B))
    C = B.T if framed.model.Ct is None else to_dense(framed.model.Ct).T
    return C @ np.linalg.solve(s * s * M + s * D + K, B.astype(complex))


def test_its_error_is_less_than_that_of_modes_and_points(linkage):
    full = hpcred.frequency_response(linkage, F, FRAME, DAMPING)
    irka = IRKA(size=8, band=(0, 300), frame=FRAME, damping=DAMPING).reduce(linkage)
    modes = hpcred.reduce(linkage, hpcred.Modes(count=8), FRAME, DAMPING)
    points = hpcred.reduce(linkage, [hpcred.Krylov(f) for f in (50.0, 150.0, 250.0)], FRAME, DAMPING)
    ours, *others = (h2(rom.frequency_response(F) - full) for rom in (irka, modes, points))
    assert ours < 0.5 * min(others)


@pytest.mark.mpi(build="real")
def test_two_sided_points_are_matched_on_both_sides(linkage):
    with linkage.with_outputs([(4, "x"), (10, "z")]) as model:
        rom = IRKA(size=8, band=(0, 300), frame=FRAME, damping=DAMPING).reduce(model)
        assert rom.record.projection == "two_sided" and rom.size == 8
        used = rom.record.basis[0]
        for s, b, c in zip(*map(complex_of, (used.points, used.inputs, used.outputs)), strict=True):
            full, reduced = exact(model, s), rom.transfer_function(s)
            assert np.abs((full - reduced) @ b).max() < 1e-7 * np.abs(full @ b).max()
            assert np.abs(c @ (full - reduced)).max() < 1e-7 * np.abs(c @ full).max()


@pytest.mark.mpi(build="real")
def test_its_results_are_written_and_read(comm, folder, linkage):
    rom = IRKA(size=6, band=(0, 300), frame=FRAME, damping=DAMPING, turns=2, change=1e-12).reduce(linkage)
    assert any("irka: after 2 turns points still move" in text for text in rom.record.warnings)
    once = IRKA(size=6, band=(0, 300), frame=FRAME, damping=DAMPING, turns=1).reduce(linkage)
    assert any("irka: after 1 turn points still move" in text for text in once.record.warnings)
    rom.save(folder / "a.h5")
    assert hpcred.read_result(folder / "a.h5", comm).reduced.record == rom.record


def test_what_it_refuses(linkage):
    for damping in (None, hpcred.Structural(0.02)):
        with pytest.raises(InputError, match="irka: found the damping '(none|structural)', expected a viscous one"):
            IRKA(size=4, band=(0, 300), frame=FRAME, damping=damping).reduce(linkage)
    with pytest.raises(InputError, match="irka: the model has a pole without damping at .* Hz, whose mirror image"):
        IRKA(size=4, band=(0, 300), frame=FRAME, damping=hpcred.Rayleigh(1e-12, 0.0)).reduce(linkage)
    with pytest.raises(InputError, match="^model: found None, expected SecondOrderModel"):
        IRKA(size=4, band=(0, 300)).reduce(None)
    with pytest.raises(InputError, match="basis: found IRKA, a Reductor; call its method reduce"):
        hpcred.reduce(linkage, IRKA(size=4, band=(0, 300)))
    with pytest.raises(InputError, match="irka.size: found 5, expected an even number"):
        IRKA(size=5, band=(0, 300))


def membrane():
    """A damped membrane of 72 dofs with dashpots, two inputs and outputs elsewhere, whose two-sided models of eight
    coordinates are unstable."""
    rng, nx, ny = np.random.default_rng(5), 9, 8
    n = nx * ny
    T = [scipy.sparse.diags([-1, 2, -1.0], [-1, 0, 1], shape=(m, m)) for m in (nx, ny)]
    weights = np.diag(rng.uniform(0.5, 2, n))
    K = (scipy.sparse.kron(T[0], np.eye(ny)) + 0.7 * scipy.sparse.kron(np.eye(nx), T[1])).toarray() * 1e4
    K, M = weights @ K @ weights, np.diag(rng.uniform(0.5, 2, n))
    M[0, 1] = M[1, 0] = 0.1
    D = 0.3 * M + 2e-5 * K
    for i, j, c in ((10, 40, 8.0), (3, 3, 20.0), (70, 12, 5.0)):
        v = np.eye(n)[i] - (np.eye(n)[j] if i != j else 0)
        D += c * np.outer(v, v)
    B, C = np.zeros((n, 2)), np.zeros((2, n))
    B[20, 0] = B[50, 1] = C[0, 33] = C[1, 60] = 1.0
    C[1, 61] = 0.5
    return M, D, K, B, C


def test_an_unstable_model_of_a_stable_one_is_warned_of():
    """By poles of the dense matrices."""
    M, D, K, B, C = membrane()
    zero, eye = np.zeros_like(K), np.eye(len(K))
    assert np.linalg.eigvals(np.block([[zero, eye], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])).real.max() < 0
    with hpcred.SecondOrderModel(M, D, K, B, C) as model:
        rom = IRKA(size=8, band=(0, 14), turns=3).reduce(model)
        growing = int((rom.poles().real > 1e-9).sum())
        assert growing and f"model is unstable, with {growing} poles in the right half-plane" in rom.record.warnings[0]
    with hpcred.SecondOrderModel(M, D, K, B) as model:  # C = B^T keeps stability
        rom = IRKA(size=8, band=(0, 14), turns=3).reduce(model)
        assert rom.poles().real.max() < 0 and not any("unstable" in text for text in rom.record.warnings)
