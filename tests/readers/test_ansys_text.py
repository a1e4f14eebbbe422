"""Texts of ANSYS: HBMAT with its mapping, *EXPORT of APDL Math, lists of nodes, archives of the model."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from ansys_files import archive, element, write_rst
from foreign import gathered, write
from helpers import to_dense
from shared_data import shared, unpacked

import hpcred
from hpcred import InputError
from hpcred.readers.ansys import cdb as ansys_cdb
from hpcred.readers.ansys import lists as ansys_lists
from hpcred.readers.ansys import rst as ansys_rst
from hpcred.readers.ansys.nodes import read_nodes
from hpcred.readers.entries import label_of
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

DOFS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
ROWS = [(3, d) for d in DOFS] + [(2, d) for d in DOFS] + [(40, "UX"), (40, "ROTZ")]  # node 40 is held in part
SIZE = len(ROWS)
PLACES = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.5, 0.0), 3: (2.0, -1.5e-3, 0.25), 40: (0.0, 4.0, 1.0)}
ROTOR = [f"ansys/rotorAnsys{name}.txt" for name in ("StiffnessMatrixSparse", "MassMatrixSparse",
                                                     "MatrixDofMappingVector", "NodalCoordinates")]  # fmt: skip


def symmetric(seed):
    root = np.random.default_rng(seed).standard_normal((SIZE, SIZE))
    return np.round(root @ root.T + SIZE * np.eye(SIZE), 6)


MATRICES = {"K": symmetric(1), "M": symmetric(2), "D": symmetric(3)}
TITLES = {"K": "Stiffness", "M": "Mass", "D": "Damping"}


def hbmat(key, right=True):
    """As HBMAT writes it: one number a line, the lower triangle, the right-hand side behind it."""
    matrix = MATRICES[key]
    pointers, rows, values = [1], [], []
    for k in range(SIZE):
        rows += range(k + 1, SIZE + 1)
        values += list(matrix[k:, k])
        pointers.append(len(rows) + 1)
    values += [0.0] * SIZE * right
    cards = [len(pointers), len(rows), len(rows), SIZE * right]
    lines = [
        f"{TITLES[key] + ' matrix from ANSYS FULL file dumped into Harwell-Boeing format':<80}",
        "".join(f"{item:14d}" for item in (sum(cards), *cards)),
        f"RSA           {SIZE:14d}{SIZE:14d}{len(rows):14d}{0:14d}",
        f"{'(I14)':<16}{'(I14)':<16}{'(d25.15)':<20}{'(d25.15)' * right:<20}", *[f"F{1:27d}{SIZE:14d}"] * right,
        *(f"{item:14d}" for item in pointers + rows), *(f"{item:25.15E}".replace("E", "D") for item in values),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


MAPPING = "    Matrix Eqn          Node    DOF     \n" + "".join(
    f"{k + 1:14d}{node:14d}    {dof:<4}\n" for k, (node, dof) in enumerate(ROWS))  # fmt: skip
NLIST = """
 LIST ALL SELECTED NODES.   DSYS=      0

    NODE        X             Y             Z           THXY     THYZ     THZX
{}
    NODE        X             Y             Z           THXY     THYZ     THZX
{}
"""
LINES = [f"{n:9d}" + "".join(f"{x:14.6g}" for x in xyz) + "     0.00     0.00     0.00" for n, xyz in PLACES.items()]
LISTING = NLIST.format("\n".join(LINES[:2]), "\n".join(LINES[2:]))


def check(comm, model, keys="KM"):
    """Rows are those of the mapping, ordered as in the files."""
    for key in keys:
        assert np.allclose(to_dense(getattr(model, key)), MATRICES[key], rtol=1e-14)
    node, direction, position = gathered(comm, model.dofs.node, model.dofs.direction, model.dofs.position)
    assert [(n, DOFS[d]) for n, d in zip(node, direction, strict=True)] == ROWS
    assert np.allclose(position, [PLACES[n] for n in node], rtol=1e-6)


def test_hbmat_with_mapping_and_archive(comm, folder):
    """Any names: the titles say what the matrices are; a damping matrix comes along."""
    for key, name in (("K", "a.txt"), ("M", "b.matrix"), ("D", "c.txt")):
        write(folder / name, hbmat(key, right=key != "M"), comm)
    write(folder / "a.mapping", MAPPING, comm)
    write(folder / "b.mapping", MAPPING, comm)
    write(folder / "model.cdb", archive(PLACES), comm)
    for name in ("a.txt", "b.matrix"):
        with load_export(folder / name, comm) as model:
            check(comm, model, "KMD")


def test_hbmat_by_options(comm, folder):
    write(folder / "a.txt", hbmat("K"), comm)
    write(folder / "b.txt", hbmat("M"), comm)
    source = Source(*(str(folder / name) for name in ("a.txt", "b.txt")),
                    dofs=str(write(folder / "a.mapping", MAPPING, comm)),
                    nodes=str(write(folder / "nodes.lis", LISTING, comm)))  # fmt: skip
    with load_source(source, comm) as model:
        check(comm, model)


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda t: t.replace("ROTY", "TEMP", 1), "expected equation, node and one of UX"),
        (lambda t: t.replace("ROTY", "ROTX", 1), "found two rows of 3:rx"),
        (lambda t: t.replace("    14    ", "    15    "), "equations not numbered 1, 2, 3"),
        (lambda t: t[: t.rindex("\n", 0, -1) + 1], "found 13 rows, expected 14"),
        (lambda t: t[:-12] + "\n", "expected equation, node and one of UX"),
        (lambda t: t.replace("ROTY", "5", 1), "expected equation, node and one of UX"),
    ],
)
def test_damaged_mappings_are_refused(comm, folder, change, says):
    write(folder / "a.txt", hbmat("K"), comm)
    write(folder / "b.txt", hbmat("M"), comm)
    write(folder / "a.mapping", change(MAPPING), comm)
    with pytest.raises(InputError) as error:
        load_export(folder / "a.txt", comm)
    assert says in str(error.value) and "a.mapping" in str(error.value)


def test_sets_that_are_not_clear_are_refused(comm, folder):
    path = write(folder / "a.txt", hbmat("K"), comm)
    with pytest.raises(InputError, match="found none as mass matrix beside it"):
        load_export(path, comm)
    for name in ("b.txt", "c.txt"):
        write(folder / name, hbmat("M"), comm)
    with pytest.raises(InputError, match="found b.txt and c.txt as mass matrix"):
        load_export(path, comm)


def test_matrix_market_of_apdl_math(comm, folder):
    """A real set: stiffness, lumped mass, nodes in the order of the rows, and coordinates with decimal commas."""
    path = unpacked(comm, folder, *ROTOR)
    with load_export(path, comm) as model:
        K, M = to_dense(model.K), to_dense(model.M)
        node, position = gathered(comm, model.dofs.node, model.dofs.position)
        report = hpcred.inspect(model)
    assert node[::3][:5].tolist() == [3, 31, 17, 10, 33]
    assert np.allclose(position[node == 107][0], [0, 0.1959844447, 0.15])
    for found, name in ((K, ROTOR[0]), (M, ROTOR[1])):
        assert np.array_equal(found, scipy.io.mmread(folder / Path(name).name).toarray())
    assert report["rigid_body_modes"] == 6 and report["mass_kg"] == pytest.approx(M.diagonal().sum() / 3)
    # the same stiffness as in the binary file of the program, in the same order of rows
    with load_export(unpacked(comm, folder, "ansys/rotorAnsys.full", "ansys/rotorAnsys.rst"), comm) as other:
        assert np.allclose(to_dense(other.K), K, rtol=1e-12, atol=1e-6)
        others = gathered(comm, other.dofs.node, other.dofs.position)
    assert np.array_equal(others[0], node) and np.allclose(others[1], position, atol=1e-9)


def test_matrices_whose_names_say_nothing(comm, folder):
    path = unpacked(comm, folder, *ROTOR)
    other = folder / "first.txt"
    if comm.rank == 0:
        path.rename(other)
    comm.Barrier()
    with pytest.raises(InputError, match="name does not say which it is"):
        load_export(other, comm)


@pytest.mark.parametrize(
    "old, new, says",
    [("\n115 1\n", "\n116 1\n", "found 116 nodes for 345 rows"), ("\n46\n", "\n47\n", "found the node"),
     ("\n46\n", "\n", "found 114 nodes, but 115"), ("\n46\n", "\n4.6\n", "as a whole number"),
     ("\n46\n", "\n46 1\n", "one node number a line")],
)  # fmt: skip
def test_damaged_vectors_of_nodes_are_refused(comm, folder, old, new, says):
    path = unpacked(comm, folder, *ROTOR)
    vector = folder / "rotorAnsysMatrixDofMappingVector.txt"
    text = comm.bcast(vector.read_text() if comm.rank == 0 else None)
    assert old in text
    write(vector, text.replace(old, new), comm)
    with pytest.raises(InputError, match=says):
        load_export(path, comm)



def general(x):
    """Fortran's G20.13."""
    exponent = int(np.floor(np.log10(abs(x)))) + 1 if x else 1
    if 0 <= exponent <= 13:
        return f"{x:16.{13 - exponent}f}    "
    return f"{x / 10.0**exponent:16.13f}E{exponent:+03d}"


