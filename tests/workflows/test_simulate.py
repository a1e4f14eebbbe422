"""sim.toml to files, on any number of ranks."""

import json
import re
import shutil

import h5py
import numpy as np
import pytest
from helpers import MODES_JOB, SIMULATION, names

import hpcred
from hpcred.cli.main import run
from hpcred.parallel.failures import InputError
from hpcred.workflows.simulate import simulate_file


@pytest.fixture(scope="module")
def reduced_once(module_folder, comm):
    """A folder with the linkage and its result."""
    with hpcred.linkage(comm) as model:
        hpcred.write_model(module_folder / "model.h5", model)
    if comm.rank == 0:
        (module_folder / "job.toml").write_text(MODES_JOB)
    comm.Barrier()
    assert run(["reduce", str(module_folder / "job.toml")]) == 0
    return module_folder


@pytest.fixture
def made(reduced_once, folder, comm):
    """A good sim.toml in a copy of that folder."""
    if comm.rank == 0:
        shutil.copytree(reduced_once, folder, dirs_exist_ok=True)
        (folder / "sim.toml").write_text(SIMULATION)
    comm.Barrier()
    return folder / "sim.toml"


@pytest.fixture
def undrawn(monkeypatch):
    """Simulations without a picture."""
    monkeypatch.setattr("hpcred.workflows.simulate.has_matplotlib", lambda: False)


@pytest.mark.mpi
@pytest.mark.parametrize("gravity, doubted", [("[0.0, 0.0, -9810.0]", True), ("[-9.81, 0.0, 0.0]", False)])
@pytest.mark.costly
def test_gravity_in_mm_is_warned_of(made, undrawn, gravity, doubted):
    warnings = simulate_file(made, overrides=["end=1e-4", f"gravity={gravity}"])["warnings"]
    assert ("gravity: found 9810 m/s^2; in SI it is 9.81" in warnings) == doubted


@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_a_motion_that_diverges_is_told_once_also_quietly(made, undrawn, capsys, quiet):
    """On stderr, in the file, and by info; where it is told while the simulation runs, not again at its end."""
    path = made
    capsys.readouterr()
    more = ["elastic_velocity=[2e4, 0.0, 0.0, 0.0, 0.0, 0.0]", "gravity=[0.0, 0.0, -9810.0]", "end=1e-4"]
    more = [word for setting in more for word in ("--set", setting)]
    assert run(["simulate", str(path), *quiet, *more]) == 0
    told = capsys.readouterr()
    assert (told.out == "") == bool(quiet) and "warning: the simulation diverges: at t = " in told.err
    for sentence in ("warning: gravity: found 9810 m/s^2", "warning: the simulation diverges"):
        assert told.err.count(sentence) == 1 and sentence not in told.out
    with h5py.File(path.with_name("simulation.h5")) as file:
        warnings = json.loads(file["provenance"][()])["warnings"]
    assert any(text.startswith("the simulation diverges") for text in warnings)
    assert warnings[-1] in hpcred.info(path.with_name("simulation.h5"))["warnings"]


@pytest.mark.mpi
@pytest.mark.costly
def test_places_in_mm_are_warned_of(made, undrawn):
    path, spring = made, "spring=[{kind='line', node=20, at=[%s, 0.0, 3.0], stiffness=1.0}]"
    doubted, meant = (simulate_file(path, overrides=["end=1e-4", spring % x])["warnings"] for x in (500.0, -20.0))
    assert any(re.match(r"spring.at: found \[500.0, 0.0, 3.0\] m, [45]\d\d m from where node 20 starts", note)
               for note in doubted)  # fmt: skip
    assert not any("spring.at" in note for note in meant)


