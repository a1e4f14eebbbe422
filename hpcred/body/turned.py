"""Bring what belongs to the coordinates q of a body to others z, with q = X z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .floating_frame import FloatingFrame
from .geometric_stiffness import GeometricStiffness
from .node_shapes import NodeShape


def turned_frame(frame: FloatingFrame, X: np.ndarray) -> FloatingFrame:
    """Return floating-frame quantities in the coordinates z (k,) with q = X z, X (m, k)."""
    columns = {key: np.tensordot(X.T, getattr(frame, key), axes=1) for key in ("Ct", "Cr", "N")}
    return replace(frame, **columns, S=X.T @ frame.S @ X, Me=X.T @ frame.Me @ X)


def turned_node(node: NodeShape, X: np.ndarray) -> NodeShape:
    """Return the shapes of a node in the coordinates z with q = X z."""
    return replace(node, phi=node.phi @ X, psi=node.psi @ X)


def turned_stiffness(stiffness: GeometricStiffness, X: np.ndarray) -> GeometricStiffness:
    """Return the stiffness of unit states of load in the coordinates z with q = X z."""
    return replace(stiffness, matrices=X.T @ stiffness.matrices @ X)
