"""Abaqus input files: nodes at their places, and refusals of what would put them elsewhere."""

import numpy as np
import pytest
from foreign import gathered, write

from hpcred import InputError
from hpcred.readers.abaqus.input_file import begins, read

pytestmark = pytest.mark.mpi(build="real")


def nodes_of(path, comm):
    nodes = read(path, comm).nodes
    label, position, place = gathered(comm, nodes.label, nodes.position, nodes.place)
    assert np.array_equal(place, np.arange(len(label))) and (np.diff(label) > 0).all()
    return dict(zip(label.tolist(), position.tolist(), strict=True))


ASSEMBLY = """*Heading
 a text, not data
*Part, name=Rod
*Node
1, 1., 0., 0.
2, 2., 0., 0.
*Element, type=B31
1, 1, 2
*End Part
*Part, name=unused
*Node
1, 7., 7., 7.
*End Part
*Part, name=tip
*Node, nset=all
11, 1., 0., 0.
*End Part
*Assembly, name=A
*Instance, name=r-1, part=rod
10., 0., 0.
*End Instance
** the translation first, then a quarter turn about the axis from (1, 1, 0) along z
*Instance, name=t-1, part=TIP
0., 1., 5.
1., 1., 0., 1., 1., 3., 90.
*Node
12, 1., 2., 0.
*End Instance
*End Assembly
"""


def test_instances_are_placed(comm, folder, monkeypatch):
    for size in (2**21, 16):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        found = nodes_of(write(folder / "a.inp", ASSEMBLY, comm), comm)
        expected = {1: (11, 0, 0), 2: (12, 0, 0), 11: (1, 1, 5), 12: (-1, 1, 5)}
        assert set(found) == set(expected)
        for label, place in expected.items():
            assert np.allclose(found[label], place, atol=1e-14)


def test_a_rotation_keeps_its_axis_and_lengths(comm, folder):
    """Against the matrix exponential of the axis."""
    expm = pytest.importorskip("scipy.linalg").expm
    a, b, angle = np.array([1.0, -2.0, 0.5]), np.array([2.0, 0.0, 3.0]), 37.0
    points = {1: a, 2: b, 3: np.array([4.0, 5.0, 6.0])}
    lines = "".join(f"{n}, {p[0]!r}, {p[1]!r}, {p[2]!r}\n".replace("np.float64", "").replace("(", "").replace(")", "")
                    for n, p in points.items())  # fmt: skip
    text = f"*Part, name=p\n*Node\n{lines}*End Part\n*Assembly\n*Instance, name=i, part=p\n\n0,0,0\n"
    text += ",".join(str(x) for x in (*a.tolist(), *b.tolist(), angle)) + "\n*End Instance\n*End Assembly\n"
    x, y, z = (b - a) / np.linalg.norm(b - a) * np.deg2rad(angle)
    turn = expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    for label, place in nodes_of(write(folder / "a.inp", text, comm), comm).items():
        assert np.allclose(place, a + turn @ (points[label] - a), atol=1e-13)


def test_equal_numbers_in_two_instances_are_refused(comm, folder):
    text = ASSEMBLY.replace("*End Assembly", "*Instance, name=r-2, part=rod\n*End Instance\n*End Assembly")
    path = write(folder / "a.inp", text, comm)
    with pytest.raises(InputError, match="found the node [12] in instance r-1 and instance r-2; .* without parts"):
        read(path, comm)
    path = write(folder / "b.inp", ASSEMBLY.replace("*End Assembly", "*Node\n2, 0., 0., 0.\n*End Assembly"), comm)
    with pytest.raises(InputError, match="found the node 2 in .*the assembly"):
        read(path, comm)


def test_includes_are_followed(comm, folder):
    (folder / "sub").mkdir(exist_ok=True)
    write(folder / "a.inp", "*Heading\n*INCLUDE, INPUT=sub/b.inp\n*Node\n1, 1.\n", comm)
    write(folder / "sub" / "b.inp", '*Node\n2, 2.\n*Include,\n input="c.inp"\n** end\n', comm)
    write(folder / "sub" / "c.inp", "** only nodes\n*NODE, input=d.txt\n", comm)
    write(folder / "sub" / "d.txt", "** data\r\n3, 3., 4.\r\n", comm)
    assert nodes_of(folder / "a.inp", comm) == {1: [1, 0, 0], 2: [2, 0, 0], 3: [3, 4, 0]}


