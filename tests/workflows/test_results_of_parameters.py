"""Results of models with parameters: jobs, result.h5, and everything that is done with it at chosen values."""

import json
import zipfile
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from helpers import refused, to_dense
from pictures import undrawn

import hpcred as package
from hpcred import Modes, Parameter, ParametricModel, Term, read_result, rotation_terms
from hpcred.body import Preload
from hpcred.cli.main import run
from hpcred.model.damping import GivenDamping, NoDamping
from hpcred.reduction.parametric import greedy
from hpcred.reduction.parametric.reduced import ParametricReducedModel, projected_parts
from hpcred.reduction.result.record import difference_of
from hpcred.settings.simulation_file import read_simulation

OMEGA = Parameter("omega", (0.0, 2000.0), unit="rad/s")
F = np.array([500.0, 9000.0, 14000.0])


@pytest.fixture(scope="module", autouse=True)
def few_points():
    """Errors are estimated, and poles followed, at few values: these tests measure errors at theirs."""
    with pytest.MonkeyPatch.context() as patch:
        for key, value in (("FRESH", 2), ("CHECKS", {1: 4}), ("SPREAD", 4)):
            patch.setattr(greedy, key, value)
        patch.setattr("hpcred.analysis.campbell.POINTS", 3)
        yield


def by_modes(parametric, count=8):
    """A reduced model of the modes at the reference, which is no good one but has all parts."""
    reference = parametric.at()
    damping = NoDamping() if reference.D is None else GivenDamping()
    reduced = package.reduce(reference, [Modes(count=count)], None, damping)
    known = {item.name: getattr(reduced, item.name) for item in fields(reduced)} | {"model": reference}
    return ParametricReducedModel(
        **known, parameters=parametric.parameters, **projected_parts(parametric, reduced, damping)
    )


@pytest.fixture
def rotor(comm):
    """A block that spins, as a model and reduced."""
    with package.solid((4, 2, 3), inputs=3, comm=comm) as plain:
        stiff = Term("K", to_dense(plain.K), "0.01*e")
        with ParametricModel(plain, [OMEGA, Parameter("e", (0.0, 1.0))], [*rotation_terms(plain, "x"), stiff]) as model:
            yield model, by_modes(model)


AT = {"omega": 1500.0, "e": 0.9}


@pytest.mark.mpi
def test_files_keep_parameters(rotor, folder, comm):
    _, rom = rotor
    rom.save(folder / "r.h5")
    found = read_result(folder / "r.h5", comm).reduced
    assert found.parameters == rom.parameters
    assert [(item.of, item.factor) for item in found.terms] == [("D", "omega"), ("K", "omega^2"), ("K", "0.01*e")]
    for mine, other in zip(found.terms, rom.terms, strict=True):
        assert np.array_equal(mine.matrix, other.matrix)
    assert found.constant.keys() == rom.constant.keys()
    assert all(np.array_equal(found.constant[key], rom.constant[key]) for key in rom.constant)
    assert np.array_equal(found.frequency_response(F, **AT), rom.frequency_response(F, **AT))
    assert np.array_equal(found.frequency_response(F), rom.frequency_response(F))


