"""Read single matrices in any of the formats, which the first bytes of a file determine."""

from ..files.text import first_bytes, first_line, refuse_packed, shown
from ..parallel.failures import InputError
from .base import Reader
from .entries import Entries, LabelledEntries
from .registry import read_by, reader_of, readers_of, with_broken
from .unread import refuse_unread


def matrix_reader(path, comm) -> Reader:
    """Return the reader of a matrix. Collective. Raises InputError where there is none."""

    def check(reader):
        if reader is None or reader.vague:
            refuse_unread(path)
        if reader is None:
            start = first_bytes(path)
            if first_line(start)[:1] == b"*":
                raise InputError(
                    f"{path}: found keywords such as '{shown(first_line(start), 40)}' (an input file, or "
                    "matrices of single elements or of a substructure), expected an assembled matrix; let Abaqus "
                    "write it by *Matrix Generate, Stiffness, Mass and *Matrix Output, Stiffness, Mass"
                )
            names = [reader.name for reader in readers_of("matrix")]
            raise InputError(with_broken(
                f"{path}: found a file that begins with {start[:12]!r}, expected {', '.join(names[:-1])}, or "
                f"{names[-1]}"
            ))  # fmt: skip
        if not reader.packed:
            refuse_packed(path, reader.name)

    return reader_of(path, comm, "matrix", check)


def read_entries(path, comm, key="K", variables=None, reader: Reader | None = None) -> Entries | LabelledEntries:
    """Read a matrix: K, M, D, B, C, Cv or Ca by `variables` where a file has several. Collective. Raises InputError."""
    return read_by(reader or matrix_reader(path, comm), "matrix", path, comm, key, variables or {})
