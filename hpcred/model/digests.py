"""Compute digests of the contents of a model: the same on any number of ranks and in both builds of PETSc."""

from dataclasses import asdict, replace

import numpy as np

from ..parallel.digest import digest, digest_of_block, digest_of_plain
from ..parallel.petsc import MPI
from .operator import ADDED
from .outputs.rates import KEY as RATES

# all that responses and reduced models of a model depend on, by field; elements and node sets by what is made of them
PARTS = (ADDED, "M", "K", "D", "B", "Ct", RATES, "interfaces", "dofs")
DIGITS = np.pi * 1e7  # no decimal ones, near whose ends round numbers are
SMALL = 1e-5  # of the largest entry of a column, from which on digits of entries count, not of the largest one


def digest_of(model, key: str) -> str | None:
    """Return the digest that SecondOrderModel.digest_of keeps. Collective."""
    field = "dofs" if key == "labels" else key
    # what is small, and the same on all ranks
    if key == ADDED:
        return digest_of_plain(model.added.digest(model.digest_of)) if model.added else None
    if key == RATES:
        if not model.rates:
            return None
        arrays, direct = model.rates.parts.tolist(), model.rates.direct
        if direct is None:
            return digest_of_plain(arrays)
        scale, values = _rounded(MPI.COMM_SELF, direct, np.arange(direct.shape[1]))  # sums, as those of B
        return digest_of_plain([arrays, scale, values.tolist()])
    held = model.matrices[key] if key in model.matrices else getattr(model, field)
    if held is None or held == ():
        return None
    # what is distributed by rows: labels, columns of B and C^T, and matrices without their zeros
    first = model.first_row
    if field == "dofs":
        labels = [held.node, held.direction, *([held.position] if key == "dofs" else [])]
        return digest_of_block(model.comm, first, np.column_stack(labels).astype("<f8"))
    if key == "interfaces":  # what set, bore, pin, weights, elements and places come to
        asked = [asdict(replace(node, position=None, count=0, warnings=())) for node in held]
        return digest_of_plain([asked, model.digest_of("Gt")])
    if key in ("B", "Ct"):
        columns = np.ascontiguousarray(held.getDenseArray().real, "<f8")
        scale, values = _rounded(model.comm, columns, np.arange(columns.shape[1]))
        return digest_of_plain([scale, digest_of_block(model.comm, first, values)])
    indptr, indices, values = held.getValuesCSR()
    number = "<u4" if model.size < 2**32 else "<u8"
    if key == "Gt":
        scale, rounded = _rounded(model.comm, values.real, indices, held.getSize()[1])

    def between(low, high):
        ends = indptr[low : high + 1]
        if key == "Gt":
            kept, entries = slice(ends[0], ends[-1]), rounded
        else:  # the patterns of other matrices leave zeros
            kept, entries = ends[0] + np.flatnonzero(values[ends[0] : ends[-1]]), values.real
            ends = np.searchsorted(kept, ends)
        return (np.diff(ends), indices[kept].astype(number, copy=False)), (np.diff(ends), entries[kept])

    found = digest(model.comm, first, len(indptr) - 1, between)
    return digest_of_plain([scale, found]) if key == "Gt" else found


def _rounded(comm, values, columns, count=None):
    """Return seven digits of the largest entry of each column, and of the entries relative to it: where interfaces,
    elements and loads made them the last ones depend on the number of ranks. Of small entries fewer count."""
    most = np.zeros(count or len(columns))
    np.maximum.at(most, np.broadcast_to(columns, values.shape), np.abs(values))
    comm.Allreduce(MPI.IN_PLACE, most, MPI.MAX)
    most[most == 0] = 1.0
    rounded = np.round(np.arcsinh(values / (SMALL * most)[columns]) * DIGITS).astype("<i8")
    return (np.round(np.log(most) * DIGITS) + 0.0).tolist(), rounded  # no -0.0 beside 0.0
