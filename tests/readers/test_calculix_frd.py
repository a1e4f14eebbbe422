"""Results of CalculiX as nodes: those of a run of its own, text and binary, in place of the input file."""

import gzip

import numpy as np
import pytest
from conftest import DATA
from foreign import gathered, write
from helpers import to_dense

import hpcred
from hpcred import InputError
from hpcred.files import text as text_module
from hpcred.readers.abaqus import input_file as abaqus_input
from hpcred.readers.calculix import frd as calculix_frd
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

FORMS = ("text", "binary")


def put(comm, folder, **results):
    """The files of the matrices, and others by suffix."""
    data = DATA / "calculix"
    for suffix in ("sti", "mas"):
        write(folder / f"a.{suffix}", gzip.decompress((data / f"quadratic.{suffix}.gz").read_bytes()), comm)
    write(folder / "a.dof", (data / "quadratic.dof").read_bytes(), comm)
    for suffix, content in results.items():
        write(folder / f"a.{suffix}", content, comm)
    return {key: str(folder / f"a.{suffix}") for key, suffix in (("K", "sti"), ("M", "mas"), ("dofs", "dof"))}


def results(form):
    return (DATA / "calculix" / f"quadratic_{form}.frd").read_bytes()


def short(text):
    """The same text with numbers of nodes and elements in five columns, fifteen nodes a line."""
    head, mesh = text[: text.index(b"    2C")], text[text.index(b"    2C") : text.index(b"    1PSTEP")]
    lines, nodes = [], []
    for line in mesh.splitlines():
        if line[:3] == b" -2":
            nodes += line[3:].split()
            continue
        rows = [nodes[low : low + 15] for low in range(0, len(nodes), 15)]
        lines += [b" -2" + b"".join(b"%5s" % node for node in row) for row in rows]
        nodes = []
        lines.append(line[:-1] + b"0" if line[5:6] == b"C" else line[:3] + line[8:] if line[:3] == b" -1" else line)
    return head + b"\n".join(lines) + b"\n" + text[text.index(b"    1PSTEP") :]


@pytest.mark.parametrize("form", [*FORMS, "short"])
@pytest.mark.parametrize("piece", [60, 2**19])
def test_nodes_and_elements_are_those_of_the_input_file(comm, folder, monkeypatch, form, piece):
    monkeypatch.setattr(text_module, "PIECE", piece)
    monkeypatch.setattr(calculix_frd, "SHARE", 1)
    content = short(results("text")) if form == "short" else results(form)
    found = calculix_frd.read(write(folder / "a.frd", content, comm), comm)
    mesh = abaqus_input.read(DATA / "calculix" / "quadratic.inp", comm, calculix=True)
    label, position, expected = gathered(comm, found.nodes.label, found.nodes.position, mesh.nodes.position)
    assert label.tolist() == [*range(1, 28)] and found.rough == (form != "binary")
    assert np.abs(position - expected).max() <= (5e-7 if found.rough else 0)
    assert set(found.elements) == set(mesh.elements) == {"hexahedron20", "wedge15"}
    for kind, nodes in found.elements.items():
        assert np.array_equal(*(gathered(comm, item)[0] for item in (nodes, mesh.elements[kind])))


@pytest.mark.parametrize("form", FORMS)
def test_results_in_place_of_the_input_file(comm, folder, form):
    """Beside the matrices, and by options; the same rows as with the input file."""
    files = put(comm, folder, inp=(DATA / "calculix" / "quadratic.inp").read_bytes())
    with load_export(folder / "a.sti", comm) as model:
        K, names = to_dense(model.K), gathered(comm, model.dofs.node, model.dofs.direction)
        assert hpcred.inspect(model)["rigid_body_modes"] == 6
    comm.Barrier()
    if comm.rank == 0:
        (folder / "a.inp").unlink()
    put(comm, folder, frd=results(form))
    nodes = str(write(folder / "other.frd", results(form), comm))
    for load in (lambda: load_export(folder / "a.sti", comm), lambda: load_source(Source(**files, nodes=nodes), comm)):
        with load() as model:
            assert np.array_equal(to_dense(model.K), K)
            assert all(map(np.array_equal, gathered(comm, model.dofs.node, model.dofs.direction), names))
            said = " ".join(model.remarks)
            assert ("6 digits" in said) == (form == "text") and "supports and sets of nodes only the input file" in said
            assert max(hpcred.inspect(model)["rigid_body_residuals"]) < (1e-6 if form == "text" else 1e-14)


