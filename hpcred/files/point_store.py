"""A folder of expansion points: the blocks of a chain or a set of modes enter a file each, and leave on any ranks.

The name of an entry is its kind (chain, modes, attachment modes, solution, count) and a digest of its key; see
reduction.components.krylov_sequence.Entry.
attributes: format, version; checksum: SHA-256 of `about`
about: JSON of key, facts, model (name), date, hpcred (version), and digests of the arrays below (parallel.digest)
blocks/0, blocks/1, ... (n, columns), contiguous, in the free dofs of the frame
arrays/<name>: small arrays
and a seal (files.seal)
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
from contextlib import suppress
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np

from ..linalg.blocks import create_block, local_rows
from ..parallel.digest import digest_of_block, digest_of_slices
from ..parallel.failures import InputError, agreed, reason_of, unfinished
from ..parallel.petsc import MPI
from ..reduction.points import point_name
from ..reduction.store import Entry
from .checked import own_datasets
from .hdf5 import created, opened, place_of, require_whole
from .seal import seal

FORMAT, VERSION = "hpcred-point", 2
NAME = re.compile(r"(chain|modes|attachment modes|solution|count)-[0-9a-f]{32}\.h5(\.tmp-[0-9a-f]{16})?")


class PointStore:
    """A store of expansion points in a folder, which is made if it is not there.

    Runs may use one folder at the same time: entries appear whole or not at all, and are independent of the number of
    ranks. Making one is collective. Raises InputError where the folder cannot be written.
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
        """See Store. An entry that is damaged, of another version or of another key is ignored with a word."""
        path = self.folder / name_of(key)
        if not model.comm.bcast(path.is_file() if model.comm.rank == 0 else None):
            return None
        first = model.first_row
        found = reason = None
        try:
            with opened(path, FORMAT, VERSION) as file:
                dict(own_datasets(file, path))  # all in this file
                about = about_of(file)
                if about["key"] != _plain(key):
                    raise ValueError("it belongs to another key")
                found = about, *_read(file, about, first, model.local_rows, model.size, most)
        except Exception as error:  # whatever a damaged file makes HDF5 and what follows it raise
            reason = _text(error)
        reasons = model.comm.allgather((reason, None if found is None else found[0]["digests"]))
        reason = next((item for item, _ in reasons if item is not None), None)
        if reason is None and any(digests != reasons[0][1] for _, digests in reasons):
            reason = "it was replaced while it was read"
        if reason is None:
            about, blocks, arrays = found
            wrong = [j for j, values in enumerate(blocks)
                     if digest_of_block(model.comm, first, values) != about["digests"][f"blocks/{j}"]]  # fmt: skip
            reason = f"block {wrong[0]} does not have its checksum" if wrong else None
        if reason is not None:
            say(f"store: {path.name} is not used ({reason}); what it should have is computed")
            return None
        with suppress(OSError):  # the time of last use, for pruning
            if model.comm.rank == 0:
                os.utime(path)
        widths = tuple(values.shape[1] for values in blocks)
        block = None
        if sum(widths):
            block = create_block(model.K, sum(widths))
            with local_rows(block) as rows:
                rows[...] = np.concatenate(blocks, axis=1)
        return Entry(about["facts"], widths, block, arrays)

    def save(self, model, key, entry, say) -> None:
        """See Store. A disk that is full makes `say` a word of it, and nothing else."""
        comm, blocks = model.comm, []
        if entry.block is not None:
            with local_rows(entry.block) as rows:
                parts = np.split(rows.real, np.cumsum(entry.widths)[:-1], axis=1)
                blocks = [np.ascontiguousarray(part, "<f8") for part in parts]
        digests = {f"blocks/{j}": digest_of_block(comm, model.first_row, part) for j, part in enumerate(blocks)}
        arrays = {name: np.asarray(value) for name, value in entry.arrays.items()}
        digests |= {f"arrays/{name}": _digest_of_array(value) for name, value in arrays.items()}
        path = self.folder / name_of(key)
        temporary = path.with_name(f"{path.name}.tmp-{comm.bcast(secrets.token_hex(8))}")
        unfinished.add(temporary)
        places = reason = None
        try:
            if comm.rank == 0:
                try:
                    about = {"key": _plain(key), "facts": entry.facts, "model": model.name, "digests": digests,
                             "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
                             "hpcred": version("hpcred")}  # fmt: skip
                    places = _create(temporary, model.size, entry.widths, arrays, json.dumps(about))
                except Exception as error:
                    reason = _text(error)
            places, reason = comm.bcast((places, reason))
            if reason is None:
                try:
                    _write(temporary, places, blocks, model.first_row)
                except OSError as error:
                    reason = _text(error)
                reason = next((item for item in comm.allgather(reason) if item is not None), None)
            if reason is None and comm.rank == 0:
                try:
                    with open(temporary, "rb") as file:
                        os.fsync(file.fileno())
                    os.replace(temporary, path)
                except OSError as error:
                    reason = _text(error)
            reason = comm.bcast(reason)
        finally:
            unfinished.discard(temporary)
            if comm.rank == 0:
                with suppress(OSError):
                    temporary.unlink(missing_ok=True)
        if reason is not None:
            say(f"store: {path.name} could not be written ({reason}); the run goes on without it")


