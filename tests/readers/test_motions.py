"""Coordinates over time of other programs: Exudyn and FMPy themselves, tables, and files that are cut or foreign."""

import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest

import hpcred
from hpcred import Buckens, InputError, ModalDamping, Modes
from hpcred.files.opened_hdf5 import PROBE
from hpcred.parallel.petsc import MPI
from hpcred.readers.motions.source import read_coordinates

HEAD = """#Exudyn implicit second order time integration solver solution file
#simulation started=2026-11-24,08:16:24
#columns contain: time, ODE2 displacements, ODE2 velocities, ODE2 accelerations, AE coordinates
#number of system coordinates [nODE2, nODE1, nAlgebraic, nData] = [9,0,1,0]
#number of written coordinates [nODE2, nVel2, nAcc2, nODE1, nVel1, nAlgebraic, nData] = [9,9,9,0,0,1,0]
#total columns exported  (excl. time) = 28
#
"""
LINES = ["0," + ",".join(f"{k / 4}" for k in range(28)), "0.5," + ",".join(f"{k}" for k in range(28))]
TAIL = "#simulation finished=2026-11-24,08:16:24\n#Solver Info: cpuTime=0.01\n"


def read(path, count=2, first=None, outputs=None):
    return read_coordinates(path, count, "", outputs or {}, MPI.COMM_SELF, first)


def exudyn_file(tmp_path, text):
    path = tmp_path / "coordinatesSolution.txt"
    path.write_text(text)
    return path


def test_columns_of_exudyn(tmp_path):
    found = read(exudyn_file(tmp_path, HEAD + "\n".join(LINES) + "\n" + TAIL))
    assert found.t.tolist() == [0, 0.5] and found.frame is None and found.remarks == ()
    assert found.q.tolist() == [[7 / 4, 2], [7, 8]]
    assert found.velocity.tolist() == [[4, 17 / 4], [16, 17]] and found.acceleration[1].tolist() == [25, 26]


def test_another_place_of_the_body_and_an_end_that_is_missing(tmp_path):
    found = read(exudyn_file(tmp_path, HEAD + "\n".join(LINES) + "\n"), first=3)
    assert found.q[1].tolist() == [3, 4] and found.velocity[1].tolist() == [12, 13]
    assert found.remarks[0].endswith("no line says that the simulation is finished; it may have stopped")


@pytest.mark.parametrize("change, message, more", [
    (lambda text: text, r"found 9 coordinates of second order, expected 7 of the frame and 3 of", {"count": 3}),
    (lambda text: text, r"--first: found 8, expected 0 to 7, since .* has 9 coordinates", {"first": 8}),
    (lambda text: text.replace("0.5,0,1,2,", "0.5,0,1,"), r"line 9: found '0.5,0,1,3,.*expected 29 numbers", {}),
    (lambda text: text.replace("0.5,0,1", "0.5,0,a1"), r"line 9: found '0.5,0,a1,.*expected 29 numbers", {}),
    (lambda text: text[: text.index(TAIL) - 2], r"found no line break at its end; the file is cut off", {}),
    (lambda text: text.replace("#number of written", "#"), r"no line '#number of written coordinates", {}),
    (lambda text: text.replace("[9,9,9,", "[9,9,8,"), r"found 9 velocities and 8 accelerations of 9 coordinates", {}),
    (lambda text: text.replace("0.5,0,1", "0.5,0,inf"), r"q is not finite at instant 2 of 2", {"first": 1}),
    (lambda text: "EXUBIN" + text, r"found a binary solution of Exudyn, expected a text", {}),
    (lambda text: HEAD, r"found no instants, expected at least one", {}),
])  # fmt: skip
def test_files_of_exudyn_that_are_refused(tmp_path, change, message, more):
    text = HEAD + "\n".join(LINES) + "\n" + TAIL
    with pytest.raises(InputError, match=message):
        read(exudyn_file(tmp_path, change(text)), **more)


def table(tmp_path, head, rows=3, end="\n"):
    path = tmp_path / "motion.csv"
    width = len(head.split(","))
    values = np.arange(rows * width, dtype=float).reshape(rows, width)
    lines = [",".join(f"{x:g}" for x in row) for row in values]
    path.write_text("\n".join([head, *lines]) + end)
    return path


