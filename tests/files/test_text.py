"""Lines of text files, read once and to their last character."""

import gzip

import numpy as np
import pytest
from foreign import gathered, write

from hpcred import InputError
from hpcred.files import text_numbers
from hpcred.files.text import Piece, first_bytes, line_number, pieces, read_lines
from hpcred.files.text_numbers import numbers, triples

pytestmark = pytest.mark.mpi(build="real")


def test_every_line_is_read_once_wherever_the_pieces_are_cut(folder, comm, monkeypatch):
    lines = [f"{k} {'x' * (k % 7)}\n".encode() for k in range(200)]
    if comm.rank == 0:
        (folder / "lines.txt").write_bytes(b"".join(lines))
        with gzip.open(folder / "lines.txt.gz", "wb") as file:
            file.write(b"".join(lines))
    comm.Barrier()
    for size in (1, 7, 64, 10**6):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        plain = sum(comm.allgather([line for piece in pieces(folder / "lines.txt", comm)
                                    for line in piece.text.splitlines(True)]), [])  # fmt: skip
        assert plain == lines
        packed = sum(comm.allgather([line for piece in pieces(folder / "lines.txt.gz", comm)
                                     for line in piece.text.splitlines(True)]), [])  # fmt: skip
        assert sorted(packed) == sorted(lines)


@pytest.mark.parametrize("mark", ["$", "**", "!", "#", "  %"])
@pytest.mark.costly
def test_a_format_is_told_below_all_comments(folder, comm, mark):
    for count in (0, 1, 99, 3000):
        content = f"{mark} {'x' * 70}\n\n" * count + "first\nsecond\n" + "y" * 9000
        start = first_bytes(write(folder / "a.txt", content, comm))
        assert len(start) >= 4096 and content.startswith(start.decode()) and b"first\nsecond\nyyy" in start
        comm.Barrier()
    endless = write(folder / "a.txt", f"{mark}\n" * 10**6, comm)
    assert len(first_bytes(endless)) < 3e6


def piece_of(path, content, comm):
    return Piece(write(path, content, comm), content.encode("latin-1"), 0)


def all_ways(monkeypatch):
    """By fast_matrix_market, by that of SciPy, and without, as far as they are there."""
    yield
    monkeypatch.setattr(text_numbers, "fast_matrix_market", None)
    yield
    monkeypatch.setattr(text_numbers, "SCIPY_HAS_IT", False)
    yield


@pytest.mark.parametrize(
    "value, number",
    [("1.5", 1.5), ("-2", -2.0), ("1.5D+02", 150.0), ("1.5d2", 150.0), ("+7.e-3", 7e-3), (".5", 0.5), ("1E5", 1e5)],
)
def test_numbers_of_every_writer(comm, folder, monkeypatch, value, number):
    piece = piece_of(folder / "a.txt", f"1 1 2.5\n3 4 {value}\n", comm)
    for _ in all_ways(monkeypatch):
        i, j, v, _ = triples(piece)
        assert i.tolist() == [0, 2] and j.tolist() == [0, 3] and v.tolist() == [2.5, number]


@pytest.mark.parametrize(
    "line",
    ["2 2 1.5+02", "2 2 1.5-02", "2 2 1e", "2 2 1e+", "2 2 1_000", "2 2 0x10", "2 2 1,5", "2 2 1.2.3", "2 2 1e2.5",
     "2 2 1e2e3", "2 2", "22 1.0", "2 2 1.0 7", "2 2 1.0 x", "2 2 1.0f", "2 2.5 1", "2.5 2 1", "2 2e0 x", "0 2 1.0",
     "2 -2 1.0", "2 2 .", "2 2 --1", "2 2 1 2 2 1", "2 2 1.5.7e-98", "2 2 1e5.7e-98", "2 2 1.5nan", "2 2 1.5.nan"],
)  # fmt: skip
def test_values_are_parsed_to_the_last_character(comm, folder, monkeypatch, line):
    piece = piece_of(folder / "a.txt", f"1 1 2.5\n{line}\n3 3 1.0\n", comm)
    for _ in all_ways(monkeypatch):
        with pytest.raises(InputError, match=r"a.txt, line 2: found '2") if line[0] == "2" else pytest.raises(
            InputError, match="a.txt, line 2: found '0 2 1.0', expected the row number as a whole number of at least 1"
        ):
            triples(piece)


