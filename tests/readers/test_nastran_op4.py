"""Matrices of OUTPUT4: all flavours of real files agree, matrices written here come back, damage is refused."""

import struct

import numpy as np
import pytest
from foreign import gathered, unpack, write

from hpcred import InputError
from hpcred.readers.nastran import op4 as nastran_op4
from hpcred.readers.nastran import op4_binary as nastran_op4_binary

pytestmark = pytest.mark.mpi(build="real")

RNG = np.random.default_rng(4)
FLAVOURS = [f"{style}_{way}" for style in ("dense", "bigmat", "nonbigmat")
            for way in ("ascii", "ascii_i64", "be", "be_i64", "le", "le_i64")]  # fmt: skip


def dense(path, comm, matrix):
    entries = nastran_op4.read_matrix(path, comm, matrix)
    i, j, v = gathered(comm, entries.rows, entries.columns, entries.values)
    result = np.zeros(entries.shape)
    np.add.at(result, (i, j), v)
    return result


def matrices(path, comm):
    return {matrix.name: dense(path, comm, matrix) for matrix in nastran_op4.contents(path, comm)}


def test_all_flavours_agree(comm, folder):
    unpack(folder, comm, "nastran/variants")
    found = {}
    for kind in ("double", "single"):
        for flavour in FLAVOURS:
            path = folder / f"{kind}_{flavour}.op4"
            real, *others = nastran_op4.contents(path, comm)
            found.setdefault(kind, {})[flavour] = dense(path, comm, real)
            assert real.shape == (25, 31) and [item.kind > 2 for item in others] == [True, True]
            with pytest.raises(InputError, match="found the complex matrix CMAT"):
                dense(path, comm, others[0])
    exact = found["double"]["bigmat_le"]
    assert np.count_nonzero(exact) == 32  # counted by another reader
    for flavour, matrix in found["double"].items():
        digits = 0 if "ascii" not in flavour else 1e-9 if flavour != "nonbigmat_ascii_i64" else 1e-13
        assert np.abs(matrix - exact).max() <= digits * np.abs(exact).max(), flavour
    for flavour, matrix in found["single"].items():
        assert np.abs(matrix - exact).max() <= 1e-7 * np.abs(exact).max(), flavour
    for name in ("double_nonbigmat_ascii_d", "double_dense_ascii_d", "double_bigmat_ascii_d"):
        assert np.abs(matrices_of(folder / f"{name}.op4", comm) - exact).max() < 1e-9 * np.abs(exact).max()


def matrices_of(path, comm):
    return dense(path, comm, nastran_op4.contents(path, comm)[0])


def test_headers_without_names_or_formats(comm, folder):
    unpack(folder, comm, "nastran/variants")
    found = nastran_op4.contents(folder / "double_bigmat_ascii_badname.op4", comm)
    assert [item.name for item in found] == ["1MAT", "", "09"]
    many = nastran_op4.contents(folder / "big_bigmat_binary.op4", comm)
    assert [str(item) for item in many] == ["ALLZ (66001 x 4)", "ALLZC (66001 x 4)", "SPARSE (66001 x 4)",
                                            "SPARSEC (66001 x 4)"]  # fmt: skip
    for name in ("big_bigmat_binary", "big_bigmat_ascii", "big_dense_binary", "big_dense_ascii"):
        path = folder / f"{name}.op4"
        entries = nastran_op4.read_matrix(path, comm, nastran_op4.contents(path, comm)[2])
        i, j, v = gathered(comm, entries.rows, entries.columns, entries.values)
        assert sorted(zip(j + 1, i + 1, v, strict=True)) == [
            (1, 4501, 9.8), (1, 4506, -9.8), (2, 13, 1.2), (2, 17, -1.2), (3, 55001, 5.5), (3, 55003, -5.5)
        ]  # fmt: skip


def test_dimensions_of_more_than_seven_digits(comm, folder):
    """Ten million columns, rows, or both; the header of a text then has wider fields."""
    unpack(folder, comm, "nastran/variants")
    found = []
    for name in ("nas_large_dim_bigmat_binary", "nas_large_dim_bigmat_ascii"):
        path = folder / f"{name}.op4"
        contents = nastran_op4.contents(path, comm)
        assert [item.shape for item in contents] == [(19, 10000001), (10000001, 19), (10000001, 10000001), (5, 7)]
        for item in contents:
            entries = nastran_op4.read_matrix(path, comm, item)
            found.append(gathered(comm, entries.rows, entries.columns, entries.values))
    for (i, j, v), (k, m, w) in zip(found[:4], found[4:], strict=True):
        assert np.array_equal(i, k) and np.array_equal(j, m) and np.allclose(v, w, rtol=1e-15)


def test_binary_and_text_of_a_real_stiffness(comm, folder):
    unpack(folder, comm, "nastran/testplate")
    exact = matrices_of(folder / "testplate_kgg.op4", comm)
    assert exact.shape == (726, 726) and np.count_nonzero(exact) == 12196 and (exact == exact.T).all()
    text = matrices_of(folder / "testplate_kgg_ascii.op4", comm)
    assert 0 < np.abs(text - exact).max() < 1.4e-10 * np.abs(exact).max() * 10