@pytest.mark.mpi
@pytest.mark.costly
def test_a_body_at_values_has_the_motion_of_its_shapes(rotor, folder, comm):
    """Node shapes, couplings, mass and shapes in files belong to the coordinates at the values."""
    model, rom = rotor
    rom.save(folder / "r.h5")
    result = read_result(folder / "r.h5", comm)
    there = result.at(**AT)
    assert there.values == AT and not hasattr(there.reduced, "parameters")
    X = rom.turn(AT)
    with model.at(**AT) as full:
        K = to_dense(full.K)
        V = np.concatenate(comm.allgather(columns(rom.columns))) @ X
        assert pytest.approx(there.reduced.K, abs=1e-9 * np.abs(there.reduced.K).max()) == V.T @ K @ V
        dofs = full.dofs
        fresh = package.floating_frame(full, rom.columns)
    frame = there.floating_frame
    assert frame.Me == pytest.approx(np.eye(8), abs=1e-9)
    for key, expected in (("Ct", X.T @ fresh.Ct), ("Cr", X.T @ fresh.Cr), ("S", X.T @ fresh.S @ X),
                          ("N", np.einsum("ji,jab->iab", X, fresh.N))):  # fmt: skip
        assert getattr(frame, key) == pytest.approx(expected, abs=1e-12 + 1e-9 * np.abs(expected).max())
    node = there.nodes[0]
    rows = np.flatnonzero(np.concatenate(comm.allgather(dofs.node)) == node.node)
    assert node.phi == pytest.approx(V[rows], abs=1e-9 * np.abs(V).max())
    if comm.rank == 0:
        other = int(np.concatenate([dofs.node])[0])
        assert there.body([other]).nodes[0].phi == pytest.approx(V[:3], abs=1e-9 * np.abs(V).max())
        surface, base = there.surface(), result.at_reference().surface()
        assert surface.phi == pytest.approx(base.phi @ X)
        with there.shapes() as shapes:
            assert shapes.frequencies == pytest.approx(there.reduced.frequencies)
            assert f"{there.reduced.frequencies[0]:.6g} Hz" in shapes.names[0]


def columns(block):
    from hpcred.linalg.blocks import local_rows

    with local_rows(block) as rows:
        return rows.real.copy()


def test_stresses_and_geometric_stiffness_turn(tmp_path):
    with package.solid((3, 2, 2)) as plain:
        model = plain.with_material(package.Material(name="steel", young=2.1e11, poisson=0.3, density=7850.0))
        with model, ParametricModel(model, [OMEGA], [rotation_terms(model, "z")[1]]) as parametric:
            rom = by_modes(parametric, 6)
            stress = package.stress_modes(model, rom.columns)
            package.write_result(tmp_path / "r.h5", rom, rom.model, stress=stress)
    X, result = rom.turn({"omega": 1800.0}), read_result(tmp_path / "r.h5")
    there = result.at(omega=1800.0)
    assert there.stress_modes().stress == pytest.approx(np.einsum("ji,jsc->isc", X, result.stress_modes().stress))
    q = np.arange(6.0)
    with there.shapes() as turned, result.at_reference().shapes() as plain:
        assert turned.stress(q) == pytest.approx(plain.stress(X @ q), nan_ok=True)
        moved = plain.moved(X @ q)[0]
        assert turned.moved(q)[0] == pytest.approx(moved, abs=1e-9 * np.abs(moved).max())


