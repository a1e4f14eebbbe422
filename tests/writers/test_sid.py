"""SID files: those of another program, and ours read by a second reader."""

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA

import hpcred
from hpcred import Buckens, CraigBampton, Interface, Modes, Nodes, Rayleigh
from hpcred.body.body import body_of
from hpcred.model.damping import Structural
from hpcred.parallel.failures import InputError
from hpcred.writers import read_sid, write_sid


def body_with(damping, inputs=((20, "z"),)):
    with hpcred.linkage() as model:
        model = model.with_inputs(inputs)
        with hpcred.reduce(model, [Modes(index=tuple(range(7, 13)))], Buckens(), damping) as rom:
            return body_of(model, rom, [1, 7, 20])


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def numbers_of(path):
    """Name of object -> {indices: value}, by an independent reader of the text."""
    objects, name = {}, None
    for line in Path(path).read_text().splitlines():
        words = line.split()
        if len(words) == 1 and words[0] not in ("part", "refmod"):
            name = words[0]
        found = re.match(r"\s*(m\d)\(\s*([\d,\s]+)\)\s*=\s*(\S+)", line)
        if found:
            key = (found[1], *(int(i) for i in found[2].split(",")))
            objects.setdefault(name, {})[key] = float(found[3].replace("D", "e"))
    return objects


@pytest.mark.parametrize("name, modes, nodes", [("balken1m", 1, None), ("beam", 11, None)])
def test_sid_files_of_another_program(name, modes, nodes, tmp_path):
    """They parse, satisfy the definitions of the quantities, and come out again as they were."""
    sid = read_sid(DATA / f"sid/{name}.SID_FEM")
    assert len(sid.coordinates) == modes and sid.mass > 0
    own = sid.objects
    for k in range(modes):
        assert own["mdCM"].m1[:, k, 0] == pytest.approx(own["Ct"].m0[k], rel=1e-9, abs=1e-12)
        gr = own["Gr"].m0[:, 3 * k : 3 * k + 3]
        xx, yy, zz, xy, xz, yz = own["J"].m1[:, k, 0]
        slope = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert (gr + gr.T) / 2 == pytest.approx(slope, rel=1e-8, abs=1e-9)
        assert own["Oe"].m0[k] == pytest.approx([-xx / 2, -yy / 2, -zz / 2, -xy, -yz, -xz], rel=1e-8, abs=1e-9)
    assert own["Cr"].m1 == pytest.approx(-own["Cr"].m1.transpose(1, 0, 2), rel=1e-9, abs=1e-12)
    for node in sid.nodes:
        for k in range(modes):
            assert node.objects["AP"].m1[:, k, :] == pytest.approx(skew(node.objects["psi"].m0[:, k]), abs=1e-12)
    write_sid(tmp_path / "again.SID_FEM", sid)
    lines, again = (
        (path).read_text().split("\n") for path in (DATA / f"sid/{name}.SID_FEM", tmp_path / "again.SID_FEM")
    )
    assert [line.rstrip() for line in again] == [line.rstrip() for line in lines]


def test_sid_of_ours(tmp_path):
    body, path, again = body_with(Rayleigh(2.0, 1e-5)), tmp_path / "body.SID_FEM", tmp_path / "again.SID_FEM"
    notes = write_sid(path, body)
    sid = read_sid(path)
    found, reduced, count = body.floating_frame, body.reduced, body.reduced.size
    assert notes == [
        "integrals quadratic in the shapes: mean of directions, an approximation",
        "no geometric stiffness: loads and rotations do not change the stiffness",
    ]
    assert notes[0] in sid.comment
    assert [item.node for item in sid.nodes] == [1, 7, 20]
    assert sid.mass == pytest.approx(found.mass) and sid.objects["Cr"].m1.shape == (count, count, 3)
    write_sid(again, sid)
    assert again.read_text() == path.read_text()
    text = numbers_of(path)
    for k in range(count):
        assert text["Ke"]["m0", k + 1, k + 1] == pytest.approx((2 * np.pi * reduced.frequencies[k]) ** 2, rel=1e-10)
    assert text["mdCM"]["m0", 1, 1] == pytest.approx(found.mc[0])
    assert text["J"]["m0", 3, 1] == pytest.approx(found.J[2, 2])
    assert text["De"]["m0", 2, 2] == pytest.approx(2.0 + 1e-5 * reduced.K[1, 1])
    for i, shape in enumerate(body.nodes):
        objects = sid.nodes[i].objects
        assert objects["phi"].m0 == pytest.approx(shape.phi, rel=1e-10, abs=1e-10 * np.abs(shape.phi).max())
        assert objects["psi"].m0 == pytest.approx(shape.psi, rel=1e-10, abs=1e-10 * np.abs(shape.psi).max())
        assert objects["origin"].m0[:, 0] == pytest.approx(shape.position)
        assert objects["origin"].m1[:, :, 0] == pytest.approx(shape.phi, rel=1e-10, abs=1e-10)