@pytest.mark.parametrize("head, places", [
    ("t,q1,q2", ([1, 2], None, None)),
    ("t,q2,q1,qdot1,qdot2,qddot1,qddot2", ([2, 1], [3, 4], [5, 6])),
    ('"time","force_20_z","q[1]","q[2]","v[1]","v[2]"', ([2, 3], [4, 5], None)),
    ("time,der(q[1]),der(q[2]),q[1],q[2],der(v[2]),der(v[1])", ([3, 4], [1, 2], [6, 5])),
    ("\ufefft, q1, q2, energy", ([1, 2], None, None)),
    ("t,position_x,q1,q2,displacement_20_z", ([2, 3], None, None)),
])  # fmt: skip
def test_columns_of_tables(tmp_path, head, places):
    found = read(table(tmp_path, head))
    for key, at in zip(("q", "velocity", "acceleration"), places, strict=True):
        values = getattr(found, key)
        width = len(head.split(","))
        assert (values is None) if at is None else values[1].tolist() == [width + k for k in at]


@pytest.mark.parametrize("head, end, message", [
    ("t,displacement_20_z", "\n", r"found columns t, displacement_20_z, and none of the reduced coordinates, q1, q2"),
    ("t,q1,q3", "\n", r"found 2 columns such as q1, and no q2; expected all from 1 on"),
    ("t,q1,q1", "\n", r"found the column 'q1' more than once"),
    ("t,q1,q2,qdot1", "\n", r"found 2 coordinates and 1 columns of their velocity, such as qdot1"),
    ("t,q1,q2", "", r"found no line break at its end; the file is cut off"),
    ("t,q1,q2", "\n1,2\n", r"line 5: found '1,2', expected 3 numbers"),
    ("t,q1,q2", "\n9,2,three\n", r"line 5: found '9,2,three', expected 3 numbers"),
    ("t,q1,q2", "\n9,,3\n", r"line 5: found '9,,3', expected a number between two commas"),
    ("x,q1,q2", "\n", r"motion.csv: found no motion; expected simulation.h5"),
    ("t,q1", "\n", r"found 1 coordinates, expected 2 of the result"),
    ("t,q01,q02", "\n", r"found columns t, q01, q02, and none of the reduced coordinates"),
    ("t,q\u0661,q\u0662", "\n", r"and none of the reduced coordinates"),
    ("t,q1,q2", "\n9,2,1e300\n", r"q is beyond \+-1e\+150 at instant 4 of 4, expected finite numbers"),
])  # fmt: skip
def test_tables_that_are_refused(tmp_path, head, end, message):
    with pytest.raises(InputError, match=message):
        read(table(tmp_path, head, end=end))


def test_names_of_columns_of_any_length_and_number(tmp_path):
    """A number of 5000 digits is one without those before it; the time of 40,000 columns is linear in their number."""
    with pytest.raises(InputError, match="found 3 columns such as q1, and no q3"):
        read(table(tmp_path, f"t,q1,q2,q{'9' * 5000}"))
    assert read(table(tmp_path, ",".join(["t", "q1", "q2", *(f"c{k}" for k in range(40_000))]), rows=1)).q.shape[1] == 2


def _elsewhere(folder, kind):
    """An HDF5 file whose q lies in another file, which has it."""
    q = np.ones((3, 2))
    with h5py.File(folder / "other.h5", "w") as file:
        file["q"] = q
    q.tofile(folder / "other.bin")
    with h5py.File(folder / "q.h5", "w") as file:
        file["t"] = np.arange(3.0)
        if kind == "link":
            file["q"] = h5py.ExternalLink(str(folder / "other.h5"), "/q")
        elif kind == "soft":
            file["q"] = h5py.SoftLink("/t")
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape=(3, 2), dtype="f8")
            layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "q", shape=(3, 2))
            file.create_virtual_dataset("q", layout)
        else:
            file.create_dataset("q", (3, 2), "f8", external=[(str(folder / "other.bin"), 0, q.nbytes)])
    return folder / "q.h5"


@pytest.mark.parametrize("kind, says", [
    ("link", "/q is a link to something else, which is not followed"), ("soft", "/q is a link to something else"),
    ("virtual", "/q is kept in another file, which is not followed"), ("storage", "/q is kept in another file"),
])  # fmt: skip
def test_arrays_elsewhere_are_not_followed(tmp_path, kind, says):
    with pytest.raises(InputError, match=says):
        read(_elsewhere(tmp_path, kind))


