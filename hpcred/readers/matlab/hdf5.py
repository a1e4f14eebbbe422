"""Read the variables of MATLAB files of version 7.3, which are HDF5, and columns or rows of one.

A sparse matrix is a group with the attribute MATLAB_sparse (its rows) and the arrays data, ir, jc, of which the first
two are missing if it is empty; a dense one is an array with its columns as rows; a struct is a group; cells and struct
arrays contain references.
"""

from contextlib import contextmanager

import h5py
import numpy as np

from ...files.opened_hdf5 import damaged, guarded, opened_hdf5, require_own
from ...files.system_errors import damaged_file
from ...files.text import shown
from .binary import DEPTH, MOST_ITEMS
from .variables import Variable, entries_of

LISTS = {"jc": "iu", "ir": "iu", "data": "fiuV"}  # of a sparse matrix, with kinds of numpy; V: complex numbers


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is of version 7.3."""
    return start[:15] == b"MATLAB 7.3 MAT-"


@contextmanager
def _opened(path):
    with opened_hdf5(path) as file, guarded(path, "its contents"):
        # MATLAB never writes links to other files
        name = file.id.links.visit(lambda name, info: None if info.type == h5py.h5l.TYPE_HARD else name, info=True)
        if name is not None:
            raise damaged(path, f"/{shown(name)} is a link to something else, which is not followed")
        yield file


def _require_own_numbers(path, node):
    """Raise InputError where the numbers of an array lie in other files, or are not there."""
    if isinstance(node, h5py.Dataset):
        require_own(node, path, node.name)


def variables(path) -> list[Variable]:
    """Return all numeric matrices of a file, those in structs and cells included. Raises InputError."""
    listed, seen = [], set()
    with _opened(path) as file:
        for name in file:
            if not name.startswith("#"):
                _look(path, file, file[name], name, listed, seen, 0)
    return listed


def _look(path, file, node, name, listed, seen, depth):
    if depth > DEPTH or isinstance(node, h5py.Datatype):
        return
    if isinstance(node, h5py.Group) and not _is_new(node, seen):
        return
    _require_own_numbers(path, node)
    if isinstance(node, h5py.Dataset) and "MATLAB_object_decode" in node.attrs:  # numbers that say where an object is
        return
    if isinstance(node, h5py.Group):
        if "MATLAB_sparse" in node.attrs:
            listed.append(_sparse(path, node, name))
            return
        for key in node:
            child = node[key]
            if isinstance(child, h5py.Dataset) and child.dtype == h5py.ref_dtype and "MATLAB_class" not in child.attrs:
                _references(path, file, child, lambda k, key=key: f"{name}({k}).{key}", listed, seen, depth)  # an array
            else:
                _look(path, file, child, f"{name}.{key}", listed, seen, depth + 1)
    elif node.dtype == h5py.ref_dtype:
        _references(path, file, node, lambda k: f"{name}{{{k}}}", listed, seen, depth)
    elif node.attrs.get("MATLAB_empty", 0):
        shape = tuple(int(number) for number in node[...].ravel()[:32])
        if _class_of(node) not in ("char", "cell", "struct"):
            listed.append(Variable(name, shape, place=None))
    elif _class_of(node) not in ("char", "cell", "struct") and (node.dtype.kind in "fiub" or node.dtype.names):
        listed.append(Variable(name, node.shape[::-1], complex=bool(node.dtype.names), place=node.name))


def _is_new(node, seen):
    """Whether a group or list of references is seen the first time: one may be in itself, or in many places."""
    place = h5py.h5o.get_info(node.id).addr
    new = place not in seen
    seen.add(place)
    return new


def _references(path, file, dataset, name_of, listed, seen, depth):
    if not _is_new(dataset, seen):
        return
    for k, reference in enumerate(dataset[...].ravel(order="F")[:MOST_ITEMS]):
        if reference:
            _look(path, file, file[reference], name_of(k + 1), listed, seen, depth + 1)


def _class_of(dataset):
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode() if isinstance(kind, bytes) else str(kind)


def _sparse(path, group, name):
    lists = [group.get(key) for key in LISTS]
    for dataset in lists:
        _require_own_numbers(path, dataset)
    if lists[0] is None or any(
        not isinstance(dataset, h5py.Dataset) or dataset.ndim != 1 or dataset.dtype.kind not in kinds
        for dataset, kinds in zip(lists, LISTS.values(), strict=True) if dataset is not None
    ):  # fmt: skip
        raise damaged_file(path, f"a sparse matrix '{name}' without its lists of numbers")
    rows, columns = int(group.attrs["MATLAB_sparse"]), lists[0].shape[0] - 1
    nonzeros = int(lists[0][-1]) if columns >= 0 else -1
    if rows < 0 or not 0 <= nonzeros <= min(dataset.shape[0] if dataset is not None else 0 for dataset in lists[1:]):
        raise damaged_file(path, f"a sparse matrix '{name}' whose lists do not fit each other")
    is_complex = lists[2] is not None and bool(lists[2].dtype.names)
    return Variable(name, (rows, columns), True, nonzeros, is_complex, group.name)


def entries(path, variable, rank, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows, columns (from 0) and values of the share of one of `size` ranks. Raises InputError."""
    rows = variable.shape[0]
    with _opened(path) as file:

        def numbers(key, low, high):
            dataset = file[variable.place]
            if variable.sparse:
                return dataset[{"starts": "jc", "rows": "ir", "values": "data"}[key]][low:high]
            return dataset[low // rows : high // rows].ravel()

        return entries_of(path, variable, numbers, rank, size)


def table_of(path, variable, first, last, across) -> np.ndarray:
    """Return rows (`across`: columns) first..last of a dense matrix, one in each row. Raises InputError."""
    if variable.place is None:
        return np.zeros((0, variable.shape[not across]))
    with _opened(path) as file:
        dataset = file[variable.place]
        return (dataset[first:last] if across else dataset[:, first:last].T).astype(float)
