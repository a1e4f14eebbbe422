"""Second-order Krylov subspaces, more expansion points, two-sided projection, damping laws, dominance."""

import numpy as np
import pytest
import scipy.linalg
from helpers import close, dense_model, gather, moments, second_order_moments, to_dense

import hpcred
from hpcred import (
    Buckens,
    Caughey,
    GivenDamping,
    Krylov,
    ModalDamping,
    Modes,
    Rayleigh,
    SecondOrderKrylov,
    StaticCorrection,
    Structural,
)
from hpcred.examples import linkage as example
from hpcred.examples.section5 import MIMO, SISO, compare
from hpcred.model.damping import is_proportional

pytestmark = pytest.mark.mpi


@pytest.fixture
def solid(comm):
    with hpcred.solid((4, 2, 3), inputs=3, comm=comm) as model:
        yield model


def damped(solid, unsymmetric=False):
    """The solid with Rayleigh damping, two discrete dampers, and perhaps a gyroscopic pair; D as numpy too."""
    K, M, B = dense_model(solid)
    D = 10.0 * M + 1e-5 * K
    D[5, 5] += 3e3
    D[40, 40] += 1e4
    if unsymmetric:
        D[5, 40] += 2e3
        D[40, 5] -= 2e3
    model = hpcred.SecondOrderModel.from_scipy(K, M, D, solid.comm)
    set_columns(model, "input", B)
    return model, K, M, D, B


def set_columns(model, key, array):
    mine = slice(model.first_row, model.first_row + model.local_rows)
    getattr(model, f"set_{key}_columns")(array[mine], [f"{key} {i}" for i in range(array.shape[1])])


POINTS = [
    {"frequency": 700.0, "order": 2},
    {"frequency": 300.0, "decay": 500.0, "order": 1},
    {"decay": 2000.0, "order": 2},
    {"s": (100.0, 4000.0), "order": 0},
    {"frequency": 0.0, "order": 2},
]


@pytest.mark.parametrize("unsymmetric", [False, True])
@pytest.mark.parametrize("point", POINTS)
def test_second_order_moments_match(solid, point, unsymmetric):
    """order + 1 moments; twice as many where V^T A V keeps the symmetry of the full model."""
    model, K, M, D, B = damped(solid, unsymmetric)
    ingredient = SecondOrderKrylov(**point)
    count = (ingredient.order + 1) * (1 if unsymmetric else 2)
    with model, hpcred.reduce(model, [ingredient], damping=GivenDamping()) as rom:
        assert rom.size == ingredient.columns(3, 0)
        for s in (ingredient.point, ingredient.point.conjugate()):
            full = second_order_moments(K, M, D, B, B.T, s, count)
            small = second_order_moments(rom.K, rom.M, rom.D, rom.B, rom.C, s, count)
            assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9


def test_high_orders_do_not_collapse(solid):
    """The bare recurrence has turned into the dominant modes long before order 9."""
    model, K, M, D, B = damped(solid)
    with model, hpcred.reduce(model, [SecondOrderKrylov(700.0, order=9)], damping=GivenDamping()) as rom:
        assert rom.size >= 50
        frequencies = np.linspace(10.0, 4000.0, 60)
        full = hpcred.frequency_response(model, frequencies, damping=GivenDamping())
        assert hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies)).max() < 1e-8


def test_without_damping_both_krylov_methods_span_the_same(solid):
    with (
        hpcred.reduce(solid, [Krylov(700.0, 2)]) as a,
        hpcred.reduce(solid, [SecondOrderKrylov(700.0, order=2)]) as b,
    ):
        assert np.allclose(a.frequencies, b.frequencies, rtol=1e-6)


@pytest.mark.parametrize("point", [{"decay": 3000.0, "order": 1}, {"frequency": 300.0, "decay": 3000.0, "order": 1}])
def test_moments_of_the_proportional_method_off_the_imaginary_axis(solid, point):
    K, M, B = dense_model(solid)
    ingredient = Krylov(**point)
    shift = ingredient.point**2
    with hpcred.reduce(solid, [ingredient]) as rom:
        full = moments(K + 0j, M, B, B.T, shift, 4)
        small = moments(rom.K + 0j, rom.M, rom.B, rom.C, shift, 4)
        assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9


def test_markov_parameters_match_at_infinity(solid):
    K, M, B = dense_model(solid)
    with hpcred.reduce(solid, [Krylov(infinity=True, order=2)]) as rom:
        x, y = np.linalg.solve(M, B), rom.B
        for _ in range(6):
            assert close(B.T @ x, rom.C @ y) < 1e-9
            x, y = np.linalg.solve(M, K @ x), rom.K @ y


