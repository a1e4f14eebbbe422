"""MATLAB files of all versions against what was put into them, and against scipy.io."""

import struct
import zlib

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import DATA
from fe_data import FE, needs_fe
from foreign import assembled, gathered, write
from helpers import to_dense

import hpcred
from hpcred import InputError
from hpcred.parallel.petsc import is_complex
from hpcred.readers.matlab.matrices import contents, read, read_parts
from hpcred.readers.matrix_formats import read_entries
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

SIZE = 12
RNG = np.random.default_rng(8)
ROOT = RNG.standard_normal((SIZE, SIZE)) * (RNG.random((SIZE, SIZE)) < 0.3)
K, M = ROOT @ ROOT.T + 40 * np.eye(SIZE), np.diag(np.arange(1.0, SIZE + 1))
NODES = np.array([[7, 0.0, 0.0, 1.0], [3, 2.0, 0.0, 0.0], [30, 0.0, 3.0, 0.0], [4, 1.0, 1.0, 1.0]])
DOFS = np.array([(n, d) for n in (30, 7, 3, 4) for d in (1, 2, 3)])


def write_hdf5(path, tree):
    """What MATLAB's save -v7.3 makes of nested dicts of arrays and sparse matrices."""

    def put(group, name, item):
        if isinstance(item, dict):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, part in item.items():
                put(inner, key, part)
        elif scipy.sparse.issparse(item):
            item = item.tocsc()
            inner = group.create_group(name)
            inner.attrs["MATLAB_sparse"] = np.uint64(item.shape[0])
            inner["jc"] = item.indptr.astype(np.uint64)
            if item.nnz:
                inner["ir"], inner["data"] = item.indices.astype(np.uint64), item.data
        else:
            group[name] = np.asarray(item).T
            group[name].attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, item in tree.items():
            put(file, name, item)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


WRITERS = {
    "v5 packed": lambda path, tree: scipy.io.savemat(path, tree, do_compression=True),
    "v5": lambda path, tree: scipy.io.savemat(path, tree),
    "v7.3": write_hdf5,
    "v4": lambda path, tree: scipy.io.savemat(path, tree, format="4"),
}


def saved(comm, folder, kind, tree):
    path = folder / "a.mat"
    if comm.rank == 0:
        WRITERS[kind](path, tree)
    comm.Barrier()
    return path


def model_matrices(path, comm, **keywords):
    with load_export(path, comm, **keywords) as model:
        return to_dense(model.K), to_dense(model.M)


@pytest.mark.parametrize("kind", WRITERS)
def test_sparse_and_dense_matrices_of_all_versions(comm, folder, kind):
    for change in (scipy.sparse.csc_matrix, np.asarray):
        path = saved(comm, folder, kind, {"Kgg": change(K), "MGG": change(M), "x": np.arange(3.0)})
        found_K, found_M = model_matrices(path, comm)
        assert np.array_equal(found_K, K) and np.array_equal(found_M, M)
        comm.Barrier()


@pytest.mark.parametrize("kind", ["v5 packed", "v5", "v7.3"])
def test_matrices_in_structs_are_chosen_by_name(comm, folder, kind):
    tree = {"s": {"kaa": {"k0": scipy.sparse.csc_matrix(K), "k101": M}, "maa": {"k0": M, "k101": K}}, "phi": K[:, :3]}
    path = saved(comm, folder, kind, tree)
    assert contents(path)["s.kaa.k0"].startswith(f"{SIZE} x {SIZE} sparse, {np.count_nonzero(K)} entries")
    with load_export(path, comm) as model:  # k0: the residual structure
        assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
        assert any("of such a name: s.kaa.k101, s.maa.k101;" in remark for remark in model.remarks)
    found_K, found_M = model_matrices(path, comm, variables={"K": "s.kaa.k101", "M": "s.maa.k101"})
    assert np.array_equal(found_K, M) and np.array_equal(found_M, K)
    names = {"K": "s.kaa.k0", "M": "s.maa.k0", "B": "phi"}
    source = Source(str(path), str(path), B=str(path), variables=names)
    with load_source(source, comm) as model:
        assert np.array_equal(to_dense(model.K), K) and model.input_names == ("a.mat:1", "a.mat:2", "a.mat:3")


