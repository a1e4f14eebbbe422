"""Reduce a model in its frame and with its damping, by a list of basis components or to a tolerance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from typing import Literal

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import apply, copy_of, create_block
from ..linalg.solvers.base import DoesNotFit
from ..linalg.solvers.settings import Factoring
from ..model.damping import Damping, ModalDamping, NoDamping, damping_or_given, doubts_of_damping, loss_factor_of
from ..model.definiteness import check_definite, doubts_of_definiteness, growing
from ..model.digits import doubts_of_digits
from ..model.frames import Buckens, Frame, NoFrame, apply_frame, inputs_without_effect
from ..model.interfaces import doubts_of_interfaces
from ..model.port_counts import require_room
from ..model.rigid_body_modes import doubts_of_nodes, exchange_of_matrices, soft_supports
from ..model.scales import scaled, scales_of
from ..model.second_order_model import SYMMETRIC_TO, SecondOrderModel, require_inputs, require_model
from ..parallel.decisions import decided
from ..parallel.declared import declared, spelled
from ..parallel.failures import ComputationError, InputError, Owned
from ..parallel.petsc import MPI, free_dropped
from ..parallel.progress import Progress
from ..parallel.stopping import stop_if_asked
from .components.component import Component, PointComponent
from .components.craig_bampton import ConstraintModes
from .components.groups import blocks_in_groups, number_of_groups
from .components.krylov import StaticCorrection
from .components.krylov_sequence import Store
from .interface_coordinates import Projected, check_interface_coordinates, elastic_part, to_interface_coordinates
from .projection import diagonalise, project, project_columns
from .record import make_record, signature_of
from .reduced_damping import reduced_damping
from .reduced_model import ReducedModel
from .reductor import Reductor
from .run import Run, identity_of_model
from .settings import Reduction
from .tolerance.accuracy import Accuracy, Adaptive
from .tolerance.projections import Projections
from .tolerance.round_off import with_round_off
from .tolerance.search import Search, deflation_of_search
from .two_sided import biorthogonal

ORTHONORMAL_TO = 1e-12
ROOM = 96  # columns that a search is expected to need
BEYOND = 10.0  # times the highest frequency of a single node: a mesh has modes up to about five times that


@spelled
def reduce(
    model: SecondOrderModel,
    basis: Component | Iterable[Component] = (),
    frame: Frame | None = None,
    damping: Damping | None = None,
    *,
    tolerance: float | None = None,
    band: Sequence[float] | np.ndarray | None = None,
    measure: Literal["directions", "paper"] | None = None,
    static: Literal["tolerance", "exact"] | None = None,
    adaptive: Adaptive | None = None,
    settings: Reduction | None = None,
    factoring: Factoring | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
    deflation_tolerance: float | None = None,
    drop_above: float | None = None,
    projection: Literal["one_sided", "two_sided"] | None = None,
    allow_unstable: bool | None = None,
    groups: int | Literal["auto"] | None = None,
    coordinates: Literal["modal", "interface"] | None = None,
) -> ReducedModel:
    """Reduce a SecondOrderModel by projection onto the span of the components. Collective.

    `tolerance` and `band` (Hz), or an Adaptive with more to say: expansion points, orders and size are chosen so that
    eps(f) <= tolerance over the band, and the record says how large the error is and how that is known; `measure` and
    `static`: see Adaptive. `basis`: list
    of Modes, Krylov, SecondOrderKrylov, StaticCorrection; each extends what the ones before it gave. With a tolerance
    they come first, and may be left out. `store`: where the blocks of points and sets of modes are kept from one
    reduction to the next, so that no point is factored twice (PointStore is one in a folder).
    `frame`: Tangent, Chord, Buckens or None; `damping`: Rayleigh, Caughey, GivenDamping, ModalDamping, Structural or
    NoDamping, by default the damping matrix of the model if it has one. The keywords from `deflation_tolerance` on are
    those of Reduction, and replace those of `settings`.

    The reduced model has V^T M V = I and diagonal V^T K V (but for a two-sided projection, W^T M V = I).
    Raises InputError or ComputationError, the same on all ranks; `model` is not changed.
    """
    require_model(model)
    free_dropped(model.comm)
    given = {
        "deflation_tolerance": deflation_tolerance, "drop_above": drop_above, "projection": projection,
        "allow_unstable": allow_unstable, "groups": groups, "coordinates": coordinates,
    }  # fmt: skip
    settings = replace(
        declared("settings", settings, Reduction | None) or Reduction(),
        **{key: value for key, value in given.items() if value is not None},
    )
    declared("factoring", factoring, Factoring | None)
    declared("progress", progress, Progress | None)
    if store is not None and not isinstance(store, Store):
        raise InputError(f"store: found {store!r}, expected a Store, such as PointStore(folder)")
    if isinstance(basis, Reductor):
        raise InputError(f"basis: found {type(basis).__name__}, a Reductor; call its method reduce(model)")
    basis = declared("basis", (basis,) if isinstance(basis, Component) else basis or (), tuple[Component, ...])
    adaptive = _asked_accuracy(
        declared("adaptive", adaptive, Adaptive | None), tolerance, band, measure=measure, static=static
    )
    frame = declared("frame", frame, Frame | None) or NoFrame()
    damping = damping_or_given(model, damping)
    given = {"basis": basis, "frame": frame, "damping": damping, "adaptive": adaptive,
             "settings": settings, "factoring": factoring or Factoring(), "store": store,
             "progress": progress or Progress(model.comm, show=False)}  # fmt: skip
    inputs, outputs = scales_of(model)
    if (inputs, outputs) == (1.0, 1.0):
        reduced = _reduce(model, **given)
    else:
        with scaled(model, inputs, outputs) as usual:
            reduced = _reduce(usual, **given)
        reduced.B, reduced.C = reduced.B * inputs, reduced.C * outputs
        accuracy = reduced.record.accuracy
        reduced.record = replace(
            reduced.record, signature=signature_of(model), accuracy=accuracy and accuracy.times(inputs, outputs)
        )
    reduced.model = model.shared()
    return reduced


def _reduce(model, basis, frame, damping, adaptive, settings, factoring, store, progress) -> ReducedModel:
    """reduce() with what it was given checked and complete, in usual units."""
    progress.expect(model.size)
    warnings = _check(model, frame, damping, adaptive, settings)
    for doubt in doubts_of_band(model, adaptive):  # before a search that may take long for that reason
        progress.tell(doubt)
        warnings += (doubt,)
    with Owned(model.comm) as owned:
        with progress.stage("frame"):
            framed = owned.owns(apply_frame(model, frame, damping))
            warnings += inputs_without_effect(framed)
        deflation = settings.deflation_tolerance if adaptive is None else deflation_of_search(framed.model)
        columns = _check_size(framed, basis, adaptive)
        run = Run(framed, progress, deflation, factoring, inertia=adaptive is not None, columns=columns)
        runs = [owned.owns(run)]
        if store is not None:
            with progress.stage("store"):
                asked = {"frame": frame, "damping": damping, "basis": [asdict(item) for item in basis]}
                run.store, run.identity = store, identity_of_model(model, framed, **asked)
        if _is_two_sided(model, settings):
            runs.append(owned.owns(run.dual()))
        bases = [owned.owns(Basis(run.mass, framed.rigid_columns, deflation, columns, run.keeps_images)) for _ in runs]
        points = sum(isinstance(item, PointComponent) for item in basis) if adaptive is None else model.comm.size
        groups = number_of_groups(settings.groups, run, points)
        kept = range(0)
        if adaptive is not None and (settings.coordinates == "interface" or adaptive.static == "exact"):
            kept = _kept_columns(bases[0], run, adaptive, settings)
        _extend_by_all(basis, bases, runs, groups, last=adaptive is None)
        accuracy = projections = None
        if adaptive is not None:
            accuracy, projections = _to_tolerance(bases[0], run, adaptive, groups, settings, kept)
        for each in runs:
            run.massless |= each.massless
            each.release()
        if not all(vectors.size for vectors in bases):
            raise InputError("basis: no vector is left; no mode lies in the bands and no input loads the body")
        with progress.stage("project"):
            projected = _project if len(bases) == 1 else _project_two_sided
            reduced, defect = projected(model, framed, *bases, run, settings)
        if framed.rigid is not None and adaptive is None:
            run.check_free_motions(float(reduced.frequencies.min()), _highest(basis, run))
        if accuracy is not None:
            with progress.stage("estimate"):
                elastic = elastic_part(reduced, framed.rigid_size if reduced.interfaces else 0)
                accuracy = with_round_off(accuracy, elastic, projections)
        reduced.record = make_record(
            model, framed, runs, progress, frame=frame, damping=damping, basis=basis, groups=groups,
            projection="one_sided" if len(bases) == 1 else "two_sided", deflation_tolerance=deflation,
            drop_above=settings.drop_above, coordinates=settings.coordinates, orthonormality_defect=defect,
            warnings=(*(accuracy.warnings if accuracy is not None else ()), *warnings, *run.warnings),
            accuracy=accuracy,
            unstable_poles=tuple((pole.real, pole.imag) for pole in reduced.unstable_poles().tolist()),
        )  # fmt: skip
        return reduced


def _check(model, frame, damping, adaptive, settings) -> tuple[str, ...]:
    """Refuse what cannot be reduced in this way; returns what is doubtful of the model. Collective."""
    check_model(model)
    require_room(model, *([0] if adaptive is None else []))
    if _is_two_sided(model, settings):
        _check_two_sided(settings, damping, adaptive)
    if settings.coordinates == "interface":
        check_interface_coordinates(model, frame)
    doubts = doubts_of_damping(damping)
    if model.D is not None and isinstance(damping, NoDamping):
        doubts += (f"damping: none, though {model.name} has a damping matrix, which kind = 'given' takes",)
    return warnings_of(model, frame) + doubts


def _is_two_sided(model, settings):
    return settings.projection == "two_sided" and model.Ct is not None


def _asked_accuracy(adaptive, tolerance, band, **more) -> Adaptive | None:
    """What a search is to reach: `adaptive`, or a tolerance, its band and what `more` says; None for neither."""
    more = {key: value for key, value in more.items() if value is not None}
    if tolerance is None and band is None and not more:
        return adaptive
    if adaptive is not None:
        raise InputError("adaptive: found it beside a tolerance, a band or what belongs to them; leave one out")
    if band is None and tolerance is not None:
        raise InputError("tolerance: a reduction to a tolerance needs the band in Hz")
    if tolerance is None:
        key = next(iter(more), "band")
        raise InputError(f"{key}: found it without a tolerance, to which it belongs; give both, or leave it out")
    return Adaptive(tolerance=tolerance, band=band, **more)


def _check_two_sided(settings, damping, adaptive):
    """Refuse what a two-sided projection does not go with."""
    if adaptive is not None:
        raise InputError("projection: a reduction to a tolerance is one-sided, which keeps stability; leave it out")
    if settings.drop_above is not None or isinstance(damping, ModalDamping):
        raise InputError(
            "projection: 'two_sided' leaves no diagonal model, which drop_above and modal damping need; "
            "take 'one_sided'"
        )
    if settings.coordinates == "interface":
        raise InputError("projection: interface coordinates belong to a one-sided projection; leave it out")


def _extend_by_all(basis, bases, runs, groups, last):
    """Extend each of the bases, with its run, by all components; `last`: whether nothing comes after them."""
    ready = blocks_in_groups(basis, runs, groups) if groups > 1 else {}
    for i, component in enumerate(basis):
        runs[0].progress.step("points and modes", i, len(basis), always=True)
        for r, (vectors, run) in enumerate(zip(bases, runs, strict=True)):
            if (i, r) in ready:
                ready[i, r].join(vectors, run)
            else:
                component.extend(vectors, run)
        if i + 1 < len(basis) or not last:
            stop_if_asked(runs[0].model.comm, f"part {i + 1} of the basis")


def _highest(basis, run) -> float:
    """The highest point or mode (Hz) that a basis was made for."""
    points = [abs(getattr(item, "point", 0.0)) for item in basis if isinstance(item, PointComponent)]
    modes = [max(item.frequencies_hz) for item in run.components if item.frequencies_hz]
    return max([*(point / 2 / np.pi for point in points if np.isfinite(point)), *modes], default=0.0) or np.inf


def doubts_of_band(model, adaptive) -> tuple[str, ...]:
    """A band that ends far above all that the mesh follows, as one in other units does. Collective."""
    if adaptive is None:
        return ()
    K, M = (matrix.getDiagonal() for matrix in (model.K, model.M))
    stiffness, mass = K.getArray(readonly=True).real, M.getArray(readonly=True).real
    ratios = stiffness[mass > 0] / mass[mass > 0]
    highest = np.sqrt(max(model.comm.allreduce(ratios.max(initial=0.0), op=MPI.MAX), 0.0)) / 2 / np.pi
    K.destroy()
    M.destroy()
    if not 0 < BEYOND * highest < adaptive.band[1]:
        return ()
    return (
        f"band: it ends at {adaptive.band[1]:g} Hz, while single nodes of {model.name} vibrate at {highest:.2g} Hz at "
        "most, which no mesh follows; is the band in Hz, and are M and K in the units of one system?",
    )


def check_model(model):
    """Refuse a model that cannot be reduced: an unsymmetric M or K, one of the other sign, no inputs."""
    check_symmetric(model)
    check_definite(model)
    require_inputs(model)


def check_symmetric(model):
    """Refuse an unsymmetric M or K."""
    for key in ("M", "K"):
        if model.symmetry_defects[key] > SYMMETRIC_TO:
            raise InputError(
                f"{model.name}: matrix {key} is not symmetric: ||A - A^T|| / ||A|| = "
                f"{model.symmetry_defects[key]:.1e}, expected round-off (below {SYMMETRIC_TO:g})"
            )


def warnings_of(model, frame) -> tuple[str, ...]:
    """What is doubtful of the model; refused where the frame depends on it."""
    signs = tuple(doubts_of_definiteness(model))
    if model.dofs is None:
        return signs
    exchanged = exchange_of_matrices(model)
    doubts = (exchanged,) if exchanged else tuple(doubts_of_nodes(model))  # all else follows from it
    if doubts and isinstance(frame, Buckens):
        raise InputError(doubts[0])
    if isinstance(frame, Buckens) and (soft := soft_supports(model).max(initial=0.0)):
        doubts += (
            f"frame: {model.name} counts as free, but K resists translations by up to {soft:.1e} of its diagonal: soft "
            "springs to the ground, which the Buckens frame leaves out, have to be put into the multibody model",
        )
    return (*signs, *doubts, *doubts_of_interfaces(model))


def _kept_columns(vectors, run, adaptive, settings) -> range:
    """The columns, first in the basis, that stay in its span: by which interfaces move in interface coordinates, as the
    responses may not need it, and the deflections at 0 Hz where these are to be exact."""
    if settings.coordinates == "interface":
        ConstraintModes().extend(vectors, run)
    if adaptive.static == "exact":
        StaticCorrection().extend(vectors, run)
    if adaptive.static == "exact" and settings.drop_above is not None:
        raise InputError("drop_above: found it beside static = 'exact', whose deflections it may cut; leave one out")
    rigid = _rigid_beside(run, settings)
    if adaptive.size is not None and adaptive.size < rigid + vectors.size:
        raise InputError(
            f"adaptive.size: found {adaptive.size}, expected at least {rigid + vectors.size}, by which the interfaces "
            "can move, or deflect at 0 Hz (static = 'exact')"
        )
    return range(vectors.size)


def _rigid_beside(run, settings) -> int:
    """Coordinates of rigid-body motion, which interface coordinates of a free body have besides."""
    return run.framed.rigid_size if settings.coordinates == "interface" else 0


def _to_tolerance(vectors, run, adaptive, groups, settings, kept) -> tuple[Accuracy, Projections]:
    """Extend the basis until the tolerance is proven, and compress it; what is known of it, and its projections. The
    columns `kept` stay in the span."""
    before = vectors.size
    try:
        search, factor, accuracy = _search(vectors, run, adaptive, groups, settings, kept)
    except DoesNotFit as error:
        if vectors.size > before or not run.solvers.give_up_factors(error):
            raise
        search, factor, accuracy = _search(vectors, run, adaptive, groups, settings, kept)
    run.note("compressed", vectors.size, factor.shape[1])
    vectors.multiply(factor)
    return accuracy, search.projections


def _search(vectors, run, adaptive, groups, settings, kept):
    """The search, the factor that compresses its basis, and what is known of it; the columns `kept` stay in its span.
    """
    search = Search(vectors, run, adaptive, groups)
    return search, *search.compress(search.search(), settings.drop_above, kept, _rigid_beside(run, settings))


def _check_size(framed, basis, adaptive) -> int:
    """Refuse a basis that cannot fit before anything is factored; returns how many vectors are asked for."""
    if not basis and adaptive is None:
        raise InputError("basis: the list of components is empty, and no tolerance is asked for")
    model, rigid = framed.model, framed.rigid_size
    for item in basis:
        item.check(model.size, rigid)
    columns = sum(item.columns(model.B.getSize()[1], rigid) for item in basis)
    for item in basis:
        if item.per_direction is not None and not model.interfaces:
            raise InputError(f"basis: {item.kind} needs at least one [[interface]]")
        columns += 6 * len(model.interfaces) * (item.per_direction or 0)
    if columns > model.size - rigid:
        raise InputError(
            f"basis: {columns} vectors asked for, but {model.name} has only {model.size - rigid} elastic "
            "coordinates in this frame; ask for fewer modes, points or lower orders"
        )
    return max(columns, 1) if adaptive is None else columns + min(ROOM, adaptive.columns)


def _project(model, framed, vectors, run, settings):
    """The diagonalised reduced model with its basis in all dofs, and the orthonormality defect."""
    full, drop_above = framed.model, settings.drop_above
    squares = diagonalise(vectors, project(full.K, vectors.columns))
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    if drop_above is not None:
        kept = int((frequencies <= drop_above).sum())
        if kept == 0:
            raise InputError(f"drop_above: no pseudo-frequency lies below {drop_above:g} Hz")
        run.note(f"pseudo-frequencies up to {drop_above:g} Hz", len(frequencies), kept)
        vectors.multiply(np.eye(len(frequencies))[:, :kept])
        squares, frequencies = squares[:kept], frequencies[:kept]
    mass, defect = vectors.gram()
    if defect > ORTHONORMAL_TO:
        raise ComputationError(
            f"the basis has lost its orthonormality: max |V^T M V - I| = {defect:.1e}, allowed is {ORTHONORMAL_TO:g}"
        )
    columns = vectors.columns
    run.remarks += doubts_of_digits(model, full.K, squares, columns)
    if not doubts_of_definiteness(model) and (unstable := growing(model, squares)):
        run.remarks.append(unstable)
    small = {"M": mass, "K": np.diag(squares)}
    if "D" in full.matrices:
        small["D"] = project(full.matrices["D"], columns)
    else:
        small["D"] = reduced_damping(framed.damping, small["K"], frequencies)
    for key, value in small.items():
        if key != "D" or full.symmetric:
            small[key] = (value + value.T) / 2
    inputs = project_columns(columns, full.B)
    outputs = (inputs if full.Ct is None else project_columns(columns, full.Ct)).T.copy()
    if settings.coordinates == "interface":
        with Owned(model.comm) as owned:
            moved = to_interface_coordinates(framed, Projected(columns, **small, B=inputs, C=outputs))
            owned.owns(moved.columns)
            small = {"M": moved.M, "D": moved.D, "K": moved.K}
            frequencies = np.concatenate([np.zeros(framed.rigid_size), frequencies])
            reduced = _reduced_model(model, framed, small, moved.B, moved.C, frequencies)
            reduced.interfaces = full.interfaces
            reduced.columns = everywhere(model, framed, moved.columns)
            return reduced, defect
    reduced = _reduced_model(model, framed, small, inputs, outputs, frequencies)
    reduced.columns = everywhere(model, framed, columns)
    return reduced, defect


def _project_two_sided(model, framed, right, left, run, settings):
    """The reduced model of a two-sided projection (20), its poles checked, and the biorthonormality defect."""
    full = framed.model
    squares = diagonalise(right, project(full.K, right.columns))
    run.remarks += doubts_of_digits(model, full.K, squares, right.columns)
    defect = biorthogonal(left, right, run)
    V, W = right.columns, left.columns
    small = {key: project(mat, V, W) for key, mat in full.matrices.items()}
    frequencies = np.sort(np.sqrt(np.abs(np.linalg.eigvals(small["K"])))) / (2 * np.pi)
    if "D" not in small:
        small["D"] = reduced_damping(framed.damping, small["K"], frequencies)
    inputs, outputs = project_columns(W, full.B), project_columns(V, full.Ct)
    reduced = _reduced_model(model, framed, small, inputs, outputs.T.copy(), frequencies)
    unstable = decided(model.comm, reduced.unstable_poles)
    if len(unstable) and not settings.allow_unstable:
        listed = ", ".join(f"{pole.real:.3g}{pole.imag:+.4g}i" for pole in unstable[:6])
        raise InputError(
            f"projection: the two-sided reduced model is unstable, with {len(unstable)} poles in the right "
            f"half-plane ({listed}{', ...' if len(unstable) > 6 else ''} rad/s); take projection = 'one_sided', "
            "which keeps stability, or allow_unstable = true for frequency responses only"
        )
    reduced.columns, reduced.left_columns = (everywhere(model, framed, block) for block in (V, W))
    return reduced, defect


def _reduced_model(model, framed, small, inputs, outputs, frequencies):
    """The same arrays on all ranks, to the last digit."""
    small, inputs, outputs, frequencies = model.comm.bcast((small, inputs, outputs, frequencies))
    loss = loss_factor_of(framed.damping)
    return ReducedModel(
        **small, B=inputs, C=outputs, frequencies=frequencies, loss_factor=loss,
        input_names=model.input_names, output_names=model.output_names,
    )  # fmt: skip


def everywhere(model, framed, columns):
    """A basis of the framed model in all dofs of `model`, as a new block. Collective."""
    if framed.restore is None:
        return copy_of(columns, model.K)
    first, last = columns.getActiveColumns()
    result = create_block(model.K, last - first)
    apply(framed.restore, columns, result)
    return result
