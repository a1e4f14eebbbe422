"""Define what a reader of files of another program is: one class, registered by its address or by an entry point."""

from __future__ import annotations

from abc import ABC, abstractmethod

from .entries import Entries, LabelledEntries
from .parts import Parts


class Reader(ABC):
    """A format of another program: derive, set `name` and `told_by`, write `begins` and one of the `read_` methods.

    Attributes
    ----------
    name : str
        The format in words, for messages and the table of formats; by default the name of the entry point.
    told_by : str
        What of its first bytes tells a file, for the table of formats.
    companions : str
        The files beside it that are read too, for the table of formats.
    packed : bool
        Whether matrices can be read from gzip files. By default False.
    named : bool
        Whether files hold several matrices by name: `read_matrix` then takes (path, comm, key, variables), `read_model`
        (path, comm, variables), where key is the matrix that is wanted (K, M, D, B or C) and `variables` the names that
        the user gave, by key. By default False.
    vague, open_ended, line_ended, loose : bool
        Whether files of other kinds may begin alike; files have no mark of their end; the last number ends where the
        line does; nodes may have mass and no stiffness. All by default False.

    Notes
    -----
    Both `read_` methods are collective. Each rank reads a share of the file and gives what it found, in any order; or
    rank 0 reads a small file, and the others give nothing. Raise InputError for what is not understood. Register the
    class of another package by an entry point of the group "hpcred.readers".
    """

    name = told_by = companions = ""
    packed = named = vague = open_ended = line_ended = loose = False
    package = ""  # that brings it

    def __init__(self) -> None:
        if not self.holds:
            raise TypeError(f"{type(self).__name__} has neither read_matrix nor read_model")

    @property
    def holds(self) -> list[str]:
        """What its files hold: "model", "matrix", or both."""
        return [kind for kind in ("model", "matrix")
                if getattr(type(self), f"read_{kind}") is not getattr(Reader, f"read_{kind}")]  # fmt: skip

    @abstractmethod
    def begins(self, start: bytes) -> bool:
        """Return whether a file that starts so (its first 4096 bytes, unpacked) is of the format. Never by a suffix."""

    def read_matrix(self, path, comm, *named) -> Entries | LabelledEntries:
        """Read a single matrix. Collective.

        Return Entries where the file numbers the rows, LabelledEntries where it names them by node and direction, with
        both triangles of a symmetric matrix.
        """
        raise NotImplementedError

    def read_model(self, path, comm, *named) -> Parts:
        """Read a whole model, from the file or the set of files to which it belongs. Collective.

        Rows that the program removed (supports, dependent dofs) have no label and no entry.
        """
        raise NotImplementedError

    def contents(self, path) -> dict[str, str] | None:
        """Return names and sizes of the matrices of a file, without reading them; None where that is not known."""
        return None