@pytest.mark.parametrize("unsymmetric", [False, True])
def test_two_sided_projection_matches_twice_the_moments(solid, unsymmetric):
    model, K, M, D, B = damped(solid, unsymmetric)
    C = np.zeros((3, len(K)))
    C[0, 50] = C[1, 20] = C[2, 8] = 1.0
    with model:
        set_columns(model, "output", C.T)
        for point, two_sided in (({"frequency": 700.0, "order": 1}, True), ({"decay": 2000.0, "order": 1}, False)):
            ingredient = SecondOrderKrylov(**point)
            projection = "two_sided" if two_sided else "one_sided"
            with hpcred.reduce(
                model, [ingredient], None, GivenDamping(), projection=projection, allow_unstable=True
            ) as rom:
                count = 4 if two_sided else 2
                full = second_order_moments(K, M, D, B, C, ingredient.point, count)
                small = second_order_moments(rom.K, rom.M, rom.D, rom.B, rom.C, ingredient.point, count)
                assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9
                if two_sided:
                    V, W = gather(rom.columns), gather(rom.left_columns)
                    assert np.abs(W.T @ M @ V - np.eye(rom.size)).max() < 1e-10
                    assert close(rom.K, W.T @ K @ V) < 1e-9


def test_an_unstable_two_sided_model_is_refused(solid):
    C = np.zeros((2, solid.size))
    C[0, 50] = C[1, 20] = 1.0
    set_columns(solid, "input", dense_model(solid)[2][:, :2])
    set_columns(solid, "output", C.T)
    basis = [Krylov(700.0, 1), Krylov(0.0)]
    with hpcred.reduce(solid, basis, projection="two_sided", allow_unstable=True) as rom:
        unstable = rom.provenance["unstable_poles"]
    assert unstable
    with pytest.raises(hpcred.InputError, match="is unstable, with .* take projection = 'one_sided'"):
        hpcred.reduce(solid, basis, projection="two_sided")
    with hpcred.reduce(solid, basis, damping=Rayleigh(1.0, 1e-7)) as rom:
        assert not rom.provenance["unstable_poles"]


def test_caughey_series_against_dense_matrices(comm):
    """Five terms; full and reduced D, and Rayleigh as the series of two."""
    with hpcred.solid((2, 2, 2), inputs=2, comm=comm) as model:
        K, M, B = dense_model(model)
        a = (5.0, 2e-6, 3e-15, 1e-24, 4e-34)
        power, D = np.eye(len(K)), np.zeros_like(K)
        for coefficient in a:
            D += coefficient * M @ power
            power = np.linalg.solve(M, K) @ power
        frequencies = [0.0, 300.0, 2500.0]
        expected = []
        for s in 2j * np.pi * np.array(frequencies):
            expected.append(B.T @ np.linalg.solve(s * s * M + s * D + K, B.astype(complex)))
        full = hpcred.frequency_response(model, frequencies, damping=Caughey(a))
        assert close(np.array(expected), full) < 1e-8
        with hpcred.reduce(model, [Krylov(0.0, 1), Krylov(2500.0, 1)], damping=Caughey(a)) as rom:
            V = gather(rom.columns)
            assert close(V.T @ D @ V, rom.D) < 1e-8
            assert hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies)).max() < 1e-4
        two = hpcred.frequency_response(model, frequencies, damping=Caughey(a[:2]))
        assert close(two, hpcred.frequency_response(model, frequencies, damping=Rayleigh(*a[:2]))) < 1e-12


def test_modal_damping_ratios(solid):
    for law, ratios in (
        (ModalDamping(ratio=0.02), lambda f: np.full(len(f), 0.02)),
        (ModalDamping(ratios=(0.01, 0.03)), lambda f: np.where(np.arange(len(f)) == 0, 0.01, 0.03)),
        (ModalDamping(table=((500.0, 0.01), (2000.0, 0.04))), lambda f: np.interp(f, [500, 2000], [0.01, 0.04])),
    ):
        with hpcred.reduce(solid, [Modes(count=6), StaticCorrection()], damping=law) as rom:
            poles = rom.poles()
            poles = poles[poles.imag > 0]
            assert np.allclose(np.abs(poles), 2 * np.pi * rom.frequencies, rtol=1e-6)
            assert np.allclose(-poles.real / np.abs(poles), ratios(rom.frequencies), rtol=1e-6)
    with pytest.raises(hpcred.InputError, match="belong to a reduced model"):
        hpcred.frequency_response(solid, [10.0], damping=ModalDamping(ratio=0.02))