def nwrite(places):
    lines = [f"{n:8d}" + "".join(general(x) for x in np.trim_zeros(xyz, "b")) for n, xyz in places.items()]
    return "".join(line + "\n" for line in lines)


NWRITE = nwrite(PLACES)
WORKBENCH = "Node Number\tX Location (m)\tY Location (m)\tZ Location (m)\t\n" + "".join(
    f"{n}\t{x:.9g},\t{y:.9g}\t{z:.9g}\t\n".replace(",", "") for n, (x, y, z) in PLACES.items())  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [LISTING, NWRITE, WORKBENCH, WORKBENCH.replace(".", ","), WORKBENCH.replace(".", ",").replace("\n", "\r\n"),
     archive(PLACES), archive(PLACES).replace("\n", "\r\n")],
    ids=["NLIST", "NWRITE", "Workbench", "decimal commas", "Windows", "archive", "archive of Windows"],
)  # fmt: skip
def test_lists_of_nodes(comm, folder, text, monkeypatch):
    found = read_nodes(write(folder / "nodes", text, comm), comm)
    label, position = gathered(comm, found.nodes.label, found.nodes.position)
    assert label.tolist() == sorted(PLACES)
    assert np.allclose(position, [PLACES[n] for n in label], rtol=1e-6)
    assert not comm.allreduce(len(found.turned))


