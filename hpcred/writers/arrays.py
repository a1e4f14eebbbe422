"""Write the arrays of a Body by name, as a .npz, or as a .mat for MATLAB, Octave and Neweul-M2.

M, D, K (m, m), B (m, p), C (r, m), where not zero Cv, Ca and feedthrough (r, p), frequencies (m) in Hz,
loss_factor (eta of structural damping: K stands for
(1 + i eta) K in frequency responses), input_names, output_names; resultants (p, 6), force and moment of each input
about the origin of the body frame, which move it; the matrices viscoelastic (v, m, m) of terms c(s) K_v that are
added to K, such as (g(s) - g(0)) K_v, viscoelastic_names (v) and viscoelastic_laws (v) in JSON; the quantities of
FloatingFrame by their names there;
nodes (k), positions (k, 3) in the body frame, phi and psi (k, 3, m); where the result has stress modes, stress
(m, s, 6) of xx, yy, zz, xy, yz, zx by coordinate, and stress_nodes (s); where it has geometric stiffness,
geometric_stiffness (g, m, m) by unit states of load, and geometric_states (g), their names. SI units. Nothing that
affects numbers is missing. Lists of names are cell arrays in a .mat.

Of a model with parameters, unless values were chosen, all this is at their reference values, and parameter_names,
parameter_units (a), parameter_ranges (a, 2) and parameter_references (a), constant_M, constant_D, ..., constant_C, and
for the terms (t) term_of, term_factors, such as omega^2, and term_1, term_2, ... make up the matrices at others:
M(p) = constant_M + the sum of factor times term over the terms of M.
"""

import io
import json
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..body.body import Body, maker, remarks, resultants_of
from ..files.outputs import MATLAB, ZIP
from ..model.operator import ADDED
from ..readers.matrices.npz import shapes_of
from ..reduction.parametric.reduced import ParametricReducedModel
from ..reduction.result.reduced_model import require_finite
from .base import Writer


def arrays_of(body: Body) -> dict:
    """Everything by its name in the file. Raises InputError for NaN and Inf in the matrices."""
    require_finite(body.reduced)
    reduced, count = body.reduced, body.reduced.size
    names = ("M", "D", "K", "B", "C", "Cv", "Ca", "feedthrough", "frequencies", "loss_factor", "input_names",
             "output_names")  # fmt: skip
    arrays = {name: np.array(value) for name in names if (value := getattr(reduced, name)) is not None}
    if reduced.added:
        arrays[ADDED] = np.array([term.matrix for term in reduced.added])
        arrays[f"{ADDED}_names"] = np.array([term.name for term in reduced.added])
        arrays[f"{ADDED}_laws"] = np.array([json.dumps(asdict(term.law)) for term in reduced.added])
    if reduced.resultants is not None:
        arrays["resultants"] = resultants_of(body)
    arrays |= body.floating_frame.arrays()
    if body.stress is not None:
        arrays |= {"stress": body.stress.stress, "stress_nodes": body.stress.node.astype(float)}
    if (stiffness := body.geometric_stiffness) is not None:
        arrays |= {"geometric_stiffness": stiffness.matrices, "geometric_states": np.array(stiffness.states)}
    return arrays | {
        "nodes": np.array([shape.node for shape in body.nodes], dtype=float),
        "positions": np.array([s.position - body.floating_frame.origin for s in body.nodes]).reshape(-1, 3),
        "phi": np.array([shape.phi for shape in body.nodes]).reshape(-1, 3, count),
        "psi": np.array([shape.psi for shape in body.nodes]).reshape(-1, 3, count),
        "comment": np.array("; ".join([maker(body.reduced), *remarks(body)])),
    }


def words_on_damping(reduced: ParametricReducedModel | None) -> list[str]:
    """Return a remark on damping that is no sum of terms."""
    if reduced is None or not reduced.damping_follows:
        return []
    return ["constant_D is the damping at the reference values; that at others follows their eigenfrequencies"]


def arrays_of_parameters(reduced: ParametricReducedModel | None) -> dict:
    """The parameters, constant parts and terms by their names in the file; nothing for None."""
    if reduced is None:
        return {}
    parameters, terms = reduced.parameters, reduced.terms
    return {
        "parameter_names": np.array([entry.name for entry in parameters]),
        "parameter_units": np.array([entry.unit for entry in parameters]),
        "parameter_ranges": np.array([entry.range for entry in parameters]),
        "parameter_references": np.array([entry.reference for entry in parameters]),
        **{f"constant_{key}": matrix for key, matrix in reduced.constant.items()},
        "term_of": np.array([entry.of for entry in terms]),
        "term_factors": np.array([entry.factor.replace("**", "^") for entry in terms]),  # as MATLAB has it
        **{f"term_{k}": entry.matrix for k, entry in enumerate(terms, 1)},
    }


def save_npz(path, arrays: dict):
    """Write arrays by name; call it on one rank. They are packed in memory: an archive cannot be left half written."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    Path(path).write_bytes(content.getbuffer())


def save_mat(path, arrays: dict):
    """Write arrays by name, lists of texts as cell arrays; call it on one rank."""
    from scipy.io import savemat

    cells = {key: value.astype(object) if value.dtype.kind == "U" and value.ndim else value
             for key, value in arrays.items()}  # fmt: skip
    with open(path, "wb") as file:
        savemat(file, cells, oned_as="column")


class BodyMat(Writer):
    """Arrays of a body for MATLAB."""

    suffix, needs, kind, stress, keeps_parameters = ".mat", "body", MATLAB, True, True
    save = staticmethod(save_mat)

    def write(self, target, source):
        self.save(target, arrays_of(source.body) | arrays_of_parameters(source.parametric))
        return [*remarks(source.body), *words_on_damping(source.parametric)]


class BodyNpz(BodyMat):
    """Arrays of a body for NumPy."""

    suffix, kind, save = ".npz", ZIP, staticmethod(save_npz)

    def describe(self, path):
        """Return the arrays of a .npz by name, or nothing of another archive."""
        if not zipfile.is_zipfile(path):
            return {}
        rows = {name: " x ".join(map(str, shape)) or "1" for name, shape in shapes_of(path).items()}
        if len(rows) < 2 or "data" in rows:  # as that of a sparse matrix
            return {}
        return {"format": "NumPy arrays (.npz)", "arrays": rows}