@pytest.mark.parametrize(
    "lines, expected",
    [
        ("1, 2.", (2, 0, 0)), ("1, 2., 3.", (2, 3, 0)), ("1, 2., , 4.", (2, 0, 4)), ("1,,,4.", (0, 0, 4)),
        ("1, 2., 3., 1.5D+01,", (2, 3, 15)), ("1, 1., 2., 3.\n1, 1., 2., 3.", (1, 2, 3)),
    ],
)  # fmt: skip
def test_coordinates_left_out_are_zero(comm, folder, lines, expected):
    assert nodes_of(write(folder / "a.inp", f"*Node\n{lines}\n", comm), comm) == {1: list(expected)}


def test_cylindrical_nodes(comm, folder):
    found = nodes_of(write(folder / "a.inp", "*NODE, SYSTEM=C\n1, 2., 90., 3.\n*System\n*Node\n2, 1.\n", comm), comm)
    assert np.allclose(found[1], [0, 2, 3]) and found[2] == [1, 0, 0]


@pytest.mark.parametrize(
    "system, expected",
    [
        ("", (1, 2, 3)),
        ("0., 0., 0., 1., 0., 0.\n0., 1., 0.\n", (1, 2, 3)),
        ("0., 0., 0., 0., 0., 0.\n", (1, 2, 3)),
        ("10.\n", (11, 2, 3)),
        ("10., 20., 30.,\n", (11, 22, 33)),
        ("10., 0., 0., 10., 5.\n", (8, 1, 3)),
        ("10., 0., 0., 10., 5., 7.\n", (8, 1, 3)),  # b counts without its z
        ("10., 0., 0., 10., 0., 2.\n10., 3., 9.\n", (7, 2, 1)),
        ("1., 1., 1., 3., 1., 1.\n5., 1., 2.\n", (2, -2, 3)),
    ],
)
def test_nodes_in_a_system(comm, folder, system, expected):
    """Points a, b, c in the words of Abaqus' manual: x' from a to b, y' towards c; z' stays without c."""
    text = f"*Node\n9, 1., 2., 3.\n*System\n{system}*Node\n1, 1., 2., 3.\n*System\n*Node\n8, 1., 2., 3.\n"
    found = nodes_of(write(folder / "a.inp", text, comm), comm)
    assert np.allclose(found[1], expected) and found[8] == found[9] == [1, 2, 3]


def test_a_system_of_a_part_goes_with_its_instances(comm, folder):
    text = """*Part, name=p
*System
0., 0., 0., 0., 1.
*Node, system=C
1, 2., 90., 3.
*End Part
*Assembly, name=a
*Instance, name=i, part=p
10., 0., 0.
*End Instance
*Node
2, 1.
*End Assembly
"""
    found = nodes_of(write(folder / "a.inp", text, comm), comm)
    assert np.allclose(found[1], [8, 0, 3]) and found[2] == [1, 0, 0]