def test_nodes_of_an_input_file_of_workbench(comm, folder):
    """Two blocks of the short form, of which the first has fewer nodes than the number behind it."""
    text = (
        "/com,ANSYS\n/prep7\nnblock,3,,1389\n(1i9,3e20.9e3)\n"
        "        1     2.500000000E-02     2.500000000E-02    -1.000000000E-03\n"
        "        7     2.500000000E-02     5.000000000E-02    -1.000000000E-03\n"
        "-1\n/com,*********** Nodes for all Remote Points ***********\nnblock,3\n(1i9,3e20.9e3)\n"
        "     7354     0.000000000E+00     1.000000015E-01     5.000000237E-04\n-1\n"
    )
    found = read_nodes(write(folder / "ds.dat", text, comm), comm)
    label, position = gathered(comm, found.nodes.label, found.nodes.position)
    assert label.tolist() == [1, 7, 7354]
    assert np.array_equal(position, [[0.025, 0.025, -0.001], [0.025, 0.05, -0.001], [0, 0.1000000015, 5.000000237e-4]])


def test_nwrite_of_all_sizes(comm, folder):
    """Numbers beyond 10 and below 0.1 have other forms; a sign may touch the number in front."""
    places = {1: (-12.5, 1234.56789, 0.05), 20: (-1.25e-7, 0.0, -3.5e4), 30: (0.0, 0.0, 0.0), 31: (1e-9, -2e-9, -0.5)}
    text = nwrite(places)
    assert "-12.50000000000 " in text and " 20-0.1250000000000E-06 " in text and "E-08-0.2000000000000E-08" in text
    found = read_nodes(write(folder / "nodes", text, comm), comm)
    label, position = gathered(comm, found.nodes.label, found.nodes.position)
    assert dict(zip(label.tolist(), map(tuple, position.tolist()), strict=True)) == places