@pytest.mark.parametrize("kind", ["v5 packed", "v5", "v7.3", "v4"])
def test_nodes_and_dofs_name_the_rows(comm, folder, kind):
    tree = {"K": scipy.sparse.csc_matrix(K), "M": M, "nodes": NODES, "dofs": DOFS.astype(float)}
    path = saved(comm, folder, kind, tree)
    with load_export(path, comm) as model:
        node, direction, position = gathered(comm, model.dofs.node, model.dofs.direction, model.dofs.position)
    assert np.array_equal(np.column_stack([node, direction + 1]), DOFS)
    place = {int(row[0]): row[1:] for row in NODES}
    assert np.array_equal(position, [place[n] for n in node])


@pytest.mark.parametrize("kind", ["v5 packed", "v5", "v7.3", "v4"])
@pytest.mark.parametrize("change", [
    lambda nodes: nodes[np.argsort(nodes[:, 0]), 1:], lambda nodes: nodes[np.argsort(nodes[:, 0]), 1:].T,
    lambda nodes: nodes.T,
], ids=["n x 3", "3 x n", "4 x n"])  # fmt: skip
def test_nodes_in_other_shapes(comm, folder, kind, change):
    """Rows of x, y, z belong to the nodes 1, 2, 3, ...; six nodes of two dofs, so that no shape fits two forms."""
    nodes = np.column_stack([[4, 2, 6, 1, 3, 5], np.arange(18.0).reshape(6, 3) ** 2])
    dofs = np.array([(n, d) for n in range(1, 7) for d in (1, 3)])
    path = saved(comm, folder, kind, {"K": K, "M": M, "nodes": change(nodes), "dofs": dofs.T.astype(float)})
    with load_export(path, comm) as model:
        node, direction, position = gathered(comm, model.dofs.node, model.dofs.direction, model.dofs.position)
        assert any("'nodes'" in remark and "is read as" in remark for remark in model.remarks)
    assert np.array_equal(np.column_stack([node, direction + 1]), dofs)
    assert np.array_equal(position, nodes[np.argsort(nodes[:, 0]), 1:][node - 1])


def test_arrays_that_are_no_nodes_are_spoken_of(comm, folder):
    for tree, says in (
        ({"nodes": DOFS[:, :1]}, "'nodes' (12 x 1 dense) is not read as nodes, expected rows of number, x, y, z or"),
        ({"nodes": 4.0}, "'nodes' (1 x 1 dense) is not read as nodes"),
        ({"dofs": DOFS}, "'dofs' is not read, since there is no array nodes"),
        ({"nodes": NODES, "dofs": DOFS[:, :1]}, "'dofs' (12 x 1 dense) is not read as dofs, expected rows of node"),
    ):
        with load_export(saved(comm, folder, "v5", {"K": K, "M": M, **tree}), comm) as model:
            assert any(says in remark for remark in model.remarks), model.remarks
        comm.Barrier()


@pytest.mark.parametrize("key", ["k", "K", "stiffness", "KGG"])
def test_matrices_outside_of_structs_are_the_model(comm, folder, key):
    """Those of elements, however many, do not make the whole one ambiguous, and are not taken in its place."""
    elements = np.zeros(2, dtype=[("k", object), ("m", object)])
    elements["k"], elements["m"] = [K[:6, :6]] * 2, [M[:6, :6]] * 2
    for tree in ({"element": elements}, {"element": {"k": K[:6, :6]}}):
        path = saved(comm, folder, "v5", {**tree, key: K, "M": M})
        with load_export(path, comm) as model:
            assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
            assert any("not read, though" in remark and "element" in remark for remark in model.remarks)
        comm.Barrier()


def test_one_of_several_structures_is_named_where_there_are_no_remarks(comm, folder):
    path = saved(comm, folder, "v5", {"kaa": {"k0": K, "k101": M}, "M": M})
    with pytest.raises(InputError, match="several matrices for K: kaa.k0, kaa.k101; choose by --variables K=NAME"):
        read(path, comm, "K")
    assert read(path, comm, "K", {"K": "kaa.k0"}).shape == K.shape


