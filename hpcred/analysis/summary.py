"""Report on a model before it is reduced: what it has, what that means in sentences, and what looks wrong.

`hpcred info`, `convert`, `plan` and the reports take what `inspect` finds.
"""

from contextlib import closing

import numpy as np

from ..fe.dofs import DIRECTIONS
from ..fe.materials import properties_in_words
from ..linalg.csr import diagonal_of
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
from ..model.digits import digits_of
from ..model.loads.columns import loads_of
from ..model.order_of_matrices import questions_on_order
from ..model.rigid_body.modes import exchange_of_matrices, remark_on_digits, rigid_body_quantities, warnings_of_nodes
from ..model.rigid_body.rows_alone import warnings_of_rows_alone
from ..model.rigid_body.support import support_of
from ..model.second_order_model import SAY_SO, massless, require_model
from ..parallel.declared import declared
from ..parallel.failures import ComputationError
from ..parallel.petsc import MPI, PETSc, is_complex
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, within
from .frequency_response import checked_frequencies
from .likely_units import extent, likely_units, warnings_of_units
from .natural_modes import natural_modes

FEW_DIGITS = 13  # decimal ones of K, from which on they are not worth a word
CLEARLY_FREE, NEARLY_FREE = 1e-12, 1e-5  # ||K R|| / (||K|| ||R||)
IN_MOST = 0.3  # share of rows that few digits let resist, and supports seldom
NEGATIVE = 1e-9  # eigenvalue of M relative to its diagonal that files of ten digits make of zero


def inspect(
    model, frequencies=(), band_top=None, *, modes: int | None = None, verify: bool = False,
    factoring: Factoring | None = None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Summarise sizes, symmetry, definiteness, mass, rigid-body modes, and modes below frequencies. Collective.

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

    Returns
    -------
    dict
        Counts are None without a real build and a package that tells the inertia, and where factors are too rough for
        that; `modes_counted_by`: the source of counts, where there are any. `sets`: number of nodes by name of
        the node set. `sentences` say what the numbers mean, `warnings` what looks wrong.
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
        "nodes": 0 if model.dofs is None else model.node_count,
    }
    # definiteness of M, by a factor only where that was asked for
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
    if report["mass_matrix"] == "indefinite" and not indefinite:
        signs.append(f"{model.name}: M is indefinite by the inertia of its factor, which no mass matrix is")
    # terms, materials, sets and loads
    report |= model.declared | model.operator.families
    if model.converted_from:
        report["converted_from"] = model.converted_from
    if model.properties is not None:
        report |= properties_in_words(model.properties, model.comm)
    if sets := model.set_sizes:
        report["sets"] = sets
    if loads := loads_of(model):
        report["loads"] = [load.row for load in loads]
    # the lowest modes
    if frequencies or band_top or modes is not None:
        check_definite(model)
    first, rounded = None, ()
    if modes is not None:
        lowest = natural_modes(model, min(modes, model.size), factoring=factoring, progress=progress)
        report["lowest_frequencies_hz"] = lowest.frequencies.tolist()
        rounded = lowest.warnings
        first = next(iter(lowest.frequencies[lowest.rigid :].tolist()), None)
    # the body that the nodes make of it
    sentences, rigid_count = [_on_symmetry(model)], None
    exchanged = exchange_of_matrices(model)
    asked = [exchanged] if exchanged and model.dofs is None else questions_on_order(model)
    warnings = list(model.remarks) + _on_unsymmetric(model) + signs + _on_diagonals(model) + asked
    warnings += warnings_of_rows_alone(model)
    if model.dofs is not None:
        support = support_of(model)
        rigid_count = support.movable.shape[1]
        body, warnings = _of_body(model, support, exchanged, warnings, first)
        report |= body
        sentences.append(_on_rigid_motions(support))
        if body["units"]:
            sentences.append(
                f"looks like {body['units']}: from the mass, the size, and the speed of waves between neighbouring "
                "nodes"
            )
    if (digits := digits_of(model.K) or FEW_DIGITS) < FEW_DIGITS:
        sentences.append(f"K has {digits} digits; modes, responses and reductions warn of frequencies without any")
    # modes below frequencies, by inertia
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
    return report | {"sentences": sentences, "warnings": list(dict.fromkeys([*warnings, *rounded]))}


