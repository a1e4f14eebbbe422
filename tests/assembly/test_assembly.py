"""Machines of reduced bodies against full models put together, and the files and commands around them."""

import json
import re
from dataclasses import replace
from html import escape
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse
from helpers import block_with_ends, dense_model, refused, to_dense
from random_machines import estimated_and_true
from scipy.linalg import block_diag

import hpcred
from hpcred.assembly import BushingJoint, MachineBody, PointMass, RigidJoint, Turn
from hpcred.assembly.coupling import machine_of
from hpcred.assembly.error import sensitivity
from hpcred.assembly.parts import part_of
from hpcred.cli.main import run

BAND = (0.0, 20000.0)
R = Turn(axis="z", degrees=90.0).matrix
MACHINE = """
output = "machine.h5"
band = [0.0, 20000.0]
[[body]]
name = "bed"
result = "held.h5"
[[body]]
name = "arm"
result = "free.h5"
position = [0.06, 0.02, 0.0]
turn = {axis = "z", degrees = 90.0}
[[joint]]
bodies = ["bed.right", "arm.left"]
kind = "rigid"
[[mass]]
at = "arm.right"
mass = 0.1
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """held.h5 and free.h5 of two blocks, a held and a free one, and K, M, B of both."""
    from hpcred.parallel.petsc import MPI

    folder, matrices = tmp_path_factory.mktemp("machine"), {}
    for name, clamped, frame in (("held", True, hpcred.NoFrame()), ("free", False, hpcred.Buckens())):
        with block_with_ends(MPI.COMM_WORLD, clamped=clamped) as model:
            matrices[name] = dense_model(model)
            with hpcred.reduce(model, tolerance=1e-3, band=BAND, frame=frame) as rom:
                hpcred.write_result(folder / f"{name}.h5", rom, model)
    return folder, matrices


@pytest.fixture
def machine(made, tmp_path, monkeypatch):
    """machine.toml beside its results, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    for name in ("held.h5", "free.h5"):
        Path(name).write_bytes((made[0] / name).read_bytes())
    Path("machine.toml").write_text(MACHINE)
    return tmp_path


def truth(matrices, s, loss=0.002):
    """The response of both full blocks, joined by multipliers at the place of the bed's interface, with the mass."""
    (Kb, Mb, Bb), (Ka, Ma, Ba) = matrices["held"], matrices["free"]
    K, M, B = block_diag(Kb, Ka), block_diag(Mb, Ma), block_diag(Bb, Ba @ np.kron(np.eye(4), R).T)
    arm = np.array([0.06, 0.01, 0.015]) - (R @ [0.0, 0.01, 0.015] + [0.06, 0.02, 0.0])
    lever = np.eye(6)
    lever[:3, 3:] = [np.cross(arm, axis) for axis in np.eye(3)]  # e_d . (theta x arm) = theta . (arm x e_d)
    G = B[:, :6].T - lever @ B[:, 6:12].T
    M = M + 0.1 * B[:, 12:15] @ B[:, 12:15].T
    found = []
    for value in s:
        A = value**2 * M + (1 + 1j * loss) * K
        whole = np.block([[A, G.T], [G, np.zeros((6, 6))]])
        found.append(B.T @ np.linalg.solve(whole, np.vstack([B, np.zeros((6, B.shape[1]))]))[: len(K)])
    return np.array(found)