def test_damping_is_taken_and_the_rest_is_spoken_of(comm, folder):
    path = saved(comm, folder, "v5", {"K": K, "M": M, "D": -M, "V": K, "C": np.ones((1, SIZE))})
    with load_export(path, comm) as model:
        assert np.array_equal(to_dense(model.D), -M)
        assert any("not read, though of the same size or of such a name: V" in remark for remark in model.remarks)
        assert any("D has a negative trace" in line for line in hpcred.inspect(model)["warnings"])


def test_a_stiffness_of_the_wrong_sign_is_spoken_of(comm, folder):
    path = saved(comm, folder, "v5", {"K": -K, "M": M})
    with load_export(path, comm) as model:
        assert np.array_equal(to_dense(model.K), -K)
        assert any("K is negative definite, -K?" in line for line in hpcred.inspect(model)["warnings"])
    with pytest.raises(InputError, match="negative diagonal entries"):
        load_export(saved(comm, folder, "v5", {"K": K, "M": -M}), comm)


def test_texts_beside_the_matrices_have_any_letters(comm, folder):
    """A letter beyond 16 bits takes two of the numbers that the shape of the text counts."""
    path = saved(comm, folder, "v5", {"K": K, "M": M, "note": "ab\U0001f600c"})
    if comm.rank == 0:  # as MATLAB counts
        before, name, behind = path.read_bytes().partition(b"note")
        shape, last = np.array([1, 4], "<i4").tobytes(), before.rfind(np.array([1, 4], "<i4").tobytes())
        path.write_bytes(before[:last] + np.array([1, 5], "<i4").tobytes() + before[last + len(shape):] + name + behind)
    comm.Barrier()
    found_K, _ = model_matrices(path, comm)
    assert np.array_equal(found_K, K)


def test_empty_sparse_matrices(comm, folder):
    tree = {"K": scipy.sparse.csc_matrix(K), "M": M, "D": scipy.sparse.csc_matrix((SIZE, SIZE))}
    path = saved(comm, folder, "v7.3", tree)
    with load_export(path, comm) as model:
        assert not to_dense(model.D).any()


def test_inputs_and_outputs_that_stand_in_the_file_are_not_passed_over_in_silence(comm, folder):
    """They are read from a .mat that is named by -B and -C, as the remark says."""
    B, C = np.eye(SIZE)[:, :2], np.eye(SIZE)[3:6]
    path = saved(comm, folder, "v5", {"K": K, "M": M, "B": B, "C": C})
    with load_export(path, comm) as model:
        says = model.remarks[-1]
        assert f"B ({SIZE} x 2 dense), C (3 x {SIZE} dense)" in says and f"-B {path} -C {path}" in says
    with load_source(Source(K=path, M=path, B=path, C=path), comm) as model:
        assert len(model.input_names) == 2 and len(model.output_names) == 3


def test_lists_of_other_types_and_a_damping_of_another_size(comm, folder):
    sparse = scipy.sparse.csc_matrix(K)
    with load_export(saved(comm, folder, "v7.3", {"K": sparse, "M": M, "D": M[:3]}), comm) as model:
        assert model.D is None and "not of the size of K, and not read as a damping matrix" in model.remarks[-1]
    path = saved(comm, folder, "v7.3", {"K": sparse, "M": M})
    if comm.rank == 0:
        with h5py.File(path, "a") as file:
            starts = file["K/jc"][...] + 0.5
            del file["K/jc"]
            file["K/jc"] = starts
    comm.Barrier()
    with pytest.raises(InputError, match="found a sparse matrix 'K' without its lists of numbers"):
        load_export(path, comm)


@pytest.mark.parametrize("kind", ["link", "storage"])
def test_parts_in_other_files_are_not_followed(comm, folder, kind):
    path = saved(comm, folder, "v7.3", {"K": K, "M": M})
    if comm.rank == 0:
        (folder / "other").write_bytes(bytes(8 * SIZE**2))
        with h5py.File(path, "a") as file:
            del file["M"]
            if kind == "link":
                file["M"] = h5py.ExternalLink("other.h5", "/M")
            else:
                file.create_dataset("M", (SIZE, SIZE), "f8", external=[(str(folder / "other"), 0, 8 * SIZE**2)])
    comm.Barrier()
    with pytest.raises(InputError, match="M is (a link to something else|kept in another file), which is not fol"):
        load_export(path, comm)