@pytest.mark.parametrize(
    "text, says",
    [
        ("*Node\n1, 1., 2., 3.\n2, 1., 2., 3., 4., 5., 6., 7.\n", r"line 3: found '2, 1., .*expected .*2 to 7 numbers"),
        ("*Node\n1, 1., 2., 3.\n2\n", "line 3: found '2', expected .*2 to 7 numbers"),
        ("*Node\n1.5, 1., 2., 3.\n", "line 2: found '1.5, 1., 2., 3.', expected the node number as a whole number"),
        ("*Node\n0, 1., 2., 3.\n", "expected the node number as a whole number of 1 to 2147483647"),
        ("*Node\n-1, 1., 2., 3.\n", "expected the node number as a whole number"),
        ("*Node\n3000000000, 1., 2., 3.\n", "expected the node number as a whole number of 1 to 2147483647"),
        ("*Node\n1, 1., nan, 3.\n", "line 2: .* expected finite node coordinates"),
        ("*Node\n1, 1_0., 2., 3.\n", "line 2: found '1, 1_0., 2., 3.'"),
        ("*Node\n1, <x>, 2., 3.\n", "line 2: found '1, <x>, 2., 3.'"),
        ("*Node\n1, 1., 2., 3.\n1, 1., 2., 4.\n", r"found the node 1 at \[1.0, 2.0, 3.0\] and \[1.0, 2.0, 4.0\]"),
        ("*Node\n1, 1.\n*Ngen\n1, 9, 1\n", r"line 3: found \*Ngen, which makes or moves nodes"),
        ("*Node\n1, 1.\n*NFILL\n1, 9, 1\n", r"line 3: found \*Nfill"),
        ("*Node\n1, 1.\n*Ncopy, change number=1\n", r"found \*Ncopy"),
        ("*Node\n1, 1.\n*Elgen, elset=E\n1, 9\n", r"line 3: found \*Elgen, which makes elements"),
        ("*Node\n1, 1.\n*EL COPY, old set=E\n1, 9\n", r"line 3: found \*Elcopy, which makes elements"),
        ("*Node\n1, 1.\n*\n*Nset, nset=A\n1\n", "line 3: found a line with nothing behind its asterisk"),
        ('*Node"nset=A\n1, 1.\n', "line 1: found '.Node\"nset=A', expected a keyword with a second quote"),
        (">**\n*Node\n1, 1.\n", "found '>..' above the first keyword"),
        ("*Node, system=S\n1, 1.\n", r"line 1: found \*Node with system=S"),
        ("*Node, write=no\n1, 1.\n", r"line 1: found \*Node with the parameter write"),
        ("*System\n0., 0., 0., 1., 1.\n2., 2.\n*Node\n1, 1.\n", r"line 1: found \*System with its points on a line"),
        ("*System\n0., 0., 0., 0., 0., 1.\n*Node\n1, 1.\n", r"line 1: found \*System with its points on a line"),
        ("*System\n1.\n2.\n3.\n*Node\n1, 1.\n", r"line 1: found 3 lines below \*System"),
        ("*Node\n1, 1.\n*Transform, nset=a\n0.,1.,0.,1.,0.,0.\n", r"line 3: found \*Transform"),
        ("*Heading\n*Include, input=none.inp\n", r"line 2: found \*Include of .*none.inp, which is no file"),
        ("*Heading\n*Include, input=a.inp\n", r"line 2: found an include of .*a.inp, which includes itself"),
        ("*Heading\n*Include\n", r"line 2: found \*Include without a file"),
        ("*Node, input=none.txt\n", "line 1: found input=.*none.txt, which is no file"),
        ("*Heading\n text\n", "found no nodes"),
        ("*Node\n1, 1.\n*Nset, \xa0nset=A\n1\n", r"line 3: found \*Nset without a name"),
        ("*Part, name=p\n*Node\n1, 1.\n*End Part\n", r"found a \*Part but no \*Instance"),
        ("*Part, name=p\n*Node\n1, 1.\n*End Part\n*Assembly\n*Instance, name=i, part=q\n", "an .Instance of 'q'"),
        (ASSEMBLY.replace("1., 1., 0., 1., 1., 3., 90.", "1., 1., 0., 1., 1., 0., 90."), "about two equal points"),
        (ASSEMBLY.replace("10., 0., 0.", "10., x, 0."), "found the data line '10., x, 0.', expected 3 numbers"),
        (ASSEMBLY.replace("10., 0., 0.", "10., 0., 0., 0."), "found the data line '10., 0., 0., 0.', expected 3"),
        ("*Node\n1, 1.\n*Element, elset=E\n1, 1, 1\n", r"line 3: found \*Element without type="),
        ("*Node\n1, 1.\n*Element, type=B31 elset=E\n1, 1, 1\n", r"line 3: found type=B31 elset=E, expected the type"),
        ("*Node\n1, 1.\n*Nset\x0c, nset=a\n1\n", r"line 3: found '\*Nset.*, expected a keyword without control"),
        ("\n", "found no nodes"),
        ("*Node\n1, 1.\n*Element, type=B31\n1, 1\n", "line 4: found '1, 1', expected 3 to 4 numbers an element"),
        ("*Node\n1, 1.\n*Element, type=B31\n1, 1, 2, 3\n2, 1\n", "expected 3 to 4 numbers an element"),
        ("*Node\n1, 1.\n*Element, type=B31\n1, 1, 1, 2, 1, 1\n", "line 4: .* expected 3 to 4 numbers an element"),
        ("*Node\n1, 1.\n*Element, type=B31\n1, 1, -2\n", "line 4: .* expected the number of an element or node"),
    ],
)
def test_what_would_put_nodes_elsewhere_is_refused(comm, folder, text, says):
    path = write(folder / "a.inp", text, comm)
    with pytest.raises(InputError, match=says):
        read(path, comm)


