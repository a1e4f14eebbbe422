"""Compute stress modes S = E B V: the stresses of the columns of a basis at the nodes of its solid elements.

Stresses are those of the integration points of the element type (model.element_rules), extrapolated to the nodes of the
element (model.shape_functions), with the mean of all elements at a node, as CalculiX writes them into its .frd.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..fe.element_rows import ValuesAtRows, added_up
from ..fe.solids import Solids
from ..linalg.blocks import local_rows, times, view_of
from ..parallel.lookup import number_over_ranks
from ..parallel.petsc import PETSc
from ..parallel.sums import summed

WIDTH = 32  # columns at a time
SAMPLES = 4  # columns whose strain energy is compared with that of K
SAME_ENERGY = 1e-4  # relative difference that digits of files explain


@dataclass(frozen=True)
class StressModes:
    """Stresses of the columns of a basis at nodes.

    Attributes
    ----------
    node : ndarray of int, shape (s,)
        Numbers of the nodes of this rank, ascending over the ranks.
    stress : ndarray, shape (m, s, 6)
        Stresses xx, yy, zz, xy, yz, zx in Pa by column of the basis.
    source : str
        How they were made.
    remarks : tuple of str
        What a user should know of them.
    """

    node: np.ndarray
    stress: np.ndarray
    source: str
    remarks: tuple[str, ...] = ()


def stress_modes(model, columns, nodes: Iterable[int | str] | None = None) -> StressModes:
    """Return the stresses of the columns of a basis at the nodes of solid elements. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The full model, with nodes, elements, and their types and materials.
    columns : SLEPc.BV, shape (n, m)
        The basis V, such as `ReducedModel.columns`.
    nodes : iterable of int or str, optional
        Numbers of nodes and names of node sets; by default all nodes of solid elements.

    Returns
    -------
    StressModes
        The nodes of this rank.

    Raises
    ------
    InputError
        For a model without solids or their materials, for elements whose stresses are not those of the displacements
        of their nodes alone, and nodes and sets that do not exist.

    Notes
    -----
    At a node the mean of all its elements is taken, also of those of different materials. The strain energy of some
    columns is compared with that of K, and the forces of the elements at each node under uniform strains with those of
    K: where they differ the result has a remark.
    """
    solids = Solids(model, nodes)
    view = view_of(columns)
    count = view.stop - view.first
    used = solids.used()
    node, place = number_over_ranks(model.comm, solids.number[used])
    stress = np.zeros((count, len(node), 6))
    values = ValuesAtRows(model, solids.rows)
    adding = _adding(model, len(node), np.flatnonzero(used), place, len(solids.number))
    totals = added_up(adding, solids.counts().astype(float)[:, None])
    share = _share_of_energy(solids, values, view)
    for low in range(0, count, WIDTH):
        chunk = view.between(low, min(low + WIDTH, count))
        width = chunk.stop - chunk.first
        sums = solids.sums(values.of(chunk)).reshape(len(solids.number), 6 * width)
        mean = added_up(adding, sums) / totals
        stress[low : low + width] = mean.reshape(len(node), 6, width).transpose(2, 0, 1)
    view.bv.setActiveColumns(view.first, view.stop)  # which views of parts have moved
    remarks = solids.warnings()
    if nodes is None and share is not None and abs(share - 1) > SAME_ENERGY:
        remarks.append(
            f"stress: the strain energy of the solid elements is {share:.4g} of that of K; where the model has no "
            "other elements, and no hourglass stiffness, its elements or materials are not those of K"
        )
    return StressModes(node, stress, _source(solids), tuple(remarks))


def _source(solids) -> str:
    """Return the text that says how the stresses were made."""
    names = {(solids.model.properties.program, group.kind, group.material.name) for group in solids.groups}
    names = sorted(set().union(*solids.model.comm.allgather(names)))
    listed = ", ".join(f"{kind} of {material}" for _, kind, material in names)
    return f"hpcred, E B V at integration points of {names[0][0]}, extrapolated and averaged: {listed}"


def _adding(model, own, used, place, size) -> PETSc.Mat:
    """Return the matrix (s, l) of ones that adds up local nodes of all ranks: the nodes `used` go to `place`."""
    counts = np.zeros(size + 1, PETSc.IntType)
    counts[used + 1] = 1
    csr = (np.cumsum(counts, dtype=PETSc.IntType), place.astype(PETSc.IntType), np.ones(len(used)))
    return PETSc.Mat().createAIJ(((size, None), (own, None)), csr=csr, comm=model.K.comm).transpose(PETSc.Mat())


def _share_of_energy(solids, values, view) -> float | None:
    """Return the strain energy of the elements by that of K, of some columns together, None where it is zero."""
    model, count = solids.model, view.stop - view.first
    total = np.zeros(2)
    for column in np.unique(np.linspace(0, count - 1, min(SAMPLES, count)).astype(int)).tolist():
        columns = view.between(column, column + 1)
        total[0] += solids.energies(values.of(columns))[0]
        with local_rows(times(model.K, columns)) as forces, local_rows(columns) as moved:
            total[1] += float((forces.real * moved.real).sum())
    own, whole = summed(model.comm, total)
    return float(own / whole) if whole > 0 else None


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Return the von Mises stress.

    Parameters
    ----------
    stress : array_like, shape (..., 6)
        Stresses xx, yy, zz, xy, yz, zx.

    Returns
    -------
    ndarray, shape (...)
        In the unit of `stress`.
    """
    xx, yy, zz, xy, yz, zx = np.moveaxis(np.asarray(stress), -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.sqrt(normal / 2 + 3 * (xy**2 + yz**2 + zx**2))