@pytest.mark.parametrize(
    "tree, says",
    [
        ({"stiff1": K, "M": M}, r"no matrix with a usual name of K .*stiff1 \(12 x 12 dense\).*--variables K=NAME"),
        ({"a": {"K": K}, "b": {"K": K}, "M": M}, r"several matrices for K: a.K, b.K; choose by --variables"),
        ({"K": K + 1j, "M": M}, "found complex numbers in 'K' for K, expected real ones"),
        ({"K": K, "M": M[:3, :3]}, r"M: found 3 rows, but K .* has 12"),
        ({"K": K, "M": M, "nodes": NODES * [1, 1e30, 1, 1]}, "coordinates in 'nodes' that are NaN, Inf, or beyond"),
        ({"K": K, "M": M, "nodes": NODES, "dofs": DOFS * np.inf}, "found numbers in 'dofs' that are not whole"),
        ({"K": K, "M": M, "nodes": NODES[[0, 0]]}, "found the node 7 more than once"),
        ({"K": K, "M": M, "nodes": NODES, "dofs": DOFS[:3]}, "found 3 rows of 'dofs', expected one for each of the 12"),
        ({"K": K, "M": M, "nodes": NODES, "dofs": DOFS * 1.5}, "found numbers in 'dofs' that are not whole"),
        ({"K": K, "M": M, "nodes": NODES[:, 1:]},
         r"found 'nodes' \(4 x 3 dense\), which may have rows of x, y, z of the nodes 1, 2, 3, ... or columns of "
         "number, x, y, z; save it with rows of number, x, y, z"),
        ({"text": "abc"}, "the file has no numeric matrix"),
    ],
)
def test_files_without_a_model_are_refused(comm, folder, tree, says):
    with pytest.raises(InputError, match=says):
        load_export(saved(comm, folder, "v5 packed", tree), comm)


def test_names_that_are_not_there_are_refused(comm, folder):
    path = saved(comm, folder, "v5", {"K": K, "M": M})
    with pytest.raises(InputError, match="found no variable 'kk' for K; the file has K .*, M "):
        load_export(path, comm, variables={"K": "kk"})
    with pytest.raises(InputError, match="--variables: found B for .* expected K, M or D; .* -B "):
        read_parts(path, comm, {"B": "K"})
    mtx = write(folder / "K.mtx", "1 1 1.0\n", comm)
    with pytest.raises(InputError, match="give single matrices by -K and -M"):
        load_export(mtx, comm, variables={"K": "kk"})


@pytest.mark.parametrize("version", ["4.2c_SOL2", "7.4_GLNX86"])
def test_both_byte_orders_against_scipy(comm, version):
    path = DATA / "matlab" / f"testsparse_{version}.mat"
    entries = read(path, comm, "K", {"K": "testsparse"})
    local = np.zeros(entries.shape)
    np.add.at(local, (entries.rows, entries.columns), entries.values)
    assert np.array_equal(comm.allreduce(local), scipy.io.loadmat(path)["testsparse"].toarray())


@needs_fe
def test_sparse_matrices_of_matlab_itself(comm):
    folder = FE / "matlab" / "v73_sparse"
    entries = read(folder / "testfile1.mat", comm, "K", {"K": "data.sparse_"})
    rows, columns, values = gathered(comm, entries.rows, entries.columns, entries.values)
    assert entries.shape == (10, 8)
    assert set(zip(rows, columns, values, strict=True)) == {(1, 4, 6.0), (3, 7, 7.0)}
    entries = read(folder / "testfile13.mat", comm, "K", {"K": "A"})
    assert entries.shape == (2, 3) and comm.allreduce(len(entries.values)) == 0