@pytest.mark.parametrize(
    "text, says",
    [
        (LISTING.replace("        2 ", "        3 "), "found the node 3 more than once"),
        (LISTING.replace("0.25", "0.25x"), "expected node, x, y, z"),
        (LISTING.replace("0.25", "nan"), "expected finite node coordinates"),
        (LISTING.replace("0.25", "    "), "expected node, x, y, z"),
        (WORKBENCH.replace("0.25", "0,25"), "commas and points"),
        (archive(PLACES, announced=5), "found 4 entries of NBLOCK, but it announces 5"),
        (archive(PLACES).replace("N,R5.3,LOC,       -1,", ""), "no end of NBLOCK"),
        (archive(PLACES)[:-60], "no end of NBLOCK"),
        (archive(PLACES, form="(3i9,6x21.13e3)"), "found the format"),
        (archive(PLACES, form="(3i9,7e21.13e3)"), "NBLOCK of 10 fields"),
        (archive(PLACES).replace("2.0000000000000E", "2.00000x0000000E"), "numbers in fields of 9 characters"),
        ("/PREP7\nN,R5.3,LOC,1,0,0,0\n", "found nodes as single commands"),
        ("/PREP7\nFINISH\n", "found no nodes"),
        (archive(PLACES, elements="csys,12\nnrotat,all\n"), "found 'nrotat,all', which gives nodes axes of their own"),
    ],
    ids=range(14),
)
def test_lists_that_cannot_be_are_refused(comm, folder, text, says):
    path = write(folder / "nodes", text, comm)
    with pytest.raises(InputError) as error:
        read_nodes(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)


def test_angles_and_touching_numbers_of_archives(comm, folder):
    places = {7: (-1.0, -2.0, -3.0), 8: (0.0, 0.0, 0.0)}
    text = archive(places, {7: (10.0, -20.0, 30.0)}, form="(3i9,6e20.13)").replace(" -", "-").replace("E+00 ", "E+00")
    text = text.replace("        7        0        0 ", "        7        0        0").replace("E+01 ", "E+01")
    found = ansys_cdb.read(write(folder / "a.cdb", text, comm), comm)
    label, position, angles = gathered(comm, *found[:3])
    assert label.tolist() == [7, 8] and np.array_equal(position[0], [-1, -2, -3])
    assert np.array_equal(angles[0], [10, -20, 30]) and not angles[1].any()


@pytest.mark.parametrize("form, end, head", [
    ("(3i9,3e21.13)", "N, R5.3, LOC, -1,", "NBLOCK,6,SOLID"), ("(3i9,6e21.13e3)", "n,unbl,loc,  -1", "NBLOCK,6"),
    ("(1i9,2i9,4e21.13)", "N,R5.3,LOC,       -1,", "nblock, 6 ,solid"), ("(1i27,3e21.13)", "-1", "NBLOCK,3"),
])  # fmt: skip
def test_blocks_of_other_forms(comm, folder, form, end, head):
    text = archive(PLACES, form=form).replace("N,R5.3,LOC,       -1,", end)
    start = text.index("NBLOCK")
    text = text[:start] + head + text[text.index("\n", start) :]
    if head == "NBLOCK,3":
        text = text.replace(f"{0:9d}{0:9d}", "").replace("1i27", "1i9")
    found = read_nodes(write(folder / "a.cdb", text, comm), comm)
    label, position = gathered(comm, found.nodes.label, found.nodes.position)
    assert dict(zip(label.tolist(), map(tuple, position.tolist()), strict=True)) == PLACES


def test_nodes_behind_a_block_are_not_passed_over(comm, folder):
    for command in ("N,100,1.,2.,3.\n", "N, R5.3, LOC, 100, 1., 2., 3.\n"):
        with pytest.raises(InputError, match="found nodes as single commands"):
            read_nodes(write(folder / "a.cdb", archive(PLACES, elements=command), comm), comm)
        comm.Barrier()
    for command in ("nscale,,all,,,2.,2.,2.\n", "NGEN , 2, 10, ALL\n", "NUMMRG,NODE\n", "NMODIF,7,,5.\n", "nmod,7,1\n"):
        with pytest.raises(InputError, match="which changes nodes in ANSYS"):
            read_nodes(write(folder / "a.cdb", archive(PLACES, elements=command), comm), comm)
        comm.Barrier()
    for command in ("NMODIF,7,,,,30.\n", "nrot,all\n"):
        path = write(folder / "a.cdb", archive(PLACES, elements=command), comm)
        with pytest.raises(InputError, match="gives nodes axes of their own"):
            read_nodes(path, comm)
        assert comm.allreduce(len(ansys_cdb.read(path, comm, turned=True).label)) == len(PLACES)
        comm.Barrier()


