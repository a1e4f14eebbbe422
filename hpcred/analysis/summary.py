"""Summarise a model before it is reduced."""

from contextlib import closing

import numpy as np

from ..fe.materials import properties_in_words
from ..linalg.free_motions import ZERO
from ..linalg.solvers.base import SingularMatrix
from ..linalg.solvers.settings import Factoring
from ..linalg.solvers.shifted import ShiftedSolver
from ..model.definiteness import (
    check_definite,
    growing_in_words,
    is_mass_indefinite,
    warnings_of_definiteness,
    zero_of,
)
from ..model.loads.columns import loads_of
from ..model.order_of_matrices import questions_on_order
from ..model.rigid_body.modes import RigidBodyModes, remark_on_digits, rigid_body_quantities
from ..model.rigid_body.rows_alone import warnings_of_rows_alone
from ..model.second_order_model import massless, require_model
from ..parallel.declared import declared
from ..parallel.failures import ComputationError
from ..parallel.petsc import MPI, PETSc, is_complex
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, within
from .check import held_count, known, with_warnings
from .frequency_response import checked_frequencies
from .natural_modes import natural_modes

NEGATIVE = 1e-9  # eigenvalue of M relative to its diagonal that files of ten digits make of zero


def inspect(
    model, frequencies=(), band_top=None, *, modes: int | None = None, verify: bool = False,
    factoring: Factoring | None = None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Summarise sizes, symmetry, definiteness, mass, rigid-body modes, and modes below frequencies.

    Collective.

    Parameters
    ----------
    model : SecondOrderModel
    frequencies : array_like, default ()
        Hz, below which modes are counted by inertia.
    band_top : float, optional
        Hz; upper end of the band of interest, for the size hint: modes below twice that plus inputs.
    modes : int, optional
        How many of the lowest frequencies to find.
    verify : bool, default False
        Factor M to tell whether it is positive definite, and K of a model without nodes to count its modes at zero.
        Without it, and without `frequencies`, `band_top` or `modes`, nothing is factored.
    factoring : Factoring, optional
        How to factor, and in how much memory.
    progress : Progress, optional
        By default one that shows stages and times on stderr once they take long.

    Returns
    -------
    dict
        Counts are None without a real build and a package that tells the inertia, and where factors are too rough for
        that; `modes_counted_by`: the source of counts, where there are any. `sets`: number of nodes by name of
        the node set. `warnings` lists what looks wrong.
    """
    require_model(model)
    factoring, progress = factoring or Factoring(), progress or Progress(model.comm)
    progress.expect(model.size)
    frequencies = checked_frequencies(frequencies).tolist()
    within("band_top", declared("band_top", band_top, float | None), FREQUENCY)
    report = {
        "model": model.name,
        "size": model.size,
        "nonzeros": model.nonzeros,
        "matrices": sorted(model.matrices),
        "inputs": list(model.input_names),
        "outputs": list(model.output_names),
        "symmetry_defects": model.symmetry_defects,
    }
    with progress.stage("signs of M and K"):
        signs, indefinite = warnings_of_definiteness(model), is_mass_indefinite(model)
    if indefinite:
        report["mass_matrix"] = "indefinite"
    elif verify:
        with progress.stage("factor", "M"):
            report["mass_matrix"] = _definiteness(model.M, factoring)
    elif massless(model):
        report["mass_matrix"] = "singular"
    else:
        report["mass_matrix"] = "no negative direction found (--verify factors it)"
    report |= model.declared | model.operator.families
    if model.converted_from:
        report["converted_from"] = model.converted_from
    if model.properties is not None:
        report |= properties_in_words(model.properties, model.comm)
    if sets := model.set_sizes:
        report["sets"] = sets
    if loads := loads_of(model):
        report["loads"] = [item.row for item in loads]
    if report["mass_matrix"] == "indefinite" and not indefinite:
        signs.append(f"{model.name}: M is indefinite by the inertia of its factor, which no mass matrix is")
    if frequencies or band_top or modes is not None:
        check_definite(model)
    first, rounded = None, ()
    if modes is not None:
        found = natural_modes(model, min(modes, model.size), factoring=factoring, progress=progress)
        report["lowest_frequencies_hz"] = found.frequencies.tolist()
        rounded = found.warnings
        first = next(iter(found.frequencies[found.rigid :].tolist()), None)
    rigid_count, warnings = None, [*signs, *questions_on_order(model), *warnings_of_rows_alone(model), *model.remarks]
    if model.dofs is not None:
        body = rigid_body_quantities(model)
        rigid = RigidBodyModes(model, soft=True)
        rigid_count = rigid.count
        report |= {
            "mass_kg": body.mass,
            "masses_in_x_y_z_kg": body.masses.tolist(),
            "centre_of_mass_m": known(body.centre),
            "inertia_kg_m2": known(body.inertia),
            "rigid_body_modes": rigid.count,
            "rigid_body_defect": rigid.defect,
        }
        if count := held_count(model):
            report["held_dofs"] = count
        warnings = with_warnings(warnings, model, body, first)
        support = rigid.support
        if soft := support.movable.shape[1] - support.free.shape[1]:
            report["softly_held"] = soft
            warnings.append(
                f"{model.name}: {soft} of the {rigid.count} rigid-body motions meet{'s' * (soft == 1)} up to "
                f"{support.forces.max():.0e} of the stiffness of a row: soft supports, or few digits of K"
            )
        if few := remark_on_digits(support):
            warnings.append(f"{model.name}: {few}")
    limits = sorted({*frequencies, *([2 * band_top] if band_top else [])})
    if model.symmetric and factoring.counts() and (limits or (verify and rigid_count is None)):
        with closing(ShiftedSolver(model, prefix="inertia_", inertia=True, factoring=factoring)) as solver:

            def count_below(square, name):
                with progress.stage("factor", name, solver.known):
                    return _count_below(solver, square)

            if not signs and (negative := count_below(-zero_of(model), "K")):
                warnings.append(growing_in_words(model, negative))
            if rigid_count is None:
                # without nodes: eigenvalues that are zero to round-off
                rigid_count = count_below(model.mean_eigenvalue * ZERO, "K")
                report["modes_at_zero"] = rigid_count
            below = {limit: count_below((2 * np.pi * limit) ** 2, f"{limit:g} Hz") for limit in limits}
            counts = {f: None if None in (rigid_count, count) else count - rigid_count for f, count in below.items()}
            source = solver.source
        if set(counts.values()) - {None}:
            report["modes_counted_by"] = source.in_words
        if None in counts.values():
            rough = f"factors are too rough for that ({source.in_words})"
            warnings.append(f"modes are not counted: {rough}; leave low_rank out")
    else:
        counts = dict.fromkeys(limits)
    for limit, count in counts.items():
        if count is not None:
            progress.say(f"{count} elastic modes below {limit:g} Hz")
    if limits:
        report["elastic_modes_below_hz"] = [[limit, counts[limit]] for limit in limits]
    if band_top and counts[2 * band_top] is not None:
        report["size_hint"] = counts[2 * band_top] + len(model.input_names)
    return report | {"warnings": [*warnings, *rounded]}


def _definiteness(mass, factoring):
    """ "positive definite", "singular" or "indefinite", by the inertia of M; what the digits of files and round-off can
    have made negative, as where dofs have no mass or were condensed, counts as zero. Factors are full ones, since an
    approximate one tells nothing of a singular M."""
    factoring = factoring.exact()
    if not factoring.counts():
        return f"not known ({'complex PETSc' if is_complex() else factoring.solver.package})"
    found = _inertia_of(mass, factoring)
    if found != "indefinite":
        return found
    lifted, diagonal = mass.duplicate(copy=True), mass.getDiagonal()
    diagonal.abs()
    values = diagonal.getArray()
    smallest = mass.comm.tompi4py().allreduce(values[values > 0].min(initial=np.inf), op=MPI.MIN)
    values[values == 0] = smallest if np.isfinite(smallest) else 1.0
    diagonal.scale(NEGATIVE)
    lifted.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    lifted.setDiagonal(diagonal, addv=PETSc.InsertMode.ADD_VALUES)
    return "indefinite" if _inertia_of(lifted, factoring) == "indefinite" else "singular"


def _inertia_of(mass, factoring):
    with closing(factoring.package(mass, True, "inertia_", factoring, inertia=True, null_pivots=True)) as factors:
        try:
            factors.factor(mass="1", damping="0", inertia_relief=False)
        except SingularMatrix:
            return "singular"
        if factors.inertia is None:  # by PETSc options of a user
            return f"not known ({factors.source.in_words})"
        if factors.inertia:
            return "indefinite"
        return "singular" if factors.records[-1].null_pivots else "positive definite"


def _count_below(solver, square) -> int | None:
    """Return the number of eigenvalues of (K, M) below a square of rad/s: negative pivots of K - square M (Sylvester),
    None where the factor is too rough to tell."""
    for nudge in (1.0, 1 + 2e-9, 1 - 2e-9):
        try:
            solver.factor(-square * nudge)
            return solver.inertia
        except SingularMatrix:
            continue
    raise ComputationError(
        f"{np.sqrt(square) / (2 * np.pi):g} Hz is an eigenfrequency: modes below it cannot be counted"
    )
