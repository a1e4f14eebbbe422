"""Assembled matrices of ANSYS: real files against the program's own frequencies, made ones against what was put in."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg
from ansys_files import BLOCK, archive, turn, write_full, write_rst
from foreign import gathered, write
from helpers import to_dense
from shared_data import shared, unpacked

import hpcred
from hpcred import InputError
from hpcred.readers.ansys.full import read_parts
from hpcred.readers.ansys.records import RecordFile
from hpcred.readers.assembly import assemble
from hpcred.readers.entries import STRIDE, node_and_direction
from hpcred.readers.model_source import load_export

pytestmark = pytest.mark.mpi

MASS = "ansys/rotorAnsysMassMatrixSparse.txt"

RNG = np.random.default_rng(5)
NODES = [(7, 3), (2, 3), (30, 3), (4, 3), (5, 3), (6, 3)]  # in the order of the rows
SIZE = 18


def symmetric(sparse=0.5, seed=1):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((SIZE, SIZE)) * (rng.random((SIZE, SIZE)) < sparse)
    lower = np.tril(root, -1)
    return lower + lower.T + np.diag(10 + rng.random(SIZE))


K, M, D = (symmetric(seed=seed) for seed in (1, 2, 3))
POSITION = np.array([[number, *np.random.default_rng(number).random(3), 0, 0, 0] for number, _ in NODES])


def made(comm, folder, matrices, rst=True, name="made.full", **options):
    """Write a .full file, and a .rst file beside it, on rank 0."""
    if comm.rank == 0:
        write_full(folder / name, matrices, NODES, **options)
        if rst:
            write_rst(folder / "made.rst", POSITION)
    comm.Barrier()
    return folder / name


def dense(comm, parts):
    """The matrices of parts as arrays, and the labels of their rows, on all ranks."""
    result = {}
    for key, item in parts.matrices.items():
        local = np.zeros(item.shape)
        np.add.at(local, (item.rows, item.columns), item.values)
        result[key] = comm.allreduce(local)
    label, row = gathered(comm, *parts.row_labels)
    return result, label[np.argsort(row)]


def frequencies(K, M):
    return np.sqrt(np.abs(scipy.linalg.eigh(K, M, eigvals_only=True))) / (2 * np.pi)


def test_a_clamped_beam(comm, folder):
    """63 of its rows are held: with them the lowest frequency would be 33 Hz."""
    path = unpacked(comm, folder, "ansys/HexBeam.full", "ansys/HexBeam.cdb")
    parts = read_parts(path, comm)
    (removed,) = gathered(comm, parts.removed)
    assert len(removed) == 63 and parts.files["nodes"].endswith("HexBeam.cdb")
    with assemble(parts, comm) as model:
        assert (model.size, model.nonzeros) == (900, 77020)
        found = frequencies(to_dense(model.K), to_dense(model.M))[:4]
        node, position = gathered(comm, model.dofs.node, model.dofs.position)
        assert len(np.unique(node)) == 300 and set(removed // STRIDE).isdisjoint(node)
        assert np.allclose(found, [1283.2, 1283.2, 5781.975, 6919.399], rtol=3e-7)
        assert comm.allreduce(len(model.elements["hexahedron20"])) == 40
    lines = (folder / "HexBeam.cdb").read_text().splitlines()[36:357]
    places = {int(line[:9]): [float(line[k : k + 21] or 0) for k in (27, 48, 69)] for line in lines}
    assert np.array_equal(position, [places[number] for number in node])


def test_a_free_rotor_with_squeezed_records(comm, folder):
    path = unpacked(comm, folder, "ansys/rotorAnsys.full", "ansys/rotorAnsys.rst", MASS)
    lumped = scipy.io.mmread(folder / Path(MASS).name).diagonal()  # the mass of the same body as another file has it
    result = RecordFile(folder / "rotorAnsys.rst", 12)
    own = result.record(int(result.words(105 + 11, 1)[0]))[0][6:10]  # the program's modes, six of which are rigid
    assert np.allclose(own, [116.7331, 116.7331, 230.6054, 279.9874], rtol=1e-6)
    with load_export(path, comm) as model:
        assert (model.size, model.nonzeros) == (345, 13659)
        report = hpcred.inspect(model)
        found = frequencies(to_dense(model.K), to_dense(model.M))[6:10]
    assert report["rigid_body_modes"] == 6 and report["mass_kg"] == pytest.approx(lumped.sum() / 3, rel=1e-12)
    assert np.allclose(found, own, rtol=1e-10, atol=0)


@pytest.mark.parametrize("squeeze", [None, "windows"])
@pytest.mark.parametrize("diagonal", [(), ("M",)])
def test_what_is_written_is_read(comm, folder, squeeze, diagonal):
    held = [4, 9, 17]
    mass = np.diag(np.diag(M)) if diagonal else M
    path = made(comm, folder, {"K": K, "M": mass, "D": D}, held=held, squeeze=squeeze, diagonal=diagonal)
    parts = read_parts(path, comm)
    found, label = dense(comm, parts)
    free = np.setdiff1d(np.arange(SIZE), held)
    for key, expected in (("K", K), ("M", mass), ("D", D)):
        assert np.array_equal(found[key], expected[np.ix_(free, free)])
    names = np.array([STRIDE * number + k for number, count in NODES for k in range(count)])
    assert np.array_equal(label, names[free])
    assert np.array_equal(np.sort(gathered(comm, parts.removed)[0]), np.sort(names[held]))
    with assemble(parts, comm) as model:
        node, position = gathered(comm, model.dofs.node, model.dofs.position)
        for number, *xyz in POSITION[:, :4]:
            assert np.array_equal(position[node == number], np.tile(xyz, (np.count_nonzero(node == number), 1)))


def test_columns_without_zeros_are_refused(comm, folder):
    path = made(comm, folder, {"K": K, "M": M}, squeeze_columns="windows")
    with pytest.raises(InputError, match="zeros left out of its columns at word .*, expected plain columns"):
        read_parts(path, comm)


def test_small_pieces_and_long_columns(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.readers.ansys.records.PIECE", 32)
    found, _ = dense(comm, read_parts(made(comm, folder, {"K": K, "M": np.ones_like(M)}), comm))
    assert np.array_equal(found["K"], K) and np.array_equal(found["M"], np.ones_like(M))


def test_numbers_that_look_like_records(comm, folder):
    """Minus zero has the bits of the flags of integers; and 7 words of an integer record in a denormal number."""
    fake = K.copy()
    lower = np.tril_indices(SIZE, -1)
    fake[lower] = np.where(np.arange(len(lower[0])) % 2, -0.0, np.array([1, -(2**31)], "<i4").view("<f8")[0])
    fake = np.tril(fake) + np.tril(fake, -1).T
    found, _ = dense(comm, read_parts(made(comm, folder, {"K": fake, "M": M}), comm))
    assert np.array_equal(found["K"], fake)


def test_places_beyond_eight_gibibytes(comm, folder):
    """A file with a hole: pointers need their upper words."""
    path = made(comm, folder, {"K": K, "M": M}, hole=2**31 + 5)
    assert path.stat().st_size > 2**33
    found, _ = dense(comm, read_parts(path, comm))
    assert np.array_equal(found["K"], K) and np.array_equal(found["M"], M)


def test_directions_come_from_the_list_of_dofs(comm, folder):
    """UX, UY, ROTZ of a plane beam: the third dof is a rotation."""
    path = made(comm, folder, {"K": K, "M": M}, dofs=("UX", "UY", "ROTZ"))
    _, label = dense(comm, read_parts(path, comm))
    assert node_and_direction(label)[1].tolist() == [0, 1, 5] * 6


def test_dofs_that_follow_others_are_left_out(comm, folder):
    slaves = [3, 8]
    mats = {"K": K.copy(), "M": M.copy()}
    for mat in mats.values():
        mat[slaves, :] = mat[:, slaves] = 0.0
        mat[slaves, slaves] = 1.0
    parts = read_parts(made(comm, folder, mats, slaves=slaves, held=[0]), comm)
    found, _ = dense(comm, parts)
    free = np.setdiff1d(np.arange(SIZE), [0, *slaves])
    assert np.array_equal(found["K"], K[np.ix_(free, free)])
    assert any("2 dofs that follow others" in line for line in parts.warnings)
    removed = np.concatenate(comm.allgather(parts.removed))  # held are those only that no other dof moves
    assert [part.tolist() for part in node_and_direction(removed)] == [[7], [0]]
    with pytest.raises(InputError, match="constraint equations were not applied yet"):
        read_parts(made(comm, folder, {"K": mats["K"], "M": M}, slaves=slaves), comm)


def test_turned_axes_of_nodes_become_global(comm, folder):
    """Matrices written along axes of the nodes: the model's are those of the global axes."""
    nodes = POSITION.copy()
    nodes[[1, 4], 4:] = (30, -40, 55), (90, 0, 0)
    T = np.eye(SIZE)
    for k in (1, 4):
        T[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = turn(nodes[k, 4:])
    if comm.rank == 0:
        write_rst(folder / "made.rst", nodes, squeeze="mixed")
    path = made(comm, folder, {"K": T.T @ K @ T, "M": T.T @ M @ T, "D": D}, rst=False)
    parts = read_parts(path, comm)
    found, _ = dense(comm, parts)
    for key, expected in (("K", K), ("M", M), ("D", T @ D @ T.T)):
        assert np.allclose(found[key], expected, atol=1e-13)
    assert any("2 nodes have axes of their own" in line for line in parts.warnings)


def test_supports_in_turned_axes(comm, folder):
    """A dof held along a turned axis leaves no global directions; along an axis that stays global it does."""
    nodes = POSITION.copy()
    nodes[1, 4:] = 30, 0, 0
    if comm.rank == 0:
        write_rst(folder / "made.rst", nodes)
    with pytest.raises(InputError, match="found 2:y along an axis .* while 2:x was held"):
        read_parts(made(comm, folder, {"K": K, "M": M}, rst=False, held=[3]), comm)
    parts = read_parts(made(comm, folder, {"K": K, "M": M}, rst=False, held=[5]), comm)
    T = np.eye(SIZE)
    T[3:6, 3:6] = turn(nodes[1, 4:])
    free = np.setdiff1d(np.arange(SIZE), [5])
    assert np.allclose(dense(comm, parts)[0]["K"], (T @ K @ T.T)[np.ix_(free, free)], atol=1e-13)


@pytest.mark.parametrize(
    "options, says",
    [
        ({"item4": 1}, "buckling analysis, whose second matrix is stress stiffening and no mass"),
        ({"item4": 0}, "found a static analysis, expected those of a modal analysis"),
        ({"item0": 4}, "the frontal solver's form"),
        ({"item13": 1}, "found unsymmetric matrices"),
        ({"item62": 1}, "the part of one process of a distributed run"),
        ({"item26": 0}, "found no mass matrix"),
        ({"item8": 3}, "the file is damaged"),
        ({"item2": 17}, "but 17 active ones in the header"),
        ({"item32": 5}, "found 5 nodes in the matrices but 6 in the table"),
        ({"item22": 99999999}, "no end of the file"),
        ({"item18": 99999999}, "reaches beyond the end of the file"),
        ({"dofs": ("UX", "UY", "TEMP")}, "found the dof TEMP at node"),
        ({"dofs": ("UX", "PRES", "UZ")}, "found the dof PRES at node"),
        ({"kinds": [1, 2, 3] * 5 + [1, 2, 2]}, "found two rows of 6:y"),
        ({"kinds": [1, 2, 3] * 5 + [1, 2, 4]}, "a dof that the list of dofs does not have"),
    ],
)
def test_files_that_no_model_can_come_from(comm, folder, options, says):
    with pytest.raises(InputError) as error:
        read_parts(made(comm, folder, {"K": K, "M": M}, **options), comm)
    assert says in str(error.value) and "made.full" in str(error.value)


PARTS = [[0, 1, 2, 3], [3, 4, 5], [5, 0, 3]]  # nodes of NODES in each part of a run


def put_parts(comm, folder, parts, name="body{}.full", held=(), **header):
    """Parts of a distributed run, whose matrices are principal parts of K and M; and the sums of these."""
    K_sum, M_sum = np.zeros((2, SIZE, SIZE))
    for k, part in enumerate(PARTS):
        rows = (3 * np.array(part)[:, None] + np.arange(3)).ravel()
        at, nodes = np.ix_(rows, rows), [NODES[item] for item in part]
        K_sum[at] += (k + 1) * K[at]
        M_sum[at] += M[at]
        if comm.rank == 0 and k in parts:
            items = {"item61": SIZE, "item62": 1, "item65": 6} | header
            held_here = np.flatnonzero(np.isin(rows, held))
            write_full(folder / name.format(k), {"K": (k + 1) * K[at], "M": M[at]}, nodes, held=held_here, **items)
    if comm.rank == 0:
        write_rst(folder / "body.rst", POSITION)
    comm.Barrier()
    return K_sum, M_sum


@pytest.mark.parametrize("held", [[], [9, 17, 4]])
def test_parts_of_a_distributed_run_are_joined(comm, folder, held):
    """Two of the nodes of which dofs are held lie in several parts."""
    sums = put_parts(comm, folder, (0, 1, 2), held=held)
    for name in ("body0.full", "body2.full"):
        parts = read_parts(folder / name, comm)
        assert any("joined the parts body0.full, body1.full, body2.full" in item for item in parts.warnings)
        found, label = dense(comm, parts)
        names = np.array([STRIDE * number + k for number, _ in NODES for k in range(3)])
        order = np.argsort(names)
        order = order[~np.isin(order, held)]
        assert np.array_equal(label, names[order])
        assert sorted(np.concatenate(comm.allgather(parts.removed))) == sorted(names[held])
        for key, matrix in zip("KM", sums, strict=True):
            assert np.allclose(found[key], matrix[np.ix_(order, order)], rtol=1e-15)
    with load_export(folder / "body1.full", comm) as model:
        node, position = gathered(comm, model.dofs.node, model.dofs.position)
        place = {int(row[0]): row[1:4] for row in POSITION}
        assert np.array_equal(position, [place[n] for n in node])


@pytest.mark.parametrize(
    "parts, options, says",
    [
        ((0, 2), {}, "those of all, but there is no body1.full beside it"),
        ((0,), {}, "those of all, but there is no body1.full beside it"),
        ((0, 1), {"item61": 21}, "found 18 rows of 6 nodes in 2 parts of a distributed run, expected 21 of 6"),
        ((0, 1, 2), {"item65": 7}, "found 18 rows of 6 nodes in 3 parts of a distributed run, expected 18 of 7"),
        ((0, 1, 2), {"item67": 1}, "with constraint equations between parts"),
    ],
)
def test_parts_that_are_not_all_are_refused(comm, folder, parts, options, says):
    put_parts(comm, folder, parts, **options)
    with pytest.raises(InputError, match=says):
        read_parts(folder / "body0.full", comm)


def test_parts_that_do_not_agree_are_refused(comm, folder):
    put_parts(comm, folder, (0, 1, 2))
    put_parts(comm, folder, (1,), held=[9])
    with pytest.raises(InputError, match="found 4:x removed in one part of the distributed run, but not in another"):
        read_parts(folder / "body0.full", comm)
    comm.Barrier()
    put_parts(comm, folder, (1,), item61=19)
    with pytest.raises(InputError, match="body1.full: found a file of another run than body0.full has"):
        read_parts(folder / "body0.full", comm)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_numbers_that_are_none(comm, folder, value):
    bad = K.copy()
    bad[5, 5] = value
    with pytest.raises(InputError, match=re.escape(f"the value {value} in a stiffness matrix")):
        read_parts(made(comm, folder, {"K": bad, "M": M}), comm)


def test_a_model_without_a_file_of_nodes(comm, folder):
    parts = read_parts(made(comm, folder, {"K": K, "M": M}, rst=False), comm)
    assert "found neither .cdb nor .rst file beside it" in parts.warnings[0]
    with assemble(parts, comm) as model:
        assert model.dofs is None and np.array_equal(to_dense(model.K), K)


def test_several_files_of_nodes_are_refused(comm, folder):
    path = made(comm, folder, {"K": K, "M": M}, rst=False)
    for name in ("other.rst", "third.rst"):
        write(folder / name, "", comm)
    with pytest.raises(InputError, match="several files with nodes beside it"):
        read_parts(path, comm)


def test_a_result_file_is_no_matrix_file(comm, folder):
    made(comm, folder, {"K": K, "M": M})
    with pytest.raises(InputError, match="of kind 12 .result file., expected the .full file"):
        load_export(folder / "made.rst", comm)


def damaged_copies(good):
    """Names and bytes of copies that are cut, flipped, of another machine, or followed by something."""
    words = np.frombuffer(good, "<i4")
    end = int(words[105 + 22])
    for cut in (0, 3, 400, 412, 700, 4 * end // 2, 4 * end - 6, len(good) - 1):
        yield f"cut to {cut}", good[:cut]
    yield "bytes of another machine", words.byteswap().tobytes()
    yield "followed by a byte", good + b"x"
    yield "followed by a block and a bit", good + bytes(4 * BLOCK + 4)
    starts = [0, 103]
    while starts[-1] + words[starts[-1]] + 3 < end:
        starts.append(starts[-1] + int(words[starts[-1]]) + 3)
    for place in starts:  # lengths, flags and lengths at the end of records
        for word in (place, place + 1, place + 2 + int(words[place])):
            for bit in (0, 7, 30):
                copy = words.copy()
                copy[word] ^= 1 << bit
                yield f"bit {bit} of word {word}", copy.tobytes()


@pytest.mark.parametrize("held", [[], [4, 9]])
def test_damaged_copies_are_refused(comm, folder, held):
    path = made(comm, folder, {"K": K, "M": M}, rst=False, held=held)
    good = comm.bcast(path.read_bytes() if comm.rank == 0 else None)
    reference = dense(comm, read_parts(path, comm))
    harmless = 0
    for number, (name, content) in enumerate(damaged_copies(good)):
        if comm.size > 1 and number % 29:
            continue
        comm.Barrier()  # no rank may still read the copy before
        write(path, content, comm)
        try:
            found = dense(comm, load_parts(path, comm))
        except InputError as error:
            assert "made.full" in str(error), name
            continue
        harmless += 1
        assert all(np.array_equal(found[0][key], reference[0][key]) for key in "KM"), name
        assert np.array_equal(found[1], reference[1]), name
    assert harmless < 20  # flips in what is not read: imposed displacements


def load_parts(path, comm):
    """As load_export reads them: a file that is not known is refused as well."""
    from hpcred.files.text import first_bytes
    from hpcred.readers.ansys.records import begins

    if not begins(first_bytes(path)):
        raise InputError(f"{path}: not known")
    return read_parts(path, comm)


def test_flipped_rows_of_entries_are_refused(comm, folder):
    """All bits of all row numbers, where they change the order or leave the matrix."""
    full = np.tril(np.ones((SIZE, SIZE)))
    path = made(comm, folder, {"K": full + full.T, "M": M}, rst=False)
    good = np.frombuffer(comm.bcast(path.read_bytes() if comm.rank == 0 else None), "<i4")
    place, words = int(good[105 + 18]), []
    for k in range(SIZE):
        words += range(place + 2, place + 2 + SIZE - k)
        place += 3 * (SIZE - k) + 6
    for number, word in enumerate(words):
        if comm.size > 1 and number % 60:
            continue
        for bit in (0, 1, 4, 20, 31):
            copy = good.copy()
            copy[word] ^= np.int32(-(2**31)) if bit == 31 else 1 << bit
            comm.Barrier()
            write(path, copy.tobytes(), comm)
            with pytest.raises(InputError):
                read_parts(path, comm)


def test_the_same_body_with_the_nodes_of_its_result_file(comm):
    """Nodes of the .rst file beside it, in place of the archive; its modes are those of another analysis."""
    parts = read_parts(shared("ansys/file.full"), comm)
    assert parts.files["nodes"].endswith("file.rst")
    with assemble(parts, comm) as model:
        found = frequencies(to_dense(model.K), to_dense(model.M))[:4]
        assert model.dofs is not None and np.allclose(found, [1283.2, 1283.2, 5781.975, 6919.399], rtol=3e-7)


def test_the_input_file_of_workbench_is_found(comm, folder):
    """Its nodes where there are no others; else its elements and named selections, unless it is of another model."""
    path = made(comm, folder, {"K": K, "M": M}, rst=False)
    nodes = {int(node[0]): tuple(node[1:4]) for node in POSITION}
    first = min(nodes)
    picked = f"CMBLOCK,PICKED,NODE,       1\n(8i10)\n{first:10d}\n"
    workbench = write(folder / "ds.dat", archive(nodes, elements=picked), comm)

    def sets():
        parts = read_parts(path, comm)
        return {name: gathered(comm, numbers)[0].tolist() for name, numbers in parts.sets.items()}, parts.warnings

    assert sets()[0] == {"PICKED": [first]}
    made(comm, folder, {"K": K, "M": M})
    found, warnings = sets()
    assert found == {"PICKED": [first]}
    assert any("elements and named selections are those of this" in line for line in warnings)
    moved = {number: (xyz[0] + 1.0, *xyz[1:]) for number, xyz in nodes.items()}
    write(workbench, archive(moved, elements=picked), comm)
    found, warnings = sets()
    assert not found and any("ds.dat: its nodes are not those of" in line for line in warnings)
    write(workbench, archive(nodes, elements=picked[:-11]), comm)
    found, warnings = sets()
    assert not found and any("elements and sets are not taken from this file" in line for line in warnings)
