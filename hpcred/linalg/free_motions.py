"""Refuse a free body that has free motions beside its rigid-body modes, as one with hinges or in parts."""

from __future__ import annotations

import numpy as np

from ..parallel.failures import InputError, Owned
from .basis import Basis
from .blocks import apply, create_block, inner, random_block
from .solvers.base import SingularMatrix
from .solvers.shifted import ShiftedSolver

MOST = 24  # motions that are counted
ZERO = 1e-12  # eigenvalue relative to their mean, trace(K) / trace(M), that counts as zero
SHIFT = 1e-10  # in the same measure


def check_free_motions(model, rigid, factoring=None):
    """Raise InputError where motions besides `rigid` (model.RigidBodyModes, or None) meet no force. Collective.

    K with as many rows held as the body has rigid-body motions is regular, or else there are more.
    """
    if rigid is None:
        return
    with Owned(model.comm) as owned:
        solver = owned.owns(ShiftedSolver(model, rigid, prefix="free_", factoring=factoring))
        try:
            solver.factor(0.0)
        except SingularMatrix:
            raise free_motions_refused(model, rigid, _count(model, rigid, solver)) from None


def free_motions_refused(model, rigid, count: int | None = None) -> InputError:
    """The refusal of a body with so many motions (None: some) without force besides its rigid-body ones."""
    many = "more motions" if count is None else f"{'at least ' * (count == MOST)}{count} more motion{'s' * (count > 1)}"
    return InputError(
        f"{model.name}: K lets {many} happen without force than the {rigid.count} of a rigid body: parts that are not "
        "connected, or hinges; connect them, or take each part as a model of its own"
    )


def _count(model, rigid, solver) -> int | None:
    """How many motions without force the body has beside the rigid ones: inverse iteration of a block near 0."""
    mean = model.mean_eigenvalue
    columns = min(MOST, model.size - rigid.count)
    try:
        solver.factor(SHIFT * mean)
    except SingularMatrix:
        return None
    block, product = random_block(model.K, columns), create_block(model.K, columns)
    basis = Basis(model.M, rigid.R, 1e-14, columns)
    for _ in range(3):
        basis.extend(block)
        product.setActiveColumns(0, basis.size)
        block.setActiveColumns(0, basis.size)
        apply(model.M, basis.columns, product)
        solver.solve(product, block)
        basis.clear()
    basis.extend(block)
    product.setActiveColumns(0, basis.size)
    apply(model.K, basis.columns, product)
    gram = inner(basis.columns, product)
    values = model.comm.bcast(np.linalg.eigvalsh((gram + gram.conj().T) / 2))
    return int((values < ZERO * mean).sum()) or None