@pytest.mark.mpi
@pytest.mark.costly
def test_files_of_a_simulation(made, monkeypatch):
    path = made
    monkeypatch.setattr("hpcred.workflows.simulate.motion_figure", lambda place, _: place.touch())  # drawn below
    more = ["velocity=[0.0, 0.0, 1.0]", "relative_tolerance=1e-6", "end=0.0125", "steps=5"]
    report = simulate_file(path, overrides=more)
    assert report["output"] == [str(path.with_name(f"simulation.{suffix}")) for suffix in ("h5", "csv", "png")]
    assert any("the initial velocities did not fit the constraints" in line for line in report["notes"])
    assert report["constraint_drift_m"] < 1e-8 and report["energy_defect"] < 1e-4
    table = np.genfromtxt(path.with_name("simulation.csv"), delimiter=",", names=True)
    with h5py.File(path.with_name("simulation.h5")) as file:
        assert file.attrs["format"] == "hpcred-simulation" and file.attrs["version"] == 1
        assert file["nodes/number"][...].tolist() == [1, 7, 10, 14, 20]
        vectors = [file[name].attrs["axes"] for name in ("velocity", "angular_velocity", "position", "springs/force")]
        assert vectors == ["body", "body", "inertial", "inertial"]
        moved = file["nodes/displacement"][...]
        assert moved.shape == (6, 5, 3)
        assert report["largest_displacement_m"]["20"] == pytest.approx(np.linalg.norm(moved[:, 4], axis=1).max())
        assert file["constraints/name"][...].tolist() == [b"1:x", b"1:y", b"1:z", b"7:x", b"7:z", b"14:z"]
        assert table["t"] == pytest.approx(np.linspace(0, 0.0125, 6))
        assert table["displacement_20_z"] == pytest.approx(moved[:, 4, 2], abs=1e-10)
        names = [name.decode() for name in file["outputs/name"][...]]
        outputs = file["outputs/value"][...]
        assert outputs.shape == (6, len(names)) and f"output_{names[0].replace(':', '_')}" in table.dtype.names
        assert file["nodes/acceleration"].shape == file["nodes/velocity"].shape == moved.shape
        assert table["constraint_force_7_z"] == pytest.approx(file["constraints/force"][:, 4], rel=1e-6, abs=1e-6)
        assert table["energy_work"] == pytest.approx(file["energy/work"][...], abs=1e-9)
        record = json.loads(file["provenance"][()])
        assert record["setup"]["velocity"] == [0.0, 0.0, 1.0] and "hpcred" in record["versions"]
        assert [force["kind"] for force in record["setup"]["force"]] == ["sine", "table"]
    assert not any("observe" in line for line in report["notes"])


JOINTS = """
body = "result.h5"
end = 0.03
steps = 6
gravity = [0.0, 0.0, -9.81]
[[moment]]
kind = "constant"
node = 20
value = [0.0, 1.0, 0.0]
axes = "body"
[[constraint]]
node = 1
kind = "revolute"
axis = [0.0, 1.0, 0.0]
[[drive]]
kind = "ramp"
node = 1
about = [0.0, 1.0, 0.0]
rate = 2.0
duration = 0.02
[[spring]]
kind = "line"
node = 14
at = [0.0, 0.0, 1.0]
stiffness = 100.0
damping = 1.0
[[spring]]
kind = "bushing"
node = 20
rotational_stiffness = [1.0, 1.0, 1.0]
"""