def test_couplings_far_below_the_largest_stiffness_are_written(tmp_path):
    """A micromechanical body that is held, in interface coordinates: a K of N/m, N and N m, and 1/s^2 of modes."""
    edges = (6e-5, 2e-5, 1e-5)
    tip = Interface(name="tip", nodes=Nodes(box=((0.99 * edges[0], 0.0, 0.0), edges)))
    with (
        hpcred.solid((3, 2, 1), edges, 3) as model,
        model.with_interfaces([tip]).with_inputs([("tip", "all")]) as held,
        hpcred.reduce(held, [CraigBampton(count=6)], None, Rayleigh(2.0, 1e-9), coordinates="interface") as rom,
    ):
        body = body_of(held, rom)
    write_sid(tmp_path / "body.SID_FEM", body)
    sid = read_sid(tmp_path / "body.SID_FEM")
    node = held.interfaces[0].node
    assert sid.coordinates[:6] == [f"Node {node} : {name}" for name in ("x", "y", "z", "rx", "ry", "rz")]
    assert sid.coordinates[6:] == [f"Modal coordinate {k:4d}" for k in range(1, 7)]
    for key, matrix in (("Ke", rom.K), ("De", rom.D), ("Me", body.floating_frame.Me)):
        sizes = np.sqrt(np.diag(matrix))
        assert (np.abs(sid.objects[key].m0 - matrix) < 1e-10 * np.outer(sizes, sizes)).all()
    assert np.abs(rom.K[2, 4]) > 0.1 * np.sqrt(rom.K[2, 2] * rom.K[4, 4])  # bending is there


@pytest.mark.parametrize("order", ["component", "coordinate"])
def test_both_orders_of_the_columns_of_ge(tmp_path, order):
    """Component c of coordinate k of 2 integral Phi_k x Phi_i dm, from S; the header says what is missing."""
    with hpcred.linkage() as model, hpcred.reduce(model, [Modes(index=(7, 8, 9))], Buckens()) as rom:
        rom.export(tmp_path / "bar.SID_FEM", nodes=[1], options={"ge_order": order})
        S = body_of(model, rom, [1]).floating_frame.S
    sid = read_sid(tmp_path / "bar.SID_FEM")
    assert "no geometric stiffness" in sid.comment and f"columns of Ge by {order}" in sid.comment
    Ge = sid.objects["Ge"].m0
    for c, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
        expected = 2 * (S[a, b] - S[b, a]).T  # row i, column k: (Phi_k x Phi_i)_c
        found = Ge[:, 3 * c : 3 * c + 3] if order == "component" else Ge[:, c::3]
        assert np.allclose(found, expected, rtol=0, atol=1e-9 * np.abs(Ge).max())


@pytest.mark.parametrize("given, says", [
    ({"ge_ordr": "component"}, r"--set: sid: unknown key \(did you mean 'ge_order'\?\); known are ge_order"),
    ({"ge_order": "row"}, "--set: sid.ge_order: found 'row', expected 'component' or 'coordinate'"),
    (["mbdyn.ge_order=component"], "--set: found 'mbdyn', expected sid.key=value, of --format sid"),
    (["ge_order"], "--set: found 'ge_order', expected key=value"),
])  # fmt: skip
def test_settings_that_a_format_does_not_have(tmp_path, given, says):
    with hpcred.linkage() as model, hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
        rom.save(tmp_path / "bar.h5")
    with pytest.raises(InputError, match=says):
        hpcred.export(tmp_path / "bar.h5", "sid", nodes=[1], options=given)
    with pytest.raises(InputError, match="'uff' has no settings of its own"):
        hpcred.export(tmp_path / "bar.h5", "uff", options={"ge_order": "component"})


def test_what_a_sid_file_cannot_hold(tmp_path):
    with pytest.raises(InputError, match=r"loss factor 0.02\) has no meaning in time and no place in a SID file"):
        write_sid(tmp_path / "body.SID_FEM", body_with(Structural(0.02)))
    assert not (tmp_path / "body.SID_FEM").exists()
    notes = write_sid(tmp_path / "body.SID_FEM", body_with(None, [3, (20, "z")]))
    assert "inputs that belong to no node are left out: dof 3" in notes
    assert "outputs that belong to no node are left out: dof 3" in read_sid(tmp_path / "body.SID_FEM").comment


@pytest.mark.parametrize(
    "old, new, says",
    [
        (r"end part", "end part\n more", "found 'more', expected nothing behind 'end part'"),
        (r"(nelastq +=).*", r"\1 1.5", "expected a whole number behind 'nelastq ='"),
        (r"(mass +=).*", r"\1 nan", "expected a number behind 'mass ='"),
        (r"mass ", "massive", "expected 'mass = ...'"),
        (r"(J\n(.*\n)*?.*nrow +=).*", r"\1 5", "expected J of order 0 or 1, 6 rows"),
        (r"m0\( 1, 1\)", "m0( 0, 1)", "expected an entry of origin"),
        (r"m0\( 2, 1\)", "m0( 1, 1)", "expected an entry of origin .*, each once"),
        (r"m0\( 2, 1\)", "m0( 2 1)", "expected an entry of origin"),
        (r"origin", "origin\x00", "found a character that is no text"),
        (r"(mass +=).*", r"\1 one", "expected a number behind 'mass ='"),
        (r"end modal", "end", "expected 'end modal'"),
    ],
)
def test_files_that_are_not_understood_are_refused(tmp_path, old, new, says):
    text, count = re.subn(old, new, (DATA / "sid/balken1m.SID_FEM").read_text(), count=1)
    assert count == 1
    (tmp_path / "bad.SID_FEM").write_text(text)
    with pytest.raises(InputError, match=says):
        read_sid(tmp_path / "bad.SID_FEM")
