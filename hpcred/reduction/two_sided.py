"""Reduce a model by a two-sided projection (20), with bi-orthogonal bases: W^T M V = I."""

from dataclasses import dataclass

import numpy as np

from ..linalg.blocks import inner
from ..model.damping import ModalDamping
from ..model.digits import warnings_of_digits
from ..model.operator import Operator
from ..parallel.decisions import decided
from ..parallel.failures import ComputationError, InputError
from .basis_reductor import BasisReductor, reduced_model
from .projection import diagonalise, everywhere, project, project_columns
from .reduced_damping import reduced_damping

LOST = 1e-10  # singular value of W^T M V below which a pair of directions cannot be made bi-orthogonal


@dataclass(frozen=True, kw_only=True)
class TwoSidedReductor(BasisReductor):
    """Reduce by a two-sided projection: W from the output Krylov subspaces (33), so that more moments match."""

    projection = "two_sided"

    def _check(self, model):
        if self.settings.drop_above is not None or isinstance(self.damping, ModalDamping):
            raise InputError(
                "projection: 'two_sided' leaves no diagonal model, which drop_above and modal damping need; "
                "take 'one_sided'"
            )
        if self.settings.coordinates == "interface":
            raise InputError("projection: interface coordinates belong to a one-sided projection; leave it out")
        if model.added:
            raise InputError(f"projection: 'two_sided' has no place for the {model.added.plural} of {model.name}; take "
                             "'one_sided', or a tolerance")  # fmt: skip
        return super()._check(model)

    def _tau(self, framed):
        return 0.0  # the bases are made bi-orthonormal in M

    def _more_runs(self, run):
        return (run.dual(),)

    def _project(self, model, framed, bases, run):
        """Return the reduced model of a two-sided projection (20), its poles checked, and the biorthonormality defect.
        """
        (right, left), full = bases, framed.model
        eigenvalues = diagonalise(right, project(full.K, right.columns))
        run.notes.remarks += warnings_of_digits(model, full.K, eigenvalues, right.columns)
        defect = biorthogonal(left, right, run)
        V, W = right.columns, left.columns
        small = {key: project(mat, V, W) for key, mat in full.matrices.items()}
        frequencies = np.sort(np.sqrt(np.abs(np.linalg.eigvals(small["K"])))) / (2 * np.pi)
        if "D" not in small:
            small["D"] = reduced_damping(framed.damping, small["K"], frequencies)
        inputs, outputs = project_columns(W, full.B), project_columns(V, full.Ct)
        operator = Operator.of(**small)
        reduced = reduced_model(model, framed, operator, inputs, outputs.T.copy(), frequencies)
        unstable = decided(model.comm, reduced.unstable_poles)
        if len(unstable):
            listed = ", ".join(f"{pole.real:.3g}{pole.imag:+.4g}i" for pole in unstable[:6])
            told = (
                f"projection: the two-sided reduced model is unstable, with {len(unstable)} poles in the right "
                f"half-plane ({listed}{', ...' if len(unstable) > 6 else ''} rad/s)"
            )
            if not self.settings.allow_unstable:
                raise InputError(f"{told}; take projection = 'one_sided', which keeps stability, or allow_unstable = "
                                 "true for frequency responses only")  # fmt: skip
            run.notes.remarks.append(f"{told}: use it for frequency responses only, or take other points or another "
                                     "size, or a tolerance, which keeps stability")  # fmt: skip
        reduced.columns, reduced.left_columns = (everywhere(model, framed, block) for block in (V, W))
        return reduced, defect


def biorthogonal(left, right, run) -> float:
    """Change the mass-orthonormal bases W and V so that W^T M V = I; returns max |W^T M V - I|. Collective.

    Directions of one space that are M-orthogonal to the other one are dropped and reported; where the spaces have
    different sizes, the larger loses the difference.
    """
    u, values, vt = decided(run.model.comm, np.linalg.svd, inner(left.columns, run.times_mass(right.columns)))
    kept = int((values > LOST).sum())
    if kept == 0:
        raise ComputationError("the input and the output subspace are M-orthogonal: no two-sided model exists")
    scale = 1.0 / np.sqrt(values[:kept])
    run.note("bi-orthogonal pairs", max(left.size, right.size), kept)
    left.multiply(u[:, :kept] * scale)
    right.multiply(vt[:kept].T * scale)
    gram = inner(left.columns, run.times_mass(right.columns))
    return float(np.abs(gram - np.eye(kept)).max())
