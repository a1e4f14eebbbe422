"""Keep expansion points in a folder: the blocks of a Krylov sequence or a set of modes, a file each, for any ranks.

The name of an entry is its kind (krylov, modes, attachment modes, solution, count) and a digest of its key; see
reduction.run.store.Entry.
attributes: format, version
about: JSON of key, facts, model (name), made (a number at random), date, hpcred (version)
blocks/0, blocks/1, ... (n, columns), contiguous, in the free dofs of the frame
arrays/<name>: small arrays
and checksums and a seal, as all files of hpcred (files.checked, files.seal)
"""

from __future__ import annotations

import json
import os
import re
import secrets
from contextlib import suppress
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ..linalg.blocks import create_block, local_rows
from ..parallel.digest import name_of_plain
from ..parallel.failures import ComputationError, InputError, Owned, agreed, reason_of, unfinished
from ..parallel.petsc import MPI
from ..reduction.components.krylov import point_name
from ..reduction.run.store import Entry
from .checked import CheckedFile
from .hdf5 import CheckedWriter, reading
from .opened_hdf5 import opened_hdf5
from .seal import seal

FORMAT, VERSION = "hpcred-point", 3
NAME = re.compile(r"(krylov|chain|modes|attachment modes|solution|count)-[0-9a-f]{32}\.h5(\.tmp-[0-9a-f]{16})?")


class PointStore:
    """A store of expansion points in a folder, which is made if it is not there.

    Runs may use one folder at the same time: entries appear whole or not at all, and are independent of the number of
    ranks.

    Parameters
    ----------
    folder : str or path
        Where the entries are.
    comm : MPI communicator, optional
        By default that of all ranks.

    Raises
    ------
    InputError
        Where the folder cannot be written.

    Notes
    -----
    Collective.
    """

    def __init__(self, folder: str | os.PathLike[str], comm: MPI.Comm = MPI.COMM_WORLD) -> None:
        self.folder = Path(folder)
        with agreed(comm):
            if comm.rank == 0:
                try:
                    self.folder.mkdir(parents=True, exist_ok=True)
                    reason = None if os.access(self.folder, os.W_OK | os.X_OK) else "it cannot be written"
                except OSError as error:
                    reason = error.strerror
                if reason:
                    raise InputError(f"store {self.folder}: no folder that can be written ({reason}); choose another")

    def load(self, model, key, say, most: int | None = None):
        """See Store. An entry that is damaged, of another version or of another key is ignored with a warning.

        Parameters
        ----------
        model : SecondOrderModel
            Of the rows.
        key : dict
            What the numbers depend on.
        most : int, optional
            At most so many blocks.
        say : callable
            Takes a sentence about an entry that is ignored.

        Returns
        -------
        tuple or None
            What is known of the entry, its blocks and its arrays; None where there is none.
        """
        comm = model.comm
        key = comm.bcast(self._known(key) if comm.rank == 0 else None)
        if key is None:
            return None
        # each rank reads its rows; what one cannot read none uses
        path = self.folder / name_of(key)
        about = blocks = arrays = reason = None
        try:
            with reading(path, FORMAT, VERSION) as file:
                about = about_of(file)
                if about["key"] != _plain(key):
                    raise ValueError("it belongs to another key")
                blocks, arrays = _read(file, model, most)
        except Exception as error:  # whatever a damaged file makes HDF5 and what follows it raise
            reason = _text(error, path)
        outcomes = comm.allgather((reason, about and about["made"]))
        reason = next((failure for failure, _ in outcomes if failure is not None), None)
        if reason is None and any(made != outcomes[0][1] for _, made in outcomes):
            reason = "it was replaced while it was read"
        if reason is not None:
            say(f"store: {path.name} is not used ({reason}); what it should have is computed")
            return None
        with suppress(OSError):  # the time of last use, for pruning
            if comm.rank == 0:
                os.utime(path)
        # one block of all columns
        widths = tuple(values.shape[1] for values in blocks)
        block = None
        if sum(widths):
            block = create_block(model.K, sum(widths))
            with local_rows(block) as rows:
                rows[...] = np.concatenate(blocks, axis=1)
        return Entry(about["facts"], widths, block, arrays)

    def _known(self, key):
        """The key of what is there, in which earlier versions call a Krylov sequence a chain; None for nothing."""
        older = key | {"kind": "chain" if key["kind"] == "krylov" else key["kind"]}
        return next((candidate for candidate in (key, older) if (self.folder / name_of(candidate)).is_file()), None)

    def save(self, model, key, entry, say) -> None:
        """See Store. Of a disk that is full `say` gets a sentence, and nothing else happens.

        Parameters
        ----------
        model : SecondOrderModel
            Of the rows.
        key : dict
            What the numbers depend on.
        entry : Entry
            The blocks and arrays.
        say : callable
            Takes a sentence where the disk is full.
        """
        comm, blocks = model.comm, []
        # columns by the call that made them, on the rows of this rank
        if entry.block is not None:
            with local_rows(entry.block) as rows:
                columns = np.split(rows.real, np.cumsum(entry.widths)[:-1], axis=1)
                blocks = [np.ascontiguousarray(block, "<f8") for block in columns]
        # the file gets its name only when it is whole; a number says which save it is of
        path, made = self.folder / name_of(key), comm.bcast(secrets.token_hex(8))
        temporary = path.with_name(f"{path.name}.tmp-{made}")
        about = {"key": _plain(key), "facts": entry.facts, "model": model.name, "made": made,
                 "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
                 "hpcred": version("hpcred")}  # fmt: skip
        unfinished.add(temporary)
        try:
            with Owned(comm) as owned:
                file = owned.owns(CheckedWriter(temporary, comm, path))
                file.attribute("format", FORMAT)
                file.attribute("version", VERSION)
                file.small("about", about)
                for name, value in entry.arrays.items():
                    file.small(f"arrays/{name}", np.asarray(value))
                for j, block in enumerate(blocks):
                    file.rows(f"blocks/{j}", block)
                file.finish()
            with agreed(comm):
                if comm.rank == 0:
                    seal(temporary)
                    with open(temporary, "rb") as file:
                        os.fsync(file.fileno())
                    os.replace(temporary, path)
        # a store is a help: without it the run goes on, on all ranks alike
        except (ComputationError, OSError, RuntimeError, ValueError, TypeError) as error:
            reasons = comm.allgather(_reason_of_cause(error))
            reason = next((failure for failure in reasons if failure is not None), None) or _text(error, path)
            say(f"store: {path.name} could not be written ({reason}); the run goes on without it")
        finally:
            unfinished.discard(temporary)
            if comm.rank == 0:
                with suppress(OSError):
                    temporary.unlink(missing_ok=True)