def test_two_solids_are_those_of_the_full_models_within_the_estimate(made, machine):
    """Held and free, one turned and moved, joined beside each other, with a mass."""
    results = [hpcred.read_result(name) for name in ("held.h5", "free.h5")]
    bodies = [MachineBody(name="bed", result="-"), MachineBody(
        name="arm", result="-", position=(0.06, 0.02, 0.0), turn=Turn(axis="z", degrees=90.0))]  # fmt: skip
    parts = [part_of(*pair).as_measured() for pair in zip(bodies, results, strict=True)]
    whole = machine_of(parts, [RigidJoint(bodies=("bed.right", "arm.left"))],
                       [PointMass(at="arm.right", mass=0.1)])  # fmt: skip
    reduced = whole.model(1 / (2 * np.pi * BAND[1]))[0]
    found = sensitivity(whole, reduced, BAND)
    some = np.unique(np.r_[0 : len(found.frequencies) : 16, found.curve().argmax()])
    s = 2j * np.pi * found.frequencies[some]
    H = reduced.transfer_function(s)
    by_receptances = whole.response(s)
    size = np.abs(H).max(axis=(1, 2))
    assert (np.abs(H - by_receptances).max(axis=(1, 2)) < 1e-6 * size).all()
    true = found.measure.total(np.abs(truth(made[1], s) - H) / found.scale[some])
    assert (found.curve()[some] >= 0.5 * true).all() and 1e-3 < true.max() < 0.2
    assert np.median(found.curve()[some] / true) < 100


def test_velocities_and_accelerations_have_the_error_of_their_displacements(made):
    """A relative one, so that the measure grows with the frequency as the error does; on a circle around a frequency it
    is larger on one side than at the middle."""
    result, curves = hpcred.read_result(made[0] / "held.h5"), []
    for key, quantity in (("C", ""), ("Cv", "velocity "), ("Ca", "acceleration ")):
        C = result.reduced.C
        moved = replace(result.reduced, **{"C": 0 * C, key: C},
                        output_names=tuple(quantity + name for name in result.reduced.output_names))  # fmt: skip
        part = part_of(MachineBody(name="bed", result="-"), replace(result, reduced=moved)).as_measured()
        whole = machine_of([part], [])
        curves.append(sensitivity(whole, whole.model(1 / (2 * np.pi * BAND[1]))[0], BAND).curve())
    assert curves[1] == pytest.approx(curves[0], rel=0.2) and curves[2] == pytest.approx(curves[0], rel=0.3)


