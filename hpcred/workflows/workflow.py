"""Give the public functions of this folder common keywords: communicator and progress."""

from __future__ import annotations

from functools import wraps
from inspect import signature

from ..files.locks import locks_given_back
from ..parallel import startup
from ..parallel.declared import Function, is_blank, spelled
from ..parallel.failures import InputError
from ..parallel.progress import Progress


def workflow(function: Function) -> Function:
    """Make a function take `comm`, by default that of the job, and `progress`, by default one that shows what
    takes long.

    Warnings of what it returns are logged. Keywords that it does not have are refused, and outputs that it does not
    write in the end are given free.
    """
    names = list(signature(function).parameters)
    shows = "progress" in names

    @wraps(function)
    def run(*arguments, **keywords):
        keywords["comm"] = keywords.get("comm") or startup.start_mpi()
        progress = keywords.get("progress") or Progress(keywords["comm"])
        if shows:
            keywords["progress"] = progress
        for key, value in [*zip(names, arguments, strict=False), *keywords.items()]:
            if is_blank(value):
                raise InputError(f"{key}: found an empty text, expected one with letters; leave it out where there is "
                                 "none")  # fmt: skip
        with locks_given_back():
            return progress.found(function(*arguments, **keywords))

    return spelled(run)  # type: ignore[return-value]