@pytest.mark.parametrize("q, says", [
    (np.ones((3, 2)) * (1 + 1j), "q has numbers of the kind complex128, expected an array of real numbers"),
    (np.ones((3, 2), bool), "q has numbers of the kind bool, expected"),
    (np.full((3, 2), "1.0", "S3"), "q has numbers of the kind .S3, expected"),
    (np.full((3, 2), 1e300), "q is beyond .-1e.150 at instant 1 of 3"),
    (h5py.Empty("f8"), "q has numbers of the kind float64, expected an array"),
    (None, "q has no array, expected an array of real numbers"),
])  # fmt: skip
def test_arrays_of_other_contents_are_refused(tmp_path, q, says):
    with h5py.File(tmp_path / "q.h5", "w") as file:
        file["t"] = np.arange(3.0)
        if q is None:
            file.create_group("q")
        else:
            file["q"] = q
    with pytest.raises(InputError, match=says):
        read(tmp_path / "q.h5")


def test_sizes_of_which_nothing_is_stored_are_not_believed(tmp_path):
    with h5py.File(tmp_path / "q.h5", "w") as file:
        file.create_dataset("t", (2 * 10**9,), "f8", chunks=(1000,))
        file.create_dataset("q", (2 * 10**9, 2), "f8", chunks=(1000, 2))
    with pytest.raises(InputError, match="/t is not whole; the file is damaged"):
        read(tmp_path / "q.h5")


def test_the_program_that_looks_at_a_file_starts_by_itself(tmp_path, forks):
    """Tests fork it; the start of Python, with nothing loaded, is that of users."""
    whole, damaged = tmp_path / "whole.h5", tmp_path / "damaged.h5"
    with h5py.File(whole, "w") as file:
        file["q"] = np.ones((3, 2))
    damaged.write_bytes(whole.read_bytes()[:700])
    (start,) = forks.__bases__
    for path in (whole, damaged):
        with start([sys.executable, str(PROBE), str(path)], stderr=subprocess.PIPE) as process:
            assert process.communicate()[1] == b"" and process.returncode == 0


