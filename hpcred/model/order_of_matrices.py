"""Ask whether M, D and K were given in another order, where their sizes say so. All functions are collective."""

from __future__ import annotations

import numpy as np

from ..linalg.csr import diagonal_of

FAST = 1e25  # (rad/s)^2: k_ii / m_ii of most dofs, 5e11 Hz; meshes of a micrometre have 1e19
SLOW = 1e-3  # (rad/s)^2: mean eigenvalue, that of the stiffest dofs; exchanged ones have 1e-6 and less
LONG = 10.0  # s: D over K, which is below 1e-2 in bodies; exchanged ones have 1e2 to 1e7
OVERDAMPED = 10.0  # mean damping ratio of such a model at least, also where time is counted in other units
ORDERS = "SecondOrderModel takes M, D, K; from_scipy and from_petsc take K, M, D"


def questions_on_order(model) -> list[str]:
    """Return sentences where another order of the matrices is likely, of a model whose M and K are not exchanged (see
    exchange_of_matrices); a model that is meant so passes with them."""
    mats = {key: model.matrices[key] for key in "MDK" if key in model.matrices}
    sizes = model.comm.allreduce(np.array([np.abs(diagonal_of(mat)).sum() for mat in mats.values()]))
    size = dict(zip(mats, sizes.tolist(), strict=True))
    mass, damping, stiffness = (size.get(key, 0.0) for key in "MDK")
    if not (mass and stiffness):
        return []
    ratio = damping / 2 / np.sqrt(mass * stiffness)
    if damping > LONG * stiffness and ratio > OVERDAMPED:
        fault = f"the diagonal of D is {damping / stiffness:.1e} s times that of K, damped {ratio:.1e} times critically"
    elif model.dofs is None and stiffness < SLOW * mass:
        fault = f"the diagonal of K is {stiffness / mass:.1e} 1/s^2 times that of M"
    elif _is_fast(model, mats):
        return [
            f"{model.name}: are K and M in the units of one system? Most dofs by themselves vibrate at more than "
            f"{FAST**0.5 / 2 / np.pi:.0e} Hz, which no body does"
        ]
    else:
        return []
    return [f"{model.name}: are the matrices in their order? K is expected to be the largest, but {fault}; {ORDERS}"]


def _is_fast(model, mats) -> bool:
    """Test whether most dofs with mass are too stiff for it; a few penalty springs do not count."""
    stiffness, mass = (np.abs(diagonal_of(mats[key])) for key in "KM")
    fast, total = model.comm.allreduce(np.array([(stiffness > FAST * mass)[mass > 0].sum(), (mass > 0).sum()]))
    return bool(2 * fast > total)
