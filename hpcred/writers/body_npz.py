"""Arrays of a Body by name, and the .npz file that holds them.

M, D, K (m, m), B (m, p), C (r, m), frequencies (m) in Hz, loss_factor (eta of structural damping: K stands for
(1 + i eta) K in frequency responses), input_names, output_names; the quantities of FloatingFrame by their names there;
nodes (k), positions (k, 3) in the body frame, phi and psi (k, 3, m). SI units. Nothing that affects numbers is missing.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ..body.body import Body, maker, remarks
from ..files.outputs import ZIP
from ..reduction.reduced_model import require_finite
from .base import Writer


def arrays_of(body: Body) -> dict:
    """Everything by its name in the file. Raises InputError for NaN and Inf in the matrices."""
    require_finite(body.reduced)
    reduced, count = body.reduced, body.reduced.size
    names = ("M", "D", "K", "B", "C", "frequencies", "loss_factor", "input_names", "output_names")
    arrays = {name: np.array(getattr(reduced, name)) for name in names}
    arrays |= body.floating_frame.arrays()
    return arrays | {
        "nodes": np.array([shape.node for shape in body.nodes], dtype=float),
        "positions": np.array([s.position - body.floating_frame.origin for s in body.nodes]).reshape(-1, 3),
        "phi": np.array([shape.phi for shape in body.nodes]).reshape(-1, 3, count),
        "psi": np.array([shape.psi for shape in body.nodes]).reshape(-1, 3, count),
        "comment": np.array("; ".join([maker(body.reduced), *remarks(body)])),
    }


def write_npz(path, body: Body) -> list[str]:
    """Write all arrays of a body; call it on one rank. Returns remarks on what is approximated."""
    save_npz(path, arrays_of(body))
    return remarks(body)


def save_npz(path, arrays: dict):
    """Write arrays by name; call it on one rank. They are packed in memory: an archive cannot be left half written."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    Path(path).write_bytes(content.getbuffer())


class BodyNpz(Writer):
    """Arrays of a body for NumPy."""

    suffix, needs, kind = ".npz", "body", ZIP

    def write(self, target, source):
        return write_npz(target, source.body)
