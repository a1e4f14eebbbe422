"""Universal files: what is written is read back by fixed columns and by the reader; real nodes and elements."""

import numpy as np
import pytest
from conftest import DATA
from foreign import gathered, write
from helpers import exported

import hpcred
from hpcred import InputError, Modes
from hpcred.fe.elements import NODES
from hpcred.files import text as text_module
from hpcred.files.result_file import read_result
from hpcred.parallel.petsc import MPI
from hpcred.readers.model_source import load_source
from hpcred.readers.nodes import uff
from hpcred.settings.source import Source
from hpcred.workflows.export import export_result
from hpcred.writers.uff import CODES, UffFile

pytestmark = pytest.mark.mpi

FILE = DATA / "uff" / "heat_engine_housing.uff"


def test_nodes_and_elements_of_a_real_file(comm, monkeypatch):
    monkeypatch.setattr(text_module, "PIECE", 150)
    nodes, elements, *_ = uff.read(FILE, comm)
    label, place, position = gathered(comm, nodes.label, nodes.place, nodes.position)
    assert label.tolist() == list(range(1, 11)) and place.tolist() == list(range(10))
    assert position[0].tolist() == [-1.711755676269531e2, 1.036403427124023e2, 1.384829101562500e2]
    found = {kind: np.concatenate(comm.allgather(part)).tolist() for kind, part in elements.items()}
    assert found == {
        "tetra": [[1, 3, 6, 7], [2, 3, 4, 8], [6, 7, 9, 10], [1, 3, 9, 10]],
        "triangle": [[1, 2, 4], [8, 9, 10], [6, 8, 9], [2, 3, 8]],
    }


@pytest.mark.costly
def test_shapes_of_a_result(comm, folder):
    with hpcred.solid((2, 2, 2), inputs=2, comm=comm) as model, hpcred.reduce(model, [Modes(count=3)]) as rom:
        hpcred.write_result(folder / "r.h5", rom, model)
    report = export_result(folder / "r.h5", "uff", comm=comm)
    assert report["output"] == str(folder / "r.uff") and len(report["shapes"]) == 3
    lines = (folder / "r.uff").read_text().split("\n")
    assert lines[1] == "   164"  # (I10, 20A1, I10): code of the units, their name, kind of temperatures
    assert [lines[2][:10], lines[2][10:30], lines[2][30:]] == [f"{1:10d}", "  SI: Meter (newton)", f"{2:10d}"]
    with read_result(folder / "r.h5", MPI.COMM_SELF).shapes() as shapes:
        starts = [k for k, line in enumerate(lines) if line == "    55"]
        assert len(starts) == 3
        for k, at in enumerate(starts):
            assert lines[at + 1] == shapes.names[k]
            assert [int(lines[at + 6][10 * c : 10 * c + 10]) for c in range(6)] == [1, 2, 2, 8, 2, 3]
            assert float(lines[at + 8][:13]) == pytest.approx(shapes.frequencies[k], rel=1e-5)
            count = len(shapes.nodes)
            rows = lines[at + 9 : at + 9 + 2 * count]
            assert [int(row) for row in rows[::2]] == shapes.nodes.tolist() and lines[at + 9 + 2 * count] == "    -1"
            found = [[float(row[13 * c : 13 * c + 13]) for c in range(3)] for row in rows[1::2]]
            moved = shapes.displacement(k)
            assert np.abs(found - moved).max() < 1e-5 * np.abs(moved).max()
        nodes, elements, *_ = uff.read(folder / "r.uff", comm)
        label, position = gathered(comm, nodes.label, nodes.position)
        assert np.array_equal(label, shapes.nodes) and np.array_equal(position, shapes.points)
        cells = np.concatenate(comm.allgather(elements["hexahedron"]))
        assert np.array_equal(cells, shapes.nodes[shapes.cells["hexahedron"]])


@pytest.mark.peers("pyuff")
@pytest.mark.mpi(ranks=(1,), build="real")
def test_shapes_in_pyuff(comm, folder):
    import pyuff

    with hpcred.solid((2, 2, 2), inputs=2, comm=comm) as model, hpcred.reduce(model, [Modes(count=3)]) as rom:
        hpcred.write_result(folder / "r.h5", rom, model)
    export_result(folder / "r.h5", "uff", comm=comm)
    units, nodes, *others = pyuff.UFF(str(folder / "r.uff")).read_sets()
    assert units["length"] == units["force"] == 1 and [item["type"] for item in others] == [2412, 55, 55, 55]
    with read_result(folder / "r.h5", MPI.COMM_SELF).shapes() as shapes:
        assert np.array_equal(nodes["node_nums"], shapes.nodes)
        assert np.array_equal(np.transpose([nodes[key] for key in "xyz"]), shapes.points)
        for k, shape in enumerate(others[1:]):
            assert shape["freq"] == pytest.approx(shapes.frequencies[k], rel=1e-5)
            assert np.array_equal(shape["node_nums"], shapes.nodes)
            moved = shapes.displacement(k)
            found = np.transpose([shape[key] for key in ("r1", "r2", "r3")])
            assert np.abs(found - moved).max() < 1e-5 * np.abs(moved).max()