def test_keys_of_the_geometry_may_be_negative(comm, folder):
    """Those of elements that belong to no volume; types may stand in an ETBLOCK."""
    brick = element(1, 5, range(1, 9)).replace(f"{0:9d}" * 2, f"{-3:9d}{0:9d}", 1)
    brick = brick.replace(f"{0:9d}{8:9d}", f"{-1:9d}{8:9d}")
    many = {number: (float(number), 0.0, 0.0) for number in range(1, 9)}
    text = archive(many, elements=f"EBLOCK,19,SOLID,{1:10d},{1:10d}\n(19i9)\n{brick}{-1:9d}\n")
    types = f"ETBLOCK,{2:9d},{2:9d}\n(2i9,19a9)\n" + f"{1:9d}{185:9d}{0:9d}\n{2:9d}{181:9d}{0:9d}\n{-1:9d}\n"
    for content in (text, text.replace("ET,        1,185\nET,2,181\n", types)):
        found = ansys_cdb.read(write(folder / "a.cdb", content, comm), comm).elements
        assert comm.allreduce(len(found.get("hexahedron", ()))) == 1
        comm.Barrier()
    for good, wrong in ((f"{5:9d}{1:9d}", f"{5:9d}{-1:9d}"), (f"{5:9d}{1:9d}", f"{-5:9d}{1:9d}")):
        damaged = text.replace(brick, brick.replace(good, wrong, 1))
        assert damaged != text
        with pytest.raises(InputError, match="expected numbers of nodes, of an element and its type, from 0 on"):
            ansys_cdb.read(write(folder / "a.cdb", damaged, comm), comm)
        comm.Barrier()
    for wrong in (types.replace("185", "x"), types.replace(f"{-1:9d}\n", "")):
        with pytest.raises(InputError, match="ETBLOCK"):
            ansys_cdb.read(write(folder / "a.cdb", text.replace("ET,2,181\n", wrong), comm), comm)
        comm.Barrier()


SOLID = "".join(f"{item:9d}" for item in (1, 1, 1, 1, 0, 0, 0, 0))


def test_elements_of_archives(comm, folder):
    """Bricks, wedges, tetrahedra and shells in one block, the longer ones on two lines."""
    many = {number: (float(number), 0.0, 0.0) for number in range(1, 60)}
    kinds = {
        "hexahedron": (1, list(range(1, 9))), "wedge": (1, [1, 2, 3, 3, 5, 6, 7, 7]),
        "tetra": (1, [1, 2, 3, 3, 5, 5, 5, 5]), "pyramid": (1, [1, 2, 3, 4, 5, 5, 5, 5]),
        "hexahedron20": (1, list(range(1, 21))), "tetra10": (1, list(range(30, 40))), "quad": (2, [4, 5, 6, 7]),
        "triangle": (2, [4, 5, 6, 6]),
    }  # fmt: skip
    blocks = "".join(element(*kinds[kind][:1], k, kinds[kind][1]) for k, kind in enumerate([*kinds] * 5, 1))
    text = archive(many, elements=f"EBLOCK,19,SOLID,{40:10d},{40:10d}\n(19i9)\n{blocks}{-1:9d}\n")
    kind, nodes = kinds["quad"]
    twice = text.replace(element(kind, 7, nodes), element(kind, 6, nodes))
    with pytest.raises(InputError, match="a.cdb: found the element 6 more than once"):
        ansys_cdb.read(write(folder / "a.cdb", twice, comm), comm)
    for content in (text, text.replace("\n", "\r\n")):
        comm.Barrier()
        found = ansys_cdb.read(write(folder / "a.cdb", content, comm), comm).elements
        counts = {kind: comm.allreduce(len(nodes)) for kind, nodes in found.items()}
        assert counts == dict.fromkeys(kinds, 5)
        corner = {"wedge": [1, 2, 3, 5, 6, 7], "tetra": [1, 2, 3, 5], "pyramid": [1, 2, 3, 4, 5], "triangle": [4, 5, 6]}
        for kind, nodes in found.items():
            assert (nodes == corner.get(kind, kinds[kind][1])).all()
    count = text.replace(f"{40:10d}\n(19i9)", f"{41:10d}\n(19i9)")
    cut = text.replace(element(1, 5, range(1, 21)), SOLID)
    point, word = text.replace(f"{40:9d}\n", f"{'40.':>9}\n", 1), text.replace(f",{40:10d}\n", ",many\n")
    for wrong in (count, cut, point, word):
        assert wrong != text
        comm.Barrier()
        with pytest.raises(InputError):
            ansys_cdb.read(write(folder / "a.cdb", wrong, comm), comm)


