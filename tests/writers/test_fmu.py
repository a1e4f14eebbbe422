"""FMUs: FMPy validates and runs them, and they move as the exact solution of the reduced equations of motion does."""

import shutil
import subprocess
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
import scipy.linalg
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

import hpcred
from hpcred import Buckens, Modes, Parameter, ParametricModel, Rayleigh, Term
from hpcred.model.damping import GivenDamping
from hpcred.parallel.failures import ComputationError, InputError
from hpcred.reduction.parametric.reduced import ParametricReducedModel, ReducedTerm, projected_parts
from hpcred.writers.arrays import words_on_damping
from hpcred.writers.fmu import Family, write_fmu
from hpcred.writers.state_space import state_space

pytestmark = pytest.mark.peers("fmpy")

STEP, COUNT = 1e-3, 60


@pytest.fixture(scope="module")
def body():
    """Of the linkage: a force and a moment in, a displacement, a rotation and a row number out; M is not I."""
    with hpcred.linkage() as model:
        model = model.with_inputs([(20, "z"), (1, "rx")]).with_outputs([(7, "z"), (20, "rx"), 117])
        modes = [Modes(index=tuple(range(7, 17)))]
        with hpcred.reduce(model, modes, Buckens(), Rayleigh(2.0, 1e-5)) as rom:
            reduced = rom
    T = np.eye(reduced.size) + 0.3 * np.random.default_rng(1).standard_normal((reduced.size,) * 2)
    M, D, K = (T.T @ matrix @ T for matrix in (reduced.M, reduced.D, reduced.K))
    return replace(reduced, M=M, D=D, K=K, B=T.T @ reduced.B, C=reduced.C @ T)


@pytest.fixture(scope="module")
def fmu(body, tmp_path_factory, flags_of_fmus):
    """As users have it."""
    path = tmp_path_factory.mktemp("fmu") / "body.fmu"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hpcred.writers.fmu.FLAGS", flags_of_fmus)
        write_fmu(path, body)
    return path


def exact(reduced, steps, u, slope, x=None):
    """Displacements and velocities after steps of given lengths with inputs u (k, p) + slope (k, p) t, by expm."""
    s = state_space(reduced)
    A, B, C = s["A"], s["B"], np.concatenate([s["C"], s["C_velocity"]])
    n, p = B.shape
    x = np.zeros(n) if x is None else x
    # x' = A x + B u, u' = slope, slope' = 0
    system = np.block([[A, B, np.zeros((n, p))], [np.zeros((p, n + p)), np.eye(p)], [np.zeros((p, n + 2 * p))]])
    flow, found = {}, [C @ x]
    for h, load, rate in zip(steps, u, slope, strict=True):
        if h not in flow:
            flow[h] = scipy.linalg.expm(h * system)
        x = (flow[h] @ np.concatenate([x, load, rate]))[:n]
        found.append(C @ x)
    return np.array(found)


def numbers(result):
    """The columns of a result of FMPy behind the time."""
    return np.array([result[name] for name in result.dtype.names[1:]]).T


@contextmanager
def slave(path):
    """An instance for co-simulation in its first step mode."""
    description, folder = fmpy.read_model_description(path), fmpy.extract(path)
    instance = FMU2Slave(guid=description.guid, unzipDirectory=folder, instanceName="body",
                         modelIdentifier=description.coSimulation.modelIdentifier)  # fmt: skip
    instance.instantiate()
    instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    try:
        yield instance
    finally:
        instance.terminate()
        instance.freeInstance()
        shutil.rmtree(folder)