@pytest.fixture
def file(rotor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rotor[1].save("r.h5")
    return rotor[1]


def test_values_are_refused_once_chosen_or_without_parameters(file, solid):
    there = read_result("r.h5").at(omega=100.0)
    with pytest.raises(package.InputError, match="^r.h5: it is at omega = 100, e = 0.5 already; read a result"):
        there.at(omega=3.0)
    package.reduce(solid, [Modes(count=3)]).save("plain.h5")
    with pytest.raises(package.InputError, match="^plain.h5: it has no parameters; read a result of a job with"):
        read_result("plain.h5").at(omega=3.0)
    with pytest.raises(package.InputError, match="^parameter 'omega': found 3000, expected 0 to 2000 rad/s"):
        read_result("r.h5").at(omega=3000.0)


def test_mass_that_depends_on_parameters_has_no_body_elsewhere(solid, tmp_path):
    with ParametricModel(solid, [Parameter("m", (0.0, 1.0))], [Term("M", to_dense(solid.M), "m")]) as model:
        by_modes(model).save(tmp_path / "r.h5")
    result = read_result(tmp_path / "r.h5")
    assert result.body().nodes
    with pytest.raises(package.InputError, match="r.h5: the mass depends on parameters, and the floating-frame quant"):
        result.at(m=0.9).body()
    assert result.at(m=0.5).body().nodes


def test_exports_at_values_are_those_of_the_model_there(file, capsys):
    assert run(["export", "r.h5", "-o", "at.npz", "--at", "omega=1500,e=0.9"]) == 0
    expected = file.at(**AT)
    with np.load("at.npz") as found:
        assert found["K"] == pytest.approx(expected.K) and found["D"] == pytest.approx(expected.D)
        assert found["phi"] == pytest.approx(np.array([n.phi for n in read_result("r.h5").nodes]) @ file.turn(AT))
        assert "term_of" not in found
    assert run(["export", "r.h5", "--format", "mbdyn", "-o", "body.fem"]) == 0
    assert "at omega = 1000, e = 0.5, the reference values; --at takes others" in capsys.readouterr().out
    message = refused(capsys, "export", "r.h5", "-o", "x.npz", "--at", "omga=1")
    assert "r.h5: parameter 'omga': there is none of this name (did you mean 'omega'?)" in message
    assert "--at: found 'omega', expected such as" in refused(capsys, "export", "r.h5", "--at", "omega")


@pytest.mark.parametrize("name", ["r.npz", "r.mat", "r_statespace.npz", "r_statespace.mat"])
def test_arrays_keep_parameters(file, name):
    package.export_result("r.h5", path=name)
    found = np.load(name) if name.endswith("npz") else scipy.io.loadmat(name, simplify_cells=True)
    names = [str(item) for item in found["parameter_names"]]
    assert names == ["omega", "e"] and np.array(found["parameter_ranges"])[0].tolist() == [0.0, 2000.0]
    values = file.matrices(AT)
    for key in "MDKBC":
        total = found[f"constant_{key}"].copy()
        for k, (of, factor) in enumerate(zip(found["term_of"], found["term_factors"], strict=True), 1):
            if str(of) == key:
                total += eval(str(factor).replace("^", "**"), dict(AT)) * found[f"term_{k}"]
        assert total == pytest.approx(values[key], abs=1e-12 * np.abs(values[key]).max())


def test_preloads_and_simulations_take_the_model_there(file, monkeypatch):
    monkeypatch.setattr("hpcred.workflows.simulate.has_matplotlib", lambda: False)
    with pytest.raises(package.InputError, match="preload: the result has no geometric stiffness"):
        read_result("r.h5").at(omega=3.0).at_preload(Preload(omega=(0, 0, 1.0)))
    text = 'body = "r.h5"\nend = 1e-4\nsteps = 10\n[[force]]\nkind = "sine"\nnode = 37\nfrequency = 500.0\n'
    text += "amplitude = [0.0, 0.0, -10.0]\n"
    motions = {}
    for more in ("", "at = {omega = 2000.0, e = 1.0}\n", "at = {omega = 1000.0, e = 0.5}\n"):
        Path("sim.toml").write_text(more + text)
        package.simulate_file("sim.toml")
        with h5py.File("simulation.h5") as result:
            motions[more] = result["elastic"][...]
    plain, there, same = motions.values()
    size = np.abs(plain).max()
    assert same == pytest.approx(plain, abs=1e-4 * size)  # to the tolerance in time
    body = read_result("r.h5").at(omega=2000.0, e=1.0).body()
    setup = {item.name: getattr(read_simulation("sim.toml"), item.name) for item in fields(package.Simulation)}
    expected = package.simulate(body, package.Simulation(**setup)).elastic @ file.turn({"omega": 2000.0, "e": 1.0}).T
    assert there == pytest.approx(expected, abs=1e-6 * size) and np.abs(there - plain).max() > 3e-3 * size


JOB = """
model = "chain.h5"
output = "r.h5"
inputs = [6, 41]
tolerance = 1e-2
band = [0.0, 60.0]
[parameter_search]
points = 3
[[parameter]]
name = "k"
range = [0.5, 3.0]
[[term]]
of = "K"
file = "spring.mtx"
factor = "k"
"""
BY_MODES = JOB.replace("tolerance = 1e-2\nband = [0.0, 60.0]\n[parameter_search]\npoints = 3\n", "") + """
[[basis]]
kind = "modes"
count = 40
[[basis]]
kind = "krylov"
frequency = 30.0
order = 1
"""


@pytest.fixture(scope="module")
def reduced_job(tmp_path_factory):
    """A folder with a job of a chain with a spring that is not known, reduced."""
    folder = tmp_path_factory.mktemp("job")
    n = 60
    K = (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)) * 1e6
    spring = np.zeros((n, n))
    spring[50, 50] = 1e6
    scipy.io.mmwrite(folder / "spring.mtx", scipy.sparse.coo_matrix(spring))
    with package.SecondOrderModel(0.1 * np.eye(n), 1e-5 * K, K) as model:
        package.write_model(folder / "chain.h5", model)
    (folder / "job.toml").write_text(JOB)
    assert run(["reduce", str(folder / "job.toml")]) == 0
    return folder, K, spring