def test_the_command_writes_a_result_that_commands_take(machine, capsys):
    assert run(["assemble", "machine.toml", "--set", "band=[0.0,9000.0]", "--json", "a.json"]) == 0
    shown = capsys.readouterr().out
    assert "largest error of the machine" in shown and "bed" in shown
    assert re.search(r"joint\[0\] +rigid +bed.right +arm.left +0.0141", shown)
    report = json.loads(Path("a.json").read_text())
    result = hpcred.read_result("machine.h5")
    # a body again, with the damping that the errors of its bodies were measured with
    again = hpcred.assemble([MachineBody(name="m", result="machine.h5")], inputs=["m.arm.right:x"])
    column = result.reduced.input_names.index("arm.right:x")
    H = result.reduced.frequency_response([500.0, 9000.0])[..., [column]]
    assert np.abs(again.frequency_response([500.0, 9000.0]) - H).max() < 1e-9 * np.abs(H).max()
    part = again.machine.as_measured().parts["m"].model
    assert part.loss_factor == result.reduced.record.accuracy.loss_factor == 0.002 and again.accuracy is not None
    assert result.reduced.size == report["size"] and "arm.right:rz" in result.reduced.input_names
    assert [node.name for node in result.nodes] == ["bed.right", "arm.left", "arm.right"]
    # the basis moves the interfaces as the nodes are said to, and the shapes are orthonormal in the masses
    arm = result.nodes[1]
    assert arm.position == pytest.approx(R @ [0.0, 0.01, 0.015] + [0.06, 0.02, 0.0])
    lever = np.array([0.06, 0.01, 0.015]) - arm.position
    moved = arm.phi + np.cross(arm.psi.T, lever).T
    assert np.abs(moved - result.nodes[0].phi).max() < 1e-9 * np.abs(moved).max()
    with h5py.File("machine.h5") as file:
        node, V = file["dofs/node"][...], file["basis/V"][...]
        at = np.isclose(file["dofs/position"][:, 0], 0.06) & (node <= node.max() // 2)
        there = at & (file["dofs/direction"][...] == 1) & (node < 1 + 216 // 3 + 12)
        assert V.shape[0] == report["size"] and {"elements", "sets", "held"} & set(file)
        assert np.abs(V[:, there].mean(axis=1) - result.nodes[0].phi[1]).max() < 1e-9 * np.abs(V).max()
    for command in (["evaluate", "machine.h5", "--points", "5"], ["info", "machine.h5"],
                    ["report", "machine.h5", "-o", "r.html"], ["evaluate", "machine.h5", "--estimate"],
                    ["export", "machine.h5", "--format", "statespace-npz", "-o", "m.npz"],
                    ["export", "machine.h5", "--format", "statespace-mat", "-o", "m.mat"]):  # fmt: skip
        assert run([*command, "--quiet"]) == 0, (command, capsys.readouterr())
    # joints and places, and only tables that have a line
    capsys.readouterr()
    assert run(["info", "machine.h5"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"joint\[0\] +rigid +bed.right +arm.left +0.0141", shown)
    assert re.search(r"bed.right +\d+ +0.06 +0.01 +0.015\n", shown)
    assert run(["report", "machine.h5", "-o", "r.html", "--csv", "tabs"]) == 0
    assert {"joints_machine.csv", "error_machine.csv"} <= {path.name for path in Path("tabs").iterdir()}
    assert Path("tabs/joints_machine.csv").read_text().splitlines()[1].startswith("joint[0],rigid,bed.right,arm.left")
    assert not Path("tabs/points_machine.csv").exists() and "Joints of machine" in Path("r.html").read_text()
    # responses of pairs that are named, each in its unit
    pairs = ("arm.right:z/arm.right:z", "arm.right:ry/arm.left:x")
    capsys.readouterr()
    command = ["evaluate", "machine.h5", "--frequencies", "500,9000", "--pairs", ",".join(pairs), "--json", "e.json"]
    assert run(command) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "(m/N)" in shown and "(rad/N)" in shown and shown.count("|H|") == 2
    H, names = result.reduced.frequency_response([500.0, 9000.0]), result.reduced.input_names
    for row, pair in zip(json.loads(Path("e.json").read_text())["pairs"], pairs, strict=True):
        i, j = (names.index(name) for name in pair.split("/"))
        assert row["pair"] == pair and row["reduced"] == pytest.approx(np.abs(H[:, i, j]), rel=1e-9)
    state_space = result.reduced.to_state_space()
    assert state_space.A.shape == (2 * report["size"],) * 2


def test_a_tolerance_says_which_body_to_reduce_again_and_to_what(machine, comm, capsys):
    command = ["assemble", "machine.toml", "--set", "tolerance=2e-2", "--json", "a.json"]
    assert run(command) == 1
    shown = capsys.readouterr().out
    assert "NOT REACHED" in shown and "reduce 'bed' to" in shown
    report = json.loads(Path("a.json").read_text())
    needs = [row["needs"] for row in report["budget"]]
    assert all(0 < row["needs"] < row["error"] for row in report["budget"])
    for name, frame, tolerance in (("held", hpcred.NoFrame(), needs[0]), ("free", hpcred.Buckens(), needs[1])):
        with (
            block_with_ends(comm, clamped=name == "held") as model,
            hpcred.reduce(model, tolerance=tolerance, band=BAND, frame=frame) as rom,
        ):
            hpcred.write_result(f"{name}.h5", rom, model)
    assert run(command) == 0


def test_bushings_are_soft_conditions(machine):
    """Stiffness, damping, a Maxwell element and a table between two bodies, and to the ground, against receptances."""
    Path("mount.csv").write_text("f_hz,re_x,im_x,amplitude\n0,1e6,0,1\n20000,3e6,2e5,1\n0,2e6,0,2\n20000,4e6,2e5,2\n")
    bodies = [MachineBody(name="a", result="free.h5"), MachineBody(name="b", result="free.h5", position=(0.1, 0, 0))]
    law = hpcred.laws.Maxwell((0.5, 2.0), (1e-3, 1e-5))
    joints = [
        BushingJoint(bodies=("a.right", "b.left"), stiffness=(1e7, 1e7, 2e7, 1e4, 1e4, 1e4),
                            damping=(10.0, 20.0, 30.0), law=law, turn=Turn(axis=(1.0, 2.0, 0.5), degrees=33.0)),
        BushingJoint(bodies=("a.left", "ground"), stiffness=(1e7, 1e7, 1e7, 1e4, 1e4, 1e4)),
        BushingJoint(bodies=("ground", "b.right"), table="mount.csv", at={"amplitude": 1.5}),
    ]  # fmt: skip
    found = hpcred.assemble(bodies, joints, band=BAND, inputs=["b.right:x", "a.left"], outputs=["b.right"])
    assert found.reduced.C.shape[0] == 6 and found.reduced.B.shape[1] == 7
    f = np.array([300.0, 3000.0, 15000.0])  # receptances of free bodies have few digits near 0 Hz
    H, other = found.reduced.frequency_response(f), found.machine.response(2j * np.pi * f)
    assert np.abs(H - other).max() < 1e-6 * np.abs(H).max()
    # the table acts: 1.5e6 at 0 Hz, 3.5e6 + 2e5 i at the end
    z = found.machine.conditions[-1].impedance(2j * np.pi * np.array([1e-9, 5000.0, 20000.0]))
    assert z == pytest.approx([1.5e6, 2e6 + 5e4j, 3.5e6 + 2e5j])


def test_twice_the_same_interface_and_rigid_chains(machine):
    """A chain of the same result three times is the same whatever the order of its joints."""
    free = hpcred.read_result("free.h5")
    bodies = [MachineBody(name=f"b{k}", result=free, position=(0.06 * k, 0.0, 0.0)) for k in range(3)]
    joints = [RigidJoint(bodies=(f"b{k}.right", f"b{k + 1}.left")) for k in range(2)]
    ground = RigidJoint(bodies=("b0.left", "ground"))
    given = {"band": (0.0, 500.0), "inputs": ["b2.right"], "outputs": ["b2.right"]}
    one = hpcred.assemble(bodies, [*joints, ground], **given).reduced.frequencies
    other = hpcred.assemble(bodies[::-1], [ground, *joints[::-1]], **given).reduced.frequencies
    assert one == pytest.approx(other, rel=1e-9) and one[0] > 100
    free = hpcred.assemble(bodies, joints, **given)
    assert (free.reduced.frequencies[:6] == 0).all() and free.reduced.frequencies[6] > 100
    assert any("6 rigid-body motions" in text for text in free.warnings)


@pytest.mark.parametrize(("change", "words"), [
    (('"bed.right", "arm', '"bad.right", "arm'), "there is no body 'bad' (did you mean 'bed'?)"),
    (("bed.right", "bed.rihgt"), "has no interface 'rihgt' (did you mean 'right'?)"),
    (('kind = "rigid"', 'kind = "rigit"'), "joint[0].kind: found 'rigit', expected one of rigid, bushing"),
    (('kind = "rigid"', 'kind = "rigid"\ndirections = "xyw"'), "joint.directions: found ['x', 'y', 'w']"),
    (('name = "arm"', 'name = "bed"'), "body.name: found 'bed' twice"),
    (('output = "machine.h5"', 'output = "held.h5"'), "this is held.h5, which this run reads"),
    (('result = "held.h5"', 'result = "model.h5"'), "model.h5"),
    (("mass = 0.1", "mass = -0.1"), "mass.mass: found -0.1"),
    (('[[mass]]', '[[joint]]\nkind = "rigid"\nbodies = ["arm.left", "bed.right"]\n[[mass]]'), "overdetermined"),
    (('[[mass]]', '[[joint]]\nkind = "bushing"\nbodies = ["arm.left", "ground"]\ntable = "m.csv"\n[[mass]]'),
     "has 10 to 100 Hz, which ends inside of the band"),
    (("[0.0, 20000.0]", "[0.0, 30000.0]\ntolerance = 1e-3"), "known over 0 to 20000 Hz"),
])  # fmt: skip
def test_bad_machines_are_refused_in_one_sentence(machine, capsys, change, words):
    Path("m.csv").write_text("f_hz,re_x\n10,1e6\n100,1e6\n")
    assert change[0] in MACHINE
    Path("machine.toml").write_text(MACHINE.replace(*change, 1))
    message = refused(capsys, "assemble", "machine.toml")
    assert words in message and "Traceback" not in message


def test_what_a_body_lacks_is_refused(machine, comm):
    """Directions, and names of nodes."""
    with (
        block_with_ends(comm) as whole, whole.with_inputs([("left", "x"), ("left", "y")]) as model,
        hpcred.reduce(model, [hpcred.Modes(count=8)], hpcred.Buckens()) as rom,
    ):  # fmt: skip
        hpcred.write_result("xy.h5", rom, model)
    with pytest.raises(hpcred.InputError, match="has no direction z"):
        hpcred.assemble([MachineBody(name="a", result="xy.h5")],
                        [RigidJoint(bodies=("a.left", "ground"), directions="xyz")])  # fmt: skip
    found = hpcred.assemble([MachineBody(name="a", result="xy.h5", turn=Turn(axis="x", degrees=30.0))])
    assert found.reduced.input_names == ("a.left:x", "a.left:y of the body")
    with hpcred.solid((6, 2, 3), (60.0, 20.0, 30.0), young=2.1e5, density=7.85e-9, clamped=False) as plain:  # mm, t, s
        boxes = {"left": ((-1, -1, -1), (1, 99, 99)), "right": ((59, -1, -1), (61, 99, 99))}
        ends = [hpcred.Interface(name=name, nodes=hpcred.Nodes(box=box)) for name, box in boxes.items()]
        with plain.with_interfaces(ends) as marked, marked.with_inputs(list(boxes)) as model:
            rom = hpcred.reduce(model, [hpcred.Modes(count=8)], hpcred.Buckens())
            hpcred.write_result("mm.h5", rom, model)
            rom.close()
    told = hpcred.assemble([MachineBody(name="a", result="mm.h5")]).warnings
    assert "interfaces 60 m apart" in told[0] and "convert it with --units" in told[0]
    K = np.diag([1.0, 2.0, 3.0])
    with (
        hpcred.SecondOrderModel(np.eye(3), None, K, np.eye(3)[:, :1]) as model,
        hpcred.reduce(model, [hpcred.Modes(count=2)]) as rom,
    ):
        hpcred.write_result("plain.h5", rom, model)
    with pytest.raises(hpcred.InputError, match="has no interfaces or nodes among its inputs"):
        hpcred.assemble([MachineBody(name="a", result="plain.h5")])


def measured_free(frequencies):
    """The responses of free.h5 as those of a body, rigid-body motions included."""
    alone = hpcred.assemble([MachineBody(name="t", result="free.h5")])
    return alone, alone.reduced.frequency_response(frequencies)


@pytest.mark.peers("pyuff")
def test_a_measured_body_couples_as_the_reduced_one_that_it_was_measured_on(machine, capsys, comm):
    """Through universal files and arrays."""
    import pyuff

    f = np.linspace(200.0, 4000.0, 8)
    alone, H = measured_free(f)
    names = tuple(name.removeprefix("t.") for name in alone.reduced.input_names)
    machine = MACHINE.replace("20000.0", "4000.0")
    Path("machine.toml").write_text(machine)
    assert run(["assemble", "machine.toml", "--quiet"]) == 0
    true = hpcred.read_result("machine.h5").reduced.frequency_response(f)
    places = {"left": (1, np.array([0.0, 0.01, 0.015])), "right": (2, np.array([0.06, 0.01, 0.015]))}
    responses = hpcred.files.Responses(frequencies=f, response=H, input_names=names, output_names=names, places=places)
    for name in ("tool.unv", "tool.npz"):
        hpcred.files.write_responses(name, responses, comm)
        text = machine.replace('result = "free.h5"', f'result = "{name}"\nkind = "measured"')
        Path("machine.toml").write_text(text.replace("machine.h5", "m.csv"))
        assert run(["assemble", "machine.toml", "--json", "a.json"]) == 0
        assert "no modes" in capsys.readouterr().out
        report = json.loads(Path("a.json").read_text())
        assert report["frequencies_hz"] == pytest.approx(f.tolist())
        data = np.loadtxt("m.csv", delimiter=",", skiprows=1)[:, 1:]
        found = (data[:, ::2] + 1j * data[:, 1::2]).reshape(true.shape)
        assert np.abs(found - true).max() < 1e-5 * np.abs(true).max()
    sets = pyuff.UFF("tool.unv").read_sets()
    assert sum(item["type"] == 58 for item in sets) == 144


def test_responses_without_rigid_body_motions_are_warned_of(machine, capsys):
    for result, told in (("free.h5", True), ("held.h5", False)):
        assert run(["evaluate", result, "--frequencies", "1000,2000", "-o", "r.npz"]) == 0
        assert ("r.npz is without the 6 rigid-body motions" in capsys.readouterr().out) == told
    Path("alone.toml").write_text('output = "alone.h5"\n[[body]]\nname = "t"\nresult = "free.h5"\n')
    assert run(["assemble", "alone.toml"]) == 0
    assert run(["evaluate", "alone.h5", "--frequencies", "1000,2000", "-o", "r.npz"]) == 0
    assert "is without" not in capsys.readouterr().out
    found = hpcred.assemble([MachineBody(name="t", result="free.h5")])
    assert repr(found) == str(found) and str(found).startswith("machine of t: ")
    assert escape(found.sentence) in found._repr_html_() and "<td>t</td>" in found._repr_html_()


def test_a_free_machine_has_no_response_at_rest_and_no_full_model(machine, capsys):
    """0 Hz is left out beside other frequencies; of measured bodies too, whose lines often begin there."""
    Path("alone.toml").write_text('output = "alone.h5"\n[[body]]\nname = "t"\nresult = "free.h5"\n')
    assert run(["assemble", "alone.toml", "--quiet"]) == 0
    assert run(["evaluate", "alone.h5", "--frequencies", "0,1000", "--json", "a.json"]) == 0
    assert "0 Hz is left out: rigid-body motions have no response there" in capsys.readouterr().out
    report = json.loads(Path("a.json").read_text())
    H = hpcred.read_result("alone.h5").reduced.frequency_response([1000.0])
    assert report["frequencies_hz"] == [1000.0] and report["reduced_norm"] == pytest.approx([np.linalg.norm(H)])
    assert "found 0 Hz, where rigid-body motions have no response" in refused(
        capsys, "evaluate", "alone.h5", "--frequencies", "0")  # fmt: skip
    for command in (["evaluate", "alone.h5", "--check", "3", "--full", "held.h5"],
                    ["evaluate", "alone.h5", "--full", "held.h5"],
                    ["evaluate", "held.h5", "alone.h5", "--full", "held.h5"]):  # fmt: skip
        says = refused(capsys, *command)
        assert "alone.h5: is a machine of t, which has no full model; --estimate shows its error" in says
    names = ("p:x",)
    np.savez("m.npz", frequencies=[0.0, 1000.0], H=np.ones((2, 1, 1)), input_names=names, output_names=names)
    bodies = [MachineBody(name="m", result="m.npz", kind="measured"), MachineBody(name="t", result="free.h5")]
    found = hpcred.assemble(bodies, [BushingJoint(bodies=("m.p", "t.left"), stiffness=(1e6, 0, 0))])
    assert found.responses().frequencies.tolist() == [1000.0] and "0 Hz is left out" in found.warnings[-1]


def test_coupling_by_receptances_is_the_dual_formula(machine):
    """Two measured beams, against the formula of Lagrange-multiplier substructuring in NumPy, to 1e-10."""
    f = np.linspace(500.0, 9000.0, 7)
    alone, H = measured_free(f)
    H = H * (1 + 0.01j)  # no model has this response
    names = [name.removeprefix("t.") for name in alone.reduced.input_names]
    np.savez("beam.npz", frequencies=f, H=H, input_names=names, output_names=names)
    bodies = [MachineBody(name=name, result="beam.npz", kind="measured") for name in "ab"]
    found = hpcred.assemble(bodies, [RigidJoint(bodies=("a.right", "b.left"))])
    with pytest.raises(hpcred.InputError, match="has no coordinates"):
        found.save("m.h5")
    with pytest.raises(hpcred.InputError, match="was measured from 500 to 9000 Hz, not at 9500 Hz"):
        found.frequency_response([9500.0])
    for k, Y in enumerate(H):
        Y = block_diag(Y, Y)
        B = np.hstack([np.zeros((6, 6)), np.eye(6), -np.eye(6), np.zeros((6, 6))])
        coupled = Y - Y @ B.T @ np.linalg.solve(B @ Y @ B.T, B @ Y)
        assert np.abs(found.frequency_response()[k] - coupled).max() < 1e-10 * np.abs(coupled).max()


@pytest.mark.parametrize(("content", "words"), [
    ({"H": np.ones((2, 1, 1))}, "found no frequencies"),
    ({"frequencies": [1.0, 2.0], "H": np.ones((3, 1, 1)), "input_names": ["a:x"], "output_names": ["a:x"]}, "respon"),
    ({"frequencies": [2.0, 1.0], "H": np.ones((2, 1, 1)), "input_names": ["a:x"], "output_names": ["a:x"]}, "ascend"),
    ({"frequencies": [1.0, 2.0], "H": np.ones((2, 1, 1)), "input_names": ["u"], "output_names": ["a:x"]}, "interface"),
])  # fmt: skip
def test_bad_measurements_are_refused(tmp_path, monkeypatch, content, words):
    monkeypatch.chdir(tmp_path)
    np.savez("m.npz", **content)
    with pytest.raises(hpcred.InputError, match=words):
        hpcred.assemble([MachineBody(name="a", result="m.npz", kind="measured")])


def test_parameters_of_bodies_are_those_of_the_machine(machine, comm):
    """The stiffness of one body of two that share a parameter."""
    with block_with_ends(comm) as model:
        K = to_dense(model.K)
        term = hpcred.Term("K", scipy.sparse.csr_matrix(0.5 * K), "e")
        with (
            hpcred.ParametricModel(model, [hpcred.Parameter("e", (0.0, 1.0), 0.0)], [term]) as parametric,
            hpcred.reduce(parametric, [hpcred.Modes(count=12)], hpcred.Buckens()) as rom,
        ):
            hpcred.write_result("soft.h5", rom, model)
    bodies = [MachineBody(name="bed", result="held.h5"), MachineBody(name="arm", result="soft.h5")]
    found = hpcred.assemble(bodies, [RigidJoint(bodies=("bed.right", "arm.left"))], band=(0.0, 9000.0))
    found.save("machine.h5")
    read = hpcred.read_result("machine.h5").reduced
    assert [item.name for item in read.parameters] == ["e"]
    s = 2j * np.pi * np.array([1000.0, 7000.0])
    for value in (0.0, 0.4, 1.0):
        machine = found.machine
        Y = block(*(part.response(s, {"e": value}) for part in machine.parts.values()))
        H = machine.outputs.matrix @ machine.coupled(s, Y)[0] @ Y @ machine.inputs.matrix.T
        assert np.abs(read.transfer_function(s, e=value) - H).max() < 1e-6 * np.abs(H).max()
    assert run(["campbell", "machine.h5", "--over", "e", "--points", "3", "--highest", "9000", "--quiet"]) == 0


@pytest.mark.slow
def test_two_solids_and_a_crank_are_those_of_the_full_models(made, machine, comm):
    """A held block, a connecting rod of 800 dofs and a free block in a row, with a bushing to the ground."""
    band = (0.0, 3000.0)
    eyes = [hpcred.Interface(name=name, nodes=hpcred.Nodes(set=name)) for name in ("BIG_EYE", "SMALL_EYE")]
    with hpcred.crank(800) as plain, plain.with_interfaces(eyes) as model:
        rod = dense_model(model)
        with hpcred.reduce(model, tolerance=1e-4, band=band, frame=hpcred.Buckens()) as rom:
            hpcred.write_result("rod.h5", rom, model)
    # interfaces that meet, so that no joint has a lever
    big, small = (node.position for node in hpcred.read_result("rod.h5").nodes)
    at = np.array([0.06, 0.01, 0.015]) - big
    bodies = [MachineBody(name="bed", result="held.h5"), MachineBody(name="rod", result="rod.h5", position=at),
              MachineBody(name="arm", result="free.h5", position=at + small - [0.0, 0.01, 0.015])]  # fmt: skip
    bodies = [bodies[0], bodies[2], bodies[1]]
    joints = [RigidJoint(bodies=("bed.right", "rod.BIG_EYE")),
              RigidJoint(bodies=("rod.SMALL_EYE", "arm.left"), directions=("x", "y", "z", "rx", "ry")),
              BushingJoint(bodies=("arm.right", "ground"), stiffness=(1e6, 2e6, 3e6), damping=(10.0, 10.0, 5.0))]
    found = hpcred.assemble(bodies, joints, band=band)
    measured = found.machine.as_measured()
    reduced = measured.model(1 / (2 * np.pi * band[1]))[0]
    curve = sensitivity(measured, reduced, band)
    some = np.unique(np.r_[0 : len(curve.frequencies) : 40, curve.curve().argmax()])
    s = 2j * np.pi * curve.frequencies[some]
    # dense, with multipliers
    K, M, B = (block_diag(*parts) for parts in zip(made[1]["held"], made[1]["free"], rod, strict=True))
    G = np.vstack([(B[:, :6] - B[:, 18:24]).T, (B[:, 24:29] - B[:, 6:11]).T])
    end = B[:, 12:15]
    zeros, true = np.zeros((len(G), len(G))), []
    for value in s:
        A = value**2 * M + (1 + 0.002j) * K
        A = A + end @ np.diag([1e6 + 10 * value, 2e6 + 10 * value, 3e6 + 5 * value]) @ end.T
        whole = np.block([[A, G.T], [G, zeros]])
        true.append(B.T @ np.linalg.solve(whole, np.vstack([B, np.zeros((len(G), B.shape[1]))]))[: len(K)])
    error = curve.measure.total(np.abs(np.array(true) - reduced.transfer_function(s)) / curve.scale[some])
    assert (curve.curve()[some] >= 0.5 * error).all() and error.max() < 0.05


def test_interface_coordinates_make_the_same_machine(machine, comm):
    """A free body whose rigid-body motions are in its result, and one whose frame took them out."""
    with block_with_ends(comm) as model:
        results = []
        for coordinates in ("modal", "interface"):
            settings = hpcred.Reduction(coordinates=coordinates)
            basis = [hpcred.Modes(count=8), hpcred.Krylov(frequency=0.0, order=0)]
            with hpcred.reduce(model, basis, hpcred.Buckens(), settings=settings) as rom:
                hpcred.write_result(f"{coordinates}.h5", rom, model)
            bodies = [MachineBody(name="bed", result="held.h5"), MachineBody(name="arm", result=f"{coordinates}.h5")]
            found = hpcred.assemble(bodies, [RigidJoint(bodies=("bed.right", "arm.left"))], band=BAND)
            assert "the error of body 'arm' is not known" in found.warnings[-1]
            results.append(found.reduced.frequency_response([500.0, 3000.0, 9000.0, 17000.0]))
    assert np.abs(results[0] - results[1]).max() < 1e-7 * np.abs(results[0]).max()


def block(one, other):
    """Block diagonal matrices (S, ., .)."""
    return np.array([block_diag(*pair) for pair in zip(one, other, strict=True)])


@pytest.mark.parametrize("seed", [*range(5), *(pytest.param(k, marks=pytest.mark.slow) for k in range(5, 20))])
def test_random_machines_stay_within_the_estimate(seed):
    estimated, true, _ = estimated_and_true(seed)
    there = true > 1e-5  # of smaller ones round-off is a part, beside sharp resonances near 0 Hz
    assert (estimated[there] >= 0.5 * true[there]).all()