OF_CALCULIX = """>**
>** a shell wrote the first sign
*

** nothing below
*Part, name=p
*Node, nset=a,
1
2, , 3.
3,
*System
1., 0., 0.
*Element, type=C3D4, elset=E,
1, 1, 2, 3, 4
*Ngen
1, 3, 1
*Elgen
1, 4
*Node
4, 0., 0., 5.
*Nset, nset=a
4
*End Part
*Assembly, name=A
*Instance, name=i, part=p
10., 0., 0.
*End Instance
"""


def test_calculix_leaves_out_what_it_does_not_know(comm, folder):
    """As readinput.c, calinput.f, nodes.f and elements.f of CalculiX read it."""
    path = write(folder / "a.inp", OF_CALCULIX, comm)
    assert begins(OF_CALCULIX.encode())
    mesh = read(path, comm, calculix=True)
    label, position, members = gathered(comm, mesh.nodes.label, mesh.nodes.position, mesh.sets["a"])
    assert dict(zip(label.tolist(), position.tolist(), strict=True)) == {
        1: [0, 0, 0], 2: [0, 3, 0], 3: [0, 0, 0], 4: [0, 0, 5]}  # fmt: skip
    assert gathered(comm, mesh.elements["tetra"])[0].tolist() == [[1, 2, 3, 4]] and sorted(members) == [1, 2, 3, 4]
    for old, new, says in (
        (">**", "> *", "found '> .' above the first keyword, expected a keyword"),
        ("*Node, nset=a,", "*Node, system=C", r"line 7: found \*Node with system=C, which CalculiX does not know"),
        ("\n1\n2", "\n1.5\n2", "line 8: found '1.5', expected the node number"),
        ("*Nset", "*", "line 21: found data lines below a line with nothing behind its asterisk"),
    ):
        with pytest.raises(InputError, match=says):
            read(write(folder / "b.inp", OF_CALCULIX.replace(old, new, 1), comm), comm, calculix=True)


def test_normals_and_middle_nodes_do_not_count(comm, folder):
    numbers = range(1, 10)
    text = "*Node\n" + "".join(f"{n}, {n}., 0., ,0., 0., 1.\n" for n in numbers)
    text += "*Element, type=S8R5\n" + "".join(f"{k}, {', '.join(map(str, numbers))}\n" for k in (1, 2))
    path = write(folder / "a.inp", text, comm)
    assert nodes_of(path, comm) == {n: [n, 0, 0] for n in numbers}
    (found,) = gathered(comm, read(path, comm).elements["quad8"])
    assert found.tolist() == [[*range(1, 9)]] * 2
    with pytest.raises(InputError, match="expected 9 numbers an element"):
        read(write(folder / "b.inp", text.replace("S8R5", "S8R"), comm), comm)


@pytest.mark.parametrize(
    "name, kind, count",
    [
        ("CPS3", "triangle", 3), ("CPE4RH", "quad", 4), ("cps6m", "triangle6", 6), ("CPE8R", "quad8", 8),
        ("M3D4R", "quad", 4), ("M3D8", "quad8", 8), ("SC8R", "hexahedron", 8), ("SC6R", "wedge", 6),
        ("B21H", "line", 2), ("B22", "line3", 3), ("T2D2", "line", 2), ("CPEG4", None, 5),
        ("CPS40", None, 4), ("M3D9R", None, 9),
    ],
)  # fmt: skip
def test_kinds_of_elements(comm, folder, name, kind, count):
    numbers = range(1, count + 1)
    text = "*Node\n" + "".join(f"{n}, {n}.\n" for n in numbers)
    text += f"*Element, type={name}, elset=E\n7, {', '.join(map(str, numbers))}\n"
    mesh = read(write(folder / "a.inp", text, comm), comm)
    assert set(mesh.elements) == ({kind} if kind else set()) and ("elements of E" in mesh.sets) == bool(kind)
    if kind:
        assert sorted(gathered(comm, mesh.elements[kind])[0].ravel().tolist()) == [*numbers]