def test_a_job_of_parameters_from_end_to_end(reduced_job, capsys, monkeypatch):
    folder, K, spring = reduced_job
    monkeypatch.chdir(folder)
    record = read_result("r.h5").reduced.record
    assert record.accuracy.reached and record.accuracy.parameters.ranges == {"k": (0.5, 3.0)}
    assert any(name.endswith("spring.mtx") for name in record.contents)
    for k in (0.5, 2.2):
        found = package.evaluate_result("r.h5", "chain.h5", at={"k": k}, points=7)
        assert found["at"] == {"k": k} and found["eps_max"] < 1e-2
        reduced = read_result("r.h5").at(k=k).reduced
        s = 2j * np.pi * 30.0
        full = np.linalg.inv(s * s * 0.1 * np.eye(60) + s * 1e-5 * K + K + k * spring)[np.ix_([5, 40], [5, 40])]
        assert reduced.frequency_response([30.0])[0] == pytest.approx(full, rel=2e-2, abs=2e-2 * np.abs(full).max())
    assert run(["evaluate", "r.h5", "--full", "chain.h5", "--check", "3", "--seed", "1", "--at", "k=2.9"]) == 0
    assert run(["evaluate", "r.h5", "--full", "chain.h5", "--points", "5"]) == 0
    assert run(["info", "r.h5", "--json", "info.json"]) == 0
    said = capsys.readouterr().out
    assert "pseudo-frequencies there" not in said and "Parameters" in said
    info = json.loads(Path("info.json").read_text())
    assert info["parameters"][0]["parameter"] == "k" and info["terms"] == [{"of": "K", "factor": "k"}]


def test_comparisons_and_reports_at_values(reduced_job, tmp_path, monkeypatch):
    folder = reduced_job[0]
    monkeypatch.chdir(folder)
    undrawn(monkeypatch)
    Path("coarse.toml").write_text(BY_MODES.replace("r.h5", "coarse.h5"))
    Path("at.toml").write_text(JOB.replace('"r.h5"', '"at.h5"') + "[at]\nk = 2.2\n")
    assert run(["reduce", "coarse.toml"]) == 0
    chosen = ["--full", "chain.h5", "--at", "k=2.2", "--frequencies", "10,30,55"]
    assert run(["evaluate", "r.h5", "coarse.h5", *chosen, "--json", str(tmp_path / "both.json")]) == 0
    both = json.loads((tmp_path / "both.json").read_text())
    assert both["at"] == {"k": 2.2}
    assert max(both["eps"]["r"]) < 1e-2 and max(both["eps"]["coarse"]) < 1e-1
    for mode in both["modes"][:2]:  # those of the model there, in the shapes at the values
        assert abs(mode["r error"]) < 1e-3 and mode["r MAC"] == pytest.approx(1.0, abs=1e-3)
    page = tmp_path / "page.html"
    assert run(["report", "r.h5", "--full", "chain.h5", "--at", "k=2.2", "--solves", "5", "-o", str(page),
                "--csv", str(tmp_path)]) == 0  # fmt: skip
    rows = np.loadtxt(tmp_path / "frequencies_r.csv", delimiter=",", skiprows=1)
    assert (np.abs(rows[:2, 3]) < 1e-3).all() and "k = 2.2" in page.read_text()
    error = np.loadtxt(tmp_path / "error_measured_r.csv", delimiter=",", skiprows=1)
    assert error[:, 1].max() < 1e-2
    assert run(["reduce", "at.toml", "--basis", "r.h5"]) == 0
    assert package.describe_file("at.h5")["basis_of"] == str(folder / "r.h5")


