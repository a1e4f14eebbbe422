"""Viscoelastic parts: laws, what is refused, and full responses against dense ones."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from helpers import bar, close, dense_model, to_dense
from viscoelastic_models import MAXWELL, SPRINGPOT, ZENER, Sandwich, law_at, sandwich

import hpcred
from hpcred import InputError, Viscoelastic
from hpcred.analysis import frequency_response
from hpcred.laws import Fractional, FractionalKelvinVoigt, Maxwell
from hpcred.model.frames import apply_frame
from hpcred.model.operator import ADDED

LAWS = (MAXWELL, ZENER, SPRINGPOT)
FREQUENCIES = np.array([0.0, 3.0, 61.0, 400.0, 2500.0])


@pytest.mark.parametrize("law", LAWS)
def test_laws(law):
    s = np.array([[2j, 50.0 + 3e3j], [1e5j, 4.0]])
    expected = np.array([[law_at(law, value) for value in row] for row in s])
    assert np.allclose(law.static + law.excess(s), expected, rtol=1e-13)
    assert law.static == law_at(law, 0.0) and law.excess(0.0) == 0
    step = 1e-6 * s
    assert np.allclose(law.slope(s), (law.excess(s + step) - law.excess(s - step)) / (2 * step), rtol=1e-7)


@pytest.mark.parametrize("law", [*LAWS, hpcred.laws.Hysteretic((1.0, 10.0), (0.1, 0.2)),
                                 FractionalKelvinVoigt(low=1.0, rise=2.0, time=1.0, exponent=0.5)])  # fmt: skip
def test_the_power_of_a_law_is_that_with_which_it_begins(law):
    """What it adds to the static stiffness, at frequencies near zero."""
    few, many = np.abs(law.coefficient(np.array([1e-14j, 1e-10j])))
    assert np.log10(many / few) / 4 == pytest.approx(law.power, abs=1e-3)


@pytest.mark.parametrize("law, wanted, message", [
    (Maxwell, {"factors": [1.0], "times": []}, "found 1 factors and 0 times"),
    (Maxwell, {"factors": [], "times": []}, "expected one of each"),
    (Maxwell, {"factors": [-1.0], "times": [1.0]}, "law.factors: found -1, expected 0 to"),
    (Maxwell, {"factors": [1.0], "times": [0.0]}, "law.times: found 0, expected 1e-30 to 1e\\+30 s"),
    (Maxwell, {"factors": [1.0], "times": [1.0], "constant": np.nan}, "law.constant: found nan"),
    (Fractional, {"low": 2.0, "high": 1.0, "time": 1.0, "exponent": 0.5}, "low = 2 above high = 1"),
    (Fractional, {"low": 1.0, "high": 2.0, "time": 1.0, "exponent": 1.5}, "law.exponent: found 1.5, expected 0.001"),
    (FractionalKelvinVoigt, {"low": 1.0, "rise": -2.0, "time": 1.0, "exponent": 0.5}, "law.rise: found -2"),
])  # fmt: skip
def test_laws_that_are_refused(law, wanted, message):
    with pytest.raises(InputError, match=message):
        law(**wanted)


@pytest.mark.parametrize("change, message", [
    (lambda K: K[:-1, :-1], "Kv1: found 39 rows of K_v, expected 40 as K of sandwich has"),
    (lambda K: K + np.triu(K, 1), "Kv1: found an unsymmetric K_v"),
    (lambda K: -K, "Kv1: x\\^T K_v x comes down to"),
    (lambda K: 0.0 * K, "Kv1: K_v is zero"),
    (lambda K: K * np.nan, "entries that are NaN"),
    (lambda K: K[0], "expected a square matrix"),
])  # fmt: skip
def test_matrices_that_are_refused(comm, change, message):
    case = sandwich()
    wrong = Sandwich(case.K, case.M, case.B, [(change(case.parts[0][0]), ZENER)])
    with pytest.raises(InputError, match=message):
        wrong.model(comm)


@pytest.mark.parametrize("names", [("rubber", "rubber"), ("", "Kv1"), ("Kv2", "")])
def test_two_parts_of_one_name_are_refused(comm, names):
    case = sandwich()
    K_v = case.parts[0][0]
    parts = [Viscoelastic(K_v, ZENER, name=name) for name in names]
    with (hpcred.SecondOrderModel.from_scipy(case.K, case.M, None, comm, inputs=case.B) as elastic,
          pytest.raises(InputError, match="two viscoelastic parts with the name '(rubber|Kv[12])'")):  # fmt: skip
        elastic.with_viscoelastic(parts)


@pytest.mark.parametrize("high, low, fits", [
    (None, -0.5, True), (None, -1.5, False), (20.0, -10.0, True), (20.0, -60.0, False), (20.0, 0.0, True),
])  # fmt: skip
def test_round_off_of_stiff_parts_passes(comm, high, low, fits):
    """A diagonal of 1, and the eigenvalues `high` of the sum of all rows, `low` in 1e-7 of their alternating sum, and
    one that all others have; what is below zero is measured by the largest."""
    n, low = 40, low * 1e-7
    high = high or (n - low) / (n - 1)
    even, odd = np.full((n, n), 1 / n), np.where(np.indices((n, n)).sum(axis=0) % 2, -1 / n, 1 / n)
    K = high * even + low * odd + (n - high - low) / (n - 2) * (np.eye(n) - even - odd)
    assert np.diag(K) == pytest.approx(1.0) and np.linalg.eigvalsh(K)[0] == pytest.approx(low, abs=1e-13)
    case = sandwich()
    damped = Sandwich(case.K, case.M, case.B, [(K, ZENER)])
    if fits:
        damped.model(comm).close()
    else:
        with pytest.raises(InputError, match="comes down to"):
            damped.model(comm)


def test_what_is_no_law_is_refused():
    with pytest.raises(InputError, match="law: found 'rubber'"):
        Viscoelastic(np.eye(3), "rubber")


@pytest.mark.mpi
def test_matrices_of_a_model(comm):
    case = sandwich((MAXWELL, ZENER))
    with case.model(comm) as model:
        assert sorted(model.matrices) == ["K", "Kv1", "Kv2", "M"]
        assert [part.name for part in model.viscoelastic] == ["Kv1", "Kv2"]
        assert close(case.stiffness(0.0), to_dense(model.K)) < 1e-14
        assert close(case.parts[1][0], to_dense(model.viscoelastic[1].matrix)) < 1e-15
        assert "Kv2" in str(model)
        twice = model.viscoelastic[0].matrix.copy()
        twice.scale(2.0)
        digests = model.digests
        with model.with_fields(Kv1=twice) as changed:  # another model, also for stores
            assert changed.digests[ADDED] != digests[ADDED]
        with model.with_fields(name="other") as same:
            assert same.digests == digests
        with pytest.raises(InputError, match="has viscoelastic parts already"):
            model.with_viscoelastic([Viscoelastic(np.eye(40), ZENER)])
        with model.with_inputs([1]) as other:
            assert other.digest_of("Kv1") == model.digest_of("Kv1") != model.digest_of("Kv2")


@pytest.mark.mpi
@pytest.mark.parametrize("tiny", [0, 150])
def test_full_response(comm, monkeypatch, tiny):
    monkeypatch.setattr(frequency_response, "TINY", tiny)
    for case in (sandwich(LAWS, inputs=2), sandwich((ZENER,), outputs=2, damped=True)):
        with case.model(comm) as model:
            assert close(case.truth(FREQUENCIES)[0], model.frequency_response(FREQUENCIES)) < 1e-10
            damping = hpcred.GivenDamping(0.03) if case.D is not None else hpcred.Structural(0.03)
            found = model.frequency_response(FREQUENCIES, damping=damping)
            assert close(case.truth(FREQUENCIES, 0.03)[0], found) < 1e-10


def test_long_series_are_refused(comm):
    with sandwich().model(comm) as model, pytest.raises(InputError, match="viscoelastic parts, beside which a Caughey"):
        model.frequency_response([3.0], damping=hpcred.Caughey([1.0, 1e-6, 1e-12]))


@pytest.mark.mpi
def test_frames_and_interfaces_change_k_v_as_k(solid):
    """K_v = K: the response is that of a structural loss factor, with complex stiffness g K."""
    K = solid.K.copy()
    with solid.with_viscoelastic([Viscoelastic(K, SPRINGPOT)]) as model:
        interface = hpcred.Interface(name="end", nodes=hpcred.Nodes(box=((0.035, -1, -1), (1, 1, 1))), kind="rigid")
        with model.with_interfaces([interface]) as coupled:
            framed = apply_frame(coupled).model
            assert framed.size < coupled.size
            expected = (1 + law_at(SPRINGPOT, 0.0)) * to_dense(framed.viscoelastic[0].matrix)
            assert close(to_dense(framed.K), expected) < 1e-14


@pytest.mark.mpi
def test_units(solid):
    """mm, t, s: a stiffness in N/mm is a thousand times larger in SI."""
    K = solid.K.copy()
    units = hpcred.model.units_of("mm,t,s")
    with solid.with_viscoelastic([Viscoelastic(K, ZENER)]) as model, hpcred.model.in_si(model, units) as si:
        assert close(to_dense(si.viscoelastic[0].matrix), 1e3 * to_dense(K)) < 1e-14


def test_a_part_that_holds_a_free_body_is_refused(comm):
    """K alone is that of a free body where the mount carries nothing at rest."""
    mount = np.zeros((120, 120))
    mount[2, 2] = 1e5
    law = Maxwell(factors=[1.0], times=[1e-3])
    message = "the viscoelastic part mount of .* resists its rigid-body motions"
    with (
        hpcred.linkage(comm) as model, model.with_viscoelastic([Viscoelastic(mount, law, "mount")]) as held,
        pytest.raises(InputError, match=message),
    ):  # fmt: skip
        apply_frame(held, hpcred.Buckens())


@pytest.mark.mpi
@pytest.mark.costly
def test_a_free_body(comm):
    """K_v = K, by modes: the elastic part of a body of viscoelastic material."""
    law, f = Maxwell(factors=[1.0, 0.3], times=[1e-3, 1e-5]), np.array([20.0, 90.0])
    with bar(comm, 2.0, 6) as beam, beam.with_inputs([(1, "y"), (3, "z")]) as model:
        K, M, B = dense_model(model)
        with model.with_viscoelastic([Viscoelastic(model.K.copy(), law, "core")]) as free:
            values, modes = scipy.linalg.eigh(K, M)
            loads = (modes.T @ B)[6:]
            s = 2j * np.pi * f
            diagonal = s[:, None] ** 2 + (1 + law.excess(s))[:, None] * values[6:]
            expected = np.array([loads.T @ (loads / row[:, None]) for row in diagonal])
            assert close(expected, free.frequency_response(f, frame=hpcred.Buckens())) < 1e-8
            with hpcred.reduce(free, frame=hpcred.Buckens(), tolerance=1e-4, band=(0, 100)) as rom:
                assert close(expected, rom.frequency_response(f)) < 2e-4


@pytest.mark.mpi
def test_parameters_beside_it(comm):
    """A term off the pattern of K brings K_v to the pattern of all."""
    case, spring = sandwich((MAXWELL,)), np.zeros((40, 40))
    spring[np.ix_([3, 31], [3, 31])] = 2e6 * np.array([[1, -1], [-1, 1]])
    f = np.array([20.0, 300.0])
    with (
        case.model(comm) as model,
        hpcred.ParametricModel(model, [hpcred.Parameter("p", (0.0, 1.0))], [hpcred.Term("K", spring, "p")]) as whole,
    ):
        for p in (0.0, 0.7):
            with whole.at(p=p) as there:
                case.K = sandwich((MAXWELL,)).K + p * spring
                assert close(case.truth(f)[0], there.frequency_response(f)) < 1e-10


def two_materials(model, young=None):
    """The block with its elements beyond the middle of a second material, "rubber"."""
    properties = model.properties
    steel = properties.materials[0]
    rubber = replace(steel, name="rubber", young=young or steel.young)
    table = {}
    for kind in model.elements:
        table[kind] = properties.table[kind].copy()
        table[kind][:, 2] = table[kind][:, 0] % 4 >= 2
    return model.with_fields(properties=replace(properties, materials=(steel, rubber), table=table))


@pytest.mark.mpi
def test_stiffness_of_a_material(comm):
    """The elements of all materials make up K; g = 1 is the model as it was."""
    with hpcred.solid((4, 2, 3), inputs=2, clamped=False, comm=comm) as block, two_materials(block) as model:
        names = [item.name for item in model.properties.materials]
        parts = [to_dense(hpcred.material_stiffness(model, name)) for name in names]
        assert all(np.linalg.matrix_rank(part) < len(part) for part in parts)
        assert close(to_dense(model.K), sum(parts)) < 1e-12
        law = Maxwell(factors=[2.0], times=[1e-4], constant=1.0)
        core = Viscoelastic(hpcred.material_stiffness(model, "rubber"), law, "rubber", within=True)
        with model.with_viscoelastic([core]) as damped:
            assert close(to_dense(model.K), to_dense(damped.K)) < 1e-12
            K, M, B = dense_model(model)
            s = 2j * np.pi * 5000.0
            expected = B.T @ np.linalg.solve(s * s * M + K + law.excess(s) * parts[1], B)
            assert close(expected, damped.frequency_response([5000.0])[0]) < 1e-9


@pytest.mark.mpi
def test_materials_that_are_refused(solid):
    with pytest.raises(InputError, match="material 'rubber': solid has no such material; it has"):
        hpcred.material_stiffness(solid, "rubber")
    with two_materials(solid, young=1e6) as model, pytest.raises(InputError, match="K of solid has other numbers in"):
        hpcred.material_stiffness(model, "rubber")


def test_section_forces_are_refused(solid):
    nodes = np.unique(solid.dofs.node[solid.dofs.position[:, 0] > 0.025])
    with solid.with_fields(sets={"TIP": nodes}) as model:
        part, cut = Viscoelastic(model.K.copy(), MAXWELL), hpcred.outputs.CutOutput(cut="TIP")
        with model.with_outputs([cut]) as measured, pytest.raises(InputError, match="leave the outputs of cuts out"):
            measured.with_viscoelastic([part])
        with model.with_viscoelastic([part]) as damped, pytest.raises(InputError, match="that of the static stiffness"):
            damped.with_outputs([cut])