def test_elements_of_several_lines(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 10)
    numbers = np.arange(1, 21)
    element = ", ".join(map(str, numbers[:15])) + ",\n " + ", ".join(map(str, numbers[15:]))
    text = "*Node\n" + "".join(f"{n}, {n}.\n" for n in numbers) + "*Element, type=C3D20R, elset=all\n"
    text += "".join(f"{k}, {element}\n" for k in range(1, 8))
    elements = read(write(folder / "a.inp", text + "*Element, type=XYZ\n1, 2\n*Step\n", comm), comm).elements
    (found,) = gathered(comm, elements["hexahedron20"])
    assert np.array_equal(found, np.tile(numbers, (7, 1))) and set(elements) == {"hexahedron20"}
    comm.Barrier()
    again = write(folder / "a.inp", text + f"*Element, type=C3D4\n8, 1, 2, 3, 4\n7, {', '.join('5678')}\n", comm)
    with pytest.raises(InputError, match="a.inp: found the element 7 more than once, expected each once"):
        read(again, comm)


@pytest.mark.parametrize("piece", [10, 2**19])
@pytest.mark.parametrize("name, kind, width, more", [
    ("B31", "line", 2, [[], [9]]), ("B31OS", "line", 2, [[9], [8]]), ("b31h", "line", 2, [[0], []]),
    ("B32", "line3", 3, [[9], []]), ("B32OS", "line3", 3, [["", ], [9]]), ("B33", "line", 2, [[9], [9]]),
    ("C3D15V", "wedge15", 15, [[16, 17, 18], [], [16, "", 18], [16]]),
])  # fmt: skip
def test_nodes_that_give_a_direction_or_lie_on_a_side(comm, folder, monkeypatch, piece, name, kind, width, more):
    """These do not count; lines are wrapped behind sixteen numbers, and may all end with a comma."""
    monkeypatch.setattr("hpcred.files.text.PIECE", piece)
    numbers = [*range(1, width + 1)]
    lines = [[k, *(n + k for n in numbers), *extra] for k, extra in enumerate(3 * more, 1)]
    nodes = "*Node\n" + "".join(f"{n}, {n}.\n" for n in range(1, 40)) + f"*Element, type={name}, elset=E\n"
    expected = np.array([[n + k for n in numbers] for k in range(1, len(lines) + 1)])
    expected = expected[:, [0, 2, 1]] if kind == "line3" else expected
    for end in ("\n", ",\n"):
        parts = [[", ".join(map(str, line[low : low + 16])) for low in range(0, len(line), 16)] for line in lines]
        text = "".join(",\n".join(part) + end for part in parts)
        mesh = read(write(folder / "a.inp", nodes + text, comm), comm)
        (found,) = gathered(comm, mesh.elements[kind])
        assert np.array_equal(found, expected)
        assert 38 not in np.concatenate(comm.allgather(mesh.sets["elements of E"]))
        comm.Barrier()
    most = width + 1 + (3 if width == 15 else 1)
    for few in (numbers[:-1], range(1, width + 5)):
        with pytest.raises(InputError, match=f"expected {width + 1} to {most} numbers an element"):
            read(write(folder / "a.inp", f"{nodes}1, {', '.join(map(str, few))}\n", comm), comm)
        comm.Barrier()
    with pytest.raises(InputError, match="the number of an element or node as a whole number of 1 to"):
        read(write(folder / "a.inp", f"{nodes}1, 0, {', '.join(map(str, numbers[1:]))}\n", comm), comm)


SETS = """*Part, name=rod
*Node, nset=every
1, 1., 0., 0.
2, 2., 0., 0.
3, 3., 0., 0.
*Element, type=B31, elset=bars
1, 1, 2
2, 2, 3
*Nset, nset=ends
1, 3
*Nset, nset=both
ends, 2
*Elset, elset=second
 2
*End Part
*Assembly, name=A
*Instance, name=r-1, part=rod
*End Instance
*Node
11, 0., 0., 0.
12, 0., 0., 0.
13, 0., 0., 0.
14, 0., 0., 0.
*Nset, nset=row, generate
 11, 14, 2
*Nset, nset="of instance", instance=R-1
 2,
 3
*Nset, nset=mixed
 r-1.1, row
*Nset, nset=_Picked, internal
 1
*Elset, elset=all-bars, instance=r-1, generate
 1, 2
*End Assembly
"""


