"""A .npz file of a Body that Exudyn's ObjectFFRFreducedOrderInterface.LoadFromFile reads; its nodes are the interface.

The file has mass, stiffness and the integrals of the floating frame, and no inputs and outputs but nodes. It has no
damping: Exudyn takes two coefficients when the object is added, which the remarks name where they say the same as D.
"""

from __future__ import annotations

import numpy as np

from ..multibody.body import Body, check_moving, inputs_without_node, remarks

SAME_DAMPING = 1e-8  # largest part of D that its two coefficients may leave out


def write_exudyn(path, body: Body) -> list[str]:
    """Write a body; call it on one rank. Returns remarks: what the file does not hold, and the coefficients of D.

    Raises InputError for a body with structural damping, rigid-body motions, or without mass in some direction.
    """
    check_moving(body, "a file for Exudyn")
    reduced, quantities, count = body.reduced, body.floating_frame, body.reduced.size
    identity = np.eye(3)
    trace_n = np.trace(quantities.N, axis1=1, axis2=2)
    trace_s = quantities.S[0, 0] + quantities.S[1, 1] + quantities.S[2, 2]
    # with Psi~ = skew(Phi_k) side by side, integrals of Psi~^T Psi, Psi~^T Psi~, ...
    psi_psi = -quantities.Cr1.transpose(1, 2, 0).reshape(3 * count, count)
    tilde = trace_s[:, :, None, None] * identity - quantities.S.transpose(2, 3, 1, 0)
    psi_tilde = tilde.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
    reference = trace_n[:, None, None] * identity - quantities.N.transpose(0, 2, 1)
    centre = quantities.mc / quantities.mass
    data = {
        "fileVersion": 1,
        "modeBasis": np.array([shape.phi for shape in body.nodes]).reshape(-1, count),
        "trigList": np.zeros((0, 3), dtype=int),
        "postProcessingModes": np.array({}, dtype=object),
        "massMatrixReduced": reduced.M,
        "stiffnessMatrixReduced": reduced.K,
        "infoList": np.array([count, len(body.nodes), 3, 4, 7, 7 + count]),
        "rigidBodyNodeType": "NodeType.RotationEulerParameters",
        "xRef": np.array([shape.position - quantities.origin for shape in body.nodes]).ravel(),
        "inertiaLocal": quantities.J,
        "Mtt": quantities.mass * identity,
        "totalMass": quantities.mass,
        "chiU": centre,
        "chiUtilde": np.cross(identity, centre),
        "mPsiTildePsi": psi_psi,
        "mPsiTildePsiTilde": psi_tilde,
        "mPhitTPsi": quantities.Ct.T,
        "mPhitTPsiTilde": np.concatenate([np.cross(identity, row) for row in quantities.Ct], axis=1),
        "mXRefTildePsi": -quantities.Cr.T,
        "mXRefTildePsiTilde": reference.transpose(1, 0, 2).reshape(3, -1),
    }
    with open(path, "wb") as file:
        np.savez(file, **data)
    return [*remarks(body), *_damping(reduced), *inputs_without_node(body)]


def _damping(reduced) -> list[str]:
    """How to give D to Exudyn, or that it cannot be given."""
    if not reduced.D.any():
        return []
    coefficients = rayleigh_coefficients(reduced)
    if coefficients is None:
        return [
            "the file has no damping, and D is not alpha M + beta K, so that it is lost; reduce with damping of kind "
            "'rayleigh', or take the arrays by format 'npz' and give D to Exudyn by your own script"
        ]
    alpha, beta = coefficients
    return [
        f"the file has no damping; give it to AddObjectFFRFreducedOrder: massProportionalDamping = {alpha:.10g}, "
        f"stiffnessProportionalDamping = {beta:.10g}"
    ]


def rayleigh_coefficients(reduced):
    """alpha (1/s) and beta (s) with D = alpha M + beta K of a reduced model, or None where there are none."""
    M, D, K = reduced.M, reduced.D, reduced.K
    own = np.abs(np.diag(D))
    if not own.all():
        return None
    # each equation relative to the damping of its mode, so that alpha is not lost beside a large beta K
    weight = 1 / own
    system = np.stack([np.diag(M) * weight, np.diag(K) * weight], axis=1)
    scale = np.linalg.norm(system, axis=0)
    found = np.linalg.lstsq(system / scale, np.diag(D) * weight, rcond=None)[0] / scale
    alpha, beta = np.where(np.abs(found * system).max(axis=0) < SAME_DAMPING, 0.0, found)
    rest = (D - alpha * M - beta * K) / np.sqrt(np.outer(own, own))
    return (float(alpha), float(beta)) if np.abs(rest).max() < SAME_DAMPING else None
