"""Read matrices or models from MATLAB files (.mat of version 4 to 7.3).

Matrices have usual names (K, KAA, KGG, ...), alone or in structs, or names that the user gives. `nodes` has rows (or
columns) of number, x, y, z, or of x, y, z of the nodes 1, 2, 3, ...; `dofs` has rows (or columns) of node, direction
(1 to 6), one for each row of K.
"""

import re

import numpy as np

from ...files.text import LARGEST_LABEL, first_bytes
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import require_once
from ...parallel.shares import row_range
from ..base import Reader
from ..entries import Entries, label_name, label_of
from ..nodes.table import LARGEST_COORDINATE, NodeTable
from ..parts import Parts
from . import binary as mat_binary
from . import hdf5 as mat_hdf5
from .variables import Variable

NAMES = {
    "K": ("k", "kaa", "kff", "kll", "kgg", "knn", "stiffness", "stiff", "stif"),
    "M": ("m", "maa", "mff", "mll", "mgg", "mnn", "mass"),
    "D": ("d", "daa", "baa", "dff", "bff", "dgg", "bgg", "damping", "damp"),
    "B": ("b",),
    "C": ("c",),
    "Cv": ("cv",),
    "Ca": ("ca",),
}
RESIDUAL = ".k0"  # pyYeti keeps the matrices of the residual structure and of superelements by k0, k101, ...
# numbers of a node or row, negative where they stand in a column, and what the array then is
FORMS = {
    "numbered": (4, "rows of number, x, y, z"), "places": (3, "rows of x, y, z of the nodes 1, 2, 3, ..."),
    "numbered across": (-4, "columns of number, x, y, z"),
    "places across": (-3, "columns of x, y, z of the nodes 1, 2, 3, ..."),
    "rows": (2, "rows of node, direction"), "rows across": (-2, "columns of node, direction"),
}  # fmt: skip
USES = {"nodes": ("numbered", "places", "numbered across", "places across"), "dofs": ("rows", "rows across")}


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is of MATLAB."""
    return mat_hdf5.begins(start) or mat_binary.begins_version_5(start) or mat_binary.begins_version_4(start)


def contents(path) -> dict[str, str]:
    """Return names and sizes of the matrices of a file, without reading them. Raises InputError."""
    return {variable.name: variable.in_words() for variable in _reader(path).variables(path)}


def read(path, comm, key="K", variables=None) -> Entries:
    """Read the matrix of a key (K, M, D, B, C, Cv, Ca), by its usual name or that of `variables`. Collective."""
    listed = _variables(path, comm)
    with agreed(comm):
        variable, _ = _chosen(path, listed, key, (variables or {}).get(key), residual=False)
    return _entries(path, comm, variable)


def read_parts(path, comm, variables=None) -> Parts:
    """Return K, M and, where there is one, D; nodes and names of the rows where there are such arrays. Collective."""
    # which variable is which matrix, by option or by name
    listed = _variables(path, comm)
    with agreed(comm):
        unknown = sorted(set(variables or {}) - {"K", "M", "D"})
        if unknown:
            raise InputError(f"--variables: found {unknown[0]} for {path}, expected K, M or D; {_by_options(path)}")
        chosen, passed = {}, []
        for key in ("K", "M"):
            chosen[key], left = _chosen(path, listed, key, (variables or {}).get(key))
            passed += left
        damping, left = _chosen(path, listed, "D", (variables or {}).get("D"), needed=False)
        passed += left
        if damping is not None and (damping.shape == chosen["K"].shape or (variables or {}).get("D")):
            chosen["D"] = damping
    # what was not taken is said, since names are a guess
    parts = Parts(
        {key: _entries(path, comm, variable) for key, variable in chosen.items()},
        {key: f"{path}: {variable.name}" for key, variable in chosen.items()},
    )
    if damping is not None and "D" not in chosen:
        parts.warnings.append(
            f"{path}: '{damping.name}' ({damping.in_words()}) is not of the size of K, and not read as a damping matrix"
        )
    others = [matrix.name for matrix in listed if matrix not in chosen.values()
              and (matrix.shape == chosen["K"].shape or matrix in passed)]  # fmt: skip
    if others:
        taken = ", ".join(f"{key} = {matrix.name}" for key, matrix in chosen.items())
        names = ", ".join(others[:8]) + (f" and {len(others) - 8} more" if len(others) > 8 else "")
        parts.warnings.append(
            f"{path}: took {taken}; not read, though of the same size or of such a name: {names}; choose by --variables"
        )
    if unread := _inputs_and_outputs(listed, chosen["K"].shape[0]):
        parts.warnings.append(f"{path}: not read as inputs and outputs: {unread}; {_by_options(path)}")
    with agreed(comm):
        # nodes and rows, where there are arrays of such names
        tables = {name: _table(path, listed, name, parts.warnings) for name in USES}
    if tables["nodes"]:
        parts.nodes = _nodes(path, comm, *tables["nodes"], parts.warnings)
        if tables["dofs"]:
            parts.row_labels = _row_labels(path, comm, *tables["dofs"], chosen["K"].shape[0])
    elif tables["dofs"]:
        parts.warnings.append(f"{path}: '{tables['dofs'][0].name}' is not read, since there is no array nodes")
    return parts


def _inputs_and_outputs(variables, rows) -> str:
    """Return B (n, p) and C, Cv, Ca (r, n), in words; those of the size of K may be anything."""
    fitting = [
        array
        for key, along in (("B", 0), ("C", 1), ("Cv", 1), ("Ca", 1))
        for array in variables
        if array.name.lower() in NAMES[key] and len(array.shape) == 2
        and array.shape[along] == rows != array.shape[1 - along]
    ]  # fmt: skip
    return ", ".join(f"{array.name} ({array.in_words()})" for array in fitting)


def _by_options(path):
    return (
        f"for B or C of a file name each matrix: -K {path} -M {path} -B {path} -C {path}, with --nodes and --dofs from "
        "text files; unit loads go by --inputs"
    )


def _reader(path):
    return mat_hdf5 if mat_hdf5.begins(first_bytes(path)) else mat_binary


def _variables(path, comm) -> list[Variable]:
    """Return all matrices of a file, looked for by one rank. Collective."""
    return decided(comm, lambda: _reader(path).variables(path))


def _entries(path, comm, variable) -> Entries:
    with agreed(comm):
        return Entries(variable.shape, *_reader(path).entries(path, variable, comm.rank, comm.size))


def _chosen(path, variables, key, name, needed=True, residual=True) -> tuple[Variable | None, list[Variable]]:
    """Return the variable of a key, and others passed over; `residual`: whether k0 may stand for several."""
    listed = ", ".join(f"{array.name} ({array.in_words()})" for array in variables[:12]) or "no numeric matrix"
    if name:
        fitting = [array for array in variables if array.name == name] or [
            array for array in variables if array.name.lower() == name.lower()]  # fmt: skip
        if len(fitting) != 1:
            raise InputError(f"{path}: found no variable '{name}' for {key}; the file has {listed}")
        return _real(path, fitting[0], key), []
    matrices = [array for array in variables if len(array.shape) == 2 and array.shape != (1, 1)]
    usual = [array for array in matrices if set(_words(array.name)) & set(NAMES[key])]
    for fitting in _by_preference(usual, NAMES[key]):
        best = fitting
        if len(fitting) > 1:
            best = [array for array in fitting if residual and array.name.endswith(RESIDUAL)]
        if len(best) != 1:
            names = ", ".join(array.name for array in fitting[:8])
            raise InputError(f"{path}: found several matrices for {key}: {names}; choose by --variables {key}=NAME")
        others = fitting + [array for array in usual if _words(array.name)[-1] in NAMES[key] and array not in fitting]
        return _real(path, best[0], key), [array for array in others if array is not best[0]]
    if needed:
        raise InputError(
            f"{path}: found no matrix with a usual name of {key} ({', '.join(NAMES[key][:5])}); the file has {listed}; "
            f"choose by --variables {key}=NAME"
        )
    return None, []


def _by_preference(usual, names):
    """Yield matrices with a usual name: in few structs first, then by name, and last those in such structs."""
    for last_only in (True, False):
        words = [(array, _words(array.name)) for array in usual]
        for depth in sorted({len(levels) for _, levels in words}):
            for name in names:
                fitting = [array for array, levels in words
                           if len(levels) == depth and name in levels[-1 if last_only else 0 :]]  # fmt: skip
                if fitting:
                    yield fitting


def _words(name):
    """Return the parts of a name, without numbers of items, in small letters."""
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


def _table(path, variables, name, warnings) -> tuple[Variable, str] | None:
    """Return the dense array of a name and its key of FORMS, or None with a warning of other shapes."""
    named = [array for array in variables if _words(array.name)[-1] == name]
    fitting = [array for array in named if _forms(name, array)]
    depth = min((len(_words(array.name)) for array in fitting), default=0)
    fitting = [array for array in fitting if len(_words(array.name)) == depth]
    if len(fitting) > 1:
        raise InputError(f"{path}: found several arrays {name}: {', '.join(array.name for array in fitting)}; expected "
                         "one")  # fmt: skip
    expected = " or ".join(FORMS[form][1] for form in USES[name])
    for array in named:
        if array not in fitting:
            warnings.append(f"{path}: '{array.name}' ({array.in_words()}) is not read as {name}, expected {expected}")
    if not fitting:
        return None
    form, *other = _forms(name, fitting[0])
    if other:
        raise InputError(
            f"{path}: found '{fitting[0].name}' ({fitting[0].in_words()}), which may have {FORMS[form][1]} or "
            f"{FORMS[other[0]][1]}; save it with {FORMS[USES[name][0]][1]}"
        )
    return fitting[0], form


def _forms(name, array) -> list[str]:
    """Return the keys of FORMS that the shape of an array allows; the documented one goes first, and alone."""
    if array.sparse or array.complex or len(array.shape) != 2:
        return []
    rows, columns = array.shape
    fitting = [form for form in USES[name] if FORMS[form][0] in (columns, -rows)]
    return fitting[:1] if USES[name][0] in fitting else fitting


def _share(path, comm, variable, form):
    """Return the first node or row of this rank, and its numbers (share, width), of an array."""
    across = FORMS[form][0] < 0
    first, last = row_range(comm, variable.shape[across])
    return first, _reader(path).table_of(path, variable, first, last, across)


def _nodes(path, comm, variable, form, warnings):
    with agreed(comm):
        first, table = _share(path, comm, variable, form)
        if abs(FORMS[form][0]) == 4:
            number, place = _whole(path, variable, table[:, 0], LARGEST_LABEL), table[:, 1:]
        else:
            number, place = first + 1 + np.arange(len(table)), table
        if not (np.abs(place) <= LARGEST_COORDINATE).all():
            raise InputError(f"{path}: found coordinates in '{variable.name}' that are NaN, Inf, or beyond all units")
    if form != USES["nodes"][0]:
        warnings.append(f"{path}: '{variable.name}' ({variable.in_words()}) is read as {FORMS[form][1]}")
    require_once(comm, number, lambda twice: f"{path}: found the node {twice} more than once in '{variable.name}', "
                                             "expected each once")  # fmt: skip
    return NodeTable(number, np.ascontiguousarray(place), first + np.arange(len(number)))


def _row_labels(path, comm, variable, form, size):
    across = FORMS[form][0] < 0
    if variable.shape[across] != size:
        raise InputError(f"{path}: found {variable.shape[across]} {'columns' if across else 'rows'} of "
                         f"'{variable.name}', expected one for each of the {size} rows of K")  # fmt: skip
    with agreed(comm):
        first, table = _share(path, comm, variable, form)
        node, direction = _whole(path, variable, table[:, 0], LARGEST_LABEL), _whole(path, variable, table[:, 1], 6)
    label = label_of(node, direction - 1)
    require_once(comm, label, lambda twice: f"{path}: found two rows of {label_name(twice)} in '{variable.name}', "
                                            "expected one")  # fmt: skip
    return label, first + np.arange(len(label))


def _whole(path, variable, values, high):
    if not ((values >= 1) & (values <= high) & (values == np.floor(values))).all():
        raise InputError(f"{path}: found numbers in '{variable.name}' that are not whole and from 1 to {high}")
    return values.astype(np.int64)


class MatFile(Reader):
    """Files of MATLAB and Octave."""

    name, told_by, named = "MATLAB .mat (version 4 to 7.3)", "its header, or HDF5 with one", True
    companions = "none: K, M, D, nodes, dofs in one file"
    begins, contents = staticmethod(begins), staticmethod(contents)
    read_matrix, read_model = staticmethod(read), staticmethod(read_parts)