def test_sets_of_nodes_and_elements(comm, folder, monkeypatch):
    remarked = SETS.replace("\n", "\n** Section: a,, b\n")
    for size, text in ((2**21, SETS), (8, SETS), (2**21, remarked), (8, remarked)):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        sets = read(write(folder / "a.inp", text, comm), comm).sets
        found = {name: np.sort(np.concatenate(comm.allgather(part))).tolist() for name, part in sets.items()}
        assert found == {
            "r-1.every": [1, 2, 3], "r-1.ends": [1, 3], "r-1.both": [1, 2, 3], "row": [11, 13],
            "of instance": [2, 3], "mixed": [1, 11, 13], "elements of r-1.bars": [1, 2, 3],
            "elements of r-1.second": [2, 3], "elements of all-bars": [1, 2, 3],
        }  # fmt: skip
        comm.Barrier()


@pytest.mark.parametrize(
    "lines, says",
    [
        ("*Nset\n1\n", "found \\*Nset without a name"),
        ("*Nset, nset=a\n1, , 1\n", "line 4: found '1, , 1', expected a number between two commas"),
        ("*Nset, nset=a\n, 1\n", "line 4: found ', 1', expected a number between two commas"),
        ("*Nset, nset=a\n1 1\n", "line 4: found '1 1', expected a comma between two numbers"),
        ("*Nset, nset=a, generate\n1, 2 1\n", "line 4: found '1, 2 1', expected a comma between two numbers"),
        ("*Node\n2, 0.5 1., 0.\n", "line 4: found '2, 0.5 1., 0.', expected a comma between two numbers"),
        ("** a b\n*Element, type=T3D2\n** a b\n1, 1 1\n", "line 6: found '1, 1 1', expected a comma between two"),
        ("*Nset, nset=a\n1.5\n", "line 4: found '1.5', expected a number as a whole number"),
        ("*Nset, nset=a, generate\n1, 2, 3, 4\n", "expected first, last and step"),
        ("*Nset, nset=a, generate\n5, 2\n", "the first not above the last"),
        ("*Nset, nset=a\n1, b\n", "found the set 'b' in the set of nodes 'a', expected one of the sets"),
        ("*Nset, nset=a\nb, #\n", "line 4: found .b, #., expected numbers and names of sets"),
    ],
)
def test_sets_that_cannot_be_are_refused(comm, folder, lines, says):
    with pytest.raises(InputError, match=says):
        read(write(folder / "a.inp", "*Node\n1, 0., 0., 0.\n" + lines, comm), comm)


@pytest.mark.mpi(build="real")
@pytest.mark.parametrize("line, good", [("1, 5, 10", True), ("1, Part-1.5, 10,", True), ("1, , 10", True),
                                        ("1, 1;5, 10", False), ("1, x", False)])  # fmt: skip
def test_lines_of_elements_that_are_not_drawn_are_read_too(comm, folder, line, good):
    text = f"*Node\n5, 0., 0., 0.\n10, 1., 0., 0.\n*Element, type=D3D2\n2, 5, 10\n{line}\n"
    path = write(folder / "a.inp", text, comm)
    if good:
        assert read(path, comm).elements == {}
    else:
        with pytest.raises(InputError, match=f"line 6: found '{line}', expected numbers of an element and its nodes"):
            read(path, comm)


BARS = """*Node
1, 1.
2, 2.
3, 3.
4, 4.
*Element, type=B31, elset=left
1, 1, 2
2, 2, 3
*Element, type=SPRINGA, elset=springs
8, 1, 4
"""


def sets_of(path, comm, **options):
    mesh = read(path, comm, **options)
    return {name: gathered(comm, numbers)[0].tolist() for name, numbers in mesh.sets.items()}, mesh.remarks