def test_results_of_other_terms_are_not_compared(reduced_job, monkeypatch):
    """Their matrices at the reference may be the same."""
    monkeypatch.chdir(reduced_job[0])
    undrawn(monkeypatch)
    Path("other.toml").write_text(BY_MODES.replace('factor = "k"', 'factor = "1.75^2/k"').replace("r.h5", "other.h5"))
    assert run(["reduce", "other.toml"]) == 0
    with pytest.raises(package.InputError, match=r"other.h5: was reduced from another model than r.h5 \(its term"):
        package.compare_results(["r.h5", "other.h5"], "chain.h5", at={"k": 2.2}, frequencies=[10.0])
    package.report_file(["r.h5", "other.h5"], "chain.h5", at={"k": 2.2}, band=(0, 15), solves=2, csv="tables")
    errors = [np.loadtxt(f"tables/error_measured_{name}.csv", delimiter=",", skiprows=1) for name in ("r", "other")]
    assert max(error[:, 1].max() for error in errors) < 1e-2


def test_a_full_model_at_values_needs_the_terms_of_a_job(reduced_job, monkeypatch):
    monkeypatch.chdir(reduced_job[0])
    with package.read_model("chain.h5") as chain:
        spring = scipy.io.mmread("spring.mtx")
        term = Term("K", spring, "k - 1.75")
        model = ParametricModel(chain.with_inputs([6, 41]), [Parameter("k", (0.5, 3.0))], [term])
        package.reduce(model, [Modes(count=4)]).save("python.h5")
    package.evaluate_result("python.h5", "chain.h5", points=2)
    said = r"python.h5: found values of parameters \(k = 2.2\), but no \[\[term\]\] in its job"
    with pytest.raises(package.InputError, match=said):
        package.evaluate_result("python.h5", "chain.h5", points=2, at={"k": 2.2})


SPINNING = """
model = "body.h5"
output = "r.h5"
inputs = [[12, "z"]]
tolerance = 1e-2
band = [0.0, 6000.0]
parameter_search = {points = 3}
[[parameter]]
name = "omega"
range = [0.0, 3000.0]
"""


@pytest.mark.mpi
@pytest.mark.costly
def test_a_body_that_spins_against_its_full_model(folder, comm):
    """D is skew-symmetric, of which no z^T D z tells anything."""
    with package.solid((3, 1, 1), comm=comm) as model:
        package.write_model(folder / "body.h5", model)
    terms = [f'[[term]]\nkind = "{kind}"\naxis = "x"\nfactor = "{factor}"\n'
             for kind, factor in (("coriolis", "omega"), ("spin_softening", "omega^2"))]  # fmt: skip
    if comm.rank == 0:
        (folder / "job.toml").write_text(SPINNING + "".join(terms))
    comm.Barrier()
    assert run(["reduce", str(folder / "job.toml")]) == 0
    for omega in (0.0, 2500.0):
        found = package.evaluate_result(
            folder / "r.h5", folder / "body.h5", at={"omega": omega}, frequencies=[1000.0, 5000.0], comm=comm
        )
        assert found["eps_max"] < 1e-2
    for kind, told in (("npz", True), ("statespace-npz", False)):
        report = package.export_result(folder / "r.h5", kind, folder / f"{kind}.npz", comm=comm)
        assert any("D and K have terms of rotation" in item for item in report["remarks"]) == told
    record = read_result(folder / "r.h5", comm).reduced.record
    with package.read_model(folder / "body.h5", comm) as model, model.with_inputs([(12, "z")]) as model:
        for factor, differs in ((1500.0, None), (1400.0, "D")):
            with (ParametricModel(model, [OMEGA], rotation_terms(model, "x")) as parametric,
                  parametric.at(omega=1500.0) as there,
                  there.with_damping_matrix(scaled(there.D, factor / 1500.0)) as changed):  # fmt: skip
                assert difference_of(changed.digests, record) == differs


def scaled(mat, factor):
    other = mat.copy()
    other.scale(factor)
    return other


def test_a_job_at_one_value(reduced_job, monkeypatch):
    """A reduction without parameters, which the basis for all values must be like."""
    monkeypatch.chdir(reduced_job[0])
    package.reduce_job("job.toml", overrides=["at.k=2.2", "output='one.h5'"])
    reduced = read_result("one.h5").reduced
    assert not hasattr(reduced, "parameters") and reduced.record.job["at"] == {"k": 2.2}
    assert package.evaluate_result("one.h5", "chain.h5", points=4)["eps_max"] < 1e-2
    together = read_result("r.h5").at(k=2.2).reduced.frequency_response([20.0, 50.0])
    assert reduced.frequency_response([20.0, 50.0]) == pytest.approx(together, abs=3e-2 * np.abs(together).max())