@pytest.mark.parametrize("squeeze", [None, "bits", "windows", "mixed"])
@pytest.mark.parametrize("piece", [40, 2**21])
def test_nodes_of_result_files(comm, folder, squeeze, piece, monkeypatch):
    monkeypatch.setattr("hpcred.readers.ansys.records.PIECE", piece)
    rng = np.random.default_rng(3)
    reals = np.where(rng.random((50, 6)) < 0.5, rng.standard_normal((50, 6)), 0)
    nodes = np.hstack([np.arange(50, 0, -1)[:, None], reals])
    if comm.rank == 0:
        write_rst(folder / "a.rst", nodes, squeeze)
    comm.Barrier()
    label, position, angles = gathered(comm, *ansys_rst.read(folder / "a.rst", comm))
    assert np.array_equal(np.column_stack([label, position, angles]), nodes)


def test_damaged_result_files_are_refused(comm, folder):
    nodes = np.column_stack([np.arange(1, 9), np.random.default_rng(1).random((8, 3)), np.zeros((8, 3))])
    if comm.rank == 0:
        write_rst(folder / "a.rst", nodes, "bits")
    comm.Barrier()
    good = np.frombuffer(comm.bcast((folder / "a.rst").read_bytes() if comm.rank == 0 else None), "<i4")
    reference = gathered(comm, *ansys_rst.read(folder / "a.rst", comm))
    for word in [0, 1, 2, 102, 103, 104, 120, 185, 186, 187, 214, *range(269, 269 + 26)]:
        for bit in (0, 3, 30):
            copy = good.copy()
            copy[word] ^= 1 << bit
            comm.Barrier()
            path = write(folder / "a.rst", copy.tobytes(), comm)
            try:
                found = gathered(comm, *ansys_rst.read(path, comm))
            except InputError:
                continue
            # a number of a node may be another one; nothing else
            same = [np.array_equal(a, b) for a, b in zip(found, reference, strict=True)]
            assert sum(same) >= 2 and word > 272, (word, bit)
    for cut in (0, 300, 4 * 270, 4 * 300):
        comm.Barrier()
        with pytest.raises(InputError):
            ansys_rst.read(write(folder / "a.rst", good.tobytes()[:cut], comm), comm)


def test_texts_are_told_apart():
    vector = b"%%MatrixMarket matrix array integer general \n%===\n% Creator: ANSYS Inc\n"
    kinds = [ansys_lists.begins_nodes, ansys_lists.begins_mapping, ansys_lists.begins_vector, ansys_cdb.begins]
    texts = [LISTING, NWRITE, WORKBENCH, MAPPING, vector.decode(), archive(PLACES)]
    found = [[begins(text.encode()) for begins in kinds].index(True) for text in texts]
    assert found == [0, 0, 0, 1, 2, 3]
    for text in ("1 0.5 0.25 0.125\n2 1 1 1\n", "1, 0, 0, 0\n", "*Node\n1, 0., 0., 0.\n", ""):
        assert not any(begins(text.encode()) for begins in kinds)


def test_labels_of_a_vector(comm, folder):
    text = "%%MatrixMarket matrix array integer general \n% Creator: ANSYS Inc\n3 1\n7\n2\n30\n"
    label, row = gathered(comm, *ansys_lists.read_vector(write(folder / "v.txt", text, comm), comm, 18))
    assert label[np.argsort(row)].tolist() == [label_of(np.array(n), k) for n in (7, 2, 30) for k in range(6)]


