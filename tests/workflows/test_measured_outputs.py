"""Velocities and accelerations as outputs of jobs, of files, of exports and of simulations."""

import numpy as np
import pytest
import scipy.io
from mpi4py import MPI
from scipy import sparse

import hpcred
from hpcred import InputError
from hpcred.cli.main import run
from hpcred.model.units import unit_of_response
from hpcred.outputs import MotionOutput
from tests.helpers import refused
from tests.reduction.test_derivative_outputs import FREQUENCIES, case, close, dense

NAMES = ("60:z", "velocity 60:z", "acceleration 60:z", "acceleration 20:x")
OUTPUTS = """outputs = [[60, "z"], {node = 60, direction = "z", quantity = "velocity"},
  {node = 60, direction = "z", quantity = "acceleration"}, {node = 20, direction = "x", quantity = "acceleration"}]
"""


def block(comm, folder, more="tolerance = 1e-3\n"):
    """Write the model of a small block and its job, with all quantities at one node."""
    with hpcred.solid((6, 2, 3), None, 3, comm=comm) as model:
        hpcred.write_model(folder / "m.h5", model)
    if comm.rank == 0:
        head = 'model = "m.h5"\noutput = "r.h5"\nband = [0.0, 5000.0]\n'
        (folder / "job.toml").write_text(head + OUTPUTS + more)
    comm.Barrier()


@pytest.mark.mpi
@pytest.mark.costly
def test_a_job_with_quantities(comm, folder):
    block(comm, folder)
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    reduced = hpcred.read_result(folder / "r.h5", comm).reduced
    assert reduced.output_names == NAMES and reduced.record.accuracy.reached
    f = np.array([0.0, 100.0, 4000.0])
    H, s = reduced.frequency_response(f), 2j * np.pi * f[:, None]
    assert np.allclose(H[:, 1], s * H[:, 0], rtol=1e-12) and np.allclose(H[:, 2], s**2 * H[:, 0], rtol=1e-12)
    found = hpcred.evaluate(folder / "r.h5", folder / "m.h5", frequencies=f, comm=comm)
    assert found["eps_max"] <= 1e-3
    errors = {item["output"]: item["largest"] for item in found["directions"]}
    # relative errors of velocities and accelerations are those of the displacements
    assert errors["velocity 60:z"] == pytest.approx(errors["acceleration 60:z"], rel=1e-6)
    check = hpcred.workflows.check_result(folder / "r.h5", folder / "m.h5", count=3, seed=4, comm=comm)
    assert check["passed"]


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.costly
def test_interface_coordinates_keep_them(comm, folder):
    coordinates = 'coordinates = "interface"\n[[interface]]\nname = "A"\nkind = "averaging"\nnodes = [49, 52, 57, 60]\n'
    basis = '[[basis]]\nkind = "constraint_modes"\n[[basis]]\nkind = "modes"\ncount = 12\n'
    block(comm, folder, coordinates + basis)
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    again = hpcred.read_result(folder / "r.h5", comm).reduced
    f = np.array([100.0, 900.0])
    H, s = again.frequency_response(f), 2j * np.pi * f[:, None]
    assert len(again.interfaces) == 1 and np.allclose(H[:, 2], s**2 * H[:, 0], rtol=1e-9)
    found = hpcred.evaluate(folder / "r.h5", folder / "m.h5", frequencies=f, comm=comm)
    assert found["eps_max"] < 0.05


def files(folder, form):
    """Write K, M, D, B, C, Cv, Ca of a chain, in Matrix Market files, in one .mat file, or Cv and Ca as .npz. Returns
    the options of convert and the matrices."""
    M, D, K, *rows = case(3)
    given = dict(zip(("K", "M", "D", "B", "C", "Cv", "Ca"), (K, M, D, *rows), strict=True))
    names = {key: folder / f"{key}.mtx" for key in given}
    if form == "mat":
        names = dict.fromkeys(given, folder / "all.mat")
        scipy.io.savemat(folder / "all.mat", given)
    else:
        for key, value in given.items():
            scipy.io.mmwrite(names[key], sparse.coo_matrix(value))
    if form == "npz":
        for key in ("Cv", "Ca"):
            names[key] = folder / f"{key}.npz"
            sparse.save_npz(names[key], sparse.csr_matrix(given[key]))
    return [word for key, name in names.items() for word in (f"-{key}", str(name))], (M, D, K, *rows)


