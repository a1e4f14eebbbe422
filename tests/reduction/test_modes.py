"""Modes by count, band, index and dominance."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from helpers import dense_model, few_on_ranks

import hpcred
from hpcred import Buckens, ModalDamping, Modes, Rayleigh
from hpcred.examples import linkage as example

pytestmark = pytest.mark.mpi

SUPPORTED = [10.5726, 23.3801, 29.3622, 54.5380, 75.2618, 141.4085, 144.9854, 235.7926]
FREE = [33.3047, 52.4523, 72.1522, 77.5797, 120.4666, 221.8691, 253.2911, 410.4717]


def test_modes_of_the_supported_linkage(linkage):
    with hpcred.reduce(linkage, [Modes(count=8)], example.FRAME) as rom:
        assert np.allclose(rom.frequencies, SUPPORTED, atol=1e-4)
    with hpcred.reduce(linkage, [Modes(band=(20.0, 142.0))], example.FRAME) as rom:
        assert np.allclose(rom.frequencies, SUPPORTED[1:6], atol=1e-4)


@pytest.mark.costly
def test_elastic_modes_of_the_free_linkage(linkage):
    """Shift-invert at zero of a free body gives wrong eigenvalues when K is factored as it is."""
    with hpcred.reduce(linkage, [Modes(count=8)], Buckens()) as rom:
        assert np.allclose(rom.frequencies, FREE, atol=1e-4)
    with hpcred.reduce(linkage, [Modes(band=(0.0, 300.0))], Buckens()) as rom:
        assert np.allclose(rom.frequencies, FREE[:7], atol=1e-4)
    with hpcred.reduce(linkage, [Modes(index=(7, 9, 13))], Buckens()) as rom:
        assert np.allclose(rom.frequencies, np.array(FREE)[[0, 2, 6]], atol=1e-4)
    with pytest.raises(hpcred.InputError, match="start at 7"):
        hpcred.reduce(linkage, [Modes(index=(6, 7))], Buckens())


def test_all_modes_are_the_whole_model(linkage):
    frequencies = [0.0, 12.0, 77.0, 290.0]
    full = hpcred.frequency_response(linkage, frequencies, Buckens(), example.DAMPING)
    with hpcred.reduce(linkage, [Modes(count=114)], Buckens(), example.DAMPING) as rom:
        reduced = hpcred.frequency_response(rom, frequencies)
        assert hpcred.relative_error(full, reduced).max() < 1e-8


@pytest.mark.costly
def test_dominant_modes_are_those_that_the_loads_excite(comm):
    """A force along x on a bar: stretching modes matter, bending modes do not."""
    with hpcred.solid((12, 2, 2), (1.2, 0.2, 0.2), inputs=1, comm=comm) as bar:
        center = [node + 1 for node in range(12 * 9) if node % 9 == 4][-1]  # the middle of the end face
        bar = bar.with_inputs([(center, "x")])
        with hpcred.reduce(bar, [Modes(count=20)]) as rom:
            share = np.abs(rom.B[:, 0]) ** 2 / rom.frequencies**2
            expected = rom.frequencies[np.sort(np.argsort(-share)[:3])]
        with hpcred.reduce(bar, [Modes(count=20, dominant=3)]) as rom:
            assert np.allclose(rom.frequencies, expected, rtol=1e-8)
            assert len(rom.record.components[0].dominance) == 3
            longitudinal = 1 / (4 * 1.2) * np.sqrt(2.1e11 / 7850)
            assert abs(rom.frequencies[0] / longitudinal - 1) < 0.02


@pytest.mark.parametrize("damping", [None, Rayleigh(20.0, 0.0), ModalDamping(ratios=(0.5, 0.01))])
def test_dominance_is_half_the_height_of_a_resonance(comm, damping):
    """|b| |c| / (4 xi omega^2), where the response of one mode at its omega is |b| |c| / (2 xi omega^2)."""
    K, M = np.diag(np.array([1.0, 4.0, 9.0, 16.0]) ** 2 * 1e4), 2.0 * np.eye(4)
    B = np.array([[1.0], [3.0], [4.0], [30.0]])
    columns = {"inputs": B, "input_names": ["u"], "outputs": np.ones((4, 1)), "output_names": ["y"]}
    model = hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, **columns)
    with model, hpcred.reduce(model, [Modes(count=4, dominant=2)], damping=damping) as rom:
        found, frequencies = rom.record.components[0].dominance, rom.frequencies
    omega = np.sqrt(np.diag(K) / 2.0)
    if damping is None:
        ratio = np.full(4, 0.01)
    else:
        ratio = 20.0 / (2 * omega) if damping.kind == "rayleigh" else np.array([0.5, 0.01, 0.01, 0.01])
    heights = B[:, 0] / (2.0 * 2j * ratio * omega**2)  # of a mass of 2
    chosen = np.sort(np.argsort(-np.abs(heights))[:2])
    assert np.allclose(found, np.abs(heights[chosen]) / 2, rtol=1e-8)
    assert np.allclose(frequencies, omega[chosen] / (2 * np.pi), rtol=1e-8)


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
@pytest.mark.parametrize("cells", [(10, 2, 2), (4, 4, 4)])
def test_no_mode_of_a_repeated_pair_is_left_out(comm, cells):
    """Free square bars, whose bending modes are pairs, against dense numpy, for even and odd numbers of modes."""
    with hpcred.solid(cells, clamped=False, comm=comm) as model:
        K, M, _ = dense_model(model)
        expected = np.sqrt(scipy.linalg.eigvalsh(K, M)[6:20]) / 2 / np.pi
        for count in (1, 2, 3, 6, 9, 12):
            with hpcred.reduce(model, [Modes(count=count)], Buckens()) as rom:
                assert np.allclose(rom.frequencies, expected[:count], rtol=1e-8), count


def blades(count, of=4, k=4e4):
    """K and M of equal chains of so many masses on a hub, which a spring holds; the hub is the last row."""
    one = scipy.sparse.diags([[2 * k] * (of - 1) + [k], [-k] * (of - 1), [-k] * (of - 1)], [0, 1, -1])
    K = scipy.sparse.block_diag([one] * count + [[[count * k + 1e6]]]).tolil()
    K[-1, :-1:of] = K[:-1:of, -1] = -k
    return K.tocsr(), scipy.sparse.diags([1.0] * (count * of) + [1e3])


@pytest.mark.mpi
@pytest.mark.parametrize(
    "asked", few_on_ranks([Modes(band=(0.0, 32.0)), Modes(count=50), Modes(index=tuple(range(20, 51)))]),
    ids=["band", "lowest", "listed"],
)  # fmt: skip
@pytest.mark.costly
def test_every_mode_of_equal_blades_is_found(comm, asked):
    """39 of 40 blades vibrate against each other with the same frequency, of which a Krylov sequence knows one."""
    K, M = blades(40)
    exact = np.sqrt(scipy.linalg.eigh(K.toarray(), M.toarray(), eigvals_only=True)) / (2 * np.pi)
    chosen = exact[:50] if asked.count else exact[19:50] if asked.index else exact[exact < 32.0]
    assert np.ptp(exact[1:40]) < 1e-9 * exact[1]
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, inputs=np.eye(K.shape[0])[:, :1]) as model:
        with hpcred.reduce(model, [asked]) as reduced:
            assert reduced.frequencies == pytest.approx(chosen, rel=1e-9)
        if asked.count:
            assert hpcred.natural_modes(model, 50).frequencies == pytest.approx(exact[:50], rel=1e-9)
