"""Refuse early what a run must not write over, by the names and kinds of its files.

A file that the run reads is never written, under whatever name. A file of another kind is not replaced, nor what is
read-only or no file (a pipe, a device). A file of the same kind is, which is said, unless the user keeps what is there.
"""

import os
import re
import stat
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..parallel.failures import InputError, agreed, unfinished
from .locks import begin, is_locked_here, lock, lock_name, temporary_name
from .opened_hdf5 import Damaged, guarded, opened_hdf5
from .room import free_bytes, no_room
from .system_errors import open_input, reading_from
from .text import shown

HDF5 = b"\x89HDF\r\n\x1a\n"
JSON, CSV_OF_RESPONSES, CSV_OF_MOTION = "JSON file", ".csv file of responses", ".csv file of a simulation"
CSV_OF_RECOVERY = ".csv file of recovered motion"
TABLES = (CSV_OF_RESPONSES, CSV_OF_MOTION, CSV_OF_RECOVERY)
PNG, SVG, PDF = "PNG picture", "SVG picture", "PDF file"
ZIP, MATLAB, SID, UFF, VTK = "zip archive", "MATLAB .mat file", "SID file", "universal file", "VTK file"
SUPERELEMENT, MBDYN, OP4 = "superelement", ".fem file for MBDyn", "Nastran OP4 file"
DENSE, MARKET = "Matrix Market file of a dense matrix", "Matrix Market file"  # one of hpcred's, one of a big model
SURFACE = "surface of a body"
OTHER = "file of another kind"
GIF, WEBP, HTML = "GIF picture", "WebP picture", "HTML report"
PICTURES = {".png": PNG, ".svg": SVG, ".pdf": PDF, ".gif": GIF, ".webp": WEBP}
BEGINNINGS = (
    (b"PK\x03\x04", ZIP), (b"MATLAB", MATLAB),
    (b"\x89PNG", PNG), (b"%PDF", PDF), (b"GIF8", GIF), (b"RIFF", WEBP), (b"<!DOCTYPE html>", HTML),
    (b"    -1\n", UFF), (b"%%MatrixMarket matrix array", DENSE), (b"%%MatrixMarket", MARKET),
    (b"# surface of a body", SURFACE),
    (b"** superelement", SUPERELEMENT), (b"! superelement", SUPERELEMENT), (b"$ superelement", SUPERELEMENT),
    (b"! ExtPtfm", SUPERELEMENT),
    (b"$ external superelement", SUPERELEMENT), (b"** hpcred ", MBDYN),
    (b"<VTKFile", VTK), (b"f_hz,", CSV_OF_RESPONSES), (b"t,position_x,", CSV_OF_MOTION), (b"{\n", JSON), (b"[\n", JSON),
    *((b"t,%s_" % word, CSV_OF_RECOVERY) for word in (b"displacement", b"velocity", b"acceleration")),
    (b"[]", JSON), (b"{}", JSON), (b"# hpcred sweep", "job of a sweep"),
    (b"#!/bin/bash\n# hpcred sweep", "script of a sweep"),
)  # fmt: skip
PATTERNS = (
    (re.compile(rb"\s*\d+\s+\d+\s*:[^\n]*\n\s*part\s*\n"), SID),  # two numbers and a comment, then the line "part"
    (re.compile(rb"(?s)\x18\0\0\0.{24}\x18\0\0\0"), OP4),  # the record of six words before a matrix
)
TITLES = re.compile(rb"[A-Za-z][^\n,;]*(,[^-+.\d\s,;][^\n,;]*)+\n")  # the first line of a table, all of it words
EMPTY = "empty file"

_keep = False


@dataclass(frozen=True)
class OtherKind:
    """A kind of files that is not known here: its `name`, and whether a file is of it, by its first bytes."""

    name: str
    begins: Callable[[bytes], bool]


def keep_files(keep: bool):
    """Whether files that exist are refused as outputs, of the same kind too: what the user of a command wants."""
    global _keep
    _keep = keep


def check_kept(path):
    """Raise InputError where the file exists and files are kept. On one rank."""
    if _keep and os.path.exists(path):
        raise InputError(f"output {path}: it exists, and --keep leaves it; choose another name")


def hdf5_kind(name: str) -> str:
    """The kind of an HDF5 file whose attribute `format` is a name."""
    return f"HDF5 file of format '{name}'"


def kind_of(path) -> str:
    """What a file is, by its first bytes, in words; of archives of arrays with the first of their names."""
    with open_input(path) as file:
        start = file.read(4096)
    if not start:
        return EMPTY
    if start.startswith(HDF5):
        try:
            with opened_hdf5(path) as file, guarded(path, "its attributes"):
                return hdf5_kind(str(file.attrs.get("format", "none")))
        except Damaged:
            return "damaged HDF5 file"
    kind = kind_of_start(start)
    return _archive_kind(path, kind) if kind in (ZIP, MATLAB) else kind


def kind_of_start(start: bytes) -> str:
    """What a file is that begins so, in words; of HDF5 files and archives without what is in them."""
    if start.startswith(b"<?xml"):
        return SVG if b"<svg" in start else VTK if b"<VTKFile" in start else "XML file"
    kind = next((kind for begins, kind in BEGINNINGS if start.startswith(begins)), None)
    kind = kind or next((kind for begins, kind in PATTERNS if begins.match(start)), None)
    if kind is None and TITLES.match(start):
        return f".csv table of {shown(start.split(b',')[0])}"
    return kind or OTHER


