"""The reduced model against mathematics and dense second methods."""

import numpy as np
import pytest
import scipy.linalg
import scipy.spatial.transform
from helpers import dense_model, gather, moments

import hpcred
from hpcred import Buckens, Chord, GivenDamping, Krylov, Modes, Rayleigh, StaticCorrection, Tangent
from hpcred.examples import linkage as example
from hpcred.model.frames import apply_frame
from hpcred.parallel.petsc import is_complex

pytestmark = pytest.mark.mpi

SUPPORTED = [10.5726, 23.3801, 29.3622, 54.5380, 75.2618, 141.4085, 144.9854, 235.7926]
FREE = [33.3047, 52.4523, 72.1522, 77.5797, 120.4666, 221.8691, 253.2911, 410.4717]
ALL_LOADS = (*example.SUPPORTS, example.LOAD)


@pytest.fixture
def linkage(comm):
    with hpcred.linkage(comm) as model:
        yield model


@pytest.fixture
def solid(comm):
    with hpcred.solid((4, 2, 3), inputs=4, comm=comm) as model:
        yield model


@pytest.mark.parametrize("points", [[(0.0, 1)], [(700.0, 2)], [(300.0, 0), (2500.0, 1)]])
def test_moments_match_at_every_point_and_order(solid, points):
    K, M, B = dense_model(solid)
    with hpcred.reduce(solid, [Krylov(frequency, order) for frequency, order in points]) as rom:
        for frequency, order in points:
            shift = -((2 * np.pi * frequency) ** 2)
            full = moments(K, M, B, B.T, shift, 2 * (order + 1) + 1)
            small = moments(rom.K, rom.M, rom.B, rom.C, shift, 2 * (order + 1) + 1)
            for a, b in list(zip(full, small, strict=True))[:-1]:
                assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()
            if len(points) == 1:
                assert np.abs(full[-1] - small[-1]).max() > 1e-8 * np.abs(full[-1]).max()  # not more than was asked


def test_the_basis_is_orthonormal_and_the_matrices_are_its_projections(solid):
    K, M, B = dense_model(solid)
    basis = [Modes(count=4), Krylov(0.0, 1), Krylov(1500.0, 1), Modes(band=(0.0, 1500.0))]
    with hpcred.reduce(solid, basis, damping=Rayleigh(3.0, 1e-6)) as rom:
        V = gather(rom.columns)
        assert np.abs(V.T @ M @ V - np.eye(rom.size)).max() < 1e-12
        for small, full in ((rom.K, K), (rom.M, M), (rom.D, 3.0 * M + 1e-6 * K)):
            assert np.abs(small - V.T @ full @ V).max() < 1e-9 * np.abs(small).max()
        assert np.allclose(rom.B, V.T @ B, atol=1e-9 * np.abs(rom.B).max())
        assert np.allclose(rom.C, rom.B.T, rtol=0, atol=0)
        off = rom.K - np.diag(np.diag(rom.K))
        assert np.abs(off).max() < 1e-9 * rom.K.max()
        assert np.allclose(np.sqrt(np.diag(rom.K)) / (2 * np.pi), rom.frequencies, rtol=1e-8)
        # the modes of the band were there already
        assert rom.provenance["ingredients"][-1]["kept"] == 0


def test_dependent_inputs_and_repeated_points_are_dropped_and_counted(solid):
    solid.set_inputs([(45, "x"), (45, "z"), (45, "x"), (48, "y")])
    with hpcred.reduce(solid, [Krylov(400.0, 1), Krylov(400.0, 1), StaticCorrection()]) as rom:
        assert rom.size == 9
        kept = [(item["columns"], item["kept"]) for item in rom.provenance["ingredients"]]
        assert kept == [(4, 3), (3, 3), (3, 3), (3, 0), (3, 0), (3, 3)]


def test_modes_of_the_supported_linkage(linkage):
    with hpcred.reduce(linkage, [Modes(count=8)], example.FRAME) as rom:
        assert np.allclose(rom.frequencies, SUPPORTED, atol=1e-4)
    with hpcred.reduce(linkage, [Modes(band=(20.0, 142.0))], example.FRAME) as rom:
        assert np.allclose(rom.frequencies, SUPPORTED[1:6], atol=1e-4)


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


def test_table_1(linkage):
    frequencies = np.linspace(0.1, 300, 601)
    full = hpcred.frequency_response(linkage, frequencies, example.FRAME, example.DAMPING)
    krylov = [Krylov(10, 1), Krylov(150, 5), Krylov(240, 3), Krylov(300, 1)]
    for basis, low, high in (
        (krylov, 0.0, 1e-8),
        ([Modes(count=13), StaticCorrection()], 8.7e-2, 9.1e-2),
        ([Modes(count=14)], 8.2, 8.6),
    ):
        with hpcred.reduce(linkage, basis, example.FRAME, example.DAMPING, tolerance=1e-13) as rom:
            assert rom.size == 14
            errors = hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies))
            assert low <= hpcred.error_integral(frequencies, errors) <= high