@pytest.mark.mpi
@pytest.mark.costly
def test_joints_drives_and_springs_in_the_files(made, comm):
    path = made
    if comm.rank == 0:
        path.write_text(JOINTS)
    comm.Barrier()  # others read it
    report = simulate_file(path)
    assert report["constraint_drift_rad"] < 1e-6 and report["energy_defect"] < 1e-4
    table = np.genfromtxt(path.with_name("simulation.csv"), delimiter=",", names=True)
    with h5py.File(path.with_name("simulation.h5")) as file:
        assert file["nodes/name"][...].tolist() == [b"1", b"14", b"20"]
        assert file["nodes/rotation"][-1, 0] == pytest.approx([0, 2.0 * 0.02, 0], abs=1e-6)
        assert table["rotation_1_y"] == pytest.approx(file["nodes/rotation"][:, 0, 1], abs=1e-10)
        assert file["constraints/name"][...].tolist() == [b"1:x", b"1:y", b"1:z"]
        assert file["constraints/moment_name"][...].tolist() == [b"1:rx", b"1:ry", b"1:rz"]
        assert table["constraint_moment_1_ry"] == pytest.approx(file["constraints/moment"][:, 1], rel=1e-6, abs=1e-6)
        assert file["springs/name"][...].tolist() == [b"1:14", b"2:20"]
        force, moment, energy = (file[f"springs/{key}"][...] for key in ("force", "moment", "energy"))
        assert force.shape == moment.shape == (7, 2, 3) and np.abs(moment[-1, 1]).max() > 1e-3
        assert table["spring_force_1_14_z"] == pytest.approx(force[:, 0, 2], rel=1e-6, abs=1e-9)
        assert file["energy/springs"][...] == pytest.approx(energy.sum(axis=1)) and energy[-1].min() > 0
        assert table["energy_drives"] == pytest.approx(file["energy/drives"][...], rel=1e-6, abs=1e-9)
        setup = json.loads(file["provenance"][()])["setup"]
        assert setup["drive"][0]["kind"] == "ramp" and setup["spring"][1]["kind"] == "bushing"
    assert path.with_name("simulation.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.mpi
def test_simulations_are_refused_on_all_ranks(made, comm):
    path = made
    before = names(path.parent, comm)
    for change, says in (
        ("force.0.node=99", "result.h5: node 99 does not exist"),
        ("body=model.h5", "found an HDF5 file of format 'hpcred-model', expected 'hpcred-result'"),
        ("output=nowhere/out.h5", "nowhere does not exist"),
        ("force.0.node='pin'", "node 'pin': no interface or node set of this name; interfaces: none; node sets: none"),
        ("ende=1.0", "sim.toml: ende: unknown key"),
        ("start=static", "they leave 1 rigid motions free"),
    ):
        overrides = [change, "constraint.2.directions=['x']"] if "static" in change else [change]
        with pytest.raises(InputError, match=re.escape(says)):
            simulate_file(path, overrides=overrides)
    assert names(path.parent, comm) == before


# `python -m hpcred` without a picture, which takes longer than all else
UNDRAWN = """
import importlib.util, runpy
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "matplotlib" else find(name, *more)
runpy.run_module("hpcred", run_name="__main__", alter_sys=True)
"""


def test_a_program_of_two_ranks_ends(made, hpcred):
    """PETSc, which all ranks start together, has not been started by a reduction before."""
    found = hpcred("simulate", made, "--set", "end=1e-5", "--set", "steps=1", ranks=2, program=("-c", UNDRAWN))
    assert found.returncode == 0 and "constraint drift" in found.stdout, found.stderr


@pytest.mark.mpi(ranks=(1,))
@pytest.mark.costly
def test_a_free_body_at_rest_has_a_picture(made):
    """No node, joint or spring to draw: the energies, all zero."""
    path = made
    path.write_text('body = "result.h5"\nend = 0.01\nsteps = 2\n')
    assert any("of the shapes and of no node; observe = [...]" in line for line in simulate_file(path)["notes"])
    assert path.with_name("simulation.png").read_bytes()[:4] == b"\x89PNG"


def test_structural_damping_has_no_motion(reduced_linkage, folder):
    head, tail = MODES_JOB.split('kind = "rayleigh"\nalpha = 2.0\nbeta = 1e-5\n')
    reduced_linkage(head + 'kind = "structural"\nloss_factor = 0.02\n' + tail)
    (folder / "sim.toml").write_text(SIMULATION)
    with pytest.raises(InputError, match=r"loss factor 0.02.*no place in a simulation.*ratio = 0.01"):
        simulate_file(folder / "sim.toml")


def test_without_matplotlib_the_numbers_are_written(made, undrawn):
    report = simulate_file(made, overrides=["end=1e-4", "observe=[]"])
    assert len(report["output"]) == 2 and "no picture was drawn" in report["notes"][-1]
    assert made.with_name("simulation.csv").exists() and not made.with_name("simulation.png").exists()
    # of what is not observed
    known = "the result has the motion of the body frame, of the shapes and of nodes 1, 7, 14, 20; observe"
    assert any(known in line for line in report["notes"])


BAR_JOB = """
model = "bar.h5"
output = "bar_reduced.h5"
[frame]
kind = "buckens"
[[interface]]
name = "left"
nodes = {box = [[-1e-6, -1.0, -1.0], [1e-6, 1.0, 1.0]]}
kind = "rigid"
[[interface]]
name = "right"
nodes = {box = [[0.999999, -1.0, -1.0], [1.000001, 1.0, 1.0]]}
kind = "rigid"
[[basis]]
kind = "modes"
count = 3
[[basis]]
kind = "static_correction"
"""
SPIN = """
body = "bar_reduced.h5"
end = 2e-3
steps = 2
observe = ["right"]
[[constraint]]
node = "left"
kind = "fixed"
[[drive]]
node = "left"
kind = "ramp"
about = [0.0, 0.0, 1.0]
rate = 5.0
duration = 0.1
"""


def test_interfaces_of_a_job_are_inputs_also_of_a_model_that_has_some(folder, undrawn):
    """Without `inputs` all directions of all interfaces, as docs/bearings.md says; with others a simulation that holds
    an interface warns."""
    with hpcred.solid((8, 1, 1), (1.0, 0.02, 0.02), 2, clamped=False) as bar:
        hpcred.write_model(folder / "bar.h5", bar.with_outputs([(1, "x")]))
        own = bar.input_names
    (folder / "job.toml").write_text(BAR_JOB)
    (folder / "spin.toml").write_text(SPIN)
    every = tuple(f"{name}:{d}" for name in ("left", "right") for d in ("x", "y", "z", "rx", "ry", "rz"))
    cases = (
        ([], every, every),
        (['inputs=["left", "right"]', 'outputs=["left", "right"]'], every, every),
        ([f"inputs=[[{own[0][:-2]}, 'x']]"], own[:1], ("1:x",)),
    )
    moved = []
    for more, inputs, outputs in cases:
        record = hpcred.reduce_job(folder / "job.toml", overrides=more).record
        assert (record.inputs, record.outputs) == (inputs, outputs)
        told = [text for text in record.warnings if text.startswith("the interfaces of the job take the place of")]
        assert len(told) == (not more)
        assert more or f"the inputs ({own[0]}, {own[1]}) and outputs (1:x) of bar.h5" in told[0]
        report = simulate_file(folder / "spin.toml")
        warned = [text for text in report["warnings"] if "are no inputs of the reduction" in text]
        assert [text.partition(" are ")[0] for text in warned] == (
            [] if inputs == every else ["node left: forces and moments there (fixed at left)"]
        )
        moved.append(report["largest_displacement_m"]["right"])
    assert moved[0] == pytest.approx(moved[1], rel=1e-6)