SQUARE = {k: (x, y, 0.0) for k, (x, y) in enumerate([(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)], 1)}
QUADS = ("EBLOCK,19,SOLID,         9,         2\n(19i9)\n" + element(2, 8, (1, 2, 5, 4)) + element(2, 9, (2, 3, 6, 5))
         + "       -1\n")  # fmt: skip


def components(*items):
    """CMBLOCK of name, kind and numbers each, eight in a line."""
    text = ""
    for name, kind, numbers in items:
        text += f"CMBLOCK,{name:8},{kind},{len(numbers):8d}  ! users component definition\n(8i10)\n"
        for k in range(0, len(numbers), 8):
            text += "".join(f"{number:10d}" for number in numbers[k : k + 8]) + "\n"
    return text


def sets_in(path, comm):
    return {name: gathered(comm, numbers)[0].tolist() for name, numbers in read_nodes(path, comm).sets.items()}


def test_components_are_sets(comm, folder, monkeypatch):
    """Numbers and ranges, over lines and pieces, of nodes that are there; of elements the nodes of those."""
    many = [1, -3, 5, 6, -99999999]
    text = QUADS + components(("BEARING", "NODE", many), ("Plate 2", "ELEM", [9]), ("ALL", "ELEMENTS", [8, -9]))
    expected = {"BEARING": [1, 2, 3, 5, 6], "elements of Plate 2": [2, 3, 5, 6], "elements of ALL": [1, 2, 3, 4, 5, 6]}
    for size in (2**21, 16):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        monkeypatch.setattr("hpcred.readers.ansys.cdb.AT_ONCE", size)
        assert sets_in(write(folder / "a.cdb", archive(SQUARE, elements=text), comm), comm) == expected
        comm.Barrier()
    singly = archive({k: (k, 0, 0) for k in range(1, 40)}, elements=components(("ODD", "NODE", [*range(1, 40, 2)])))
    assert sets_in(write(folder / "b.cdb", singly, comm), comm) == {"ODD": [*range(1, 40, 2)]}


@pytest.mark.parametrize("text, says", [
    (components(("A", "NODE", [1, 2])).replace("       2  !", "       3  !"), "found 2 numbers of the component"),
    (components(("A", "NODE", [1, 2]))[:-11] + "\n", "found 1 numbers of the component 'A', but it announces 2"),
    (components(("A", "NODE", [-2, 3])), "with a range that does not ascend"),
    (components(("A", "NODE", [5, -2])), "with a range that does not ascend"),
    (components(("A", "NODE", [5, -6, -7])), "with a range that does not ascend"),
    (components(("A", "NODE", [0])), "with a range that does not ascend"),
    (components(("A", "AREA", [1])), "expected CMBLOCK, a name, NODE or ELEM, and how many numbers follow"),
    (components(("", "NODE", [1])), "expected CMBLOCK, a name"),
    (components(("A", "NODE", [1]), ("a", "NODE", [2])), "found a second component 'a', expected one"),
    (components(("A", "NODE", [1])).replace("(8i10)", "(8f10.1)"), "a format of other than whole numbers"),
    (components(("A", "NODE", [1])).replace("         1\n", "        1x\n"), "found 0 numbers of the component"),
])  # fmt: skip
def test_damaged_components_are_refused(comm, folder, text, says):
    path = write(folder / "a.cdb", archive(SQUARE, elements=text), comm)
    with pytest.raises(InputError, match=says):
        read_nodes(path, comm)


def test_named_selections_of_the_shared_archive(comm):
    """Against a parse of its lines in plain Python."""
    path, expected = shared("fe/ansys/cantilever/HexBeam.cdb"), {}
    lines = Path(path).read_text().splitlines()
    for k, line in enumerate(lines):
        if line.startswith("CMBLOCK") and ",NODE," in line:
            name, count = line.split(",")[1].strip(), int(line.split(",")[3].split("!")[0])
            numbers = [int(word) for text in lines[k + 2 : k + 2 + -(-count // 8)] for word in text.split()]
            found = set()
            for before, number in zip([0, *numbers], numbers, strict=False):
                found |= set(range(before + 1, -number + 1)) if number < 0 else {number}
            expected[name] = sorted(found)
    found = sets_in(path, comm)
    assert set(expected) == {"NCOMP2", "NODE_SELECTION"} and expected.items() <= found.items()