@pytest.mark.parametrize("form", ["mtx", "mat", "npz"])
def test_convert_reads_them(tmp_path, form):
    options, given = files(tmp_path, form)
    assert run(["convert", *options, str(tmp_path / "m.h5")]) == 0
    with hpcred.read_model(tmp_path / "m.h5") as model:
        assert model.output_names == ("output 1", "output 2", "output 3", "output 4")
        assert close(hpcred.frequency_response(model, FREQUENCIES), dense(*given, FREQUENCIES), 1e-10)
    source = {key[1:]: name for key, name in zip(options[::2], options[1::2], strict=True)}
    text = "\n".join(f'{key} = "{name}"' for key, name in source.items())
    (tmp_path / "job.toml").write_text(f"output = 'r.h5'\nbasis = [{{kind = 'modes', count = 2}}]\n[model]\n{text}\n")
    hpcred.reduce_job(tmp_path / "job.toml")
    with hpcred.read_result(tmp_path / "r.h5").reduced as reduced:
        assert reduced.Cv is not None and reduced.Ca is not None


def test_convert_takes_names_of_quantities(tmp_path, capsys):
    options, _ = files(tmp_path, "mtx")
    target, none = str(tmp_path / "m.h5"), str(tmp_path / "none.h5")
    assert run(["convert", *options[:4], "--inputs", "5", "--outputs", "velocity dof 7,2", target]) == 0
    with hpcred.read_model(target) as model:
        assert model.output_names == ("velocity dof 7", "dof 2")
    rates = "or velocity 20:z, acceleration dof 115"
    assert rates in refused(capsys, "convert", *options[:4], "--outputs", "speed dof 7", none)
    assert "inputs: found" in refused(capsys, "convert", *options[:4], "--inputs", "velocity dof 7", none)
    other = tmp_path / "short.mtx"
    scipy.io.mmwrite(other, sparse.coo_matrix(np.ones((3, 20))))
    sentence = "C of 4 rows, Cv of 4 rows, Ca of 3 rows and 4 names, expected as many rows as names"
    assert sentence in refused(capsys, "convert", *options, "-Ca", str(other), none)


@pytest.mark.parametrize("table, sentence", [
    ('{node = 20, stress = "xx", quantity = "velocity"}', r"outputs\[0\].quantity: unknown key; known are node, str"),
    ('{node = 20, direction = "z", quantity = "speed"}', r"outputs\[0\].quantity: found 'speed', expected 'displac"),
    ('{node = 20, dir = "z"}', r"outputs\[0\].dir: unknown key .*; known are node, direction, dof, quantity"),
    ('{node = 20}', r"outputs: found node, expected a node and its direction, or a dof"),
    ('{dof = 3, node = 2}', r"outputs: found node, dof, expected a node and its direction, or a dof"),
    ('{node = 20, direction = "q"}', r"outputs.direction: found the direction 'q', expected one of x, y, z"),
    ('{node = 0, direction = "x"}', r"outputs.node: found 0, expected 1 to"),
    ('{cut = "A", component = "qx"}', r"outputs\[0\].component: found 'qx', expected 'all' or 'fx'"),
    ('{cut = "A", about = [0.0, 1.0]}', r"outputs\[0\].about: found \[0.0, 1.0\], expected"),
])  # fmt: skip
def test_tables_that_cannot_be_are_refused(tmp_path, table, sentence):
    (tmp_path / "job.toml").write_text(f'model = "m.h5"\nband = [0.0, 1.0]\ntolerance = 1e-3\noutputs = [{table}]\n')
    with pytest.raises(InputError, match=sentence):
        hpcred.settings.read_job(tmp_path / "job.toml")


def test_names_say_what_is_measured():
    with hpcred.solid((3, 2, 2), None, 3, comm=MPI.COMM_SELF) as model:
        node = int(model.dofs.node[-1])
        chosen = MotionOutput(node=node, direction="all", quantity="velocity")
        names = model.with_outputs([chosen]).output_names
        assert names == tuple(f"velocity {node}:{axis}" for axis in "xyz")
        rows = np.zeros((model.size, 1))
        rows[0] = 1.0
        for given in ({"names": ["velocity 1:x"]}, {"names": ["1:x"], "Cv": rows}, {"names": ["1:x"], "Ca": rows}):
            local = None if "Cv" in given or "Ca" in given else rows
            with pytest.raises(InputError, match=r"outputs: found '(velocity )?1:x', the name of a .*name it"):
                model.with_output_columns(local, **given)
        with pytest.raises(InputError, match=r"for a row of displacement and velocity; name it by a word of your own"):
            model.with_output_columns(rows, ["1:x"], Cv=rows)
        assert model.with_output_columns(rows, ["mixed"], Cv=rows).output_names == ("mixed",)
    assert unit_of_response("velocity 20:z", "1:x") == "m/s/N"
    assert unit_of_response("acceleration 20:ry", "1:rx") == "rad/s^2/(N m)"
    assert unit_of_response("acceleration dof 5", "1:x") == unit_of_response("acceleration oil", "1:x") == ""


