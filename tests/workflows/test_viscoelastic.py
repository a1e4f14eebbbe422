"""Viscoelastic parts in files: jobs, model.h5, result.h5, exports, and the commands that use them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import close, refused, to_dense
from pictures import undrawn
from viscoelastic_models import MAXWELL, ZENER, sandwich

import hpcred
from hpcred import InputError, Krylov, Viscoelastic
from hpcred.body.body import require_no_laws
from hpcred.body.units import in_units
from hpcred.cli.main import run
from hpcred.files.hdf5 import opened
from hpcred.laws import Maxwell
from hpcred.reduction.parametric import greedy
from hpcred.writers.arrays import arrays_of
from hpcred.writers.state_space import state_space

FRESH = np.linspace(1.0, 150.0, 14)
LOW = FRESH[FRESH < 60]
LAW = """{kind = "fractional", low = 0.5, high = 40.0, time = 1e-5, exponent = 0.6}"""
JOB = f"""
model = "model.h5"
inputs = [1]
tolerance = 1e-4
band = [0, 150]
[[viscoelastic]]
file = "Kv.mtx"
law = {LAW}
"""


@pytest.fixture
def case(tmp_path, monkeypatch, comm):
    """The elastic sandwich as model.h5 and its K_v as Kv.mtx in the current folder, with a job."""
    monkeypatch.chdir(tmp_path)
    found = sandwich(n=24)
    scipy.io.mmwrite("Kv.mtx", scipy.sparse.coo_array(found.parts[0][0]))
    for key in "KM":
        scipy.io.mmwrite(f"{key}.mtx", scipy.sparse.coo_array(getattr(found, key)))
    with hpcred.SecondOrderModel.from_scipy(found.K, found.M, comm=comm) as model:
        hpcred.write_model("model.h5", model)
    (tmp_path / "job.toml").write_text(JOB)
    found.B = np.eye(len(found.K))[:, :1]
    return found


def test_a_job_reduces_and_everything_reads_it(case, capsys, monkeypatch):
    undrawn(monkeypatch)
    assert run(["reduce", "job.toml"]) == 0
    result = hpcred.read_result("result.h5")
    rom = result.reduced
    assert rom.viscoelastic[0].law == ZENER and rom.viscoelastic[0].name == "Kv.mtx"
    assert [item.name for item in rom.record.viscoelastic] == ["Kv.mtx"]
    assert hpcred.relative_error(case.truth(FRESH)[0], rom.frequency_response(FRESH)).max() < 1e-4
    capsys.readouterr()
    assert run(["info", "result.h5"]) == 0 and "Kv.mtx: Fractional(low=0.5" in capsys.readouterr().out
    assert run(["info", "job.toml"]) == 0
    assert run(["info", "--verify", "result.h5"]) == 0
    capsys.readouterr()
    # the model file has no parts: the job of the record names the file of K_v
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--check", "4", "--seed", "1"]) == 0
    told = capsys.readouterr().out
    assert "): largest error" in told and "measured with the viscoelastic parts of the model" in told
    assert run(["report", "result.h5", "--full", "model.h5", "-o", "r.html"]) == 0
    assert "Kv.mtx: Fractional(low=0.5" in Path("r.html").read_text(encoding="utf-8")
    slower = hpcred.Viscoelastic(case.parts[0][0], replace(ZENER, time=2 * ZENER.time))  # the same at rest
    with hpcred.SecondOrderModel.from_scipy(case.K, case.M) as model, model.with_viscoelastic([slower]) as other:
        hpcred.write_model("other.h5", other)
    assert "its viscoelastic laws or matrices differ" in refused(capsys, "evaluate", "result.h5", "--full", "other.h5")
    with opened("result.h5", "hpcred-result", 2) as file:
        assert file.attrs["version"] == 3  # which programs of before refuse


def test_a_job_with_parameters_as_well(case, capsys, monkeypatch):
    """The spring that it has at a value is there in responses, comparisons, results at values and their exports."""
    undrawn(monkeypatch)
    monkeypatch.setattr("hpcred.analysis.campbell.POINTS", 3)
    for key, value in (("FRESH", 2), ("CHECKS", {1: 4}), ("SPREAD", 2)):  # errors are measured
        monkeypatch.setattr(greedy, key, value)
    spring, law = np.zeros((24, 24)), Maxwell(factors=[2.0, 5.0], times=[1e-2, 3e-4], constant=0.4)
    spring[12, 12] = 3e6
    scipy.io.mmwrite("spring.mtx", scipy.sparse.coo_array(spring))
    told = 'law = {kind = "maxwell", factors = [2.0, 5.0], times = [1e-2, 3e-4], constant = 0.4}'
    table = '[[parameter]]\nname = "p"\nrange = [0.0, 2.0]\n[[term]]\nof = "K"\nfile = "spring.mtx"\nfactor = "p"\n'
    text = JOB.replace(f"law = {LAW}", told).replace("1e-4", "1e-3")
    text += table + "[parameter_search]\npoints = 2\n"
    Path("job.toml").write_text(text)
    assert run(["reduce", "job.toml"]) == 0
    case.K, case.parts = case.K + 1.7 * spring, [(case.parts[0][0], law)]
    H = case.truth(FRESH)[0]
    result = hpcred.read_result("result.h5")
    assert hpcred.relative_error(H, result.reduced.frequency_response(FRESH, p=1.7)).max() < 1e-3
    assert hpcred.relative_error(H, result.at(p=1.7).reduced.frequency_response(FRESH)).max() < 1e-3
    run(["info", "result.h5"])
    assert "Kv.mtx: Maxwell(" in capsys.readouterr().out
    given = ["--full", "model.h5", "--at", "p=1.7"]
    assert run(["evaluate", "result.h5", *given, "--check", "4", "--seed", "1"]) == 0
    assert "measured with the viscoelastic parts of the model" in capsys.readouterr().out
    assert run(["report", "result.h5", *given, "-o", "r.html"]) == 0
    Path("at.toml").write_text("at = {p = 1.7}\n" + text.replace("[parameter_search]\npoints = 2\n", ""))
    assert run(["response", "at.toml", "--band", "0,150", "--points", "8", "-o", "f.h5"]) == 0
    found = hpcred.files.read_responses("f.h5")
    assert close(case.truth(found.frequencies)[0], found.response) < 1e-8

    for at in (None, {"p": 1.7}):
        report = hpcred.export("result.h5", "statespace-npz", "s.npz", at=at)
        assert any("are those of Maxwell elements" in text for text in report["remarks"])
        with np.load("s.npz") as file:
            arrays = dict(file)
        keys = ("mass", "damping", "stiffness", "input_matrix")
        parts = {of: arrays[key] for of, key in zip("MDKB", keys, strict=True)}
        if at is None:  # the arrays of parameters make the same up
            assert close(arrays["constant_K"] + arrays["term_1"], arrays["stiffness"]) < 1e-12
            parts = {of: arrays[f"constant_{of}"] for of in "MDKB"}
            parts["K"] = parts["K"] + 1.7 * arrays["term_1"]
        for f, expected in zip(FRESH[:3], H, strict=False):
            s = 2j * np.pi * f
            x = np.linalg.solve(s * s * parts["M"] + s * parts["D"] + parts["K"], parts["B"])
            assert close(expected, parts["B"].T @ x) < 1e-3


def test_convert_and_response(case, capsys):
    part = f'{{file = "Kv.mtx", name = "core", law = {LAW}}}'
    given = ["convert", "-K", "K.mtx", "-M", "M.mtx", "--inputs", "1", "--viscoelastic", part]
    assert run([*given, "whole.h5"]) == 0
    assert "core: Fractional(low=0.5" in capsys.readouterr().out
    with hpcred.read_model("whole.h5") as model:
        assert model.viscoelastic[0].law == ZENER and model.viscoelastic[0].name == "core"
        assert close(case.parts[0][0], to_dense(model.viscoelastic[0].matrix)) < 1e-15
        assert close(case.stiffness(0.0), to_dense(model.K)) < 1e-14
    assert run(["response", "whole.h5", "--band", "0,150", "--points", "12", "--tolerance", "1e-6", "-o", "r.h5"]) == 0
    found = hpcred.files.read_responses("r.h5")
    assert close(case.truth(found.frequencies)[0], found.response) < 1e-6


@pytest.mark.parametrize("change, message", [
    (("Kv.mtx", "K2.mtx"), "K2.mtx: found 23 x 23, expected 24 x 24, as the matrices of model.h5 have"),
    (("exponent = 0.6", "exponent = 1.2"), "law.exponent: found 1.2"),
    (('file = "Kv.mtx"', ""), "file"),
    (('kind = "fractional"', 'kind = "rubber"'), "rubber"),
    (('"Kv.mtx"', '"nothing.mtx"'), "nothing.mtx"),
])  # fmt: skip
def test_jobs_that_are_refused(case, capsys, tmp_path, change, message):
    scipy.io.mmwrite("K2.mtx", scipy.sparse.coo_array(case.parts[0][0][:-1, :-1]))
    (tmp_path / "job.toml").write_text(JOB.replace(*change))
    assert message in refused(capsys, "reduce", "job.toml")


def test_tables_of_the_command_line_that_are_refused(case, capsys):
    given = ("convert", "-K", "K.mtx", "-M", "M.mtx", "--viscoelastic", "Kv.mtx", "whole.h5")
    assert "--viscoelastic: found 'Kv.mtx', expected a table such as" in refused(capsys, *given)
    two = f'{{file = "Kv.mtx", law = {LAW}}}\nx = 1'
    given = ("convert", "-K", "K.mtx", "-M", "M.mtx", "--viscoelastic", two, "whole.h5")
    assert "x: unknown key; known are viscoelastic" in refused(capsys, *given)


def test_a_variable_of_a_mat_file(case):
    scipy.io.savemat("both.mat", {"Ke": scipy.sparse.csc_array(case.K), "Kv": scipy.sparse.csc_array(case.parts[0][0])})
    of_file = ['viscoelastic.0.file="both.mat"', 'viscoelastic.0.variable="Kv"', "band=[0, 60]"]
    job = hpcred.settings.read_job("job.toml", of_file)
    assert hpcred.reduce_job(job).size > 2
    rom = hpcred.read_result("result.h5").reduced
    assert hpcred.relative_error(case.truth(LOW)[0], rom.frequency_response(LOW)).max() < 1e-4


@pytest.mark.mpi
def test_models_and_results_on_any_number_of_ranks(folder, comm):
    case = sandwich((MAXWELL, ZENER))
    with case.model(comm) as model, hpcred.reduce(model, Krylov(frequency=100.0, order=5)) as rom:
        hpcred.write_model(folder / "m.h5", model)
        hpcred.write_result(folder / "r.h5", rom, model)
        with hpcred.read_model(folder / "m.h5") as again:
            assert [part.law for part in again.viscoelastic] == [MAXWELL, ZENER]
            for key in ("K", "Kv1", "Kv2"):
                assert again.digest_of(key) == model.digest_of(key)
            assert close(model.frequency_response([33.0]), again.frequency_response([33.0])) < 1e-12
        found = hpcred.read_result(folder / "r.h5").reduced
        assert close(rom.transfer_function(300j), found.transfer_function(300j)) < 1e-14


@pytest.fixture
def maxwell(comm):
    case = sandwich((MAXWELL, MAXWELL), inputs=2, outputs=1)
    with case.model(comm) as model, hpcred.reduce(model, Krylov(frequency=100.0, order=3)) as rom:
        yield rom


def test_state_spaces_have_maxwell_states(maxwell):
    found = state_space(maxwell)
    for s in (2j * np.pi * FRESH[:5]).tolist():
        H = maxwell.transfer_function(s)
        one = np.eye(len(found["A"]))
        assert close(H, found["C"] @ np.linalg.solve(s * one - found["A"], found["B"])) < 1e-9
        assert close(s * H, found["C_velocity"] @ np.linalg.solve(s * one - found["A"], found["B"])) < 1e-9
        assert close(H, found["C"] @ np.linalg.solve(s * found["E"] - found["EA"], found["EB"])) < 1e-9
        A = s * s * found["mass"] + s * found["damping"] + found["stiffness"]
        assert close(H, found["output_matrix"] @ np.linalg.solve(A, found["input_matrix"])) < 1e-9
    for key in ("mass", "damping", "stiffness"):
        assert close(found[key], found[key].T) < 1e-12
    assert "Maxwell elements (Kv1, Kv2)" in str(found["comment"]) and maxwell.poles().real.max() < 0
    w, H = maxwell.to_state_space(), maxwell.transfer_function(200j)
    assert close(H, w.C @ np.linalg.solve(200j * np.eye(len(w.A)) - w.A, w.B)) < 1e-9


def test_state_spaces_of_velocities_and_accelerations(comm):
    case = sandwich((MAXWELL,), inputs=2, outputs=3)
    zero = np.zeros_like(case.Ct)
    with case.model(comm) as model:
        Cv, Ca = zero.copy(), zero.copy()
        Cv[:, 1], Ca[:, 2] = case.Ct[:, 1], case.Ct[:, 2]
        C = case.Ct * [1.0, 0.0, 0.0]
        first, last = model.first_row, model.first_row + model.local_rows
        rates = {"Cv": Cv[first:last], "Ca": Ca[first:last]}
        with (
            model.with_output_columns(C[first:last], ["d", "v", "a"], **rates) as measured,
            hpcred.reduce(measured, Krylov(frequency=100.0, order=3)) as rom,
        ):  # fmt: skip
            found = state_space(rom)
            for s in (30j, 900j):
                H = rom.transfer_function(s)
                one = np.eye(len(found["A"]))
                by_states = found["C"] @ np.linalg.solve(s * one - found["A"], found["B"]) + found["D"]
                assert close(H, by_states) < 1e-9
                outputs = sum(s**k * found[f"{key}_matrix"]
                              for k, key in enumerate(("output", "velocity", "acceleration")))  # fmt: skip
                A = s * s * found["mass"] + s * found["damping"] + found["stiffness"]
                assert close(H, outputs @ np.linalg.solve(A, found["input_matrix"])) < 1e-9


def test_jobs_with_a_material(comm, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with hpcred.solid((4, 2, 3), inputs=1, clamped=False, comm=comm) as model:
        name = model.properties.materials[0].name
        hpcred.write_model("model.h5", model)
        full = model.frequency_response([9000.0], frame=hpcred.Buckens())
    law = 'law = {kind = "maxwell", factors = [0.5], times = [1e-5], constant = 1.0}'
    job = 'model = "model.h5"\nframe = {kind = "buckens"}\ntolerance = 1e-3\nband = [0, 20000]\n[[viscoelastic]]\n'
    (tmp_path / "job.toml").write_text(f'{job}material = "{name}"\n{law}\n')
    assert run(["reduce", "job.toml"]) == 0
    rom = hpcred.read_result("result.h5").reduced
    assert close(rom.K, rom.viscoelastic[0].matrix) < 1e-9 and rom.viscoelastic[0].name == name
    assert close(full[0], rom.frequency_response([9000.0])[0]) > 0.01
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--check", "3", "--seed", "1"]) == 0
    (tmp_path / "result.h5").unlink()
    for wrong, message in ((f'material = "{name}"\nfile = "K.mtx"', "either a file or a material"),
                           (f'material = "{name}"\nvariable = "K"', "variable and units belong to a file"),
                           ('material = "wood"', "has no such material; it has")):  # fmt: skip
        (tmp_path / "job.toml").write_text(f"{job}{wrong}\n{law}\n")
        assert message in refused(capsys, "reduce", "job.toml")


def test_exports_without_a_place_for_it_refuse(maxwell, comm, tmp_path):
    path = tmp_path / "r.h5"
    hpcred.write_result(path, maxwell)
    with pytest.raises(InputError, match="a SID file has no place for a stiffness that .* \\(Kv1, Kv2\\)"):
        require_no_laws(maxwell, "a SID file")
    told = hpcred.export(path, "fmu")
    assert any("the dashpots of Maxwell elements" in remark for remark in told["remarks"])
    told = hpcred.export(path, "statespace-npz")
    assert any("Maxwell elements (Kv1, Kv2)" in remark for remark in told["remarks"])
    case = sandwich()
    with (
        case.model(comm) as model, hpcred.reduce(model, Krylov(frequency=100.0, order=3)) as rom,
        pytest.raises(InputError, match="the law of Kv1 is fractional, which no finite number of states has"),
    ):  # fmt: skip
        rom.to_state_space()


def test_superelements_refuse(solid, tmp_path):
    interface = hpcred.Interface(name="end", nodes=hpcred.Nodes(box=((0.035, -1, -1), (1, 1, 1))))
    core = Viscoelastic(solid.K.copy(), MAXWELL, "core")
    with (
        solid.with_viscoelastic([core]) as model, model.with_interfaces([interface]) as body,
        hpcred.reduce(body, hpcred.CraigBampton(count=2), coordinates="interface") as rom,
    ):  # fmt: skip
        hpcred.write_result(tmp_path / "r.h5", rom, body)
    with pytest.raises(InputError, match="a superelement has no place for a stiffness that depends on frequency"):
        hpcred.export(tmp_path / "r.h5", "nastran")


def test_bodies_and_units(solid, tmp_path):
    """Arrays hold K_v and its law, in units of time too; programs of moving bodies refuse."""
    core = Viscoelastic(solid.K.copy(), MAXWELL, "core")
    with solid.with_viscoelastic([core]) as model, hpcred.reduce(model, Krylov(frequency=100.0, order=3)) as rom:
        body = hpcred.body.body_of(model, rom)
        arrays = arrays_of(body)
        assert close(arrays["viscoelastic"][0], rom.viscoelastic[0].matrix) == 0
        assert arrays["viscoelastic_names"].tolist() == ["core"]
        assert json.loads(arrays["viscoelastic_laws"][0])["times"] == list(MAXWELL.times)
        ms = in_units(body, hpcred.model.units_of("mm-kg-ms")).reduced
        s = 2j * np.pi * 300.0
        H, other = rom.transfer_function(s), ms.transfer_function(1e-3 * s)
        assert close(other / other[0, 0], H / H[0, 0]) < 1e-10
        hpcred.write_result(tmp_path / "r.h5", rom, model)
        for name in ("sid", "mbdyn", "mbsim", "exudyn"):
            with pytest.raises(InputError, match="has no place for a stiffness that .* \\(core\\)"):
                hpcred.export(tmp_path / "r.h5", name)
    (tmp_path / "s.toml").write_text(f'body = "{tmp_path / "r.h5"}"\nend = 0.01\nsteps = 3\n')
    notes = hpcred.simulate_file(tmp_path / "s.toml", overrides=[f'output="{tmp_path / "simulation.h5"}"'])["notes"]
    assert any("the Maxwell elements of core are" in text for text in notes)


def test_store(comm, tmp_path):
    """Points of a law are not those of another one."""
    case = sandwich(n=16)
    kept = hpcred.PointStore(tmp_path / "points")
    for law in (ZENER, MAXWELL, ZENER):
        case.parts = [(case.parts[0][0], law)]
        with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=(0, 60.0), store=kept) as rom:
            assert hpcred.relative_error(case.truth(LOW)[0], rom.frequency_response(LOW)).max() < 1e-4
            made = rom.record.accuracy.factorisations
    assert made == 0