def test_structural_damping(solid):
    K, M, B = dense_model(solid)
    omega = 2 * np.pi * 900.0
    expected = B.T @ np.linalg.solve((1 + 0.05j) * K - omega**2 * M, B)
    law = Structural(0.05)
    full = hpcred.frequency_response(solid, [900.0, 0.0], damping=law)
    assert close(expected, full[0]) < 1e-9
    assert close(B.T @ np.linalg.solve((1 + 0.05j) * K, B), full[1]) < 1e-9
    with hpcred.reduce(solid, [Krylov(900.0, 3), Krylov(0.0, 1)], damping=law) as rom:
        assert rom.D.max() == 0.0
        assert hpcred.relative_error(full, hpcred.frequency_response(rom, [900.0, 0.0])).max() < 1e-5


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
            set_columns(damped_body, "input", B)
            full = hpcred.frequency_response(damped_body, [60.0], Buckens(), GivenDamping())
            assert close(expected, full[0]) < 1e-8
            basis = [Modes(count=3), SecondOrderKrylov(60.0, order=1)]
            with hpcred.reduce(damped_body, basis, Buckens(), GivenDamping()) as rom:
                assert close(expected, rom.transfer_function(s)) < 1e-8


def test_proportional_damping_is_recognised(solid):
    model, K, M, D, _ = damped(solid)
    with model:
        assert not is_proportional(model)
        with pytest.raises(hpcred.InputError, match="'second_order_krylov' fits"):
            hpcred.reduce(model, [Krylov(300.0, decay=20.0)], damping=GivenDamping())
        hpcred.reduce(model, [Krylov(300.0)], damping=GivenDamping()).close()
    with hpcred.SecondOrderModel.from_scipy(K, M, 3.0 * M + 1e-6 * K, solid.comm) as model:
        assert is_proportional(model)
    with pytest.raises(hpcred.InputError, match="'krylov' fits"):
        hpcred.reduce(solid, [SecondOrderKrylov(300.0)], damping=Caughey((1.0, 1e-6, 1e-16)))


def test_dominant_modes_are_those_that_the_loads_excite(comm):
    """A force along x on a bar: stretching modes matter, bending modes do not."""
    with hpcred.solid((12, 2, 2), (1.2, 0.2, 0.2), inputs=1, comm=comm) as bar:
        center = [node + 1 for node in range(12 * 9) if node % 9 == 4][-1]  # the middle of the end face
        bar.set_inputs([(center, "x")])
        with hpcred.reduce(bar, [Modes(count=20)]) as rom:
            share = np.abs(rom.B[:, 0]) ** 2 / rom.frequencies**2
            expected = rom.frequencies[np.sort(np.argsort(-share)[:3])]
        with hpcred.reduce(bar, [Modes(count=20, dominant=3)]) as rom:
            assert np.allclose(rom.frequencies, expected, rtol=1e-8)
            assert len(rom.provenance["ingredients"][0]["dominance"]) == 3
            longitudinal = 1 / (4 * 1.2) * np.sqrt(2.1e11 / 7850)
            assert abs(rom.frequencies[0] / longitudinal - 1) < 0.02


def test_tables_of_the_paper(comm):
    with hpcred.linkage(comm) as model:
        siso = compare(model, SISO, numbers=(2,))
        mimo = compare(model, MIMO, numbers=(1, 2)) if comm.size == 1 else []
    assert siso[0]["size"] == 14 and siso[0]["Q"] < 1e-8
    for result, q in zip(mimo, (2.03e-3, 8.5e-4), strict=False):
        assert result["size"] == 21
        assert result["Q"] == pytest.approx(q, rel=0.02)


def test_symmetric_pattern_of_an_unsymmetric_matrix(solid):
    """D may have entries where D^T has none; all matrices share one pattern, its transpose included."""
    K, M, B = dense_model(solid)
    D = np.zeros_like(K)
    D[0, -1] = 3.0
    with hpcred.SecondOrderModel.from_scipy(K, M, D, solid.comm) as model:
        assert np.array_equal(to_dense(model.D), D)
        transposed = model.D.transpose()
        assert np.array_equal(transposed.getValuesCSR()[1], model.K.getValuesCSR()[1])
        transposed.destroy()


@pytest.mark.parametrize("frame", [None, Buckens()])
def test_groups_of_ranks_share_the_frequencies(comm, frame):
    frequencies = [5.0, 60.0, 110.0, 250.0, 290.0]
    with hpcred.linkage(comm, inputs=(example.LOAD, (3, "ry"))) as model:
        model.set_outputs([(4, "x"), (17, "rz"), (20, "z")])
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
