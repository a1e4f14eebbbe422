"""Make folders for outputs: new ones go again after an error, and one that is an output appears whole or not at all."""

import ctypes
import os
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ..parallel.failures import InputError, agreed, unfinished
from .locks import HOST, left_by_the_dead, lock, lock_name, locks_given_back, temporary_name
from .outputs import check_kept, is_of_another_user
from .system_errors import reading_from, writing_to
from .together import Waiting, take, together

EXCHANGE = 2  # of renameat2
NO_FOLDER = -100  # AT_FDCWD: names are as usual

_libc = ctypes.CDLL(None, use_errno=True)


@contextmanager
def folder_for(folder, comm, called: str = ""):
    """Make a folder for outputs unless it is there; what was made goes again where the block fails, if it is empty.

    `called`: what stands before its name in messages. Collective. Raises InputError.
    """
    name, folder, made = folder, Path(os.path.abspath(folder)), []
    with agreed(comm):
        if comm.rank == 0:
            missing = [place for place in (folder, *folder.parents) if not place.exists()]
            try:
                for place in reversed(missing):
                    with suppress(FileExistsError):  # of another run, meanwhile
                        place.mkdir()
                        made.insert(0, place)
                if not folder.is_dir():
                    raise NotADirectoryError(0, "it is not a folder")
            except (OSError, ValueError) as error:
                _remove_empty(made)
                reason = getattr(error, "strerror", None) or str(error)
                raise InputError(f"{called}{name}: cannot be created ({reason}); choose another") from error
    try:
        with locks_given_back():  # whose files are in the folder
            yield
    except BaseException:
        _remove_empty(made)
        raise


def _remove_empty(folders):
    with suppress(OSError):  # where one has something in it
        for folder in folders:
            folder.rmdir()


@contextmanager
def atomic_folder(folder, comm, is_own: Callable[[Path], bool], replaces: bool = True):
    """A temporary folder that becomes `folder` when the block ends well; see `together` for files beside it.

    `is_own(path)`: whether hpcred wrote a file in such a folder. `replaces`: whether a folder of such files is
    replaced, else only an empty one. Collective. Raises InputError before the block where there is something else,
    and ComputationError where the system refuses the folder.
    """
    folder = Path(folder)
    temporary, check = temporary_name(folder, *comm.bcast((os.getpid(), HOST))), is_own if replaces else None
    with agreed(comm):
        if comm.rank == 0:
            check_folder(folder, check)
            lock(folder)
    unfinished.update({temporary, lock_name(folder)})
    put_in = _PutIn(folder, temporary, check, is_own)
    with together(comm):
        take(Waiting(folder, temporary, put_in, put_in.undo, put_in.drop))
        with agreed(comm), writing_to(folder):
            if comm.rank == 0:
                for other in (*left_by_the_dead(folder), temporary):
                    remove_folder(other, is_own)
                temporary.mkdir()
        yield temporary


@dataclass
class _PutIn:
    """Puts a folder in the place of an older one, which has the temporary name then. Called on one rank."""

    folder: Path
    temporary: Path
    check: Callable[[Path], bool] | None
    is_own: Callable[[Path], bool]
    older: bool = False
    done: bool = False

    def __call__(self):
        check_folder(self.folder, self.check)
        self.older = os.path.lexists(self.folder)
        if self.older:
            _exchange(self.temporary, self.folder)
        else:
            self.temporary.rename(self.folder)
        self.done = True

    def undo(self):
        if self.older:
            _exchange(self.temporary, self.folder)
        else:
            self.folder.rename(self.temporary)
        self.done = False

    def drop(self):
        """Remove what has the temporary name: the older folder, or all of a new one that is not put in."""
        remove_folder(self.temporary, self.is_own if self.done else lambda path: True)


def check_folder(folder, is_own: Callable[[Path], bool] | None):
    """Raise InputError unless a folder can become an output: it is not there, or empty, or has only files that
    `is_own` takes for those of hpcred. On one rank."""
    folder = Path(folder)
    if not os.path.lexists(folder):
        return
    check_kept(folder)
    if os.path.islink(folder) or not os.path.isdir(folder):
        raise InputError(f"output {folder}: found a file or a link there, expected a folder; choose another name")
    with reading_from(folder), os.scandir(folder) as entries:
        own = is_own or (lambda path: False)
        other = next((file.name for file in entries if not (file.is_file(follow_symlinks=False) and own(Path(file)))),
                     None)  # fmt: skip
    if other is not None:
        raise InputError(
            f"output {folder}: found '{other[:80]}' in this folder, which is not replaced with it; move it, or choose "
            "another name"
        )
    if os.path.ismount(folder) or is_of_another_user(folder):
        raise InputError(f"output {folder}: this folder is not yours to replace; choose another name")


def remove_folder(folder: Path, is_own: Callable[[Path], bool]):
    """Remove the files of hpcred in a folder that has a temporary name, and the folder if nothing else is in it."""
    with suppress(OSError):
        with os.scandir(folder) as entries:
            paths = [Path(entry) for entry in entries if entry.is_file(follow_symlinks=False)]
        for path in paths:
            if is_own(path):
                path.unlink()
        folder.rmdir()


def _exchange(one: Path, other: Path):
    """Exchange two names, at once where the file system can. Raises OSError."""
    names = os.fsencode(one), os.fsencode(other)
    if hasattr(_libc, "renameat2") and not _libc.renameat2(NO_FOLDER, names[0], NO_FOLDER, names[1], EXCHANGE):
        return
    aside = one.with_name(f"{one.name}.old")
    other.rename(aside)
    try:
        one.rename(other)
    except OSError:
        aside.rename(other)
        raise
    aside.rename(one)
