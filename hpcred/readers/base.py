"""Define the base class of readers of files of other programs.

A reader is registered by its address (see registry) or by an entry point.
"""

from abc import ABC, abstractmethod

from .entries import Entries, LabelledEntries
from .parts import Parts


class Reader(ABC):
    """Base class of a file format: derive, set `name` and `told_by`, write `begins` and one of the `read_` methods.

    Attributes
    ----------
    name : str
        The format, for messages and the table of formats; by default the name of the entry point.
    told_by : str
        How the first bytes identify a file, for the table of formats.
    companions : str
        Files beside it that are read as well, for the table of formats.
    packed : bool
        Whether matrices can be read from gzip files. By default False.
    named : bool
        Whether files have several matrices by name. Then `read_matrix` takes (path, comm, key, variables) and
        `read_model` (path, comm, variables), where key is the wanted matrix (K, M, D, B, C, Cv or Ca) and `variables`
        has the names that the user gave, by key. By default False.
    vague : bool
        Whether files of other kinds may begin alike; such readers are tried last. By default False.
    open_ended : bool
        Whether files have no end mark. By default False.
    line_ended : bool
        Whether the last number ends with its line. By default False.
    loose : bool
        Whether nodes may have mass but no stiffness. By default False.

    Notes
    -----
    Both `read_` methods are collective. Each rank reads a share of the file and returns it, in any order; or rank 0
    reads a small file, and the others return empty parts. Raise InputError for contents that are not understood.
    Another package registers its class by an entry point of the group "hpcred.readers".
    """

    name = told_by = companions = ""
    packed = named = vague = open_ended = line_ended = loose = False
    package = ""  # that brings it

    def __init__(self) -> None:
        if not self.holds:
            raise TypeError(f"{type(self).__name__} has neither read_matrix nor read_model")

    @property
    def holds(self) -> list[str]:
        """The contents of its files: "model", "matrix", or both."""
        return [kind for kind in ("model", "matrix")
                if getattr(type(self), f"read_{kind}") is not getattr(Reader, f"read_{kind}")]  # fmt: skip

    @abstractmethod
    def begins(self, start: bytes) -> bool:
        """Test whether a file is of the format, by its `start` of 4096 bytes, unpacked; never by its suffix."""

    def read_matrix(self, path, comm, *named) -> Entries | LabelledEntries:
        """Read a single matrix. Collective.

        Parameters
        ----------
        path : Path
        comm : MPI.Comm
        *named
            The wanted matrix and the names of the user, if `named` is True.

        Returns
        -------
        Entries or LabelledEntries
            Entries if the file numbers the rows, LabelledEntries if it labels them by node and direction; with both
            triangles of a symmetric matrix.

        Raises
        ------
        InputError
            For contents that are not understood.
        """
        raise NotImplementedError

    def read_model(self, path, comm, *named) -> Parts:
        """Read a whole model, from the file or the set of files to which it belongs. Collective.

        Parameters
        ----------
        path : Path
        comm : MPI.Comm
        *named
            The names of the user, if `named` is True.

        Returns
        -------
        Parts
            Rows that the program removed (supports, dependent dofs) have no label and no entry.

        Raises
        ------
        InputError
            For contents that are not understood.
        """
        raise NotImplementedError

    def contents(self, path) -> dict[str, str] | None:
        """Return names and sizes of the matrices of the file `path` without reading them, or None if that is not
        possible."""
        return None
