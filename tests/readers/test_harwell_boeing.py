"""Harwell-Boeing and Rutherford-Boeing: real files of the collection, and made ones of every kind."""

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse
from foreign import assembled, write
from helpers import columns_of, to_dense
from shared_data import shared

import hpcred
from hpcred import InputError
from hpcred.readers.matrices import harwell_boeing
from hpcred.readers.matrix_formats import read_entries
from hpcred.readers.model_source import load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

RNG = np.random.default_rng(8)
DENSE = np.where(RNG.random((9, 9)) < 0.4, RNG.standard_normal((9, 9)) * 10.0 ** RNG.integers(-9, 9, (9, 9)), 0.0)
DENSE[:, 3] = 0.0  # a column without entries
SYMMETRIC = np.tril(DENSE) + np.tril(DENSE, -1).T
SKEW = np.tril(DENSE, -1) - np.tril(DENSE, -1).T
WIDE = DENSE[:4]


def lines_of(items, per_line):
    return ["".join(items[k : k + per_line]) for k in range(0, len(items), per_line)]


def hb(matrix, kind="RUA", rutherford=False, right=0, per_line=3, number="{:25.16E}", form="(3E25.16)"):
    """The text of a file of a dense matrix, of which a symmetric kind keeps the lower triangle."""
    kept = np.tril(matrix) if kind[1] in "SZ" else matrix
    columns = scipy.sparse.csc_matrix(kept)
    pointers = lines_of([f"{item + 1:6d}" for item in columns.indptr], 13)
    rows = lines_of([f"{item + 1:6d}" for item in columns.indices], 13)
    values = lines_of([number.format(item) for item in columns.data], per_line)
    sides = lines_of([number.format(item) for item in range(right * len(matrix))], per_line)
    cards = [len(part) for part in (pointers, rows, values, sides)]
    cards = cards[: 3 if rutherford else 4]
    head = [
        f"{'a title':<72}KEY     ", "".join(f"{item:14d}" for item in (sum(cards), *cards)),
        f"{kind:<14}{matrix.shape[0]:14d}{matrix.shape[1]:14d}{columns.nnz:14d}{0:14d}",
        f"{'(13I6)':<16}{'(13I6)':<16}{form:<20}" + (f"{form:<20}" if right else ""),
    ]  # fmt: skip
    if right:
        head.append(f"F             {right:14d}{0:14d}")
    return "\n".join([*head, *pointers, *rows, *values, *sides]) + "\n"


@pytest.mark.parametrize("rutherford", [False, True])
@pytest.mark.parametrize(
    "matrix, kind, right", [(DENSE, "RUA", 0), (SYMMETRIC, "RSA", 0), (SYMMETRIC, "rsa", 2), (SKEW, "RZA", 0),
                            (WIDE, "RRA", 1), (WIDE.T.copy(), "RRA", 0)],
)  # fmt: skip
def test_what_is_written_is_read(comm, folder, matrix, kind, right, rutherford):
    text = hb(matrix, kind.upper(), rutherford and not right, right).replace(kind.upper(), kind)
    assert np.array_equal(assembled(write(folder / "a.hb", text, comm), comm), matrix)


@pytest.mark.parametrize("size", [16, 100, 333])
def test_pieces_of_any_size(comm, folder, size, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", size)
    path = write(folder / "a.hb", hb(SYMMETRIC, "RSA", right=1), comm)
    assert np.array_equal(assembled(path, comm), SYMMETRIC)


@pytest.mark.parametrize(
    "number, form, per_line",
    [
        ("{:26.17E}", "(3D26.17)", 3), ("{:25.17E}", "(1P,3E25.17)", 3), ("{:25.17E}", "(1P3D25.17)", 3),
        ("{:25.17E}", "(3(1PE25.17))", 3), ("{:24.16E}", "(3G24.16)", 3), ("{:23.16E}", "(3e23.16)", 3),
        ("{:30.17E}", "(E30.17E3)", 1), ("{:25.15E}", "(d25.15)", 1),
    ],
)  # fmt: skip
def test_formats_of_fortran(comm, folder, number, form, per_line):
    matrix = np.round(SYMMETRIC, 3) if "15" in form else SYMMETRIC
    matrix = np.array([[float(number.format(item)) for item in line] for line in matrix])
    text = hb(matrix, "RSA", number=number, form=form, per_line=per_line)
    if "D" in form.upper():
        head, body = text.split("\n", 4)[:4], text.split("\n", 4)[4]
        text = "\n".join([*head, body.replace("E", "D")])
    assert np.array_equal(assembled(write(folder / "a.hb", text, comm), comm), matrix)


def test_exponents_with_a_blank_or_without_a_letter(comm, folder):
    """Old writers: 1.0E 00 and 1.0-101; numbers that touch each other."""
    text = hb(np.diag([1.0, -2.0, 3.0]), "RSA", number="{:9.2E}", form="(3E9.2)")
    for old, new in ((" 1.00E+00-2.00E+00 3.00E+00", "-1.00E 01-2.00-101 3.00D+02"),):
        assert old in text
        text = text.replace(old, new)
    found = assembled(write(folder / "a.hb", text, comm), comm)
    assert np.array_equal(found, np.diag([-10.0, -2e-101, 300.0]))


def test_rests_of_cards_behind_the_numbers(comm, folder):
    """What stands behind the last number of a list is not read, as by Fortran."""
    lines = hb(np.diag([1.0, 2.0]), "RSA").split("\n")
    lines[5] += "     9     9"
    assert np.array_equal(assembled(write(folder / "a.hb", "\n".join(lines), comm), comm), np.diag([1.0, 2.0]))


REAL = {
    "lund/lund_a.rsa": ((147, 147), 2449), "parser_only/utm300.rua": ((300, 300), 3155),
    "parser_only/well1850.rra": ((1850, 712), 8758), "parser_only/mahindas.rua": ((1258, 1258), 7682),
    "parser_only/illc1033.rra": ((1033, 320), 4732),
}  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_files_of_the_collection(comm, name):
    entries = read_entries(shared(f"fe/harwell_boeing/{name}"), comm)
    assert (entries.shape, comm.allreduce(len(entries.values))) == REAL[name]


def test_lund(comm):
    """Frequencies of a pencil whose other file is Matrix Market; K as another program wrote it."""
    folder = shared("fe/harwell_boeing/lund/lund_a.rsa").parent
    with load_source(Source(str(folder / "lund_a.rsa"), str(folder / "lund_b.mtx")), comm) as model:
        K, M = to_dense(model.K), to_dense(model.M)
    assert np.allclose(K, scipy.io.mmread(folder / "LUNDA.mtx").toarray(), rtol=1e-8)
    found = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[:4]) / (2 * np.pi)
    assert np.allclose(found, [2.296671, 3.813932, 5.953178, 6.734884], rtol=3e-7)