def test_rows_by_options(comm, folder):
    """A .dof file with the input file, whose ROT nodes are rotations, with a list of nodes, and results with a list of
    rows."""
    files = put(comm, folder, frd=results("binary"))
    data = DATA / "calculix"
    bodies = {}
    for suffix in ("sti", "mas"):
        content = gzip.decompress((data / f"incompatible.{suffix}.gz").read_bytes())
        bodies[suffix] = str(write(folder / f"b.{suffix}", content, comm))
    dofs, mesh = str(data / "incompatible.dof"), str(data / "incompatible.inp")
    with load_source(Source(bodies["sti"], bodies["mas"], nodes=mesh, dofs=dofs), comm) as model:
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
        assert (direction >= 3).any()
        assert max(hpcred.inspect(model)["rigid_body_residuals"]) < 1e-12
    mesh = abaqus_input.read(data / "quadratic.inp", comm, calculix=True)
    label, position = gathered(comm, mesh.nodes.label, mesh.nodes.position)
    lines = "".join(f"{n} {x!r} {y!r} {z!r}\n" for n, (x, y, z) in zip(label.tolist(), position.tolist(), strict=True))
    table = str(write(folder / "nodes.txt", lines, comm))
    rows = str(write(folder / "dofs.txt", (folder / "a.dof").read_bytes().replace(b".", b" "), comm))
    for nodes, dofs in ((table, files["dofs"]), (str(folder / "a.frd"), rows)):
        with load_source(Source(files["K"], files["M"], nodes=nodes, dofs=dofs), comm) as model:
            assert max(hpcred.inspect(model)["rigid_body_residuals"]) < 1e-14


def test_rows_that_results_do_not_tell_have_no_names(comm, folder):
    """Rows of a node without element, as of a rigid body; plane elements; a run that wrote no results."""
    files = put(comm, folder)
    rows = (folder / "a.dof").read_bytes()
    lost = rows.replace(b"27.", b"28.")
    flat = results("text").replace(b" -1         1    4    0    1", b" -1         1   10    0    1")
    cut = flat.index(b"        11        12        17")
    flat = flat[: cut - 3 - 20 - 1] + b"\n" + flat[flat.index(b" -1         2    5") :]
    for dof, frd, says in (
        (lost, results("text"), "the node 28 is not in"), (rows, flat, r"quad8\) become solids"),
        (rows, b"    1C\n 9999\n", "has no nodes"),
    ):  # fmt: skip
        put(comm, folder, dof=dof, frd=frd)
        with load_export(folder / "a.sti", comm) as model:
            assert model.dofs is None and any("the rows have no names" in item for item in model.remarks)
        with pytest.raises(InputError, match=says):
            load_source(Source(**files, nodes=str(folder / "a.frd")), comm)
        comm.Barrier()
    twice = put(comm, folder, dof=rows.replace(b"1.2\n", b"1.1\n", 1))
    table = str(write(folder / "nodes.txt", "1 0 0 0\n", comm))
    with pytest.raises(InputError, match="found two rows of 1:x, since CalculiX makes solids of beams and shells"):
        load_source(Source(**twice, nodes=table), comm)


def test_damaged_results_are_refused(comm, folder):
    text, binary = (results(form) for form in FORMS)
    nodes, elements = text.index(b"    2C"), text.index(b"    3C")
    for content in (
        text[: nodes + 300], text[: elements + 100], text.replace(b"27    ", b"28    ", 1), text[:elements] + b"xyz\n",
        text.replace(b" -1         2 1.00000E-01", b" -1         1 1.00000E-01"),
        text.replace(b" -1         2 1.00000E-01", b" -1         2 1.0000xE-01"),
        text.replace(b" -1         2 1.00000E-01", b" -1         2         NaN"),
        text.replace(b"     2    5    0    1", b"     2   15    0    1"),
        text.replace(b"     2    5    0    1", b"     2    4    0    1"),
        binary[: binary.index(b"    2C") + 300], binary[: binary.index(b"    3C") + 100],
    ):  # fmt: skip
        assert content not in (text, binary)
        with pytest.raises(InputError, match="a.frd"):
            calculix_frd.read(write(folder / "a.frd", content, comm), comm)
        comm.Barrier()


def test_lists_of_results_without_nodes_are_refused(comm, folder):
    files = put(comm, folder, frd=b"    1C\n 9999\n")
    with pytest.raises(InputError, match="a.frd: found results of CalculiX without nodes, as a run that only writes"):
        load_source(Source(files["K"], files["M"], nodes=str(folder / "a.frd")), comm)
