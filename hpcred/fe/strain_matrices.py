"""Make the matrices B of solids, which take displacements of nodes to strains, and E B, which take them to stresses.

Components are xx, yy, zz, xy, yz, zx; shear strains are gamma = 2 epsilon.
"""

import numpy as np

from .element_rules import Rule
from .shape_functions import extrapolation, gradients_in_space, integration_points, shape_functions

COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "zx")
SHEAR = ((0, 1), (1, 2), (2, 0))


def elasticity(young: float, poisson: float) -> np.ndarray:
    """Return E (6, 6), stresses by strains, of an isotropic material."""
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = young / (2 * (1 + poisson))
    elastic = np.diag([2 * shear] * 3 + [shear] * 3)
    elastic[:3, :3] += lame
    return elastic


def strain_matrices(kind: str, rule: Rule, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return B (e, g, 6, 3k) at the integration points, in 1/m, and their volumes (e, g) in m^3.

    `positions` (e, k, 3) of the nodes in m. Columns are x, y, z of the first node, and so on.
    """
    points, weights = integration_points(kind, "full" if rule.strain == "mean" else rule.scheme)
    gradients, determinants = gradients_in_space(shape_functions(kind, points)[1], positions)
    volumes = determinants * weights
    mean = np.einsum("eg,egkx->ekx", volumes, gradients) / volumes.sum(axis=1)[:, None, None]
    if rule.strain == "mean":
        gradients, volumes = mean[:, None], volumes.sum(axis=1)[:, None]
    B = np.zeros((*gradients.shape[:2], 6, gradients.shape[2], 3))
    for a in range(3):
        B[:, :, a, :, a] = gradients[..., a]
    for row, (a, b) in enumerate(SHEAR, start=3):
        B[:, :, row, :, a], B[:, :, row, :, b] = gradients[..., b], gradients[..., a]
    if rule.strain == "mean volume":
        B[:, :, :3] += ((mean[:, None] - gradients) / 3)[:, :, None]
    return B.reshape(*B.shape[:3], 3 * B.shape[3]), volumes


def stiffness_matrices(kind: str, rule: Rule, positions: np.ndarray, elastic: np.ndarray) -> np.ndarray:
    """Return K (e, 3k, 3k) = sum of B^T E B dV over the integration points, in N/m; `elastic` (6, 6)."""
    B, volumes = strain_matrices(kind, rule, positions)
    return np.einsum("eg,egia,ij,egjb->eab", volumes, B, elastic, B, optimize=True)


def nodal_stress_matrices(kind: str, rule: Rule, positions: np.ndarray, elastic: np.ndarray) -> np.ndarray:
    """Return the matrices (e, k, 6, 3k), in Pa/m, that take the displacements of the nodes of an element to the
    stresses at its nodes, extrapolated from its integration points; `elastic` (6, 6)."""
    B, _ = strain_matrices(kind, rule, positions)
    return np.einsum("kg,ij,egja->ekia", extrapolation(kind, rule.scheme), elastic, B, optimize=True)