def test_what_cannot_have_them_refuses():
    M, D, K, B, *_ = case(1)
    with hpcred.SecondOrderModel(M, D, K, B, Ca=B.T) as model:
        with pytest.raises(InputError, match=r"irka: found outputs that are velocities or accelerations"):
            hpcred.IRKA(size=4, band=(0.1, 5.0), damping=hpcred.GivenDamping()).reduce(model)
        omega = hpcred.Parameter("omega", (0.0, 1.0))
        with pytest.raises(InputError, match=r"found terms of C, and outputs that are velocities or accelerations"):
            hpcred.ParametricModel(model, [omega], [hpcred.Term("C", B.T, "omega")])


def test_models_in_other_units():
    M, D, K, B, C, Cv, Ca = case(2)
    rows = {"C": C, "Cv": Cv, "Ca": Ca}
    # in m, kg and ms a velocity is one in m/ms; of the mixed row, a displacement, the factors are times
    for key, power in (("Cv", 1), ("Ca", 2)):
        rows[key] = rows[key].copy()
        rows[key][2] *= 1e3**power
    with (
        hpcred.SecondOrderModel(M, D * 1e-3, K * 1e-6, B, **rows) as given,
        hpcred.model.in_si(given, hpcred.model.units_of("m-kg-ms")) as model,
    ):
        found = hpcred.frequency_response(model, FREQUENCIES)
    assert close(found, dense(M, D, K, B, C, Cv, Ca, FREQUENCIES), 1e-9)


@pytest.mark.peers("fmpy")
@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
def test_state_spaces_and_fmus_have_them(tmp_path, kind):
    import fmpy

    with hpcred.solid((6, 2, 3), None, 3, comm=MPI.COMM_SELF) as model:
        outputs = [(60, "z"), MotionOutput(node=60, direction="z", quantity=kind)]
        model = model.with_outputs(outputs)
        reduced = hpcred.reduce(model, [hpcred.Modes(count=5)], damping=hpcred.Rayleigh(20.0, 1e-6))
        hpcred.writers.write_fmu(tmp_path / "body.fmu", reduced)
    found = hpcred.state_space(reduced)
    A, B, C, D = (found[key] for key in "ABCD")
    s = 2j * np.pi * 700.0
    assert np.allclose(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D, reduced.transfer_function(s), rtol=1e-9)
    force = reduced.input_names[0]
    labels = reduced.plot([f"60:z/{force}", f"{kind} 60:z/{force}"], band=(0.0, 900.0))
    unit = {"velocity": "m/s/N", "acceleration": "m/s^2/N"}[kind]
    assert labels.axes[0].get_ylabel() == f"|H| (m/N, {unit})"
    assert found["C_velocity"].shape == (1, len(A)) and list(found["velocity_names"]) == ["velocity of 60:z"]
    description = fmpy.read_model_description(tmp_path / "body.fmu")
    names = [item.name for item in description.modelVariables if item.causality == "output"]
    other = {"velocity": "velocity_60_z_", "acceleration": "velocity_60_z"}[kind]
    assert names == ["displacement_60_z", f"{kind}_60_z", other]
    # a constant force from rest, of which the solution is known
    force = next(item.name for item in description.modelVariables if item.causality == "input")
    given = {"stop_time": 2e-4, "step_size": 1e-6, "start_values": {force: 7.0}, "fmi_type": "CoSimulation"}
    motion = fmpy.simulate_fmu(str(tmp_path / "body.fmu"), output=names, **given)
    values, X = np.linalg.eig(A)
    rest = np.linalg.solve(A, B[:, 0] * 7.0)
    growth = np.exp(np.outer(values, motion["time"]))
    states = (X @ (growth * np.linalg.solve(X, rest)[:, None])).real - rest[:, None]
    for place, name in enumerate(names[:2]):
        expected = C[place] @ states + D[place, 0] * 7.0
        assert np.abs(motion[name] - expected).max() < 1e-6 * np.abs(expected).max()
    assert D[1].any() == (kind == "acceleration")