class Cells:
    """One element of each kind that a file can hold."""

    nodes = np.arange(1, 21) * 3
    points = np.random.default_rng(1).standard_normal((20, 3))
    cells = {kind: np.random.default_rng(2).permutation(20)[: NODES[kind]][None] for kind in CODES}
    names, frequencies = [], []


def test_every_kind_of_element_comes_back(comm, folder):
    if comm.rank == 0:
        assert exported(UffFile, folder / "a.unv", Cells) == []
    comm.Barrier()
    _, elements, *_ = uff.read(folder / "a.unv", comm)
    assert sorted(elements) == sorted(CODES)
    for kind, nodes in Cells.cells.items():
        assert np.array_equal(np.concatenate(comm.allgather(elements[kind])), Cells.nodes[nodes])


def test_middles_lie_between_their_corners():
    """In the file the nodes of edges go corner, middle, corner."""
    edges = {"triangle6": [(0, 1), (1, 2), (2, 0)], "quad8": [(0, 1), (1, 2), (2, 3), (3, 0)], "line3": [(0, 1)],
             "tetra10": [(0, 1), (1, 2), (2, 0)], "hexahedron20": [(0, 1), (1, 2), (2, 3), (3, 0)],
             "wedge15": [(0, 1), (1, 2), (2, 0)]}  # fmt: skip
    for kind, pairs in edges.items():
        corners = max(map(max, edges[kind])) + 1
        first = {"tetra10": 4, "hexahedron20": 8, "wedge15": 6}.get(kind, corners)
        for k, (a, _) in enumerate(pairs):
            assert uff.ORDER[kind][2 * k : 2 * k + 2] == [a, first + k]


NODES_15 = """    -1
    15
         1         0         0         8  1.00000E+00  2.00000E+00 -3.00000E+00
         5         0         0         8  1.50000D+00  2.00000E+00  3.00000E+00
    -1
"""


def test_nodes_of_dataset_15(comm, folder):
    nodes, elements, *_ = uff.read(write(folder / "a.unv", NODES_15, comm), comm)
    label, position = gathered(comm, nodes.label, nodes.position)
    assert label.tolist() == [1, 5] and position.tolist() == [[1, 2, -3], [1.5, 2, 3]] and not elements


@pytest.mark.parametrize(
    "label, number, x, expected",
    [
        (3, 15, 7.0, ([1, 5, 3], [1.0, 1.5, 7.0])),
        (5, 15, 1.500001, ([1, 5], [1.0, 1.5])),
        (5, 2411, 1.500001, ([1, 5], [1.0, 1.5])),
        (5, 2411, 1.51, "the node 5 at different places in two datasets"),
    ],
)
def test_nodes_of_two_datasets(comm, folder, label, number, x, expected):
    """They follow each other; those that both have are the same to the digits of dataset 15."""
    head = f"{label:10d}{0:10d}{0:10d}{8:10d}"
    more = {15: f"{head}{x:13.5E}  2.00000E+00  3.00000E+00\n", 2411: f"{head}\n{x:25.16E} 2.0 3.0\n"}[number]
    path = write(folder / "a.unv", f"{NODES_15}    -1\n{number:6d}\n{more}    -1\n", comm)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            uff.read(path, comm)
        return
    nodes = uff.read(path, comm).nodes
    label, place, position = gathered(comm, nodes.label, nodes.place, nodes.position)
    order = np.argsort(place)
    assert place[order].tolist() == list(range(len(place)))
    assert (label[order].tolist(), position[order, 0].tolist()) == expected


def system_18(number, origin, along, plane):
    values = [f"{value:13.5E}" for value in (*origin, *along, *plane)]
    return f"{number:10d}{0:10d}{0:10d}{8:10d}{1:10d}\nCS{number}\n{''.join(values[:6])}\n{''.join(values[6:])}\n"


