"""What there is to know of a model before it is reduced."""

import numpy as np

from ..linalg.factorisation import Factorisation, SingularMatrix
from ..linalg.solvers import ShiftedSolver
from ..model.rigid_body_modes import RigidBodyModes, rigid_body_quantities
from ..parallel.failures import ComputationError
from ..parallel.petsc import is_complex


def inspect(model, frequencies=(), band_top=None, progress=None) -> dict:
    """Sizes, symmetry, definiteness, mass, rigid-body modes, and modes below frequencies (Hz). Collective.

    `band_top` (Hz): upper end of the band of interest, for the size hint: modes below twice that plus inputs.
    Counts by inertia need a real build; in a complex one they are None.
    """
    report = {
        "model": model.name,
        "size": model.size,
        "nonzeros": model.nonzeros,
        "matrices": sorted(model.matrices),
        "inputs": model.input_names,
        "outputs": model.output_names,
        "symmetry_defects": model.symmetry_defects,
        "mass_matrix": _definiteness(model.M),
    }
    rigid_count = None
    if model.dofs is not None:
        body = rigid_body_quantities(model)
        rigid = RigidBodyModes(model)
        rigid_count = rigid.count
        report |= {
            "mass_kg": body.mass,
            "masses_in_x_y_z_kg": body.masses.tolist(),
            "centre_of_mass_m": _known(body.centre),
            "inertia_kg_m2": _known(body.inertia),
            "rigid_body_modes": rigid.count,
            "rigid_body_defect": rigid.defect,
        }
        rigid.close()
    limits = sorted({*frequencies, *([2 * band_top] if band_top else [])})
    counts = _count_modes(model, limits, rigid_count or 0, progress)
    if limits:
        report["elastic_modes_below_hz"] = [[limit, counts[limit]] for limit in limits]
    if band_top and counts[2 * band_top] is not None:
        report["size_hint"] = counts[2 * band_top] + len(model.input_names)
    return report


def _known(values):
    """Numbers as nested lists, None for what is not known."""
    return np.where(np.isnan(values), None, values).tolist()


def _definiteness(mass):
    """ "positive definite", "singular" or "indefinite", by the inertia of M."""
    if is_complex():
        return "not known (complex PETSc)"
    factors = Factorisation(mass, "cholesky", "inertia_", {"icntl_13": 1, "icntl_24": 1})
    try:
        factors.factor()
        if factors.negative_pivots:
            return "indefinite"
        return "singular" if factors.records[-1]["null_pivots"] else "positive definite"
    except SingularMatrix:
        return "singular"
    finally:
        factors.close()


def _count_modes(model, limits, rigid, progress):
    """Elastic modes below each limit (Hz): negative eigenvalues of K - omega^2 M, without rigid-body modes."""
    if not limits or is_complex():
        return dict.fromkeys(limits)
    solver = ShiftedSolver(model, prefix="inertia_", inertia=True)
    counts = {}
    for limit in limits:
        for nudge in (1.0, 1 + 1e-9, 1 - 1e-9):
            try:
                solver.factor(-((2 * np.pi * limit * nudge) ** 2))
                counts[limit] = solver.negative_pivots - rigid
                break
            except SingularMatrix:
                continue
        else:
            raise ComputationError(f"{limit:g} Hz is an eigenfrequency: modes below it cannot be counted")
        if progress is not None:
            progress.say(f"{counts[limit]} elastic modes below {limit:g} Hz")
    solver.close()
    return counts