def element(kind, data):
    """An element of version 5: its tag, its bytes, and what fills them up to eight."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(flags, room, *parts):
    return element(14, element(6, struct.pack("<II", flags, room)) + b"".join(parts))


# as MATLAB writes them: a string, a function handle, a sparse matrix of truths (of doubles, it says, a byte each), and
# what it keeps of objects, which has no name
OF_MATLAB = [
    matrix(17, 0, element(1, b"unit"), element(1, b"MCOS"), element(1, b"string"),
           matrix(13, 0, element(5, struct.pack("<ii", 6, 1)), element(1, b""), element(6, bytes(24)))),
    matrix(16, 0, element(1, b"f"), matrix(2, 0, element(5, struct.pack("<ii", 1, 1)), element(1, b""))),
    matrix(0x205, 5, element(5, struct.pack("<ii", SIZE, SIZE)), element(1, b"free"),
           element(5, struct.pack("<5i", *range(5))),
           element(5, struct.pack("<13i", *range(5), *[5] * 8)), element(9, b"\1" * 5)),
    matrix(9, 0, element(5, struct.pack("<ii", SIZE, SIZE)), element(1, b""), element(2, bytes(SIZE**2))),
]  # fmt: skip


@pytest.mark.parametrize("packed", (False, True))
def test_objects_of_matlab_beside_the_matrices_are_passed_over(comm, folder, packed):
    path = saved(comm, folder, "v5 packed" if packed else "v5", {"K": K, "M": M})
    if comm.rank == 0:
        with open(path, "ab") as file:
            for item in OF_MATLAB:
                file.write(struct.pack("<II", 15, len(zlib.compress(item))) + zlib.compress(item) if packed else item)
    comm.Barrier()
    assert contents(path) == {"K": "12 x 12 dense", "M": "12 x 12 dense", "free": "12 x 12 sparse, 5 entries"}
    found = read(path, comm, "K", {"K": "free"})
    rows, columns, values = gathered(comm, found.rows, found.columns, found.values)
    assert np.array_equal([rows, columns, values], [np.arange(5), np.arange(5), np.ones(5)])


def test_objects_of_matlab_in_hdf5_are_no_matrices(comm, folder):
    path = saved(comm, folder, "v7.3", {"K": K, "mass": M, "M": np.ones((SIZE, SIZE), np.uint32)})
    if comm.rank == 0:
        with h5py.File(path, "r+") as file:
            file["M"].attrs["MATLAB_object_decode"] = np.int32(3)
    comm.Barrier()
    assert np.array_equal(model_matrices(path, comm)[1], M)


@pytest.mark.skipif(is_complex(), reason="modes in a band of a free body without nodes need a real build")
def test_nastran_matrices_by_way_of_matlab(comm):
    """The frequencies that the program wrote beside the matrices."""
    path = DATA / "matlab" / "nas2cam.mat"
    table = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)["nas"]
    expected = np.sqrt(np.sort(getattr(table, "lambda").k0)[6:10]) / (2 * np.pi)
    with load_export(path, comm) as model, model.with_inputs([1]) as loaded:
        assert model.size == 54
        with hpcred.reduce(loaded, [hpcred.Modes(band=(1.0, 5.0))]) as rom:
            assert np.allclose(rom.frequencies[:4], expected, rtol=3e-8)


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.mpi
def test_damaged_copies_are_refused_or_the_same(comm, folder, kind):
    """Cut anywhere, bits flipped, bytes added: InputError, or finite numbers in rows that ascend.

    An entry that moves within its column is seen by the symmetry of K only, a digit of a value by nothing.
    """
    damage = np.random.default_rng(5)
    path = saved(comm, folder, kind, {"K": scipy.sparse.csc_matrix(K), "M": scipy.sparse.csc_matrix(M)})
    whole = path.read_bytes()
    comm.Barrier()
    cuts, flips = (25, 60) if kind != "v7.3" else (4, 6)  # HDF5 takes 0.2 s for a file
    copies = [whole[:cut] for cut in {*damage.integers(0, len(whole), cuts).tolist(), len(whole) - 1, 127, 130}]
    copies += [whole + b"garbage"] if kind != "v7.3" else []  # HDF5 says itself how long it is
    for place in damage.integers(0, len(whole), flips).tolist():
        copies.append(whole[:place] + bytes([whole[place] ^ (1 << int(damage.integers(8)))]) + whole[place + 1 :])
    for content in comm.bcast(copies):
        write(path, content, comm)
        try:
            shape = read_entries(path, comm).shape
        except InputError:
            continue
        if shape != K.shape:  # a model refuses it; as a dense matrix it may be larger than the memory
            assert kind != "v5 packed"  # which has a checksum
            continue
        entries = assembled(path, comm)
        assert kind != "v5 packed" or np.array_equal(entries, K)
        if not np.array_equal(entries != 0, K != 0):
            assert not np.array_equal(entries, entries.T)