def binary(matrix, order, size, style, name="A", form=2):
    """Bytes of a real matrix in double precision as OUTPUT4 writes it."""
    whole = "i" if size == 4 else "q"
    words = 8 // size

    def record(*parts):
        content = b"".join(parts)
        return struct.pack(order + "i", len(content)) + content + struct.pack(order + "i", len(content))

    def numbers(*values):
        return struct.pack(f"{order}{len(values)}{whole}", *values)

    rows, columns = matrix.shape
    title = f"{name:<8}".encode()
    title = title if size == 4 else title[:4] + b"    " + title[4:] + b"    "
    result = record(numbers(columns, -rows if style == "bigmat" else rows, form, 2 if size == 4 else 1), title)
    for j, column in enumerate(matrix.T):
        at = np.flatnonzero(column)
        if not len(at):
            continue
        if style == "dense":
            values = column[at[0] : at[-1] + 1]
            content = values.astype(order + "f8").tobytes()
            result += record(numbers(j + 1, at[0] + 1, words * len(values)), content)
            continue
        content = b""
        for part in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            length = words * len(part) + 1
            head = (length, part[0] + 1) if style == "bigmat" else (part[0] + 1 + 65536 * length,)
            content += numbers(*(int(item) for item in head)) + column[part].astype(order + "f8").tobytes()
        result += record(numbers(j + 1, 0, len(content) // size), content)
    return result + record(numbers(columns + 1, 1, words), struct.pack(order + "d", 1.0))


@pytest.mark.parametrize("style", ["dense", "bigmat", "nonbigmat"])
@pytest.mark.parametrize("size", [4, 8])
@pytest.mark.parametrize("order", "<>")
def test_what_is_written_comes_back(comm, folder, monkeypatch, order, size, style):
    monkeypatch.setattr(nastran_op4_binary, "SHARE", 500)  # many shares
    rng = np.random.default_rng(1)
    first = rng.standard_normal((40, 30)) * (rng.random((40, 30)) < 0.4)
    first[:, 7], first[0, 8], first[-1, 8] = 0, 1, 2  # an empty column, and one from top to bottom
    second = np.diag(rng.standard_normal(12))
    content = binary(first, order, size, style, "KAA") + binary(second, order, size, style, "VERYLONG", 6)
    path = write(folder / "a.op4", content, comm)
    found = matrices(path, comm)
    assert list(found) == ["KAA", "VERYLONG"]
    assert np.array_equal(found["KAA"], first) and np.array_equal(found["VERYLONG"], second)


def test_one_half_of_a_symmetric_matrix_is_mirrored(comm, folder):
    root = np.random.default_rng(1).standard_normal((9, 9))
    whole = root + root.T
    path = write(folder / "a.op4", binary(np.triu(whole), "<", 4, "bigmat", "K", 6), comm)
    assert np.array_equal(matrices(path, comm)["K"], whole)
    path = write(folder / "b.op4", binary(np.triu(whole), "<", 4, "bigmat", "K", 1), comm)
    assert np.array_equal(matrices(path, comm)["K"], np.triu(whole))
    path = write(folder / "c.op4", binary(np.triu(whole), "<", 4, "bigmat", "K", 5), comm)
    with pytest.raises(InputError, match="as a triangular factor"):
        matrices(path, comm)


def test_diagonals_and_identities(comm, folder):
    content = binary(np.array([[2.0], [3.0], [4.0], [5.0]]), "<", 4, "dense", "D", 3)
    content += binary(np.zeros((5, 5)), "<", 4, "dense", "I", 8)
    found = matrices(write(folder / "a.op4", content, comm), comm)
    assert np.array_equal(found["D"], np.diag([2.0, 3, 4, 5])) and np.array_equal(found["I"], np.eye(5))


GOOD = np.diag([1.0, 2, 3, 4, 5]) + np.diag([7.0, 8, 9, 10], 1)


def change(content, at, kind, value):
    changed = bytearray(content)
    struct.pack_into(kind, changed, at, value)
    return bytes(changed)


@pytest.mark.parametrize(
    "damage, says",
    [
        (lambda c: c[:10], "expected"),
        (lambda c: c[:40], "the file is cut off"),
        (lambda c: c[:-1], "the file is cut off"),
        (lambda c: c[:-30], "the file is cut off"),
        (lambda c: c + b"\0" * 12, "found no header of a matrix at byte"),
        (lambda c: c + c[:33], "found the end of the file in a matrix after column 0 of 5; the file is cut off"),
        (lambda c: change(c, 4, "<i", 4), "found no header of a matrix at byte 244"),
        (lambda c: change(c, 16, "<i", 9), "expected one of OUTPUT4"),
        (lambda c: c + change(c, 16, "<i", 9), "expected columns, rows, form, type (1 to 4) and name"),
        (lambda c: change(c, 8, "<i", -4), "a string of numbers that does not fit its column"),
        (lambda c: change(c, 36, "<i", 3), "behind column 3"),
        (lambda c: change(c, 40, "<i", 1), "whole columns beside columns of strings"),
        (lambda c: change(c, 44, "<i", 5), "a column whose number of words is not that of its record"),
        (lambda c: change(c, 48, "<i", 5), "a string of numbers that goes beyond its column"),
        (lambda c: change(c, 48, "<i", 1), "a string of numbers that goes beyond its column"),
        (lambda c: change(c, 52, "<i", 6), "a string of numbers that does not fit its column"),
        (lambda c: change(c, 52, "<i", 0), "a string of numbers that does not fit its column"),
        (lambda c: change(c, 64, "<i", 99), "a record without its end"),
    ],
)
def test_damaged_binary_files_are_refused(comm, folder, damage, says):
    good = binary(GOOD, "<", 4, "bigmat", "KAA", 1)
    assert np.array_equal(matrices(write(folder / "good.op4", good, comm), comm)["KAA"], GOOD)
    path = write(folder / "bad.op4", damage(good), comm)
    with pytest.raises(InputError) as error:
        matrices(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize("name", ["double_bigmat_be", "single_nonbigmat_le", "double_dense_le", "rd", "rdbin"])
def test_no_cut_file_is_accepted(comm, folder, name):
    unpack(folder, comm, "nastran/variants")
    content = (folder / f"{name}.op4").read_bytes()
    last = len(matrices_known(folder / f"{name}.op4", comm))
    comm.Barrier()
    for length in np.linspace(0, len(content) - 2, 25).astype(int):
        path = write(folder / "cut.op4", content[:length], comm)
        try:
            found = matrices_known(path, comm)
        except InputError:
            found = {}
        assert len(found) < last  # whole matrices above the cut may be there
        comm.Barrier()


def matrices_known(path, comm):
    """The real matrices of a file; every one must be whole."""
    return {item.name: dense(path, comm, item) for item in nastran_op4.contents(path, comm) if item.kind < 3}


TEXT = """       2       2       1       2KAA     1P,5E16.9
       1       0       5
       3       1
 1.500000000E+00
       2       0       8
       3       1
-2.000000000E-10
       3       2
 3.0000000000+10
       3       1       1
 1.000000000E+00
"""


def big(text):
    return text.replace("       2       2       1", "       2      -2       1", 1)


def test_a_text(comm, folder):
    text = big(TEXT).replace("       5\n", "       4\n")
    path = write(folder / "a.op4", text, comm)
    assert np.array_equal(matrices(path, comm)["KAA"], [[1.5, -2e-10], [0, 3e10]])
    path = write(folder / "b.op4", text.replace("\n", "\r\n").replace("E", "D"), comm)
    assert np.array_equal(matrices(path, comm)["KAA"], [[1.5, -2e-10], [0, 3e10]])


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("       1       0       4", "       1       0       5", "as many words below as it says"),
        ("       3       1\n 1.5", "       5       1\n 1.5", "as many numbers below as it says"),
        (" 1.500000000E+00", " 1.500000000E+0", "numbers of 16 characters"),
        (" 1.500000000E+00", " 1.50000000,E+00", "expected numbers"),
        (" 1.500000000E+00", " 1.50000 000E+00", "expected numbers"),
        (" 1.500000000E+00", " 1.500000000E+00 1.500000000E+00", "as many numbers below as it says"),
        ("       3       2\n", "       3       2 3333333333\n", "the header of a string of numbers"),
        ("       3       2\n", "       3       3\n", "rows up to 2"),
        ("       3       2\n", "       3       1\n", "rows that ascend in a column"),
        ("       3       2\n", "       3       0\n", "the header of a string of numbers"),
        ("       2       0       8", "       1       0       8", "a column behind the one before"),
        ("       2       0       8", "       2       x       8", "line 5: found '2       x       8', expected whole"),
        ("       3       1       1\n", "", "in the matrix KAA"),
        ("       3       1       1\n", "       3       1       2\n", "as many numbers below as it says"),
        ("       2      -2       1       2", "       2      -2       1       7", "type (1 to 4)"),
        ("1P,5E16.9", "1P,5E99.9", "expected a format such as 1P,5E16.9"),
    ],
)
def test_damaged_texts_are_refused(comm, folder, old, new, says):
    text = big(TEXT).replace("       5\n", "       4\n")
    assert old in text
    path = write(folder / "a.op4", text.replace(old, new, 1), comm)
    with pytest.raises(InputError) as error:
        matrices(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)


def test_a_packed_file_is_refused(comm, folder):
    import gzip

    path = write(folder / "a.op4.gz", gzip.compress(binary(GOOD, "<", 4, "dense")), comm)
    with pytest.raises(InputError, match="unpack it first"):
        nastran_op4.contents(path, comm)
