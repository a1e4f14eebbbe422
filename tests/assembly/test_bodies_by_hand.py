"""Machines of small bodies that are written down, and what is refused of them."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from helpers import block_with_ends
from scipy.spatial.transform import Rotation

import hpcred
from hpcred.assembly.coupling import Machine, laws_of_table, machine_of, warnings_of_table
from hpcred.assembly.error import Sensitivity, damping_of_errors
from hpcred.assembly.joints import BushingJoint, MachineBody, PointMass, RigidJoint, Turn
from hpcred.assembly.parts import part_of
from hpcred.files.machine_basis import _turned
from hpcred.settings.machine_file import MachineJob
from hpcred.workflows.assemble import _assembled


def result(M, K, names, frame=None, **more):
    """A result with a node for each input, which are the first coordinates; places are those of no lever."""
    rows = np.eye(len(M))[: len(names)]
    nodes = list(dict.fromkeys(name.rpartition(":")[0] for name in names))
    shapes = [SimpleNamespace(label=node, node=k, position=np.zeros(3), name=node) for k, node in enumerate(nodes, 1)]
    record = SimpleNamespace(frame=frame or hpcred.NoFrame(), damping=hpcred.GivenDamping(), accuracy=None, loads=(),
                             interface_nodes=(), rigid_body_modes=0, units="")  # fmt: skip
    reduced = hpcred.ReducedModel(M=M, D=np.zeros_like(M), K=K, B=rows.T, C=rows, frequencies=np.ones(len(M)),
                                  input_names=names, output_names=names, record=record, **more)  # fmt: skip
    return SimpleNamespace(reduced=reduced, floating_frame=None, nodes=shapes)


def machine(found, joints=(), **body):
    return machine_of([part_of(MachineBody(name="b", result="-", **body), found)], joints)


def test_low_modes_beside_a_coordinate_without_mass_stay():
    """5 and 12 Hz in a band to 500 Hz."""
    M, K = np.diag([1.0, 1.0, 0.0]), np.diag([25.0, 144.0, 1e4]) * (2 * np.pi) ** 2
    found = machine(result(M, K, ("a:x", "a:y", "a:z"))).model(1 / (2 * np.pi * 500))[0]
    assert found.frequencies[:2] == pytest.approx([5.0, 12.0])


@pytest.mark.parametrize("frame", [hpcred.Tangent(node=1), hpcred.Chord(nodes=(1, 2, 3))])
def test_frames_that_hold_nodes_tell_no_rigid_body_motions(frame):
    with pytest.raises(hpcred.InputError, match=f"the {frame.kind} frame does not tell.*Buckens"):
        machine(result(np.eye(1), np.eye(1), ("a:x",), frame))


def test_a_machine_within_its_tolerance_asks_nothing_of_its_bodies():
    """The largest parts of two bodies are at two frequencies, and their sum is at none."""
    out = np.array([[[[0.6, 0.01]]], [[[0.01, 0.6]]]]) * np.ones((2, 2, 1, 2))  # (S, C, r, b)
    found = Sensitivity(frequencies=np.array([1.0, 2.0]), out=out, between=np.zeros((2, 2, 2, 2)),
                        into=np.ones((2, 2, 2, 1)), scale=np.ones((2, 1, 1)),
                        measure=SimpleNamespace(total=lambda each: each.max(axis=(1, 2))))  # fmt: skip
    assert found.curve() == pytest.approx([0.61, 0.61])
    assert (found.needed(0.7) == 1).all() and (found.needed(0.5) < 1).all()
    # bodies that have little by themselves, and much by each other
    beside = replace(found, out=out / 10, between=0.9 * np.ones((2, 2, 2, 2)) * (1 - np.eye(2)))
    with np.errstate(all="raise"):
        needed = beside.needed(0.5)
    assert beside.shares().sum() < 0.5 < beside.curve().max() and (needed < 1).all()
    assert beside.curve(needed).max() <= 0.5


@pytest.mark.parametrize(("nodes", "words"), [
    ({"b": 1}, "found the name 'b', which another node has"),
    ({"c": 3}, "found the number 3 for 'c', which is no node"),
    ({"c": 1, "d": 1}, "body.nodes: found one of the nodes \\[1, 1\\] twice"),
])  # fmt: skip
def test_names_of_nodes_are_their_own(nodes, words):
    with pytest.raises(hpcred.InputError, match=words):
        machine(result(np.eye(2), np.eye(2), ("a:x", "b:x")), nodes=nodes)


def test_nodes_of_a_measurement_have_names_of_their_own(tmp_path):
    path = str(tmp_path / "m.npz")
    np.savez(path, frequencies=[1.0], H=np.ones((1, 2, 2)), input_names=["1:x", "2:x"], output_names=["1:x", "2:x"])
    found = hpcred.assemble([MachineBody(name="b", result=path, kind="measured", nodes={"2": 1, "1": 2})])
    assert found.machine.inputs.own == ("b.2:x", "b.1:x")
    with pytest.raises(hpcred.InputError, match="found the name '2', which another node has"):
        hpcred.assemble([MachineBody(name="b", result=path, kind="measured", nodes={"2": 1})])


def measured(path, frequencies, names=("a:x", "b:x"), seed=1):
    """A measured body with a random response, which a file has."""
    H = np.random.default_rng(seed).normal(size=(len(frequencies), len(names), len(names), 2)) @ [1.0, 1j]
    np.savez(path, frequencies=frequencies, H=H, input_names=names, output_names=names)
    return MachineBody(name=path.stem, result=str(path), kind="measured")


def test_the_band_of_a_machine_is_where_all_bodies_are_known(tmp_path):
    bodies = [measured(tmp_path / "long.npz", np.linspace(0.0, 500.0, 51)),
              measured(tmp_path / "short.npz", np.linspace(0.0, 300.0, 7))]  # fmt: skip
    joint = hpcred.assembly.RigidJoint(bodies=("long.a", "short.a"), directions="x")
    found = hpcred.assemble(bodies, [joint])
    assert found.band == (0.0, 300.0) and found.lines[[0, -1]] == pytest.approx([0.0, 300.0])
    assert np.isfinite(found.frequency_response()).all()
    far = measured(tmp_path / "far.npz", [600.0, 700.0])
    with pytest.raises(hpcred.InputError, match="'short' is known over 0 to 300 Hz and body 'far' is known over 600"):
        hpcred.assemble([*bodies, far], [joint])
    with pytest.raises(hpcred.InputError, match="body 'long' has no line in 600 to 700 Hz.* from 0 to 500 Hz"):
        hpcred.assemble(bodies, [joint], band=(600.0, 700.0))


def test_rigid_loops_of_measured_bodies_are_refused(tmp_path):
    bodies = [measured(tmp_path / f"{name}.npz", [1.0, 2.0], seed=k) for k, name in enumerate("pqr")]
    pairs = [("p.a", "q.a"), ("q.a", "r.a"), ("r.a", "p.a")]
    with pytest.raises(hpcred.InputError, match="joint\\[2\\] between r.a and p.a:x: is held by other rigid joints"):
        hpcred.assemble(bodies, [hpcred.assembly.RigidJoint(bodies=pair, directions="x") for pair in pairs])


def test_what_is_held_is_turned_with_its_body():
    """A quarter turn about z takes x to y; by 30 degrees only what is held in x and y stays held."""
    node, direction, position = np.array([4, 4, 7, 7]), np.array([0, 2, 0, 1]), np.arange(12.0).reshape(4, 3)
    for degrees, expected in ((90.0, [(4, 1), (4, 2), (7, 0), (7, 1)]), (30.0, [(4, 2), (7, 0), (7, 1)])):
        part = SimpleNamespace(turn=hpcred.assembly.Turn(axis="z", degrees=degrees).matrix)
        numbers, directions, places = _turned(part, node, direction, position)
        assert list(zip(numbers.tolist(), directions.tolist(), strict=True)) == expected
        assert (places == position[np.where(numbers == 4, 0, 2)]).all()


@pytest.mark.parametrize("unit", [1.0, 1e6])
@pytest.mark.parametrize("tau", [1e-4, 1.0, 1e4])
def test_springs_and_masses_that_hide_the_bodies_are_refused(unit, tau):
    """As of stiffness in another unit: 10^9 times the body is right, and beside 10^14 times nothing is left of its
    lowest motion, whatever the band is."""
    K = 3.0 * np.eye(4)
    K[0, 3] = K[3, 0] = -1.0
    body = result(unit * np.diag([1.0, 1.0, 1.0, 2.0]), unit * K, ("a:x", "a:y", "a:z", "b:x"))

    def lowest(joints=(), masses=(), body=body):
        model = machine_of([part_of(MachineBody(name="b", result="-"), body)], joints, masses).model(tau)[0]
        return (2 * np.pi * model.frequencies[0]) ** 2

    spring = [hpcred.assembly.BushingJoint(bodies=("b.a", "ground"), stiffness=(1e9 * unit, 0, 0))]
    assert lowest(spring) == pytest.approx(1.5, rel=1e-5)
    mass = [hpcred.assembly.PointMass(at="b.a", mass=1e5 * unit)]
    assert lowest(masses=mass) == pytest.approx((3.0 - 1 / 3) / 1e5, rel=1e-3)
    for factor in (1e12, 1e14):  # modes with few digits, and those that would be taken for rigid-body motion
        with pytest.raises(hpcred.InputError, match="joint.0. between b.a and ground:x: is .* times as stiff or heavy"):
            lowest([replace(spring[0], stiffness=(factor * unit, 0, 0))])
    with pytest.raises(hpcred.InputError, match="mass.0. at b.a:x: is .*e.14 times as stiff or heavy as the bodies"):
        lowest(masses=[replace(mass[0], mass=1e15 * unit)])
    # a free body beside a stiff spring keeps its rigid-body motions, which nothing hides
    free = result(unit * np.eye(2), unit * np.diag([0.0, 1.0]), ("a:x", "a:y"))
    stiff = hpcred.assembly.BushingJoint(bodies=("b.a", "ground"), stiffness=(0, 1e9 * unit, 0))
    assert lowest([stiff], body=free) == 0


def test_tables_that_give_energy_or_begin_below_zero_are_told():
    joint = hpcred.assembly.BushingJoint(bodies=("b.a", "ground"), table="t.csv")
    rows = np.array([[0.0, 1e6, 0.0, 1.0], [100.0, 1e6, -2e4, 1.0]])
    laws = laws_of_table(("f_hz", "re_x", "im_x", "im_y"), rows, joint, (0.0, 100.0), "t.csv")
    (told,) = warnings_of_table(laws, "t.csv")
    assert told.startswith("t.csv: im_x comes down to -2e+04: such a joint gives energy")
    with pytest.raises(hpcred.InputError, match="t.csv: found -5 Hz, expected frequencies of at least 0"):
        laws_of_table(("f_hz", "re_x"), np.array([[-5.0, 1.0], [100.0, 1.0]]), joint, (0.0, 100.0), "t.csv")


@pytest.mark.parametrize("value", [1e15, 1e30])
def test_masses_that_leave_nothing_of_the_bodies_are_refused(value):
    """Also where LAPACK finds no positive definite matrix any more."""
    found = result(np.diag([1.0, 2.0, 3.0, 1.0]), 3.0 * np.eye(4), ("a:x", "a:y", "a:z", "b:x"))
    body = part_of(MachineBody(name="b", result="-"), found)
    with pytest.raises(hpcred.InputError, match="mass.0. at b.a:.* times as stiff or heavy as the bodies"):
        machine_of([body], (), [hpcred.assembly.PointMass(at="b.a", mass=value)]).model(1e-3)


def test_estimates_do_not_depend_on_how_many_frequencies_are_solved_at_once(monkeypatch):
    body = part_of(MachineBody(name="b", result="-"), result(np.eye(2), np.diag([2.0, 5.0]), ("a:x", "b:x")))
    joints = [hpcred.assembly.BushingJoint(bodies=("b.a", "b.b"), stiffness=(1.0, 0, 0), damping=(0.1, 0, 0))]
    s, found = 1j * np.linspace(0.1, 4.0, 9), machine_of([body], joints)
    whole = found.response(s)
    monkeypatch.setattr("hpcred.analysis.frequency_response.TOGETHER", 200)
    assert (found.response(s) == whole).all() and whole == pytest.approx(found.model(1.0)[0].transfer_function(s))


def test_a_body_beyond_buckling_is_refused():
    with pytest.raises(hpcred.InputError, match="unstable at rest: 1 of its modes"):
        machine(result(np.eye(2), np.diag([1.0, -0.5]), ("a:x", "a:y"))).model(1.0)


def test_structural_damping_of_a_parametric_body_is_that_of_the_reference():
    found = result(np.eye(1), np.eye(1), ("a:x",), loss_factor=0.1)
    term = hpcred.reduction.parametric.reduced.ReducedTerm("K", "e", np.eye(1))
    constant = {key: getattr(found.reduced, key) for key in "MDKBC"}
    parameters = (hpcred.Parameter("e", (0.0, 1.0), 0.0),)
    found.reduced = hpcred.reduction.ParametricReducedModel.of(found.reduced, parameters=parameters, constant=constant,
                                                     terms=(term,))  # fmt: skip
    assert "structural damping is that of the reference values" in machine(found).warnings[0]
    # beside the stiffness of a parameter
    s, model = 2j, machine(found).model(1.0)[0]
    assert model.transfer_function(s, e=0.5)[0, 0] == pytest.approx(1 / (s**2 + 1.5 + 0.1j))


def test_errors_of_bodies_have_one_damping_or_none():
    def of(*factors, D=0.0, beside=False):
        parts = {k: SimpleNamespace(accuracy=SimpleNamespace(loss_factor=factor, beside_damping=beside),
                                    model=SimpleNamespace(D=np.array([D]))) for k, factor in enumerate(factors)}
        return damping_of_errors(SimpleNamespace(parts=parts))

    assert of(0.002, 0.002) == 0.002 and of(0.0, 0.0, D=1.0) == 0 and of(0.002, D=1.0, beside=True) == 0.002
    assert of(0.002, 0.0) is None and of(0.002, D=1.0) is None


@pytest.mark.parametrize(("made", "words"), [
    (lambda: hpcred.assembly.PointMass(at="a.b", mass=0.0), "mass.mass: found 0 and no inertia"),
    (lambda: PointMass(at="ground", mass=1.0), "mass.at: found 'ground'.*the ground does not move"),
    (lambda: PointMass(at="tool", mass=1.0), "mass.at: found 'tool', expected a body and an interface"),
    (lambda: MachineBody(name="a", result="a.h5", turn="z"), "body.turn: found 'z', expected hpcred.assembly.Turn"),
    (lambda: RigidJoint(bodies=("a.b", "ground"), turn={"axis": "z"}), "turn.degrees: found None, expected a number"),
    (lambda: RigidJoint(bodies=("a.b", "ground"), turn={"axes": "z", "degrees": 9}), "unknown keyword 'axes'"),
    (lambda: BushingJoint(bodies=("a.b", "ground"), stiffness=(1, 1, 1), law={"kind": "maxwell"}),
     "joint.law: found .*expected a law, such as hpcred.laws.Maxwell"),
    (lambda: hpcred.assemble([], inputs=[]), "inputs: found none, expected some; leave it out for all"),
    (lambda: MachineJob(body=(MachineBody(name="a", result="a.npz", kind="measured"),), write_basis=False),
     "write_basis: a machine with measured bodies has no basis"),
    *((lambda name=name: MachineBody(name=name, result="a.h5"), "body.name: found '.*expected a word") for name in (
        "a\x1b[31m", "a\0b", "a\nb", "a\ud800")),
    (lambda: MachineBody(name="a", result="a.h5", nodes={"b\0": 3}), r"body.nodes: found 'b\\x00'"),
    (lambda: MachineBody(name="a", result="a.h5", nodes={"b": "3"}), "body.nodes: found {'b': '3'}, expected whole"),
    (lambda: MachineBody(name="a", result="a.h5", nodes={20: 3}), "body.nodes: found {20: 3}, expected whole numbers"),
    (lambda: hpcred.assembly.BushingJoint(bodies=("a.b", "ground"), table="t.csv", at={"size": "1"}),
     "joint.at: found"),
    (lambda: MachineJob(body=(MachineBody(name="a", result="a.h5"),), joint=(
        hpcred.assembly.BushingJoint(bodies=("a.b", "ground"), table="t\0.csv"),)), r"joint\[0\].table: found 't\\x00"),
])  # fmt: skip
def test_keys_without_meaning_are_refused(made, words):
    with pytest.raises(hpcred.InputError, match=words):
        made()


@pytest.mark.parametrize(("text", "words"), [
    ("f_hz,re_x,re_x\n0,1,1\n9,1,1\n", "found the column 're_x' more than once"),
    ("f_hz,re_x\n0,1\n9,1", "the file is cut off"),
    ("f_hz,re_x\n0,1\n9,one\n", "line 3"),
    ("f_hz,re_x\n0,1\n9\n", "line 3"),
    ("f_hz,re_x\n", "found no lines"),
    ("f_hz,re_x\n0,1\n0,1\n9,1\n", "found frequencies twice"),
    ("f_hz,re_x,a\n0,1,1\n9,1,1\n0,1,2\n8,1,2\n", "other ones at other values of the parameter"),
    ("f_hz,re_x,a\n0,1,1\n9,1,1\n0,1,2\n", "other ones at other values of the parameter"),
    ("f_hz,re_x,a\n0,1,2\n9,1,2\n0,1,3\n9,1,3\n", "at: found a = 1, expected 2 to 3"),
    ("f_hz,x\n0,1\n", "found the columns f_hz, x"),
    ("f_hz,re_x\n0,1\n9,1e300\n", "t.csv: found no lines, or numbers that are not finite or above 1e30"),
])  # fmt: skip
def test_bad_tables_are_refused(tmp_path, text, words):
    (tmp_path / "t.csv").write_text(text)
    at = {"a": 1.0} if ",a" in text else {}
    joint = hpcred.assembly.BushingJoint(bodies=("b.a", "ground"), table=str(tmp_path / "t.csv"), at=at)
    with pytest.raises(hpcred.InputError, match=words):
        hpcred.assemble([measured(tmp_path / "b.npz", [1.0, 2.0])], [joint])


@pytest.mark.parametrize("axis", ["y", (1.0, 2.0, -0.5)])
@pytest.mark.parametrize("degrees", [-450.0, 30.0, 180.0])
def test_turns_are_rotations(axis, degrees):
    vector = np.array([0.0, 1.0, 0.0] if axis == "y" else axis)
    expected = Rotation.from_rotvec(np.radians(degrees) * vector / np.linalg.norm(vector)).as_matrix()
    np.testing.assert_allclose(Turn(axis=axis, degrees=degrees).matrix, expected, atol=1e-14)


def test_coordinates_of_a_machine_have_the_size_of_mass_and_stiffness():
    """Also of bodies whose stiffness is that of a load or a spin that makes it negative."""
    part = SimpleNamespace(model=SimpleNamespace(M=np.diag([1.0, 4.0, 0.0]), K=np.diag([-8.0, 5.0, 0.0])))
    assert Machine._scale(SimpleNamespace(parts={"b": part}), 2.0) ** -2 == pytest.approx([33.0, 24.0, 1.0])


def test_units_that_are_known_are_not_doubted():
    """Interfaces 60 m apart in a body of 5 kHz."""
    found = result(np.eye(2), np.eye(2) * (2 * np.pi * 5e3) ** 2, ("a:x", "b:x"))
    found.nodes[1].position = np.array([36.0, 0.0, -48.0])
    found.reduced = replace(found.reduced, frequencies=np.full(2, 5e3))
    assert "interfaces 60 m apart" in machine(found).warnings[0]
    found.reduced.record.units = "mm,t,s"
    assert not machine(found).warnings
    # beside it a body of which nothing is known
    bodies = [MachineBody(name=name, result="-") for name in ("b", "other")]
    results = [found, result(np.eye(2), np.eye(2), ("a:x", "b:x"))]
    told = _assembled(bodies, results, [], [], None, None, None, None).warnings
    assert any("body 'other': the units of its model are not known, and are taken for SI" in text for text in told)
    bodies.append(MachineBody(name="third", result="-"))
    told = _assembled(bodies, [*results, results[1]], [], [], None, None, None, None).warnings
    assert any(text.startswith("body 'other', body 'third': the units of their models") and "--units" in text
               for text in told)  # fmt: skip


def placed(extent=0.3, labels=("a", "b"), frame=None):
    """A result with two interfaces that lie apart, along x, or with one at the origin."""
    names = tuple(f"{label}:{d}" for label in labels for d in ("x", "y", "z", "rx", "ry", "rz"))
    found = result(np.eye(len(names)), np.eye(len(names)), names)
    found.nodes[-1].position = np.array([extent if len(labels) > 1 else 0.0, 0.0, 0.0])
    found.floating_frame = frame
    return found


@pytest.mark.parametrize(("position", "turn", "apart", "warned"), [
    ((0.3, 0.0, 0.0), None, 0.0, False),
    ((0.3, 0.04, 0.03), None, 0.05, False),  # beside each other
    ((300.0, 0.0, 0.0), None, 299.7, True),  # mm
    ((0.03, 0.0, 0.0), None, 0.27, True),
    ((0.6, 0.0, 0.0), {"axis": "z", "degrees": 180}, 0.3, True),
    ((0.3, 0.0, 0.0), Turn(axis="z", degrees=180.0), 0.0, False),
])  # fmt: skip
def test_ends_of_joints_that_are_far_apart_are_told(position, turn, apart, warned):
    other = MachineBody(name="c", result="-", position=position, turn=turn)
    parts = [part_of(MachineBody(name="b", result="-"), placed()), part_of(other, placed())]
    found = machine_of(parts, [RigidJoint(bodies=("b.b", "c.a")), RigidJoint(bodies=("b.a", "ground"))])
    assert found.joints[0].apart == pytest.approx(apart) and found.joints[1].apart is None
    told = [text for text in found.warnings if text.startswith("joint[0]: b.b and c.a are ")]
    assert len(told) == warned == len(found.far) and all("check position (m) and turn" in text for text in told)


def test_a_refusal_says_first_what_is_far_apart():
    """Springs on levers of a length in mm seem too stiff, and loops that do not fit overdetermined."""
    parts = [part_of(MachineBody(name="b", result="-"), placed()),
             part_of(MachineBody(name="c", result="-", position=(1e9, 0.0, 0.0)), placed())]  # fmt: skip
    ends = ("b.b", "c.a")
    spring = BushingJoint(bodies=ends, stiffness=(1.0,) * 6)
    with pytest.raises(hpcred.InputError, match=r"^joint\[0\]: b.b and c.a are 1e\+09 m apart.*as stiff or heavy"):
        machine_of(parts, [spring]).model(1.0)
    with pytest.raises(hpcred.InputError, match=r"^joint\[0\]: b.b and c.a are 1e\+09 m apart.*overdetermined"):
        machine_of(parts, [RigidJoint(bodies=ends), RigidJoint(bodies=ends[::-1])])


def test_a_body_with_one_interface_is_as_large_as_its_inertia_says():
    """A uniform cube of 1 m about its corner: its diagonal."""
    centre = np.full(3, 0.5)
    J = np.eye(3) / 6 + centre @ centre * np.eye(3) - np.outer(centre, centre)
    frame = SimpleNamespace(mass=1.0, mc=centre, J=J)
    parts = [part_of(MachineBody(name=name, result="-", position=(place, 0.0, 0.0)), placed(labels=("a",), frame=frame))
             for name, place in (("b", 0.0), ("c", 0.5), ("d", 0.9))]  # fmt: skip
    assert parts[0].extent == pytest.approx(3**0.5)
    found = machine_of(parts, [RigidJoint(bodies=("b.a", "c.a")), RigidJoint(bodies=("d.a", "b.a"))])
    assert [text[:8] for text in found.far] == ["joint[1]"]


def test_what_acts_twice_at_a_place_is_told():
    parts = [part_of(MachineBody(name=name, result="-"), placed()) for name in ("b", "c")]
    x, y = (BushingJoint(bodies=("b.a", "c.a"), stiffness=value) for value in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    again = BushingJoint(bodies=("c.a", "b.a"), damping=(2.0, 0.0, 0.0))
    masses = [PointMass(at="b.b", mass=1.0), PointMass(at="c.b", mass=1.0), PointMass(at="b.b", mass=2.0)]

    def told(*joints, masses=()):
        return [text for text in machine_of(parts, joints, masses).warnings if "add" in text]

    assert not told(x, y, masses=masses[:2])
    assert told(x, y, again) == ["2 bushings between b.a and c.a (joint[0], joint[2]): what they have in the same "
                                 "directions adds up"]  # fmt: skip
    assert told(x, masses=masses) == ["2 masses at b.b (mass[0], mass[2]): they add up"]


def test_a_force_at_an_interface_without_inputs_is_refused():
    found = result(np.eye(3), np.eye(3), ("20:x", "20:y", "20:z"))
    found.reduced.record.interface_nodes = [SimpleNamespace(name="foot", node=9, position=(0.0, 0.0, 0.0))]
    for name, words in (("b.foot", r"has the interface 'foot', but no inputs there.*model.with_inputs\("),
                        ("b.feet", r"has no interface 'feet'; it has 20"),
                        ("ground.foot", "the ground has no interfaces")):  # fmt: skip
        with pytest.raises(hpcred.InputError, match=words):
            machine(found, [RigidJoint(bodies=(name, "ground"), directions="x")])


@pytest.mark.mpi
def test_all_ranks_write_the_shapes_of_a_turned_body(comm, folder):
    """Against those of the body, which a quarter turn about z takes from x, y to y, -x."""
    with block_with_ends(comm, clamped=True) as model, hpcred.reduce(model, [hpcred.Modes(count=6)]) as rom:
        hpcred.write_result(folder / "body.h5", rom, model)
    bodies = [MachineBody(name="b", result=str(folder / "body.h5"), turn=hpcred.assembly.Turn(axis="z", degrees=90.0)),
              MachineBody(name="c", result=str(folder / "body.h5"))]  # fmt: skip
    made = hpcred.assemble(bodies, comm=comm)
    made.save(folder / "machine.h5", comm=comm)
    if comm.rank:
        return
    with h5py.File(folder / "body.h5") as body, h5py.File(folder / "machine.h5") as whole:
        labels = [np.array([file["dofs/node"][...], file["dofs/direction"][...]]) for file in (body, whole)]
        columns = [file["basis/V"][...][:, np.lexsort(of[::-1])]
                   for file, of in zip((body, whole), labels, strict=True)]  # fmt: skip
        V = columns[0].reshape(6, -1, 3)
        turned = np.stack([-V[..., 1], V[..., 0], V[..., 2]], axis=-1).reshape(6, -1)
        expected = np.hstack([made.T[:6].T @ turned, made.T[6:].T @ columns[0]])
        assert np.abs(columns[1] - expected).max() < 1e-12 * np.abs(expected).max()
        held = [sorted(zip(file["held/node"][...].tolist(), file["held/direction"][...].tolist(), strict=True))
                for file in (body, whole)]  # fmt: skip
        assert held[1][: len(held[0])] == held[0] and len(held[1]) == 2 * len(held[0])