def test_fmpy_finds_no_fault(body, fmu):
    assert validate_fmu(str(fmu)) == []
    description = fmpy.read_model_description(fmu)
    names = {v.name: v.unit for v in description.modelVariables if v.causality in ("input", "output")}
    assert names == {
        "force_20_z": "N", "moment_1_rx": "N.m",
        "displacement_7_z": "m", "rotation_20_rx": "rad", "output_dof_117": None,
        "velocity_7_z": "m/s", "angular_velocity_20_rx": "rad/s", "output_rate_dof_117": None,
    }  # fmt: skip
    assert description.modelName == "linkage"
    assert len(description.derivatives) == 2 * body.size
    # no output depends on an input at once, so that a loop through the body is no algebraic one
    known = {v.name for unknown in description.outputs for v in unknown.dependencies}
    assert known == {f"{letter}[{i + 1}]" for letter in "qv" for i in range(body.size)}


def test_the_step_response_is_exact_in_co_simulation(body, fmu):
    """10 N, which do not change between communication points."""
    names = [v.name for v in fmpy.read_model_description(fmu).modelVariables if v.causality == "output"]
    result = fmpy.simulate_fmu(fmu, fmi_type="CoSimulation", stop_time=COUNT * STEP, output_interval=STEP,
                               start_values={"force_20_z": 10.0}, output=names)  # fmt: skip
    expected = exact(body, [STEP] * COUNT, [[10.0, 0.0]] * COUNT, np.zeros((COUNT, 2)))
    scale = np.abs(expected).max(axis=0)
    assert (np.abs(numbers(result) - expected).max(axis=0) < 1e-11 * scale).all() and (scale > 0).all()


def test_the_step_response_in_model_exchange(body, fmu):
    """CVode of FMPy, to its tolerance."""
    names = [v.name for v in fmpy.read_model_description(fmu).modelVariables if v.causality == "output"]
    result = fmpy.simulate_fmu(fmu, fmi_type="ModelExchange", stop_time=COUNT * STEP, output_interval=STEP,
                               start_values={"force_20_z": 10.0}, output=names, relative_tolerance=1e-8)  # fmt: skip
    expected = exact(body, [STEP] * COUNT, [[10.0, 0.0]] * COUNT, np.zeros((COUNT, 2)))
    assert (np.abs(numbers(result) - expected).max(axis=0) < 1e-5 * np.abs(expected).max(axis=0)).all()


def test_maxwell_elements_are_coordinates(tmp_path):
    """The states of the state space, by masses of their own; velocities and accelerations are outputs too."""
    n = 8
    K = (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)) * 1e5
    soft = np.zeros((n, n))
    soft[2:5, 2:5] = K[2:5, 2:5]
    law = hpcred.laws.Maxwell(factors=[0.5, 0.8], times=[2e-2, 1e-3], constant=0.2)
    C = np.zeros((3, n))
    C[[0, 1, 2], [6, 1, 4]] = 1.0
    rates = {"C": C * [[1], [0], [0]], "Cv": C * [[0], [1], [0]], "Ca": C * [[0], [0], [1]]}
    with (
        hpcred.SecondOrderModel(np.eye(n), 0.5 * np.eye(n), K, np.eye(n)[:, :2], **rates) as plain,
        plain.with_viscoelastic([hpcred.Viscoelastic(soft, law, "rubber")]) as model,
        hpcred.reduce(model, [Modes(count=6)]) as rom,
    ):
        reduced = rom
    remarks = write_fmu(tmp_path / "body.fmu", reduced)
    assert any("are the dashpots of Maxwell elements" in text for text in remarks)
    assert validate_fmu(str(tmp_path / "body.fmu")) == []
    names = [v.name for v in fmpy.read_model_description(tmp_path / "body.fmu").modelVariables
             if v.causality == "output"]  # fmt: skip
    result = fmpy.simulate_fmu(
        tmp_path / "body.fmu", fmi_type="CoSimulation", stop_time=COUNT * STEP, output_interval=STEP, output=names,
        start_values={fmpy.read_model_description(tmp_path / "body.fmu").modelVariables[0].name: 10.0},
    )  # fmt: skip
    s = state_space(reduced)
    A, B, u = s["A"], s["B"], np.array([10.0, 0.0])
    flow = scipy.linalg.expm(STEP * np.block([[A, (B @ u)[:, None]], [np.zeros((1, len(A) + 1))]]))
    x, expected = np.append(np.zeros(len(A)), 1.0), []
    for _ in range(COUNT + 1):
        expected.append(np.concatenate([s["C"] @ x[:-1] + s["D"] @ u, s["C_velocity"] @ x[:-1]]))
        x = flow @ x
    expected, found = np.array(expected)[1:], numbers(result)[1:]
    assert found.shape[1] == 4 and np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
    without = replace(reduced, viscoelastic=())
    assert np.abs(without.poles().real).max() < 0.5 < np.abs(reduced.poles().real).max()
    springpot = hpcred.laws.FractionalKelvinVoigt(low=1.0, rise=0.2, time=1e-3, exponent=0.4)
    fractional = replace(reduced, viscoelastic=(replace(reduced.viscoelastic[0], law=springpot),))
    with pytest.raises(hpcred.InputError, match="fractional, which no finite number of states has in an FMU"):
        write_fmu(tmp_path / "other.fmu", fractional)


