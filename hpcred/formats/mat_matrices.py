"""Models in MATLAB files (.mat of version 4 to 7.3): a file enters, matrices or the parts of a model leave.

Matrices are taken by usual names (K, KAA, KGG, ...), alone or in structs, or by those that the user gives. `nodes` has
rows of number, x, y, z, and `dofs` rows of node, direction (1 to 6), one for each row of K.
"""

from __future__ import annotations

import re

import numpy as np

from ..parallel.failures import InputError, agreed
from ..parallel.lookup import repeated_key
from . import mat_binary, mat_hdf5
from .entries import Entries, label_name, label_of
from .mat_variables import Variable
from .node_table import LARGEST_COORDINATE, Nodes
from .parts import Parts
from .text import LARGEST_LABEL, first_bytes

NAMES = {
    "K": ("k", "kaa", "kff", "kll", "kgg", "knn", "stiffness", "stiff", "stif"),
    "M": ("m", "maa", "mff", "mll", "mgg", "mnn", "mass"),
    "D": ("d", "daa", "baa", "dff", "bff", "dgg", "bgg", "damping", "damp"),
    "B": ("b",),
    "C": ("c",),
}
RESIDUAL = ".k0"  # pyYeti keeps the matrices of the residual structure and of superelements by k0, k101, ...


def begins(start: bytes) -> bool:
    """Whether a file that starts so is of MATLAB."""
    return mat_hdf5.begins(start) or mat_binary.begins_version_5(start) or mat_binary.begins_version_4(start)


def contents(path) -> dict[str, str]:
    """Names and sizes of the matrices of a file, without reading them. Raises InputError."""
    return {variable.name: variable.in_words() for variable in _reader(path).variables(path)}


def read(path, comm, key="K", variables=None) -> Entries:
    """Read the matrix of a key (K, M, D, B, C), by its usual name or that of `variables`. Collective."""
    found = _variables(path, comm)
    with agreed(comm):
        variable = _chosen(path, found, key, (variables or {}).get(key))
    return _entries(path, comm, variable)


def read_parts(path, comm, variables=None) -> Parts:
    """K, M and, where there is one, D; nodes and names of the rows where there are such arrays. Collective."""
    found = _variables(path, comm)
    with agreed(comm):
        unknown = sorted(set(variables or {}) - {"K", "M", "D"})
        if unknown:
            raise InputError(f"--variables: found {unknown[0]} for {path}, expected K, M or D; {_by_options(path)}")
        chosen = {key: _chosen(path, found, key, (variables or {}).get(key)) for key in ("K", "M")}
        damping = _chosen(path, found, "D", (variables or {}).get("D"), needed=False)
        if damping is not None and (damping.shape == chosen["K"].shape or (variables or {}).get("D")):
            chosen["D"] = damping
    parts = Parts(
        {key: _entries(path, comm, variable) for key, variable in chosen.items()},
        {key: f"{path}: {variable.name}" for key, variable in chosen.items()},
    )
    if damping is not None and "D" not in chosen:
        parts.warnings.append(
            f"{path}: '{damping.name}' ({damping.in_words()}) is not of the size of K, and not read as a damping matrix"
        )
    others = [item.name for item in found if item not in chosen.values() and item.shape == chosen["K"].shape]
    if others:
        taken = ", ".join(f"{key} = {item.name}" for key, item in chosen.items())
        parts.warnings.append(
            f"{path}: took {taken}; not read, though of the same size: {', '.join(others[:8])}; choose by --variables"
        )
    if ports := _ports(found, chosen["K"].shape[0]):
        parts.warnings.append(f"{path}: not read as inputs and outputs: {ports}; {_by_options(path)}")
    nodes, dofs = (_named(path, found, name, width) for name, width in (("nodes", 4), ("dofs", 2)))
    if nodes is not None:
        parts.nodes = _nodes(path, comm, nodes)
    if dofs is not None and nodes is not None:
        parts.row_labels = _row_labels(path, comm, dofs, chosen["K"].shape[0])
    return parts


def _ports(found, rows) -> str:
    """B (n, p) and C (r, n), in words; those of the size of K may be anything."""
    fitting = [
        item
        for key, along in (("B", 0), ("C", 1))
        for item in found
        if item.name.lower() in NAMES[key] and len(item.shape) == 2
        and item.shape[along] == rows != item.shape[1 - along]
    ]  # fmt: skip
    return ", ".join(f"{item.name} ({item.in_words()})" for item in fitting)


def _by_options(path):
    return (
        f"for B or C of a file name each matrix: -K {path} -M {path} -B {path} -C {path}, with --nodes and --dofs from "
        "text files; unit loads go by --inputs"
    )


def _reader(path):
    return mat_hdf5 if mat_hdf5.begins(first_bytes(path)) else mat_binary


