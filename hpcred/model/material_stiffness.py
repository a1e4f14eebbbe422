"""Assemble the part of K that elements of one material have, from the matrices of solids."""

from __future__ import annotations

import numpy as np

from ..fe.materials import MATERIAL
from ..fe.solids import NO_NODES, NO_TABLE, Solids
from ..fe.strain_matrices import stiffness_matrices
from ..linalg.csr import sum_of_entries
from ..parallel.failures import InputError
from ..parallel.lookup import look_up, number_over_ranks
from ..parallel.petsc import PETSc
from .operator import ADDED
from .second_order_model import SecondOrderModel

SAME_ROW, MOST = 1e-5, 0.9  # relative difference of rows of K, and the part of them that has to be as small


def material_stiffness(model: SecondOrderModel, material: str) -> PETSc.Mat:
    """Return the stiffness of the solid elements of a material, which is a part of K. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        With elements, their types and materials.
    material : str
        Name of the material.

    Returns
    -------
    PETSc.Mat, shape (n, n)

    Raises
    ------
    InputError
        For materials that do not exist, elements whose matrices are not known, and where K has other numbers in the
        rows of nodes that only these elements have.
    """
    where = f"{ADDED}: material '{material}'"
    known = () if model.properties is None else tuple(material.name for material in model.properties.materials)
    if material not in known:
        raise InputError(f"{where}: {model.name} has no such material; it has {', '.join(known) or 'none'}")
    # the stiffness of the elements of this material, on free rows
    solids = Solids(model)
    groups = [group for group in solids.groups if group.material.name == material]
    rows, columns, values = [NO_NODES], [NO_NODES], [np.zeros(0)]
    for group in groups:
        for nodes in group.pieces():
            matrices = stiffness_matrices(group.kind, group.rule, solids.position[nodes], group.elastic)
            places = solids.rows[nodes].reshape(len(nodes), -1)
            i, j = (np.broadcast_to(numbers, matrices.shape) for numbers in (places[:, :, None], places[:, None]))
            there = (i >= 0) & (j >= 0)
            rows.append(i[there])
            columns.append(j[there])
            values.append(matrices[there])
    rows, columns, values = (np.concatenate(arrays) for arrays in (rows, columns, values))
    if not model.comm.allreduce(len(values)):
        raise InputError(f"{where}: no solid element of {model.name} has it")
    mat = sum_of_entries(model.K, rows, columns, values)
    # the program may have another formulation of these elements than ours, which its own rows show
    _check_rows(model, material, mat, where)
    return mat


def _check_rows(model, material, mat, where):
    """Refuse matrices of elements that are not those of K, in the rows of nodes that no other element has. Collective.
    """
    solid, others = [NO_NODES], [NO_NODES]
    number = [material.name for material in model.properties.materials].index(material)
    for kind, nodes in model.elements.items():
        table = model.properties.table.get(kind, NO_TABLE)
        chosen = table[:, MATERIAL] == number if len(table) == len(nodes) else np.zeros(len(nodes), bool)
        solid.append(np.asarray(nodes)[chosen].ravel())
        others.append(np.asarray(nodes)[~chosen].ravel())
    solid, others = (number_over_ranks(model.comm, np.concatenate(ids).astype(np.int64))[0] for ids in (solid, others))
    inner = look_up(model.comm, solid, [], model.dofs.node)[0] & ~look_up(model.comm, others, [], model.dofs.node)[0]
    rest = model.K.copy()
    rest.axpy(-1.0, mat, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    left, whole = (_row_norms(matrix) for matrix in (rest, model.K))
    same = inner & (left <= SAME_ROW * whole)
    same = model.comm.allreduce(np.array([np.count_nonzero(inner), np.count_nonzero(same)]))
    if same[1] < MOST * same[0]:
        raise InputError(
            f"{where}: K of {model.name} has other numbers in {same[0] - same[1]} of the {same[0]} rows that only its "
            "elements have; they are of another formulation, meet nodes without rows, or nodes are turned: give K_v as "
            "a file"
        )


def _row_norms(mat):
    indptr, _, values = mat.getValuesCSR()
    row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    return np.sqrt(np.bincount(row, weights=np.abs(values) ** 2, minlength=len(indptr) - 1))