def test_linear_inputs_steps_of_many_sizes_and_saved_states(body, fmu):
    """Inputs with derivatives are followed exactly over steps of any size; a state that was saved comes back."""
    rng = np.random.default_rng(2)
    steps = [1e-3, 1e-3 * (1 + 3e-13), 1e-3 * (1 - 8e-10), 2e-2, 1e-6, 3e-4, 3e-4, 0.0, 0.1]
    u, slope = rng.standard_normal((2, len(steps), 2)) * np.array([[[10.0]], [[1e3]]])
    expected = exact(body, steps, u, slope)
    with slave(fmu) as instance:
        time = 0.0
        for k, h in enumerate(steps):
            instance.setReal([0, 1], u[k])
            instance.setRealInputDerivatives([0, 1], [1, 1], slope[k])
            if k == 4:
                saved = instance.getFMUstate()
                written = instance.serializeFMUstate(saved)
                instance.doStep(time, 0.7)
                instance.setFMUstate(saved)
                instance.freeFMUstate(saved)
                instance.doStep(time, 0.2)
                saved = instance.deSerializeFMUstate(written)
                instance.setFMUstate(saved)
                instance.freeFMUstate(saved)
            instance.doStep(time, h)
            time += h
            found = np.array(instance.getReal(list(range(2, 8))))
            assert (np.abs(found - expected[k + 1]) < 1e-11 * np.abs(expected).max(axis=0)).all()
        instance.reset()
        assert not np.any(instance.getReal(list(range(8 + 4 * body.size))))


def test_directional_derivatives_are_the_matrices(body, fmu):
    s = state_space(body)
    with slave(fmu) as instance:
        first, last = 8, 8 + 2 * body.size
        states, rates = list(range(first, last)), list(range(last, last + 2 * body.size))
        for unknown, known, matrix in ((rates, states, s["A"]), (rates, [0, 1], s["B"]), ([2, 3, 4], states, s["C"]),
                                       ([5, 6, 7], states, s["C_velocity"]), ([2, 5], [0, 1], np.zeros((2, 2)))):
            columns = [instance.getDirectionalDerivative(unknown, [reference], [1.0]) for reference in known]
            found = np.array(columns).T
            assert found == pytest.approx(matrix, rel=1e-12)


def test_what_cannot_be_is_refused_by_the_fmu(fmu):
    with slave(fmu) as instance:
        for refused in (
            lambda: instance.setReal([2], [1.0]),
            lambda: instance.getReal([10**6]),
            lambda: instance.doStep(0.0, -1.0),
            lambda: instance.doStep(0.0, np.nan),
            lambda: instance.setRealInputDerivatives([0], [2], [1.0]),
            lambda: instance.getInteger([0]),
            lambda: instance.setReal([0], [np.nan]),
            lambda: instance.setReal([0], [np.inf]),
            lambda: instance.setRealInputDerivatives([0], [1], [np.nan]),
        ):
            with pytest.raises(Exception, match="failed with status"):
                refused()
        instance.doStep(0.0, STEP)
    description, folder = fmpy.read_model_description(fmu), fmpy.extract(fmu)
    other = FMU2Slave(guid="{another}", unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier)
    with pytest.raises(Exception, match="Failed to instantiate"):
        other.instantiate()
    shutil.rmtree(folder)