def test_the_full_response_at_values(reduced_job, monkeypatch, capsys):
    folder, K, spring = reduced_job
    monkeypatch.chdir(folder)
    found = package.response_file("job.toml", band=(0.0, 60.0), points=3, at={"k": 2.2}, output="full.h5")
    assert found["at"] == {"k": 2.2} and found["inputs"] == ["dof 6", "dof 41"]
    s = 2j * np.pi * 30.0
    full = np.linalg.inv(s * s * 0.1 * np.eye(60) + s * 1e-5 * K + K + 2.2 * spring)[np.ix_([5, 40], [5, 40])]
    assert package.read_responses("full.h5").response[1] == pytest.approx(full, rel=1e-5, abs=1e-6 * np.abs(full).max())
    message = "--at: chain.h5 has no parameters; give the job file that has [[parameter]] and [[term]]"
    assert message in refused(capsys, "response", "chain.h5", "--band", "0,60", "--at", "k=1")
    message = "parameter 'k': found 9, expected 0.5 to 3, its range"
    assert message in refused(capsys, "response", "job.toml", "--band", "0,60", "--at", "k=9")


def test_another_term_is_another_model(reduced_job, monkeypatch):
    folder, _, spring = reduced_job
    monkeypatch.chdir(folder)
    scipy.io.mmwrite("spring.mtx", scipy.sparse.coo_matrix(1.5 * spring))
    try:
        with pytest.raises(package.InputError, match="spring.mtx: has another content than when its term was reduced"):
            package.evaluate_result("r.h5", "chain.h5", at={"k": 1.0}, points=3)
    finally:
        scipy.io.mmwrite("spring.mtx", scipy.sparse.coo_matrix(spring))


def test_answers_to_estimates_are_over_all_values(reduced_job, capsys, monkeypatch):
    monkeypatch.chdir(reduced_job[0])
    assert "--at: cannot be combined with --estimate, which is over all values" in refused(
        capsys, "evaluate", "r.h5", "--estimate", "--at", "k=1"
    )
    there = read_result("r.h5").at(k=1.0).reduced.record.accuracy
    assert set(there.eps) == {there.largest} and there.frequencies == there.band


def test_geometric_stiffness_beside_terms_of_k_is_refused(reduced_job, capsys, monkeypatch):
    monkeypatch.chdir(reduced_job[0])
    for more, says in (
        ("geometric_stiffness = true\n", "geometric_stiffness: found it beside terms of K, on which the stress"),
        ("write_basis = true\n", None),
    ):
        Path("other.toml").write_text(more + JOB)
        assert says is None or says in refused(capsys, "reduce", "other.toml")
    text = JOB[: JOB.index("[[parameter]]")]
    Path("other.toml").write_text(text)
    assert "parameter_search: found it without [[parameter]], to" in refused(capsys, "reduce", "other.toml")
    basis = '[[basis]]\nkind = "modes"\ncount = 4\n'
    Path("other.toml").write_text(JOB.replace("tolerance = 1e-2\nband = [0.0, 60.0]\n", "") + basis)
    assert "parameter_search: found it without a tolerance" in refused(capsys, "reduce", "other.toml")
    Path("other.toml").write_text("at = {k = 1.0}\n" + text.replace("[parameter_search]\npoints = 3\n", ""))
    assert "at: found it without [[parameter]], to which it belongs" in refused(capsys, "reduce", "other.toml")
    Path("other.toml").write_text("at = {k = 5.0}\n" + JOB)
    assert "parameter 'k': found 5, expected 0.5 to 3, its range" in refused(capsys, "reduce", "other.toml")


def test_fmus_are_at_the_reference_or_at_values(file):
    remarks = package.export_result("r.h5", "fmu", "body.fmu", at=AT)["remarks"]
    assert not any("reference values" in item for item in remarks)
    assert zipfile.is_zipfile("body.fmu")