def name_of(key: dict) -> str:
    """The file of a key."""
    return f"{key['kind']}-{hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:32]}.h5"


def about_of(file) -> dict:
    """What an open entry says of itself. Raises ValueError where its checksum is wrong."""
    about = file["about"][()].tobytes()
    if hashlib.sha256(about).hexdigest() != file.attrs["checksum"]:
        raise ValueError("its header does not have its checksum")
    return json.loads(about)


def entries_of(folder) -> list[Path]:
    """The files of a folder that may be entries, by name. On one rank. Raises InputError."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"store {folder}: no such folder")
    found = (path for path in folder.iterdir() if NAME.fullmatch(path.name))
    return sorted(path for path in found if path.is_file() and not path.is_symlink())


def describe_entry(path: Path, check: bool = False) -> dict | None:
    """What an entry is: kind, model, point, blocks, columns, bytes, date, time of last use (s), and whether it is
    valid, with the reason where not; `check` reads all of it. None for a file of another format. On one rank."""
    state = path.stat()
    found = {"entry": path.name, "kind": path.name.partition("-")[0], "model": None, "point": None, "blocks": None,
             "columns": None, "bytes": state.st_size, "date": None, "used": state.st_mtime, "valid": False}  # fmt: skip
    if ".tmp-" in path.name:
        return found | {"reason": "being written, or left by a run that was killed"}
    try:
        require_whole(path)
        with h5py.File(path, "r") as file:
            kind = file.attrs.get("format")
            if kind != FORMAT:
                return None
            if file.attrs["version"] != VERSION:
                raise ValueError(f"version {file.attrs['version']}, expected {VERSION}")
            dict(own_datasets(file, path))
            about = about_of(file)
            found |= {"model": about["model"], "date": about["date"], "point": _point_of(about["key"])}
            if name_of(about["key"]) != path.name:
                raise ValueError("it belongs to another key")
            blocks = [file[name] for name in about["digests"] if name.startswith("blocks/")]
            found |= {"blocks": len(blocks), "columns": sum(block.shape[1] for block in blocks)}
            _check_arrays(file, about)
            for block in blocks:
                if (block.id.get_offset() or 0) + block.id.get_storage_size() > state.st_size:
                    raise ValueError("it is cut short")
                if check and digest_of_slices(len(block), lambda a, b, block=block: block[a:b]) != (
                    about["digests"][block.name[1:]]
                ):
                    raise ValueError(f"{block.name[1:]} does not have its checksum")
    except Exception as error:  # whatever a damaged file makes HDF5 raise
        return found | {"reason": _text(error)}
    return found | {"valid": True, "reason": ""}


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


def _check_arrays(file, about):
    """The small arrays. Raises ValueError where a checksum is wrong."""
    arrays = {}
    for name, wanted in about["digests"].items():
        if name.startswith("arrays/"):
            value = file[name][()]
            if _digest_of_array(np.asarray(value)) != wanted:
                raise ValueError(f"{name} does not have its checksum")
            arrays[name.removeprefix("arrays/")] = value
    return arrays


def _read(file, about, first, rows, size, most):
    """The rows of this rank of the first blocks, and the arrays."""
    names = [name for name in about["digests"] if name.startswith("blocks/")]
    blocks = []
    for j in range(len(names) if most is None else min(most, len(names))):
        dataset = file[f"blocks/{j}"]
        if dataset.ndim != 2 or len(dataset) != size or dataset.dtype != np.dtype("<f8"):
            raise ValueError(f"block {j} has the shape {dataset.shape}, expected {size} rows")
        blocks.append(dataset[first : first + rows])
        if not np.isfinite(blocks[-1]).all():
            raise ValueError(f"block {j} has entries that are not finite")
    return blocks, _check_arrays(file, about)


def _create(path, size, widths, arrays, about):
    """A whole file but for what stands in the blocks; returns where each begins, in bytes. On one rank.

    Its room is taken at once, so that a full disk is noticed here, on one rank and before the others begin.
    """
    with created(path) as file:
        file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
        file.attrs["checksum"] = hashlib.sha256(about.encode()).hexdigest()
        file.create_dataset("about", data=np.frombuffer(about.encode(), np.uint8))
        for name, value in arrays.items():
            file.create_dataset(f"arrays/{name}", data=value)
        places = [place_of(file, f"blocks/{j}", (size, width), "<f8") for j, width in enumerate(widths)]
    with open(path, "r+b") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, os.path.getsize(path))
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):  # file systems that cannot take room ahead
                raise
    seal(path)  # the numbers of the blocks, which come later, are not under it
    return places


def _write(path, places, blocks, first):
    """Put the rows of this rank where they belong: no rank writes where another does, so none has to wait."""
    with open(path, "r+b") as file:
        for place, values in zip(places, blocks, strict=True):
            if values.size:
                file.seek(place + 8 * first * values.shape[1])
                file.write(values.data.cast("B"))


def _digest_of_array(value):
    head = f"{value.dtype.str} {value.shape}"
    return hashlib.sha256(head.encode() + np.ascontiguousarray(value).tobytes()).hexdigest()


def _plain(key):
    return json.loads(json.dumps(key))


def _text(error):
    """An error in the words of whoever raised it, in a line."""
    return " ".join(str(reason_of(error) or error).split()) or type(error).__name__