def changed(text, line, old, new):
    lines = text.split("\n")
    assert old in lines[line], lines[line]
    lines[line] = lines[line].replace(old, new, 1)
    return "\n".join(lines)


GOOD = hb(SYMMETRIC, "RSA")


@pytest.mark.parametrize(
    "text, says",
    [
        (hb(SYMMETRIC, "PSA"), "found a pattern without values (PSA)"),
        (hb(SYMMETRIC, "CSA"), "found a complex or external matrix (CSA)"),
        (hb(SYMMETRIC, "RSE"), "found element matrices (RSE)"),
        (hb(WIDE, "RSA"), "found 4 x 9 for RSA, expected a square matrix"),
        (changed(GOOD, 3, "(3E25.16)", "(3X25.16)"), "found the format '(3X25.16)'"),
        (changed(GOOD, 3, "(3E25.16)", "(3I25)"), "found a format of values for other numbers"),
        (changed(GOOD, 4, "     1", "     2"), "pointers that do not ascend from 1"),
        (changed(GOOD, 4, "     1", "     0"), "as a whole number of at least 1"),
        (changed(GOOD, 5, "     1", "    99"), "the row 99 of 9"),
        (changed(GOOD, 5, "     1", "   1.5"), "whole numbers in the fields of such"),
        (changed(GOOD, 5, "     1", "     x"), "fields of 6 characters"),
        (changed(GOOD, 5, "     2", "     1"), "entries on both sides of the diagonal"),
        (changed(hb(DENSE), 5, "     7", "     4"), "two entries of row 4, column 1"),
        (changed(GOOD, 1, "     6", "     7"), "lines of"),
        (changed(GOOD, 1, GOOD.split("\n")[1][:14], f"{999:14d}"), "found 999 lines in all"),
        (GOOD + "1.0\n", "expected the end of the file"),
        (GOOD[:-30], "expected"),
        (GOOD[: GOOD.rindex("\n", 0, -1) + 1], "the file is damaged"),
        (hb(SYMMETRIC, "RSA", number="{:25.16f}", form="(1P,3E25.16)"), "a decimal point and an exponent"),
        (hb(np.diag([1.0, 2.0]), "RSA", number="{:9.0f}", form="(3E9.2)"), "numbers with a decimal point"),
        (hb(np.diag([1.0, np.nan]), "RSA"), "fields of"),
        (changed(GOOD, 7, "E+0", "E+9"), "the value"),
    ],
    ids=range(22),
)
def test_files_that_cannot_be_are_refused(comm, folder, text, says):
    path = write(folder / "a.hb", text, comm)
    with pytest.raises(InputError) as error:
        assembled(path, comm)
    assert says in str(error.value) and "a.hb" in str(error.value)


def test_cut_copies_are_refused(comm, folder):
    """Cut at all places of lines and of numbers, and behind each of the last characters but the end of line."""
    last = range(len(GOOD) - 30, len(GOOD) - 1)
    for cut in [*range(0, len(GOOD) - 30, 7), *last] if comm.size == 1 else range(0, len(GOOD) - 1, 97):
        comm.Barrier()
        path = write(folder / "a.hb", GOOD[:cut], comm)
        with pytest.raises(InputError):
            assembled(path, comm)


def test_right_hand_sides_are_load_vectors(comm, folder):
    """Of a symmetric file with three of them, as HBMAT writes, on any number of ranks; none where there are none."""
    path = write(folder / "a.hb", hb(SYMMETRIC, "RSA", right=3), comm)
    size = len(SYMMETRIC)
    expected = np.arange(3.0 * size).reshape(3, size).T
    found = harwell_boeing.read_right_hand_sides(path, comm)
    mine = np.zeros(found.shape)
    np.add.at(mine, (found.rows, found.columns), found.values)
    assert np.array_equal(comm.allreduce(mine), expected)
    plain = write(folder / "b.hb", hb(SYMMETRIC, "RSA"), comm)
    assert harwell_boeing.read_right_hand_sides(plain, comm) is None
    with hpcred.SecondOrderModel.from_scipy(SYMMETRIC + 10 * np.eye(size), np.eye(size), comm=comm) as model:
        load = hpcred.loads.GivenLoad(name="rhs", file=str(path), column=2)
        with model.with_loads([load]) as loaded:
            assert np.array_equal(columns_of(loaded.B)[:, 0], expected[:, 1])