def said_of_sources(path, folder):
    """What the compiler says of the sources in an FMU."""
    folder, headers = Path(fmpy.extract(path, unzipdir=str(folder))), Path(fmpy.__file__).with_name("c-code")
    return subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only", f"-I{headers}",
         str(folder / "sources/body.c")], capture_output=True, text=True,
    ).stderr  # fmt: skip


def test_the_sources_are_whole_and_the_file_is_always_the_same(body, fmu, tmp_path, monkeypatch, flags_of_fmus):
    """With the headers of FMPy, which are those of the standard, and all warnings."""
    monkeypatch.setattr("hpcred.writers.fmu.FLAGS", flags_of_fmus)
    assert said_of_sources(fmu, tmp_path / "extracted") == ""
    write_fmu(tmp_path / "again.fmu", body)
    assert (tmp_path / "again.fmu").read_bytes() == fmu.read_bytes()


@pytest.mark.parametrize(
    "name, shown, identifier",
    [
        ("Rod <2> & \"Größe\"", "Rod <2> & \"Größe\"", "Rod__2_____Gr__e_"),
        ("\x01\ufffe\udc80", "body", "body"),
        ("7" * 250, "7" * 250, "body_" + "7" * 63),
    ],
)
def test_a_body_of_any_name(body, tmp_path, name, shown, identifier):
    path = tmp_path / "body.fmu"
    write_fmu(path, body, name)
    description = fmpy.read_model_description(path)  # validated
    assert description.modelName == shown
    assert description.coSimulation.modelIdentifier == identifier
    with slave(path) as instance:
        instance.doStep(0.0, STEP)


def test_a_machine_that_cannot_compile_says_so(body, tmp_path, monkeypatch):
    for compiler, error, says in (
        ("no-such-cc -m64", InputError, "needs a C compiler, and there is no 'no-such-cc' on this machine; install"),
        ("false", ComputationError, r"not compiled by false \(exit status 1\): nothing said"),
        ("cc -include none.h", ComputationError, "not compiled by cc .*none.h"),
    ):
        monkeypatch.setenv("CC", compiler)
        with pytest.raises(error, match=says):
            write_fmu(tmp_path / "body.fmu", body)
    with pytest.raises(InputError, match="an FMU needs inputs and outputs"):
        write_fmu(tmp_path / "body.fmu", replace(body, input_names=()))
    with pytest.raises(InputError, match="no place in an FMU"):
        write_fmu(tmp_path / "body.fmu", replace(body, loss_factor=0.02))
    assert not list(tmp_path.iterdir())


