"""Find the independent loads among the inputs and outputs of a run, and express both in terms of these."""

from __future__ import annotations

import numpy as np

from ...linalg.blocks import create_block, from_dense, inner, local_rows, multiply
from ...model.frames import ONLY_RIGID
from ...parallel.decisions import decided
from ...parallel.failures import InputError
from ..small.pseudo_modal import InputsOutputs

GONE = ONLY_RIGID  # of the norm of a load: what is left without its rigid-body part is round-off
SAME = 1e-14  # of a column: differences up to it are round-off of its coefficients
DEPENDENT = 1e-13  # of the squared norm of a load: what others leave of it, below which it is a combination of them


def independent_loads(run):
    """Return L, the independent columns of [B, C^T] as a block, and the inputs and outputs in terms of them.
    Collective. Raises InputError where inputs or outputs have no part in the elastic motion."""
    model = run.model
    blocks = [from_dense(mat) for mat in (model.B, model.Ct) if mat is not None]
    L, (Lb, *Lc) = independent_columns(model, run.rigid, blocks)
    if Lc and _are_same(Lb, Lc[0]):
        Lc = []
    for columns_of, what in ((Lb, "input loads"), ((Lc or [Lb])[0], "output measures")):
        if not columns_of.any():
            raise InputError(f"{model.name}: no {what} the elastic dofs of the model; the response is zero")
    return L, InputsOutputs(Lb, Lc[0] if Lc else Lb, model.rates)


def _are_same(columns, others):
    """Test whether columns are the same ones but for round-off, each beside its own size."""
    if columns.shape != others.shape:
        return False
    return bool((np.linalg.norm(columns - others, axis=0) <= SAME * np.linalg.norm(columns, axis=0)).all())


def independent_columns(model, rigid, both):
    """Return the independent columns of blocks as one, equilibrated for rigid-body modes (or None), and each block in
    terms of them. Collective."""
    widths = [block.getActiveColumns()[1] for block in both]
    L = create_block(model.K, sum(widths))
    with local_rows(L) as target:
        for place, block in zip(np.cumsum([0, *widths]), both, strict=False):
            with local_rows(block) as source:
                target[:, place : place + source.shape[1]] = source
    before = np.sqrt(np.diag(inner(L, L)))
    if rigid is not None:
        rigid.equilibrate(L)
    kept, factor = decided(model.comm, _independent_columns, inner(L, L), before)
    turn = np.eye(sum(widths))[:, kept]
    others = np.setdiff1d(np.arange(sum(widths)), kept)
    if len(kept) and len(others):  # what is left of them, which their Gram matrix has no digits for
        rest = L.copy()
        rest_of = np.eye(sum(widths))[:, others] - turn @ factor[:, others]
        multiply(rest, rest_of)
        rest.setActiveColumns(0, len(others))
        more, coefficients = decided(model.comm, _independent_columns, inner(rest, rest), before[others])
        turn = np.hstack([turn, rest_of[:, more]])
        factor = np.vstack([factor, np.zeros((len(more), sum(widths)))])
        factor[len(kept) :, others] = coefficients
    if not turn.shape[1]:
        return L, np.split(factor, np.cumsum(widths)[:-1], axis=1)
    multiply(L, turn)
    L.setActiveColumns(0, turn.shape[1])
    # loads of about one size, by powers of 2, which change no digit: what is parallel does not depend on units
    size = decided(model.comm, lambda gram: 2.0 ** np.round(np.log2(np.sqrt(np.diag(gram)))), inner(L, L))
    multiply(L, np.diag(1 / size))
    return L, np.split(size[:, None] * factor, np.cumsum(widths)[:-1], axis=1)


def _independent_columns(gram, before):
    """Return which columns are independent, by Cholesky with pivoting, and all columns in terms of them.

    `before`: their norms before the rigid-body part was taken out, against which what is left may be round-off. Columns
    may have any units.
    """
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > GONE * before)
    unit = gram * np.outer(scale, scale)
    rest, kept = unit.copy(), []
    while len(kept) < len(unit) and np.diag(rest).max() > DEPENDENT:
        k = int(np.diag(rest).argmax())
        kept.append(k)
        rest = rest - np.outer(rest[:, k], rest[k]) / rest[k, k]
        rest[k], rest[:, k] = 0.0, 0.0
    kept = np.array(sorted(kept), dtype=int)
    if not len(kept):
        return kept, np.zeros((0, len(gram)))
    factor = np.linalg.solve(unit[np.ix_(kept, kept)], unit[kept]) * np.outer(1 / size[kept], size)
    factor[:, kept] = np.eye(len(kept))
    return kept, factor