def name_of(key: dict) -> str:
    """The file of a key."""
    return f"{key['kind']}-{name_of_plain(key, 32)}.h5"


def about_of(file) -> dict:
    """What an open entry says of itself. Raises InputError, or ValueError where it has no checksums."""
    if not file.complete:
        raise ValueError("it has no checksums")
    return file.table("about")


def entries_of(folder) -> list[Path]:
    """The files of a folder that may be entries, by name. On one rank. Raises InputError."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"store {folder}: no such folder")
    paths = (path for path in folder.iterdir() if NAME.fullmatch(path.name))
    return sorted(path for path in paths if path.is_file() and not path.is_symlink())


def describe_entry(path: Path, check: bool = False) -> dict | None:
    """What an entry is: kind, model, point, blocks, columns, bytes, date, time of last use (s), and whether it is
    valid, with the reason where not; `check` reads all of it. None for a file of another format. On one rank."""
    state = path.stat()
    kind = path.name.partition("-")[0].replace("chain", "krylov")
    row = {"entry": path.name, "kind": kind, "model": None, "point": None, "blocks": None, "columns": None,
           "bytes": state.st_size, "date": None, "used": state.st_mtime, "valid": False}  # fmt: skip
    if ".tmp-" in path.name:
        return row | {"reason": "being written, or left by a run that was killed"}
    try:
        with opened_hdf5(path) as file:
            kind = file.attrs.get("format")
            if kind != FORMAT:
                return None
            if file.attrs["version"] != VERSION:
                raise ValueError(f"version {file.attrs['version']}, expected {VERSION}")
            # what it says of itself, and whether its contents fit
            checked = CheckedFile(file, path)
            about = about_of(checked)
            row |= {"model": about["model"], "date": about["date"], "point": _point_of(about["key"])}
            if name_of(about["key"]) != path.name:
                raise ValueError("it belongs to another key")
            blocks = _group(checked, "blocks")
            row |= {"blocks": len(blocks), "columns": sum(block.shape[1] for block in blocks.values())}
            for value in _group(checked, "arrays").values():
                value.verify(0, value.rows)
            if check:
                checked.verify()
    except Exception as error:  # whatever a damaged file makes HDF5 raise
        return row | {"reason": _text(error, path)}
    return row | {"valid": True, "reason": ""}


def _point_of(key) -> str:
    """The expansion point of a key, or its modes, in words."""
    if key["kind"] == "modes":
        return "{:g} to {:g} Hz".format(*key["band"]) if key["band"] else "lowest"
    if key["kind"] == "attachment modes":
        return point_name(0j)
    if "s" in key:
        return point_name(complex(*key["s"]))
    square = complex(*np.atleast_1d(key["square"]))
    return "infinity" if square == np.inf else point_name(np.sqrt(square))


def _group(file, name) -> dict:
    """The datasets of a group by name, in the order of their numbers; none where it is missing."""
    return dict(sorted(file[name].items(), key=lambda member: (len(member[0]), member[0]))) if name in file else {}


def _read(file, model, most):
    """The rows of this rank of the first blocks, and the arrays."""
    first, blocks = model.first_row, []
    for j, dataset in enumerate(list(_group(file, "blocks").values())[:most]):
        if dataset.ndim != 2 or len(dataset) != model.size or dataset.dtype != np.dtype("<f8"):
            raise ValueError(f"block {j} has the shape {dataset.shape}, expected {model.size} rows")
        blocks.append(dataset[first : first + model.local_rows])
    return blocks, {name: value[()] for name, value in _group(file, "arrays").items()}


def _plain(key):
    return json.loads(json.dumps(key))


def _reason_of_cause(error) -> str | None:
    """The words of the system where it refused something that led to an error."""
    while error is not None and reason_of(error) is None:
        error = error.__cause__
    return None if error is None else reason_of(error)


def _text(error, path):
    """An error in the words of whoever raised it, in a line, without the name of the file and advice."""
    text = " ".join(str(reason_of(error) or error).split()) or type(error).__name__
    return text.removeprefix(f"{path}: ").removeprefix("/").partition("; the file is damaged")[0]
