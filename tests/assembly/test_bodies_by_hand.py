"""Machines of small bodies that are written down, and what is refused of them."""

from types import SimpleNamespace

import numpy as np
import pytest

import hpcred
from hpcred.assembly.coupling import machine_of
from hpcred.assembly.error import Sensitivity
from hpcred.assembly.joints import MachineBody
from hpcred.assembly.parts import part_of


def result(M, K, names, frame=None, **more):
    """A result with a node for each input, which are the first coordinates; places are those of no lever."""
    rows = np.eye(len(M))[: len(names)]
    nodes = list(dict.fromkeys(name.rpartition(":")[0] for name in names))
    shapes = [SimpleNamespace(label=node, node=k, position=np.zeros(3), name=node) for k, node in enumerate(nodes, 1)]
    record = SimpleNamespace(frame=frame or hpcred.NoFrame(), damping=hpcred.GivenDamping(), accuracy=None,
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
    joint = hpcred.RigidJoint(bodies=("long.a", "short.a"), directions="x")
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
        hpcred.assemble(bodies, [hpcred.RigidJoint(bodies=pair, directions="x") for pair in pairs])