@pytest.mark.skipif(
    not (text_numbers.fast_matrix_market or text_numbers.SCIPY_HAS_IT), reason="needs SciPy 1.12 or fast_matrix_market"
)
def test_the_fast_parser_is_used_for_plain_text(comm, folder, monkeypatch):
    """What it reads of a plain text is what the slow one reads."""
    rng = np.random.default_rng(1)
    rows = rng.integers(1, 10**9, 500)
    values = rng.standard_normal(500) * 10.0 ** rng.integers(-300, 300, 500)
    content = "".join(f" {i}\t{i}  {v!r}\r\n" for i, v in zip(rows.tolist(), values.tolist(), strict=True))
    piece = piece_of(folder / "a.txt", content, comm)
    for _ in all_ways(monkeypatch):
        found = triples(piece)
        assert (found[3] is None) == bool(text_numbers.fast_matrix_market or text_numbers.SCIPY_HAS_IT)
        assert np.array_equal(found[0] + 1, rows) and np.array_equal(found[2], values)


@pytest.mark.parametrize("line", ["1 2", "1 2 3 4", "1 2 x", "1 2 3 # remark", "1 2 nan(7)x", "1 2\n3"])
def test_ragged_lines_are_refused(comm, folder, line):
    """Six numbers in lines of two and four are no table of three columns."""
    piece = piece_of(folder / "a.txt", f"# remark\n\n1, 2, 3\n{line}\n", comm)
    with pytest.raises(InputError, match=r"a.txt, line 4: found '1 2.*', expected 3 numbers a line"):
        numbers(piece, 3)


def test_crlf_latin1_blank_lines_and_byte_order_mark(comm, folder):
    content = b"\xef\xbb\xbf% Stra\xdfe\r\n1, 2.5\r\n\r\n ** Knoten \xfc\r\n2\t3.5\r\n   \r\n"
    path = write(folder / "a.txt", content, comm)
    with_lines = [numbers(piece, 2) for piece in pieces(path, comm)]
    (table,) = gathered(comm, np.concatenate([np.zeros((0, 2)), *(item[0] for item in with_lines)]))
    assert table.tolist() == [[1, 2.5], [2, 3.5]]
    assert numbers(Piece(path, b"  \r\n", 0), 2)[0].shape == (0, 2)


def test_the_line_named_is_that_of_the_file(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 16)
    content = "".join(f"{k} {k}\n" for k in range(100)) + "7 x\n" + "1 1\n" * 10
    path = write(folder / "a.txt", content, comm)
    found = []
    for piece in pieces(path, comm):
        try:
            numbers(piece, 2)
        except InputError as error:
            found.append(str(error))
    assert sum(comm.allgather(found), []) == [f"{path}, line 101: found '7 x', expected 2 numbers a line"]
    assert line_number(path, 0) == 1


def test_the_order_of_lines_of_a_packed_file(comm, folder, monkeypatch):
    """Pieces of a gzip file go round the ranks, yet every line knows its place."""
    monkeypatch.setattr("hpcred.files.text.PIECE", 50)
    path = write(folder / "a.gz", gzip.compress(b"".join(b"%d\n" % k for k in range(300))), comm)
    values, places = read_lines(path, comm, lambda piece: (numbers(piece, 1)[0][:, 0],))
    assert np.array_equal(values, places)


def test_a_damaged_gzip_file_is_refused(comm, folder):
    packed = gzip.compress(b"1 1 1.0\n" * 5000)
    path = write(folder / "a.gz", packed[:-20], comm)
    with pytest.raises(InputError, match="found a damaged gzip file"):
        list(pieces(path, comm))


def test_a_line_without_end_in_a_small_file_is_refused(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 1000)
    monkeypatch.setattr("hpcred.files.text.LONGEST_LINE", 10**5)
    path = write(folder / "a.gz", gzip.compress(b"1 1 1.0\n" + bytes(10**6)), comm)
    with pytest.raises(InputError, match="found a line of more than 0 MB in a gzip file"):
        list(pieces(path, comm))
