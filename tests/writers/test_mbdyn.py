"""The .fem file for MBDyn, read as its input manual and its reader have it: its energies are those of the body."""

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import exported, gather, to_dense

import hpcred
from hpcred import Buckens, Interface, Krylov, ModalDamping, Modes, Nodes, Rayleigh, Structural
from hpcred.body.body import body_of
from hpcred.parallel.failures import InputError
from hpcred.writers.mbdyn import MbdynFile


def read(path):
    """The groups as MBDyn reads them: in the header a line of text first, then words up to the next `**`."""
    lines = path.read_text().split("\n")
    assert max(map(len, lines)) <= 160  # far below MBDyn's buffer of 8192
    groups, at = {}, 0
    while not lines[at].startswith("** END OF FILE"):
        found = re.match(r"\*\* RECORD GROUP (\d+),", lines[at])
        at += 1
        if not found:
            continue
        number = int(found[1])
        words = []
        if number == 1:
            assert lines[at].startswith("**")
            at += 1
        while number == 8 and "NORMAL MODE SHAPE" in lines[at] or not lines[at].startswith("**"):
            words += [] if lines[at].startswith("**") else lines[at].split()
            at += 1
        assert number not in groups
        groups[number] = words if number == 1 else np.array(words, dtype=str if number == 2 else float)
    nodes, modes = (int(word) for word in groups[1][1:3])
    assert groups[1][3:] == ["0", "0", "0"]
    shapes = {2: (nodes,), 3: (modes,), 4: (modes,), 5: (nodes,), 6: (nodes,), 7: (nodes,), 8: (modes, nodes, 6),
              9: (modes, modes), 10: (modes, modes), 12: (13,), 13: (modes, modes), 14: (3, modes), 15: (3, modes),
              16: (3, modes, 3), 17: (3, modes, modes), 18: (3, modes, modes, 3)}  # fmt: skip
    return {number: groups[number].reshape(shape) for number, shape in shapes.items()}


def test_the_energy_of_any_motion_is_that_of_the_full_model(tmp_path):
    """Kinetic energy of the body moving with v, w, q, q' by MBDyn's invariants against the mass matrix of all nodes."""
    with (
        hpcred.solid((4, 2, 3), inputs=3) as model,
        hpcred.reduce(model, [Krylov(frequency=100.0, order=1)], damping=Rayleigh(20.0, 1e-5)) as rom,
    ):
        V, M, dofs = gather(rom.columns), to_dense(model.M), model.dofs
        origin = np.array([0.1, -0.2, 0.05])
        nodes = sorted(set(dofs.node.tolist()))
        exported(MbdynFile, tmp_path / "body.fem", body_of(model, rom, nodes, origin))
        place, direction = dofs.position - origin, dofs.direction
        reduced = rom
    file = read(tmp_path / "body.fem")
    rng = np.random.default_rng(3)
    v, w = rng.standard_normal((2, 3))
    q, rate = rng.standard_normal((2, reduced.size)) * 0.3  # large, so that quadratic terms count
    # of the full model: the velocity of every row
    displaced = {(n, d): V[i] @ q for i, (n, d) in enumerate(zip(dofs.node, direction, strict=True))}
    moved = place + np.array([[displaced[n, d] for d in range(3)] for n in dofs.node])
    velocity = (v + np.cross(w, moved))[np.arange(len(M)), direction] + V @ rate
    energy = 0.5 * velocity @ M @ velocity
    # of the file
    mass, centre, about_centre = file[12][0], file[12][1:4], file[12][4:].reshape(3, 3)
    inertia = about_centre + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    linear = np.einsum("rjc,j->rc", file[16], q)
    inertia = inertia + linear + linear.T - np.einsum("rjkc,j,k->rc", file[18], q, q)
    static = mass * centre + file[14] @ q
    spin = file[15] + np.einsum("rjk,j->rk", file[17], q)
    found = 0.5 * (mass * v @ v + w @ inertia @ w + rate @ file[9] @ rate)
    found += v @ np.cross(w, static) + v @ file[14] @ rate + w @ spin @ rate
    assert found == pytest.approx(energy, rel=1e-12)
    without = found - w @ np.einsum("rjk,j->rk", file[17], q) @ rate
    assert abs(without - energy) > 1e-3 * energy  # the terms of second order are seen
    # and the rest
    assert np.array_equal(file[9], np.eye(reduced.size))  # without round-off, which MBDyn takes for entries
    for found, expected in ((file[10], reduced.K), (file[13], reduced.D)):
        assert np.array_equal(found, np.diag(np.diag(expected))) and np.allclose(found, expected) and found.any()
    assert not file[3].any() and not file[4].any()
    for row in range(len(M)):
        k = nodes.index(dofs.node[row])
        assert file[8][:, k, direction[row]] == pytest.approx(V[row], abs=1e-15)
        assert [file[5 + d][k] for d in range(3)] == pytest.approx(place[row])


def test_rotations_of_nodes_and_remarks(tmp_path):
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model.with_inputs([(20, "z"), 7]), [Modes(index=(7, 8))], Buckens(), ModalDamping(0.01)) as rom,
    ):
        body = body_of(model, rom, [20, 1])
    body.nodes[1].name = "bearing"
    notes = exported(MbdynFile, tmp_path / "body.fem", body)
    assert notes[-1] == "outputs that belong to no node are left out: dof 7"
    file = read(tmp_path / "body.fem")
    assert file[2].tolist() == ["20", "bearing"]
    for k, shape in enumerate(body.nodes):
        assert np.array_equal(file[8][:, k], np.concatenate([shape.phi, shape.psi]).T) and shape.psi.any()
    body = replace(body, reduced=replace(body.reduced, loss_factor=Structural(0.02).loss_factor))
    with pytest.raises(InputError, match="no place in a .fem file for MBDyn"):
        exported(MbdynFile, tmp_path / "again.fem", body)


def test_names_of_interfaces_are_written_as_they_are(tmp_path):
    """Letters beyond ASCII too: labels that differ in nothing else must not become the same."""
    ends = {"Lager_ä": 0.0, "Lager_ö": 0.04}
    interfaces = [Interface(name=name, nodes=Nodes(box=((x, 0, 0), (x, 1, 1)))) for name, x in ends.items()]
    with (
        hpcred.solid((4, 2, 2), inputs=3, clamped=False) as model,
        model.with_interfaces(interfaces).with_inputs([(name, "all") for name in ends]) as jointed,
        hpcred.reduce(jointed, [Modes(index=(7, 8))], Buckens()) as rom,
    ):
        exported(MbdynFile, tmp_path / "body.fem", body_of(jointed, rom))
    lines = (tmp_path / "body.fem").read_bytes().decode().split("\n")
    assert lines[lines.index("** RECORD GROUP 2, FINITE ELEMENT NODE LIST") + 1].split() == list(ends)