def _archive_kind(path, kind) -> str:
    """The kind of an archive with some of the names in it: arrays of a body are not matrices of a user."""
    try:
        with reading_from(path):
            if kind == ZIP:
                with zipfile.ZipFile(path) as archive:
                    names = archive.namelist()
            else:
                from scipy.io import whosmat  # of a tenth of a second to load

                names = [name for name, *_ in whosmat(path)]
    except InputError:
        raise
    except Exception:  # whatever a damaged file makes its reader raise
        return f"damaged {kind}"
    return f"{kind} of {', '.join(sorted(names)[:3])}"


_kinds: dict[Path, object] = {}  # of outputs that this process has locked


def check_outputs(outputs: dict, comm, reads=(), *, progress=None, needed: int = 0):
    """Refuse outputs that cannot be written or must not be, or that another run is about to write; those that are not
    refused belong to this run until they are written. `progress` tells which files are replaced. Collective.

    `outputs`: kinds (see kind_of) by path, those of None left out; `reads`: files that the run reads; `needed`: bytes
    of all. Raises InputError, or ComputationError where there is no room.
    """
    outputs = {path: kind for path, kind in outputs.items() if path is not None}
    for path in outputs:
        check_writable(path, comm)
    # what would be lost or mixed up is refused, then the outputs are locked
    replaced, locks = [], [lock_name(Path(os.path.realpath(path))) for path in outputs]
    with agreed(comm):
        if comm.rank == 0:
            for number, (path, kind) in enumerate(outputs.items()):
                for other in [*reads, *list(outputs)[:number]]:
                    if other is not None and _same(path, other):
                        use = "reads" if other in reads else "writes too"
                        raise InputError(f"output {path}: this is {other}, which this run {use}; choose another name")
                if os.path.exists(path):
                    check_kind(path, kind)
                    check_kept(path)
                    if kind not in (ZIP, MATLAB, None):  # of these it is seen at the end
                        replaced.append(path)
            if outputs:
                check_room(next(iter(outputs)), needed)
            # an output that this run writes twice is a mistake
            for path, kind in outputs.items():
                real = Path(os.path.realpath(path))
                before = _kinds.get(real, kind) if is_locked_here(real) else kind
                if before != kind and JSON in (before, kind):  # of --json, which is looked at before the command
                    raise InputError(f"output {path}: this run writes it twice, also as --json; choose another name")
                lock(real, path)
                _kinds[real] = kind
    unfinished.update(locks)  # on all ranks: any of them may be the one that ends the job
    for path in replaced:
        if progress is not None:
            progress.tell_later(f"{path} exists and will be replaced")


def check_writable(path, comm):
    """Raise InputError on all ranks if rank 0 cannot create `path`, or write it where it exists. Collective."""
    with agreed(comm):
        if comm.rank == 0:
            try:
                _check_writable(path)
            except InputError:
                raise
            except (OSError, ValueError) as error:  # a name that is too long, or with a zero byte
                reason = getattr(error, "strerror", None) or str(error)
                raise InputError(f"output {str(path)[:80]!r}: cannot be written ({reason}); choose another") from error


def _check_writable(path):
    real = Path(os.path.realpath(path)) if os.path.islink(path) else Path(path)
    folder = real.parent
    if not folder.is_dir():
        raise InputError(f"output {path}: the folder {folder} does not exist; create it first")
    if real.is_dir():
        raise InputError(f"output {path}: this is a folder, expected a file name")
    if real.exists():
        mode = real.stat().st_mode
        if not stat.S_ISREG(mode):
            raise InputError(f"output {path}: this is a pipe or a device, expected a file name")
        if not mode & 0o222 or not os.access(real, os.W_OK):
            raise InputError(f"output {path}: it is read-only; choose another name")
        if is_of_another_user(real):
            raise InputError(f"output {path}: it belongs to another user, and the folder {folder} lets nobody else "
                             "replace it; choose another name")  # fmt: skip
    try:
        probe = Path(f"{temporary_name(real)}.h5")  # no name is longer
        try:
            begin(probe)
        finally:
            probe.unlink(missing_ok=True)
    except PermissionError as error:
        raise InputError(
            f"output {path}: the folder {folder} cannot be written ({error.strerror}); choose another"
        ) from error


def is_of_another_user(path) -> bool:
    """Whether the system lets only another user remove what has a name: in a folder with the sticky bit, such as /tmp.
    """
    folder = os.stat(os.path.dirname(os.path.abspath(path)))
    return bool(folder.st_mode & stat.S_ISVTX) and os.geteuid() not in (0, folder.st_uid, os.lstat(path).st_uid)


def check_kind(path, kind: str | OtherKind | None):
    """Raise InputError where an existing file is of another kind; an empty one may become anything. On one rank.

    Archives without names, as they are known before they are written, are compared again when they are there; None is
    any kind that hpcred writes.
    """
    there = kind_of(path)
    if isinstance(kind, OtherKind):
        with open_input(path) as file:
            there, kind = kind.name if kind.begins(file.read(4096)) else there, kind.name
    alike = kind is not None and (there == kind or (kind in (ZIP, MATLAB) and there.startswith(kind)))
    if there == OTHER or not (alike or there == EMPTY or kind is None):
        article = "an" if there[0] in "aeiouH" else "a"
        by = "" if kind in (None, OTHER) else f" by {kind}"
        raise InputError(
            f"output {path}: found {article} {there} there, which is not replaced{by}; remove it or choose another name"
        )


def _same(path, other) -> bool:
    """Whether two names are of one file, through links too."""
    if os.path.realpath(path) == os.path.realpath(other):
        return True
    return os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other)


def check_room(path, needed: int):
    """Raise ComputationError where the disk has less than the bytes needed for `path`. On one rank."""
    if free_bytes(Path(os.path.realpath(path)).parent) < needed:
        raise no_room(path, needed)