def test_loads_are_inputs_by_their_names(tmp_path):
    """A pressure: its factor in, work and power out, with their units, and the motion by the exact solution."""
    end = hpcred.Nodes(box=((0.039, -1.0, -1.0), (0.041, 1.0, 1.0)))
    with (
        hpcred.solid((4, 2, 2), inputs=1) as model,
        model.with_loads([hpcred.loads.Pressure(name="oil", on=end, value=1e6)]) as loaded,
        hpcred.reduce(loaded, [Modes(count=4), hpcred.StaticCorrection()], damping=Rayleigh(0.0, 1e-6)) as rom,
    ):
        reduced = rom
    path = tmp_path / "loaded.fmu"
    write_fmu(path, reduced)
    assert not validate_fmu(str(path))
    described = fmpy.read_model_description(str(path))
    units = {item.name: item.unit for item in described.modelVariables}
    name = reduced.input_names[0].replace(":", "_")
    assert units["load_oil"] is None and units["work_oil"] == "J" and units["power_oil"] == "W"
    assert units[f"force_{name}"] == "N"
    steps = np.full(50, 1e-5)
    signal = np.zeros(51, dtype=[("time", float), ("load_oil", float)])
    signal["time"], signal["load_oil"] = np.linspace(0, 50e-5, 51), 2.0
    found = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", stop_time=50e-5, output_interval=1e-5, input=signal,
                              output=["work_oil", f"displacement_{name}"])  # fmt: skip
    k = list(reduced.input_names).index("oil")
    u = np.zeros((50, 2))
    u[:, k] = 2.0
    expected = exact(reduced, steps, u, np.zeros_like(u))
    assert found["work_oil"] == pytest.approx(expected[:, k], rel=1e-6, abs=1e-9 * np.abs(expected[:, k]).max())
    other = expected[:, 1 - k]
    assert found[f"displacement_{name}"] == pytest.approx(other, rel=1e-6, abs=1e-9 * np.abs(other).max())


SHORT = 2e-5  # s
FACTORS = ("-omega^2/1e4", "2*exp(-omega/50)*sin(pi*e)", "abs(e - 1)/(1 + sqrt(omega))", "1 + tan(e/3)^2", "log(e)")


@pytest.fixture(scope="module")
def family():
    """A block whose matrices K, D, B and C depend on two parameters, with an acceleration among the outputs."""
    rng = np.random.default_rng(3)
    with hpcred.solid((3, 2, 2), inputs=2) as plain:
        n = plain.size
        K = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.05)
        terms = [
            Term("K", 1e7 * (K @ K.T), FACTORS[0]), Term("D", 1e2 * (K - K.T), FACTORS[1]),
            Term("D", 1e2 * (K @ K.T), FACTORS[2]), Term("B", rng.normal(size=(n, 2)), FACTORS[3]),
            Term("K", 1e8 * np.eye(n), FACTORS[4]),
        ]  # fmt: skip
        outputs = [(20, "z"), hpcred.outputs.MotionOutput(node=20, direction="x", quantity="acceleration")]
        parameters = [Parameter("omega", (0.0, 100.0), unit="rad/s"), Parameter("e", (0.5, 1.5), 1.2)]
        with plain.with_outputs(outputs) as model, ParametricModel(model, parameters, terms) as parametric:
            reference = parametric.at()
            with reference, hpcred.reduce(reference, [Modes(count=6)], None, GivenDamping()) as reduced:
                parts = projected_parts(parametric, reduced, GivenDamping())
                known = {item.name: getattr(reduced, item.name) for item in fields(reduced)}
    known |= {"columns": None, "model": None}
    return ParametricReducedModel(**known, parameters=parametric.parameters, **parts)