def _of_body(model, support, exchanged, warnings, first):
    """Return what M and K make of the rigid motions of the nodes, and all warnings; `first`: see warnings_of_units.
    Collective."""
    body, (low, high) = rigid_body_quantities(model), extent(model)
    held, count = 0 if model.held is None else len(model.held.node), support.movable.shape[1]
    report = {
        "mass_kg": body.mass,
        "masses_in_x_y_z_kg": body.masses.tolist(),
        "centre_of_mass_m": _known(body.centre),
        "inertia_kg_m2": _known(body.inertia),
        "extent_m": [low.tolist(), high.tolist()],
        "rigid_body_modes": count,
        "rigid_body_residuals": _known(support.residuals),
        "held_dofs": model.comm.allreduce(held),
        "units": likely_units(model, body.mass, high - low),
    }
    # what looks wrong
    if exchanged:
        warnings = [exchanged, *warnings]  # all others follow from it
    else:
        warnings = warnings + _on_held_dofs(model, body, report["held_dofs"]) + warnings_of_nodes(model)
        warnings += warnings_of_units(model, body.mass, first)
    if soft := count - support.free.shape[1]:
        report["softly_held"] = soft
        warnings.append(
            f"{model.name}: {soft} of the {count} rigid-body motions meet{'s' * (soft == 1)} up to "
            f"{support.forces.max():.0e} of the stiffness of a row: soft supports, or few digits of K"
        )
    if few := remark_on_digits(support):
        warnings.append(f"{model.name}: {few}")
    return report, warnings


def _on_symmetry(model):
    worst = {key: defect for key, defect in model.symmetry_defects.items() if defect > 0}
    if not worst:
        return f"{', '.join(model.matrices)} are symmetric"
    listed = ", ".join(f"{key} {defect:.1e}" for key, defect in worst.items())
    if model.symmetric:
        return f"{', '.join(model.matrices)} are symmetric to round-off: max |a_ij - a_ji| / |a_ij| is {listed}"
    return f"not all of {', '.join(model.matrices)} are symmetric: max |a_ij - a_ji| / |a_ij| is {listed}"


def _on_unsymmetric(model):
    wrong = [key for key in "KM" if not model.is_symmetric(key) and not model.may_be_unsymmetric(key)]
    return [f"{model.name}: {key} is not symmetric, and cannot be reduced"
            f"{f', unless it is meant to be so ({SAY_SO})' * (key == 'K')}; a damaged file looks so too"
            for key in wrong]  # fmt: skip


def _on_diagonals(model):
    warnings = []
    if model.D is not None and model.comm.allreduce(float(diagonal_of(model.D).sum())) < 0:
        warnings.append(f"{model.name}: D has a negative trace, -D? Expected M q'' + D q' + K q = B u")
    if count := massless(model):
        warnings.append(f"{model.name}: {count} rows have no mass on the diagonal of M, which is singular")
    return warnings


def _known(values):
    """Return numbers as nested lists, None for what is not known."""
    return np.where(np.isnan(values), None, values).tolist()


def _on_rigid_motions(support):
    """Return a sentence on what K says to the rigid-body motions, of which so many combinations meet no force."""
    residuals, count = support.residuals, support.free.shape[1]
    worst, moving = np.nanmax(residuals), np.isfinite(residuals)
    still = [name for name, moves in zip("xyz", moving, strict=False) if not moves]
    plane = f"; no node has a dof in {' or '.join(still)}" if still else ""
    text = f"||K R|| / (||K|| ||R||) of the rigid-body motions R is at most {worst:.1e}"
    if not support.resisting:
        exact = "" if worst < CLEARLY_FREE else ", to the digits of the files"
        return f"{text}: a free body, which no rigid-body motion loads{exact}{plane}"
    if worst < NEARLY_FREE and support.resisting > IN_MOST:
        return (
            f"{text}: neither clearly free nor held; a free body whose K came with few digits looks so, and its "
            f"rigid-body modes are then not at 0 Hz{plane}"
        )
    if support.movable.shape[1] > count:
        return (
            f"{text}: a softly held body, which meets up to {support.forces.max():.0e} of the stiffness of a row, in "
            f"{100 * support.resisting:.2g} % of the rows{plane}"
        )
    round_off = np.repeat(support.round_off, 3)
    free = [name for name, force, limit, moves in zip(DIRECTIONS[:6], support.forces, round_off, moving, strict=True)
            if moves and force <= limit]  # fmt: skip
    ways = f", free in {', '.join(free)}" if free else ""
    if count > len(free):
        ways = f", with {count} rigid-body motion{'s' * (count > 1)} that K does not resist"
    return f"{text}: a held body{ways}{plane}"


def _on_held_dofs(model, body, count):
    if not count:
        return []
    return [
        f"{model.name}: the program that wrote the matrices holds {count} dofs, which have no row; the mass of "
        f"{body.mass:.6g} is without theirs, too small for the floating frame of a body; export the body free, without "
        "supports, and hold it here by a frame or by joints"
    ]


def _definiteness(mass, factoring):
    """ "positive definite", "singular" or "indefinite", by the inertia of M; what the digits of files and round-off can
    have made negative, as where dofs have no mass or were condensed, counts as zero. Factors are full ones, since an
    approximate one tells nothing of a singular M."""
    factoring = factoring.exact()
    if not factoring.counts():
        return f"not known ({'complex PETSc' if is_complex() else factoring.solver.package})"
    sign = _inertia_of(mass, factoring)
    if sign != "indefinite":
        return sign
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