def test_inertia_relief_is_the_elastic_response_whatever_the_supports(linkage):
    """At 0 Hz: the pseudo-inverse of K that is M-orthogonal to the rigid-body modes."""
    linkage.set_inputs(ALL_LOADS)
    K, M, B = dense_model(linkage)
    values, modes = scipy.linalg.eigh(K, M)
    elastic = modes[:, 6:]
    expected = B.T @ elastic @ np.diag(1 / values[6:]) @ elastic.T @ B
    results = []
    for supports in (None, example.SUPPORTS, tuple((5, d) for d in ("x", "y", "z", "rx", "ry", "rz"))):
        frame = Buckens(supports)
        results.append(hpcred.frequency_response(linkage, [0.0], frame)[0].real)
        assert np.abs(results[-1] - expected).max() < 1e-9 * np.abs(expected).max()
        with hpcred.reduce(linkage, [Krylov(0.0, 1)], frame) as rom:
            assert np.abs(rom.transfer_function(0.0) - expected).max() < 1e-8 * np.abs(expected).max()
    with pytest.raises(hpcred.InputError, match="expected 6 dofs"):
        hpcred.reduce(linkage, [Krylov(0.0)], Buckens(example.SUPPORTS[:3] + ((5, "x"), (5, "z"), (6, "x"))))


def test_a_buckens_basis_holds_no_rigid_motion(linkage):
    linkage.set_inputs(ALL_LOADS)
    with hpcred.reduce(linkage, [Modes(count=3), Krylov(10.0, 1), Krylov(0.0)], Buckens()) as rom:
        V = gather(rom.columns)
        K, M, _ = dense_model(linkage)
        rigid = scipy.linalg.eigh(K, M)[1][:, :6]
        assert np.abs(rigid.T @ M @ V).max() < 1e-9
        assert rom.frequencies.min() > 33.0


def test_frames_hold_what_they_say(linkage):
    with hpcred.reduce(linkage, [Modes(count=5)], Tangent(3)) as rom:
        V = gather(rom.columns)
        assert (V[12:18] == 0).all()
        free = np.delete(np.arange(120), np.arange(12, 18))
        K, M, _ = dense_model(linkage)
        values = scipy.linalg.eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], eigvals_only=True)[:5]
        assert np.allclose(rom.frequencies, np.sqrt(values) / (2 * np.pi), rtol=1e-8)
    with hpcred.reduce(linkage, [Modes(count=5)], Chord((1, 7, 18))) as rom:
        V, nodes = gather(rom.columns).reshape(20, 6, 5), example.positions()
        along = (nodes[6] - nodes[0]) / np.linalg.norm(nodes[6] - nodes[0])
        assert np.abs(V[0, :3]).max() < 1e-12
        assert np.abs(V[6, :3] - np.outer(along, along) @ V[6, :3]).max() < 1e-12  # moves along the chord only
        assert np.abs(V[17, 2]).max() < 1e-12
        assert np.abs(V[17, :2]).max() > 1e-3


