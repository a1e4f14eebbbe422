"""Make the fields of a SecondOrderModel from CSR rows, SciPy or NumPy matrices, or PETSc matrices.

All functions return the fields that SecondOrderModel.assembled takes, and raise InputError. All are collective.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypedDict

import numpy as np

from ..fe.dofs import Dofs, check_labels, dofs_per_node
from ..fe.elements import check_elements
from ..fe.materials import ElementProperties, check_properties
from ..linalg.blocks import dense_matrix
from ..linalg.csr import compress
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI, PETSc, free_dropped
from ..parallel.shares import row_range
from ..parallel.sums import anywhere
from .checked_arrays import check_columns, check_rows, coordinates, named_columns, real_columns, real_values, row_name
from .outputs.rates import Rates, check_names, packed_parts
from .petsc_matrices import decoupled, labels_of, taken


class Labels(TypedDict, total=False):
    """What describes the rows, inputs and outputs of a model: see the attributes of SecondOrderModel.

    Each rank gives its part of `dofs`, `elements` and `sets`; SecondOrderModel.from_scipy takes the `dofs` of all rows.
    """

    dofs: Dofs | None
    input_names: Iterable[str]
    output_names: Iterable[str]
    name: str
    elements: dict[str, np.ndarray]
    sets: dict[str, np.ndarray]
    remarks: Iterable[str]
    converted_from: str
    properties: ElementProperties | None
    circulatory: bool


def from_given(M, D, K, B, C, comm, **labels) -> dict:
    """Return the fields from SciPy or NumPy matrices that every rank holds, or from PETSc matrices."""
    if not isinstance(K, PETSc.Mat):
        sparse = {key: mat for key, mat in (("M", M), ("D", D), ("K", K)) if mat is not None and np.ndim(mat)}
        _require_one_size("SecondOrderModel", {key: np.shape(mat)[0] for key, mat in sparse.items()})
        B, Ct = _columns(B, C, np.shape(K)[0] if np.ndim(K) else 0)
        return from_arrays(K, M, D, comm or MPI.COMM_WORLD, B, None if _same(B, Ct) else Ct, **labels)
    if comm is not None:
        raise InputError("comm: found it beside PETSc matrices, which have one; leave it out")
    comm = K.comm.tompi4py()
    with agreed(comm):
        B, Ct = _columns(B, C, K.getLocalSize()[0])
    return from_petsc(K, M, D, inputs=B, outputs=None if all(comm.allgather(_same(B, Ct))) else Ct, **labels)


def from_csr(comm, size, indptr, indices, values, inputs=None, outputs=None, *, name="model", **labels) -> dict:
    """Return the fields from the CSR rows of this rank."""
    free_dropped(comm)
    rows = len(indptr) - 1
    first = comm.exscan(rows) or 0
    with agreed(comm):
        for key in ("K", "M"):
            if key not in values:
                raise InputError(f"{name}: no matrix {key}; a model needs K and M")
        dofs = labels.get("dofs")
        check_labels(dofs, rows, name)
        check_elements(labels.get("elements"), name)
        check_properties(labels.get("properties"), labels.get("elements"), name)
        check_columns(indptr, indices, size, first, name, dofs)
        check_rows(indptr, indices, values, first, name, dofs)
    if comm.size > size:
        fault = f"{size} rows cannot be distributed over {comm.size} ranks"
        raise InputError(f"{name}: {fault}; start at most {size} ranks")
    indptr, indices = (np.asarray(array, dtype=PETSc.IntType) for array in (indptr, indices))
    mats = {key: PETSc.Mat().createAIJ(((rows, size), (rows, size)), csr=(indptr, indices, data), comm=comm)
            for key, data in values.items()}  # fmt: skip
    return _with_columns(mats, inputs, outputs, name, **labels)


def from_arrays(K, M, D, comm, inputs=None, outputs=None, **labels) -> dict:
    """Return the fields from matrices, columns and labels that every rank holds."""
    matrices = {"K": K, "M": M, "D": D}
    matrices = {key: coordinates(f"from_scipy: {key}", mat) for key, mat in matrices.items() if mat is not None}
    sizes = {key: triplets[3] for key, triplets in matrices.items()}
    size = max(sizes.values(), default=0)
    _require_one_size("from_scipy", sizes)
    check_labels(dofs := labels.get("dofs"), size, "from_scipy")
    first, last = row_range(comm, size, dofs_per_node(dofs) if dofs is not None else 1)
    inputs, outputs = (
        None if columns is None else real_columns(columns, size, f"from_scipy: {key}")[first:last]
        for key, columns in (("inputs", inputs), ("outputs", outputs))
    )
    if dofs is not None:
        labels["dofs"] = dofs.take(slice(first, last))
    mine = {}
    for key, (i, j, v, _) in matrices.items():
        # a structurally symmetric pattern, also for an unsymmetric D
        i, j, v = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([v, np.zeros(len(v))])
        local = (i >= first) & (i < last)
        mine[key] = i[local], j[local], v[local]
    return from_csr(comm, size, *compress(mine, first, last, size), inputs, outputs, **labels)


def from_petsc(K, M, D, nodes=None, numbers=None, held=None, inputs=None, outputs=None, *, name="model", dofs=None,
               **labels) -> dict:  # fmt: skip
    """Return the fields from assembled matrices, which are referenced where they fit."""
    mats, free = taken({key: mat for key, mat in (("K", K), ("M", M), ("D", D)) if mat is not None}, held, name)
    comm = mats["K"].comm.tompi4py()
    dofs = labels_of(K, nodes, numbers, dofs, name)
    away = None
    if dofs is not None:
        away, dofs = dofs.take(np.setdiff1d(np.arange(len(dofs.node)), free)), dofs.take(free)
        away = away if comm.allreduce(len(away.node)) else None
    choice_made = anywhere(comm, held is not None)
    first = mats["K"].getOwnershipRange()[0]
    with agreed(comm):
        check_elements(labels.get("elements"), name)
        check_properties(labels.get("properties"), labels.get("elements"), name)
        indptr, indices, _ = mats["K"].getValuesCSR()
        values = {key: real_values(mat.getValuesCSR()[2], f"{name}: {key}") for key, mat in mats.items()}
        check_rows(indptr, indices, values, first, name, dofs)
        alone = [] if choice_made else decoupled(indptr, indices, values.values(), first)
        if len(alone):
            raise InputError(
                f"{name}: found {len(alone)} rows with nothing beside the diagonal, the first is "
                f"{row_name(alone[0], first, dofs)}, as boundary conditions leave them; name such rows by "
                "`held`, or give held=[] to keep them"
            )
    return _with_columns(mats, inputs, outputs, name, dofs=dofs, held=away, **labels)


def _with_columns(mats, inputs, outputs, name, input_names=(), output_names=(), remarks=(), **labels) -> dict:
    """Return the fields from matrices, and the rows of this rank of B and C^T."""
    B, input_names = columns_of(mats["K"], inputs, input_names, f"{name}: inputs")
    Ct, output_names = columns_of(mats["K"], outputs, output_names, f"{name}: outputs")
    return mats | labels | {"B": B, "Ct": Ct, "input_names": input_names, "own_output_names": output_names,
                            "name": name, "remarks": tuple(remarks)}  # fmt: skip


def columns_of(K: PETSc.Mat, local, names, what: str) -> tuple[PETSc.Mat | None, tuple[str, ...]]:
    """Return B or C^T from the rows of this rank, and the names of its columns; None and () for None."""
    local, names = named_columns(K.comm.tompi4py(), K.getLocalSize()[0], local, names, what)
    return None if local is None else dense_matrix(K, local), names


def local_columns(model, key: str, rows_given, is_local: bool) -> np.ndarray | None:
    """Return the rows of this rank of C^T, from C (r, n) of all ranks, or (r, local rows) where it `is_local`."""
    if rows_given is None:
        return None
    rows = model.local_rows if is_local else model.size
    columns = real_columns(_columns(None, rows_given, rows)[1], rows, f"{model.name}: {key}")
    return columns if is_local else columns[model.first_row : model.first_row + model.local_rows]


def measured_columns(K: PETSc.Mat, C, Cv, Ca, names, what: str) -> tuple[PETSc.Mat, Rates]:
    """Return the measured columns, and the outputs of them, from rows of this rank (local rows, r) of C^T, Cv^T and
    Ca^T, each or None."""
    comm, rows = K.comm.tompi4py(), K.getLocalSize()[0]
    with agreed(comm):
        by_key = {key: real_columns(columns, rows, f"{what}: {key}")
                  for key, columns in (("C", C), ("Cv", Cv), ("Ca", Ca)) if columns is not None}  # fmt: skip
        shapes = {key: columns.shape for key, columns in by_key.items()}
        if set(shapes.values()) != {(rows, len(names))}:
            listed = ", ".join(f"{key} of {shape[1]} rows" for key, shape in shapes.items())
            raise InputError(f"{what}: found {listed} and {len(names)} names, expected as many rows as names")
    rows_by_order = np.stack([by_key.get(key, np.zeros((rows, len(names)))).T for key in ("C", "Cv", "Ca")])
    there = np.any(comm.allgather(rows_by_order.any(axis=2)), axis=0)
    check_names(names, there, what)
    columns, rates = packed_parts(rows_by_order, there)
    return dense_matrix(K, columns), rates


def _require_one_size(where, sizes: dict[str, int]):
    """Refuse matrices, by name, with different numbers of rows."""
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{rows} rows of {key}" for key, rows in sizes.items())
        raise InputError(f"{where}: found {listed}, expected the same number")


def _columns(B, C, rows):
    """Return B and C^T with so many rows, as arrays or SciPy matrices, or None. Raises InputError for other shapes."""
    B, C = (array if array is None or hasattr(array, "tocsr") else np.asarray(array) for array in (B, C))
    for key, array, axis, expected in (("B", B, 0, f"({rows}, inputs)"), ("C", C, 1, f"(outputs, {rows})")):
        if array is not None and (array.ndim != 2 or array.shape[axis] != rows):
            turned = f"; give {key}.T" if array.ndim == 2 and array.shape[1 - axis] == rows else ""
            raise InputError(f"SecondOrderModel: {key}: found an array {array.shape}, expected {expected}{turned}")
    return B, None if C is None else C.T


def _same(B, Ct):
    """Test whether the outputs are the inputs, C = B^T, also without C."""
    return Ct is None or (B is not None and B.shape == Ct.shape and not (Ct != B).sum())