@pytest.fixture(scope="module")
def family_fmu(family, tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "body.fmu"
    assert len(write_fmu(path, family.base, parametric=family)) == 1
    return path


VALUES = [{}, {"omega": 37.5, "e": 0.8}, {"omega": 100.0}, {"e": 1.5, "omega": 0.0}]


@pytest.mark.parametrize("values", VALUES)
def test_the_step_response_at_values(family, family_fmu, values):
    names = [v.name for v in fmpy.read_model_description(family_fmu).modelVariables if v.causality == "output"]
    first = next(v.name for v in fmpy.read_model_description(family_fmu).modelVariables if v.causality == "input")
    result = fmpy.simulate_fmu(family_fmu, fmi_type="CoSimulation", stop_time=COUNT * SHORT, output_interval=SHORT,
                               start_values={first: 10.0} | values, output=names)  # fmt: skip
    at = replace(family.base, **family.matrices(values)) if values else family.base
    expected = exact(at, [SHORT] * COUNT, [[10.0, 0.0]] * COUNT, np.zeros((COUNT, 2)))
    expected[:, :2] += state_space(at)["D"] @ [10.0, 0.0]
    scale = np.abs(expected).max(axis=0)
    assert (np.abs(numbers(result) - expected).max(axis=0) < 1e-9 * scale).all() and (scale > 0).all()


def test_maxwell_elements_beside_parameters(family, tmp_path):
    root = np.random.default_rng(5).normal(size=(family.size, 2))
    law = hpcred.laws.Maxwell(factors=[0.5, 2.0], times=[2e-4, 1e-3])
    rubber = hpcred.Viscoelastic(1e7 * root @ root.T, law, "rubber")
    damped = ParametricReducedModel.of(
        replace(family.base, viscoelastic=(rubber,)), parameters=family.parameters, constant=family.constant,
        terms=family.terms,
    )  # fmt: skip
    remarks = write_fmu(tmp_path / "body.fmu", damped.base, parametric=damped)
    assert any("the last 4 coordinates are the dashpots" in text for text in remarks)
    variables = fmpy.read_model_description(tmp_path / "body.fmu").modelVariables
    names, first = [v.name for v in variables if v.causality == "output"], variables[0].name
    result = fmpy.simulate_fmu(tmp_path / "body.fmu", fmi_type="CoSimulation", stop_time=COUNT * SHORT,
                               output_interval=SHORT, start_values={first: 10.0} | VALUES[1], output=names)  # fmt: skip
    for each, far in ((damped, False), (family, True)):
        at = replace(each.base, **each.matrices(VALUES[1]))
        expected = exact(at, [SHORT] * COUNT, [[10.0, 0.0]] * COUNT, np.zeros((COUNT, 2)))
        expected[:, :2] += state_space(at)["D"] @ [10.0, 0.0]
        distance = np.abs(numbers(result) - expected).max(axis=0) / np.abs(expected).max(axis=0)
        assert distance[0] > 1e-3 if far else distance.max() < 1e-8


def test_modal_damping_is_no_sum_of_terms(family):
    """D follows the eigenfrequencies at each value: an FMU is at the reference values, and files of arrays say so."""
    modal = replace(family, record=replace(family.record, damping=hpcred.ModalDamping(ratio=0.02)))
    assert modal.damping_follows and not family.damping_follows
    found = Family.of(modal, modal.base)
    assert not found.parameters and not found.terms and "the damping follows the eigenfrequencies" in found.remarks[0]
    assert "constant_D is the damping at the reference" in words_on_damping(modal)[0] and not words_on_damping(family)


def test_fmpy_finds_no_fault_and_sees_parameters(family_fmu, tmp_path):
    assert validate_fmu(str(family_fmu)) == []
    assert said_of_sources(family_fmu, tmp_path / "extracted") == ""
    found = {v.name: v for v in fmpy.read_model_description(family_fmu).modelVariables if v.causality == "parameter"}
    assert list(found) == ["omega", "e"]
    omega = found["omega"]
    assert (omega.unit, float(omega.min), float(omega.max), float(omega.start)) == ("rad/s", 0.0, 100.0, 50.0)
    assert found["e"].variability == "fixed" and float(found["e"].start) == 1.2


def test_values_out_of_range_are_refused_and_states_keep_theirs(family_fmu):
    reference = {v.name: v.valueReference for v in fmpy.read_model_description(family_fmu).modelVariables}
    with slave(family_fmu) as instance:
        instance.setReal([reference["omega"]], [80.0])
        saved = instance.getFMUstate()
        instance.setReal([0], [3.0])
        instance.doStep(0.0, SHORT)
        there = instance.getReal([2])
        instance.setReal([reference["omega"]], [10.0])
        instance.setFMUstate(saved)
        assert instance.getReal([reference["omega"], reference["e"]]) == [80.0, 1.2]
        instance.setReal([0], [3.0])
        instance.doStep(0.0, SHORT)
        assert instance.getReal([2]) == there
        for value in (100.1, -1.0, float("nan")):
            with pytest.raises(Exception, match="failed with status"):
                instance.setReal([reference["omega"]], [value])
        instance.reset()
        assert instance.getReal([reference["omega"]]) == [50.0]


def test_mass_that_depends_on_parameters_is_that_at_the_reference(family, tmp_path):
    other = replace(family, terms=(*family.terms, ReducedTerm("M", "e", np.eye(family.size))))
    remarks = write_fmu(tmp_path / "body.fmu", family.base, parametric=other)
    assert "the mass depends on parameters: at omega = 50, e = 1.2; --at takes others" in remarks
    causes = {v.causality for v in fmpy.read_model_description(tmp_path / "body.fmu").modelVariables}
    assert "parameter" not in causes


def test_exports_of_files_keep_parameters(family, tmp_path):
    hpcred.write_result(tmp_path / "r.h5", family)
    for at, kept in ((None, True), ({"omega": 3.0}, False)):
        report = hpcred.export(tmp_path / "r.h5", "fmu", tmp_path / "r.fmu", at=at)
        assert not any("reference values" in item for item in report["remarks"])
        causes = {v.causality for v in fmpy.read_model_description(tmp_path / "r.fmu").modelVariables}
        assert ("parameter" in causes) == kept


def test_a_base_that_moves(tmp_path):
    """Absolute and relative motions of an FMU whose base has an acceleration, or a displacement, as input, against all
    modes of the full model."""
    from hpcred.loads import Base

    with (hpcred.solid((3, 1, 1), clamped=False) as free, free.with_input_columns(None, ()) as bare,
          bare.with_outputs([(16, "z")]) as sensed):  # fmt: skip
        base = Base(on=hpcred.Nodes(box=[[-1e-6, -9, -9], [1e-6, 9, 9]]), directions=("z",), absolute=[(16, "z")])
        with sensed.with_bases([base]) as shaken:
            lowest = hpcred.reduce(shaken, [Modes(count=1)], damping=Rayleigh(0.0, 1e-6)).frequencies[0]
            whole, small = (hpcred.reduce(shaken, [Modes(count=count)], damping=Rayleigh(0.0, 0.02 / lowest))
                            for count in (shaken.size, 6))  # fmt: skip
    w, t = 2 * np.pi * 0.6 * lowest, np.linspace(0.0, 2 / lowest, 2001)
    exact = hpcred.analysis.time_response(whole, t, (w * w * np.sin(w * t))[:, None])
    for quantity, u in (("acceleration", w * w * np.sin(w * t)), ("displacement", w * t - np.sin(w * t))):
        path = tmp_path / f"{quantity}.fmu"
        driven = small.driven_by(quantity)
        write_fmu(path, driven)
        variables = fmpy.read_model_description(path).modelVariables
        (given,), outputs = ([v for v in variables if v.causality == key] for key in ("input", "output"))
        assert given.unit == {"acceleration": "m/s2", "displacement": "m"}[quantity]
        names = [outputs[0].name, next(v.name for v in outputs if "absolute" in v.name)]
        signal = np.array(list(zip(t, u, strict=True)), dtype=[("time", float), (given.name, float)])
        found = fmpy.simulate_fmu(path, stop_time=t[-1], output_interval=t[1], input=signal, output=names)
        y = np.interp(t, found["time"], found[names[1]])
        np.testing.assert_allclose(np.interp(t, found["time"], found[names[0]]), exact[:, 0],
                                   atol=1e-2 * np.abs(exact[:, 0]).max())  # fmt: skip
        if quantity == "acceleration":
            np.testing.assert_allclose(y, exact[:, 1], atol=2e-2 * np.abs(exact[:, 1]).max())
        else:  # the relative displacement, and that of the base
            np.testing.assert_allclose(y, exact[:, 0] + u, atol=1e-2 * np.abs(exact[:, 0] + u).max())
    whole.close(), small.close()
