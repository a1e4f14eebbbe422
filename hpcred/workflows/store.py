"""List and prune the entries of a folder of expansion points."""

from __future__ import annotations

import time

from ..files.point_store import describe_entry, entries_of
from ..parallel.failures import InputError, agreed
from .workflow import workflow

UNFINISHED = 3600.0  # seconds after which a file that nobody finished counts as left behind


@workflow
def list_store(folder, *, check: bool = False, comm=None) -> list[dict]:
    """Return the entries of a store. Collective.

    Parameters
    ----------
    folder : str or PathLike
    check : bool
        Verify all checksums.

    Returns
    -------
    list of dict
        Rows of a table.

    Raises
    ------
    InputError
        Where there is no such folder.
    """
    rows = []
    with agreed(comm):
        if comm.rank == 0:
            entries = [describe_entry(path, check) for path in entries_of(folder)]
            rows = [row for row in entries if row is not None]
    return comm.bcast(rows)


@workflow
def prune_store(folder, *, older: float | None = None, below: float | None = None, model: str | None = None,
                broken: bool = False, comm=None) -> list[dict]:  # fmt: skip
    """Remove the entries of a store that fit all that is given. Collective.

    Parameters
    ----------
    folder : str or PathLike
    older : float, optional
        Not used for so many seconds.
    below : float, optional
        Bytes: only so many entries, the longest unused first, that what stays in the folder is not larger.
    model : str, optional
        Of the model of this name.
    broken : bool
        Damaged, by all their checksums, or left by a run that was killed.

    Returns
    -------
    list of dict
        The entries that went.

    Raises
    ------
    InputError
        Where there is no such folder.
    """
    if older is None and below is None and model is None and not broken:
        raise InputError("--prune: say what is to go: --older 30d, --below 10G, --model NAME or --broken")
    gone, now = [], time.time()
    rows = list_store(folder, check=broken, comm=comm)
    with agreed(comm):
        if comm.rank == 0:
            paths = {path.name: path for path in entries_of(folder)}
            total = sum(row["bytes"] for row in rows)
            for row in sorted(rows, key=lambda row: row["used"]):
                age = now - row["used"]
                if ".tmp-" in row["entry"] and age < UNFINISHED:
                    continue  # a run may be writing it
                fits = (older is None or age > older, model is None or row["model"] == model,
                        not broken or not row["valid"])  # fmt: skip
                if not all(fits) or (below is not None and total <= below):
                    continue
                try:
                    paths[row["entry"]].unlink(missing_ok=True)
                except OSError as error:
                    raise InputError(f"store {folder}: {row['entry']} cannot be removed ({error.strerror})") from error
                total -= row["bytes"]
                gone.append(row)
    return comm.bcast(gone)