def test_chord_frame_in_a_plane_of_no_axis(comm):
    """Turned dofs: the frequencies are those of the body turned the other way."""
    with hpcred.linkage(comm) as straight:
        with hpcred.reduce(straight, [Modes(count=6)], Chord((1, 7, 18))) as rom:
            expected = rom.frequencies
        K, M, _ = dense_model(straight)
        turn = scipy.spatial.transform.Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix()
        everywhere = np.kron(np.eye(40), turn)
        nodes = example.positions() @ turn.T
        rows = np.arange(120)
        dofs = hpcred.Dofs(rows // 6 + 1, (rows % 6).astype(np.int8), nodes[rows // 6])
        with hpcred.SecondOrderModel.from_scipy(
            everywhere @ K @ everywhere.T, everywhere @ M @ everywhere.T, comm=comm, dofs=dofs
        ) as turned:
            turned.set_inputs([(20, "z")])
            with hpcred.reduce(turned, [Modes(count=6)], Chord((1, 7, 18))) as rom:
                assert np.allclose(rom.frequencies, expected, rtol=1e-7)


def test_damping_that_is_given_is_projected(linkage):
    K, M, _ = dense_model(linkage)
    damper = np.zeros_like(K)
    damper[116, 116] = 50.0
    rows = np.arange(120)
    dofs = hpcred.Dofs(rows // 6 + 1, (rows % 6).astype(np.int8), example.positions()[rows // 6])
    with hpcred.SecondOrderModel.from_scipy(K, M, damper, linkage.comm, dofs=dofs) as model:
        model.set_inputs([(20, "z")])
        with hpcred.reduce(model, [Modes(count=110)], example.FRAME, GivenDamping()) as rom:
            V = gather(rom.columns)
            assert np.abs(rom.D - V.T @ damper @ V).max() < 1e-9 * np.abs(rom.D).max()
        assert model.D is not None  # the model is as it was
    with pytest.raises(hpcred.InputError, match="needs a damping matrix"):
        hpcred.reduce(linkage, [Modes(count=2)], example.FRAME, GivenDamping())


def test_outputs_other_than_inputs(solid):
    K, M, B = dense_model(solid)
    solid.set_outputs([(30, "y"), (45, "x")])
    with hpcred.reduce(solid, [Krylov(500.0, 1)]) as rom:
        C = np.zeros((2, len(K)))
        C[0, 3 * 29 + 1] = C[1, 3 * 44] = 1.0
        shift = -((2 * np.pi * 500.0) ** 2)
        for a, b in zip(moments(K, M, B, C, shift, 2), moments(rom.K, rom.M, rom.B, rom.C, shift, 2), strict=True):
            assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()


def test_a_free_body_needs_a_frame(comm):
    with hpcred.solid((3, 2, 2), inputs=2, clamped=False, comm=comm) as model:
        for basis in ([Krylov(0.0)], [Modes(count=3)]):
            with pytest.raises(hpcred.InputError, match="move freely"):
                hpcred.reduce(model, basis)
        with hpcred.reduce(model, [Krylov(0.0, 1)], Buckens()) as rom:
            assert rom.frequencies.min() > 100


def test_a_point_on_an_eigenfrequency_is_refused(linkage):
    with hpcred.reduce(linkage, [Modes(count=1)], Buckens()) as rom:
        exact = rom.frequencies[0]
    with pytest.raises(hpcred.InputError, match="eigenfrequency"):
        hpcred.reduce(linkage, [Krylov(exact, 1)], Buckens())
    hpcred.reduce(linkage, [Krylov(33.3047, 1)], Buckens()).close()


def test_drop_above_and_band_without_modes(linkage):
    with hpcred.reduce(linkage, [Modes(band=(0.0, 5.0)), Krylov(10.0, 3)], example.FRAME, drop_above=200.0) as rom:
        assert rom.provenance["ingredients"][0]["columns"] == 0
        assert rom.frequencies.max() <= 200.0 and rom.size < 4


@pytest.mark.skipif(is_complex(), reason="inertia needs a real build")
def test_inspection(comm, linkage):
    report = hpcred.inspect(linkage, [300.0], band_top=300.0)
    assert report["rigid_body_modes"] == 6
    assert report["mass_kg"] == pytest.approx(5.39798, abs=1e-5)
    assert report["mass_matrix"] == "positive definite"
    assert report["elastic_modes_below_hz"][0] == [300.0, 7]
    framed = apply_frame(linkage, example.FRAME)
    supported = hpcred.inspect(framed.model, [600.0], band_top=300.0)
    assert supported["rigid_body_modes"] == 0
    assert supported["elastic_modes_below_hz"] == [[600.0, 13]]
    assert supported["size_hint"] == 14
    framed.close()


def test_mass_and_inertia_of_a_block(comm):
    with hpcred.solid((4, 3, 2), (0.4, 0.2, 0.1), 3, clamped=False, comm=comm) as model:
        report = hpcred.inspect(model)
    mass = 7850 * 0.4 * 0.2 * 0.1
    assert report["mass_kg"] == pytest.approx(mass)
    assert np.allclose(report["centre_of_mass_m"], [0.2, 0.1, 0.05])
    # the consistent mass matrix integrates trilinear fields exactly
    expected = mass / 12 * np.array([0.2**2 + 0.1**2, 0.4**2 + 0.1**2, 0.4**2 + 0.2**2])
    assert np.allclose(np.diag(report["inertia_kg_m2"]), expected)


def test_a_slender_block_bends_like_a_beam(comm):
    """Cantilever of Euler and Bernoulli: f1 = 1.8751^2 / (2 pi L^2) sqrt(E I / (rho A))."""
    first = 1.875104**2 / (2 * np.pi) * np.sqrt(2e11 * 0.02**2 / 12 / 7850)
    model = hpcred.solid((200, 2, 2), (1.0, 0.02, 0.02), 1, young=2e11, poisson=0.0, comm=comm)
    with model, hpcred.reduce(model, [Modes(count=2)]) as rom:
        assert np.allclose(rom.frequencies, first, rtol=0.03)


def test_repeated_reductions_do_not_pile_up_memory(comm):
    """petsc4py frees nothing by itself."""
    from pathlib import Path

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

    with hpcred.solid((14, 10, 10), inputs=6, comm=comm) as model:
        sizes = []
        for _ in range(12):
            hpcred.reduce(model, [Krylov(100.0, 1), Modes(count=2)]).close()
            sizes.append(resident())
    # one run keeps more than 15 MB in its matrices, factor and vectors, and the allocator comes to rest only slowly
    assert sizes[-1] - sizes[3] < 8 * 15.0 / 2