def test_a_set_of_nodes_of_a_set_of_elements(comm, folder):
    """Documented by Abaqus; also of internal sets, in sets of sets, and of elements that are defined below it."""
    text = BARS + """*Nset, nset=A, elset=LEFT
*Nset, nset=end
4
*Nset, nset=both
a, end
*Nset, nset=B, elset=_within
*Elset, elset=_within, internal
left
"""
    found, remarks = sets_of(write(folder / "a.inp", text, comm), comm)
    assert found == {"A": [1, 2, 3], "end": [4], "both": [1, 2, 3, 4], "B": [1, 2, 3], "elements of left": [1, 2, 3]}
    assert not any("left" in remark for remark in remarks)
    text = ASSEMBLY.replace("*Element, type=B31", "*Element, type=B31, elset=bar")
    text = text.replace("*End Assembly", "*Nset, nset=all, elset=bar, instance=r-1\n*End Assembly")
    text = text.replace("*End Part", "*Nset, nset=own, elset=bar\n*End Part", 1)
    found, _ = sets_of(write(folder / "b.inp", text, comm), comm)
    assert found["all"] == found["r-1.own"] == found["elements of r-1.bar"] == [1, 2]


def test_sets_of_elements_that_are_not_read_are_told(comm, folder):
    text = BARS + "*Nset, nset=A, elset=springs\n*Elset, elset=mixed\nleft, 8\n*Nset, nset=C, elset=mixed\n"
    found, remarks = sets_of(write(folder / "a.inp", text, comm), comm)
    assert "A" not in found and found["C"] == found["elements of mixed"] == [1, 2, 3]
    assert any("without the nodes of elements whose types are not read: elements of mixed, elements of springs, A, C"
               in remark for remark in remarks)  # fmt: skip
    for more, says in (
        ("*Nset, nset=A, elset=other\n", "found the set 'other' in the set of nodes 'A', .* sets of elements"),
        ("*Nset, nset=A, elset=left\n4\n", r"line 11: found data lines below \*Nset with elset="),
    ):
        with pytest.raises(InputError, match=says):
            read(write(folder / "b.inp", BARS + more, comm), comm)
    # CalculiX does not know the parameter, and reads the lines below
    found, _ = sets_of(write(folder / "c.inp", BARS + "*Nset, nset=A, elset=left\n4\n", comm), comm, calculix=True)
    assert found["A"] == [4]


def test_files_that_include_each_other_again_and_again_come_to_an_end(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.included.MOST", 200)
    for k in range(22):
        write(folder / f"i{k}.inp", f"*Include, input=i{k + 1}.inp\n" * 2, comm)
    write(folder / "i22.inp", "*Nset, nset=A\n1\n", comm)
    main = write(folder / "main.inp", "*Node\n1, 1.\n*Include, input=i0.inp\n", comm)
    with pytest.raises(InputError, match="main.inp: found more than 200 files, as often as they are included, at "):
        read(main, comm)
    main = write(folder / "main.inp", "*Node\n1, 1.\n*Include, input=i17.inp\n", comm)
    assert sets_of(main, comm)[0] == {"A": [1]}  # 32 times the same set
    for k in range(101):
        write(folder / f"c{k}.inp", f"*Include, input=c{k + 1}.inp\n", comm)
    write(folder / "c101.inp", "*Node\n2, 1.\n", comm)
    assert sorted(nodes_of(write(folder / "d.inp", "*Include, input=c10.inp\n", comm), comm)) == [2]
    with pytest.raises(InputError, match="d.inp: found more than 100 files, one in the other, at .*c100.inp"):
        read(write(folder / "d.inp", "*Include, input=c0.inp\n", comm), comm)


def test_large_files_that_are_included_often_come_to_an_end(comm, folder, monkeypatch):
    """The same file of nodes, named by input= or by *Include, so that the bytes are many and the files few."""
    monkeypatch.setattr("hpcred.files.included.AGAIN", 1000)
    write(folder / "n.txt", "1, 1.\n" * 50, comm)
    write(folder / "n.inp", "*Node\n" + "1, 1.\n" * 50, comm)
    for line in ("*Node, input=n.txt\n", "*Include, input=n.inp\n"):
        assert nodes_of(write(folder / "a.inp", line * 3, comm), comm) == {1: [1, 0, 0]}
        with pytest.raises(InputError, match="a.inp: found .* MB in files of .* MB, at .*n\\..*again and again"):
            read(write(folder / "a.inp", line * 30, comm), comm)