def system_2420(number, turned):
    axes = [(0, 1, 0), (-1, 0, 0), (0, 0, 1)] if turned else np.eye(3)
    rows = "".join("".join(f"{value:25.16E}" for value in row) + "\n" for row in (*axes, (0, 0, 0)))
    return f"    -1\n  2420\n{1:10d}\npart\n{number:10d}{0:10d}{0:10d}\nCS{number}\n{rows}    -1\n"


@pytest.mark.parametrize(
    "systems, node, says",
    [
        (system_18(1, (0, 0, 0), (1, 0, 0), (0, 0, 1)), (1, 1), None),
        (system_18(4, (0, 0, 0), (1, 0, 0), (1, 0, 2)), (4, 0), None),
        (system_18(1, (0, 0, 1), (1, 0, 1), (0, 0, 2)), (1, 0), "coordinates in the global system"),
        (system_18(1, (0, 0, 0), (0, 1, 0), (0, 0, 1)), (1, 0), "coordinates in the global system"),
        (system_18(1, (0, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 1), "displacements in the global system"),
        (system_18(1, (0, 0, 0), (0, 1, 0), (0, 0, 1)).replace("0E+00", "x"), (1, 0), "coordinates in the global"),
        (system_18(2, (0, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 1), None),
    ],
)
def test_coordinate_systems_of_dataset_18(comm, folder, systems, node, says):
    nodes = NODES_15.replace("5         0         0", "5{:10d}{:10d}".format(*node))
    path = write(folder / "a.unv", f"    -1\n    18\n{systems}    -1\n{nodes}", comm)
    if says is None:
        assert sum(gathered(comm, uff.read(path, comm)[0].position)[0].tolist(), []) == [1, 2, -3, 1.5, 2, 3]
    else:
        with pytest.raises(InputError, match=says):
            uff.read(path, comm)


@pytest.mark.parametrize("number, turned", [(1, False), (3, False), (1, True), (3, True)])
def test_displacements_in_systems_of_dataset_2420(comm, folder, number, turned):
    nodes = f"    -1\n  2411\n{8:10d}{1 if turned else number:10d}{number:10d}{11:10d}\n 1.0 2.0 3.0\n    -1\n"
    path = write(folder / "a.unv", system_2420(number, turned) + nodes, comm)
    if turned:
        with pytest.raises(InputError, match="displacements in the global system"):
            uff.read(path, comm)
    else:
        assert gathered(comm, uff.read(path, comm)[0].position)[0].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("-3.00000E+00\n", "\n", "line 3: "),
        ("         5 ", "         1 ", "found the node 1 more than once"),
        ("         5         0", "         5         7", "coordinates in the global system"),
        ("3.00000E+00\n    -1", "3.00000E+00\n", "found 1 lines of -1, expected two a dataset"),
        ("    15\n", "    55\n", "found 0 datasets of nodes"),
        (" 2.00000E+00 -3", " nan -3", "expected finite node coordinates"),
        ("1.50000D+00", "1.5_000D+00", "expected numbers a line"),
        ("         8  1.5", "       8.5  1.5", "expected two systems and a colour as a whole number"),
        ("3.00000E+00\n    -1\n", "3.00000E+00\n    -1\nmore\n", "found 'more' outside of a dataset"),
        ("    15\n", "    15 7\n", "expected the number of a dataset"),
    ],
)
def test_damaged_files_are_refused(comm, folder, old, new, says):
    assert old in NODES_15
    path = write(folder / "a.unv", NODES_15.replace(old, new, 1), comm)
    with pytest.raises(InputError) as error:
        uff.read(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize("behind", [b"", b"\r\n"])
def test_nodes_beside_binary_functions(comm, folder, behind):
    """What looks like the end of a dataset among the bytes of functions is none."""
    rubbish = b"\n    -1\n    15\n\xff\x00\n    -1"
    head = f"    -1\n    58b     1     2{2:12d}{len(rubbish):12d}     0     0           0           0\na\nb\n"
    text = head.encode() + rubbish + behind + b"    -1\n"
    for content in (text + NODES_15.encode(), NODES_15.encode() + text):
        nodes, *_ = uff.read(write(folder / "a.uff", content, comm), comm)
        assert gathered(comm, nodes.label)[0].tolist() == [1, 5]
        comm.Barrier()
    unknown = text.replace(f"{2:12d}".encode(), b"           x")
    for cut, says in ((text[:-8], "found no line of -1 behind the binary"), (unknown, "number of lines and bytes")):
        assert cut != text
        with pytest.raises(InputError, match=says):
            uff.read(write(folder / "b.uff", NODES_15.encode() + cut, comm), comm)
        comm.Barrier()


def test_damaged_elements_are_refused(comm, folder):
    content = FILE.read_text()
    for old, new in (("         1         3         6         7\n", "         1         3         6\n"),
                     ("         1       111         5", "         1       111      1e99"),
                     ("         1         1         4\n", "         1         1         9\n")):  # fmt: skip
        assert old in content
        with pytest.raises(InputError, match="expected (number, kind|as many nodes|the numbers)"):
            uff.read(write(folder / "a.uff", content.replace(old, new, 1), comm), comm)


def group(number, name, *members, width=4, head=8):
    """Lines of a group as Gmsh and others write them: members are a kind and a number each."""
    numbers = [item for kind, tag in members for item in (kind, tag, 0, 0)[:width]]
    rows = ["".join(f"{item:10d}" for item in numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
    first = "".join(f"{item:10d}" for item in [number, *[0] * (head - 2), len(members)])
    return "\n".join([first, name, *rows]) + "\n"


def dataset(number, *groups):
    return f"    -1\n{number:6d}\n{''.join(groups)}    -1\n"


@pytest.mark.parametrize(("number", "form"), [(2477, {}), (2467, {}), (2452, {}), (2432, {"width": 2}),
                                              (2417, {"width": 2, "head": 7})])  # fmt: skip
def test_groups_are_node_sets(comm, folder, number, form):
    """Nodes that a group lists, and those of its elements, which are taken from the lines of the file above."""
    groups = [group(1, "big end", (7, 9), (7, 2), (7, 9), **form), group(2, "faces", (8, 5), (8, 8), **form),
              group(3, "both", (8, 1), (7, 2), **form), group(7, "", (7, 4), **form), group(8, "none", **form),
              group(9, "twice", (7, 1), **form), group(11, "twice", (7, 3), **form),
              group(12, "lacking", (8, 5), (8, 77), **form), group(13, "other", (1, 5), **form)]  # fmt: skip
    mesh = uff.read(write(folder / "a.unv", FILE.read_text() + dataset(number, *groups), comm), comm)
    found = {name: gathered(comm, nodes)[0].tolist() for name, nodes in mesh.sets.items()}
    assert found == {
        "big end": [2, 9], "faces": [1, 2, 3, 4, 8], "both": [1, 2, 3, 6, 7], "group 7": [4], "twice 9": [1],
        "twice 11": [3], "lacking": [1, 2, 4],
    }  # fmt: skip
    remarks = sum(comm.allgather(mesh.remarks), [])
    assert len(remarks) == 1 and remarks[0].endswith("elements whose kinds are not read: lacking")


@pytest.mark.parametrize("lines", [
    group(1, "A", (7, 9), (7, 2), (7, 3)).rsplit("\n", 2)[0] + "\n", group(1, "A", (7, 9)) + "junk\n",
    group(1, "A", (7, 9)).replace("         9", "       9.5"), group(1, "A", (7, -9)), "         1         0\nA\n",
    group(1, "A").replace("         0\nA", " 999999999\nA"), group(1, "A").split("A")[0],
    group(1, "A", (7, 9)).replace("         9", " " + "9" * 400),
], ids=["cut", "junk", "no whole number", "negative", "short", "more than there are", "no name", "huge"])  # fmt: skip
def test_groups_that_are_damaged_are_refused(comm, folder, lines):
    path = write(folder / "a.unv", FILE.read_text() + dataset(2477, lines), comm)
    with pytest.raises(InputError, match=r"a.unv, line \d+: found '.*a group"):
        uff.read(path, comm)


def test_groups_and_sets_of_points_reach_the_model(comm, folder):
    """The nodes of a set in the model, of a universal file and of an input file of Nastran with the same points."""
    K = write(folder / "K.mtx", "".join(f"{k} {k} 1.0\n" for k in range(1, 31)), comm)
    grids = "".join(f"GRID,{k},,{k * k}.,{k}.,0.\n" for k in range(1, 11))
    files = {
        "faces": write(folder / "a.unv", FILE.read_text() + dataset(2477, group(2, "faces", (8, 5), (8, 8))), comm),
        "SET1 4": write(folder / "a.bdf", f"BEGIN BULK\n{grids}SET1,4,1,THRU,4,8\nENDDATA\n", comm),
    }
    for name, file in files.items():
        with load_source(Source(str(K), str(K), nodes=str(file)), comm) as model:
            assert gathered(comm, model.sets[name])[0].tolist() == [1, 2, 3, 4, 8]