def _variables(path, comm) -> list[Variable]:
    """All matrices of a file, looked for by one rank. Collective."""
    found = None
    with agreed(comm):
        if comm.rank == 0:
            found = _reader(path).variables(path)
    return comm.bcast(found)


def _entries(path, comm, variable) -> Entries:
    with agreed(comm):
        return Entries(variable.shape, *_reader(path).entries(path, variable, comm.rank, comm.size))


def _chosen(path, found, key, name, needed=True) -> Variable | None:
    """The variable of a key: that of the name, or the only one with a usual name. Raises InputError."""
    listed = ", ".join(f"{item.name} ({item.in_words()})" for item in found[:12]) or "no numeric matrix"
    if name:
        fitting = [item for item in found if item.name == name] or [
            item for item in found if item.name.lower() == name.lower()]  # fmt: skip
        if len(fitting) != 1:
            raise InputError(f"{path}: found no variable '{name}' for {key}; the file has {listed}")
        return _real(path, fitting[0], key)
    matrices = [item for item in found if len(item.shape) == 2 and item.shape != (1, 1)]
    for usual in NAMES[key]:
        for last_only in (True, False):
            fitting = [item for item in matrices if usual in _words(item.name)[-1 if last_only else 0 :]]
            if len(fitting) > 1:
                fitting = [item for item in fitting if item.name.endswith(RESIDUAL)] or fitting
            if len(fitting) > 1:
                names = ", ".join(item.name for item in fitting[:8])
                raise InputError(f"{path}: found several matrices for {key}: {names}; choose by --variables {key}=NAME")
            if fitting:
                return _real(path, fitting[0], key)
    if needed:
        raise InputError(
            f"{path}: found no matrix with a usual name of {key} ({', '.join(NAMES[key][:5])}); the file has {listed}; "
            f"choose by --variables {key}=NAME"
        )
    return None


def _words(name):
    """The parts of a name, without numbers of items, in small letters."""
    return re.sub(r"[({]\d+[)}]", "", name).lower().split(".")


def _real(path, variable, key):
    if variable.complex:
        raise InputError(
            f"{path}: found complex numbers in '{variable.name}' for {key}, expected real ones; save "
            f"real({variable.name}), and give structural damping as a loss factor in the job"
        )
    if len(variable.shape) != 2:
        raise InputError(f"{path}: found '{variable.name}' ({variable.in_words()}) for {key}, expected a matrix")
    return variable


def _named(path, found, name, width):
    """The dense array of a name and width, or None."""
    fitting = [item for item in found if _words(item.name)[-1] == name and not item.sparse and not item.complex
               and len(item.shape) == 2 and item.shape[1] == width]  # fmt: skip
    if len(fitting) > 1:
        names = ", ".join(item.name for item in fitting)
        raise InputError(f"{path}: found several arrays {name}: {names}; expected one")
    return fitting[0] if fitting else None


def _share(path, comm, variable):
    """The first row of this rank, and its rows, of an array."""
    count = variable.shape[0]
    first, last = count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size
    return first, _reader(path).rows_of(path, variable, first, last)


def _nodes(path, comm, variable):
    with agreed(comm):
        first, table = _share(path, comm, variable)
        number = _whole(path, variable, table[:, 0], LARGEST_LABEL)
        if not (np.abs(table[:, 1:]) <= LARGEST_COORDINATE).all():
            raise InputError(f"{path}: found coordinates in '{variable.name}' that are NaN, Inf, or beyond all units")
    twice = repeated_key(comm, number)
    if twice is not None:
        raise InputError(f"{path}: found the node {twice} more than once in '{variable.name}', expected each once")
    return Nodes(number, np.ascontiguousarray(table[:, 1:]), first + np.arange(len(number)))


def _row_labels(path, comm, variable, size):
    if variable.shape[0] != size:
        raise InputError(f"{path}: found {variable.shape[0]} rows of '{variable.name}', expected one for each of the "
                         f"{size} rows of K")  # fmt: skip
    with agreed(comm):
        first, table = _share(path, comm, variable)
        node, direction = _whole(path, variable, table[:, 0], LARGEST_LABEL), _whole(path, variable, table[:, 1], 6)
    label = label_of(node, direction - 1)
    twice = repeated_key(comm, label)
    if twice is not None:
        raise InputError(f"{path}: found two rows of {label_name(twice)} in '{variable.name}', expected one")
    return label, first + np.arange(len(label))


def _whole(path, variable, values, high):
    if not ((values >= 1) & (values <= high) & (values == np.floor(values))).all():
        raise InputError(f"{path}: found numbers in '{variable.name}' that are not whole and from 1 to {high}")
    return values.astype(np.int64)