@pytest.mark.parametrize("what", ["import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "while True: pass"])
def test_a_file_on_which_hdf5_crashes_or_does_not_end_is_refused(tmp_path, monkeypatch, what):
    """A process of its own meets such a file first, here by another program in the place of HDF5."""
    (tmp_path / "probe.py").write_text(what)
    monkeypatch.setattr("hpcred.files.opened_hdf5.PROBE", tmp_path / "probe.py")
    monkeypatch.setattr("hpcred.files.opened_hdf5.PATIENCE", 1.0)
    with h5py.File(tmp_path / "q.h5", "w") as file:
        file["t"], file["q"] = np.arange(3.0), np.ones((3, 2))
    with pytest.raises(InputError, match="HDF5 crashes on it, or does not end; the file is damaged"):
        read(tmp_path / "q.h5")


def test_outputs_tell_another_body(tmp_path):
    path = table(tmp_path, "time,displacement_20_z,q[1],q[2]")  # 1 = c . (2, 3), 5 = c . (6, 7)
    row = np.linalg.solve([[2.0, 3], [6, 7]], [1.0, 5])
    assert read(path, outputs={"displacement_20_z": row}).q.shape == (3, 2)
    with pytest.raises(InputError, match=r"displacement_20_z is 9 at 8 s, and 18 by the coordinates; the motion is "
                                         r"that of another body"):  # fmt: skip
        read(path, outputs={"displacement_20_z": 2 * row})


@pytest.mark.parametrize("change, message", [
    (lambda file: file.pop("q"), r"found the arrays qdot, t, and no q; expected t \(nt\) and q \(nt, m\)"),
    (lambda file: file.update(q=np.ones((4, 2))), r"q has the shape \(4, 2\), expected \(nt, m\) = \(3, 2\)"),
    (lambda file: file.update(qdot=np.ones((3, 1))), r"qdot has the shape \(3, 1\), expected \(nt, m\) = \(3, 2\)"),
    (lambda file: file.update(t=np.ones((3, 1))), r"t has the shape \(3, 1\), expected \(nt\)"),
    (lambda file: file.update(t=np.array([0.0, np.nan, 1])), r"t is not finite at instant 2 of 3"),
])  # fmt: skip
def test_arrays(tmp_path, change, message):
    values = {"t": np.arange(3.0), "q": np.arange(6.0).reshape(3, 2), "qdot": np.ones((3, 2))}

    def write():
        with h5py.File(tmp_path / "q.h5", "w") as file:
            for key, array in values.items():
                file[key] = array
        return tmp_path / "q.h5"

    found = read(write())
    assert np.array_equal(found.q, values["q"]) and np.array_equal(found.velocity, values["qdot"])
    change(values)
    with pytest.raises(InputError, match=message):
        read(write())


@pytest.fixture
def linkage_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with (
        hpcred.linkage() as model,
        model.with_inputs([(20, "z"), (1, "x")]) as loaded,
        hpcred.reduce(loaded, [Modes(index=tuple(range(7, 13)))], Buckens(), ModalDamping(ratio=0.02)) as rom,
    ):
        hpcred.write_result("result.h5", rom, loaded)
    return tmp_path


@pytest.mark.peers("exudyn")
@pytest.mark.slow
def test_exudyn_itself(linkage_result):
    """Displacements of mesh nodes are those that Exudyn says at the last instant."""
    import exudyn
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    hpcred.export("result.h5", "exudyn", "body.npz", nodes=[1, 7, 14, 20])
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile("body.npz")
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0.5, 0, 0], initialAngularVelocity=[4, 20, 12],
                                              gravity=[0, 0, -9.81])["oFFRFreducedOrder"]  # fmt: skip
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 200, 0.02
    settings.solution.file.writePeriod = 1e-3
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    report = hpcred.recover("result.h5", "solution/coordinatesSolution.txt", "out.h5", nodes=[1, 7, 14, 20],
                            quantities=("displacement", "velocity", "acceleration"))  # fmt: skip
    assert report["instants"] == 21 and report["remarks"] == []
    with h5py.File("out.h5") as file:
        u, v = file["displacement"][-1], file["velocity"][-1]
    kind = exudyn.OutputVariableType
    theirs = np.array([mbs.GetObjectOutputSuperElement(own, kind.DisplacementLocal, node) for node in range(4)])
    assert u == pytest.approx(theirs, rel=1e-6, abs=1e-8 * np.abs(theirs).max())
    theirs = np.array([mbs.GetObjectOutputSuperElement(own, kind.VelocityLocal, node) for node in range(4)])
    assert np.abs(u).max() > 1e-6 and v == pytest.approx(theirs, rel=1e-6, abs=1e-8 * np.abs(theirs).max())


@pytest.mark.peers("fmpy")
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_fmpy_itself(linkage_result, kind):
    """What the FMU says of its outputs is what is recovered of the nodes."""
    import fmpy
    from fmpy.util import write_csv

    hpcred.export("result.h5", "fmu", "result.fmu")
    states = [f"{letter}[{k}]" for letter in ("q", "v") for k in range(1, 7)]
    result = fmpy.simulate_fmu(
        "result.fmu", fmi_type=kind, stop_time=0.02, output_interval=1e-3, start_values={"force_20_z": 10.0},
        output=["displacement_20_z", "velocity_1_x", *states],
    )  # fmt: skip
    write_csv("fmu.csv", result)
    report = hpcred.recover("result.h5", "fmu.csv", "out.h5", nodes=[1, 20], quantities=("displacement", "velocity"))
    assert report["remarks"] == [] and report["instants"] == len(result)
    with h5py.File("out.h5") as file:
        u, v = file["displacement"][:, 1, 2], file["velocity"][:, 0, 0]
    assert np.abs(u).max() > 1e-8
    assert u == pytest.approx(result["displacement_20_z"], rel=1e-9, abs=1e-15)
    assert v == pytest.approx(result["velocity_1_x"], rel=1e-9, abs=1e-15)
    write_csv("fmu.csv", result, ["displacement_20_z", "velocity_1_x"])
    with pytest.raises(InputError, match=r"none of the reduced coordinates, q1, q2, .*record the states"):
        hpcred.recover("result.h5", "fmu.csv", "out.h5")
