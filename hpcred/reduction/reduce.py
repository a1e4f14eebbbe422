"""Reduce a model by the reductor that the arguments ask for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np

from ..linalg.solvers.settings import Factoring
from ..model.damping import Damping, damping_or_given
from ..model.frames import Frame, NoFrame
from ..model.parameters.parametric_model import ParametricModel
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.declared import declared, refuse_file, spelled_with
from ..parallel.failures import InputError
from ..parallel.progress import Progress
from .basis_reductor import BasisReductor
from .components import second_order_krylov  # noqa: F401  (a record may have its kind)
from .components.component import Component
from .parametric.settings import ParameterSearch
from .parametric_reductor import ParametricBasisReductor, ParametricReductor
from .reductor import Reductor
from .result.kinds import from_table, table_of
from .result.measure import Measure
from .result.record import BasisPart, UnknownPart
from .result.reduced_model import ReducedModel
from .run.store import Store
from .search.goal import Adaptive
from .settings import Reduction
from .tolerance_reductor import ToleranceReductor
from .two_sided import TwoSidedReductor

if TYPE_CHECKING:
    from typing_extensions import Unpack


class Accurately(TypedDict, total=False):
    """Fields of Adaptive that may be given without one."""

    tolerance: float | None
    band: Sequence[float] | np.ndarray | None
    measure: Literal["directions", "paper"] | Measure | None
    static: Literal["tolerance", "exact"] | None


class Asked(Accurately, total=False):
    """Fields of Adaptive and of Reduction that `reduce` takes as keywords."""

    deflation_tolerance: float | None
    drop_above: float | None
    projection: Literal["one_sided", "two_sided"] | None
    allow_unstable: bool | None
    groups: int | Literal["auto"] | None
    coordinates: Literal["modal", "interface"] | None


@spelled_with(Asked)
def reduce(
    model: SecondOrderModel | ParametricModel,
    basis: Component | Iterable[Component] = (),
    frame: Frame | None = None,
    damping: Damping | None = None,
    *,
    adaptive: Adaptive | None = None,
    parameter_search: ParameterSearch | None = None,
    parameter_points: Iterable[Mapping[str, float]] | None = None,
    settings: Reduction | None = None,
    factoring: Factoring | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
    **asked: Unpack[Asked],
) -> ReducedModel:
    """Reduce a model to a tolerance, or by projection onto the span of the components of a basis.

    Collective. The reduced model has V^T M V = I and diagonal V^T K V, but for a two-sided projection, where
    W^T M V = I. `model` is not changed.

    Parameters
    ----------
    model : SecondOrderModel or ParametricModel
        The tolerance holds over the ranges of the parameters too.
    basis : Component or iterable of Component, default ()
        Modes, Krylov, SecondOrderKrylov, StaticCorrection, ...; each extends what the ones before it gave. With a
        tolerance they come first, and may be left out.
    frame : Frame, optional
        Reference frame of a free body; by default none.
    damping : Damping, optional
        By default the damping matrix of the model, if it has one.
    tolerance : float, optional
        Points, orders and size are chosen so that eps(f) <= tolerance over the band; the record of the result has the
        error, and how it is known.
    band : sequence of 2 floats, optional
        Hz; belongs to the tolerance.
    measure, static : optional
        What eps is, and at 0 Hz, see Adaptive.
    adaptive : Adaptive, optional
        Tolerance and band with more settings, in place of these four.
    parameter_search : ParameterSearch, optional
        For a ParametricModel: at how many values errors are estimated, and at how many the model may be factored.
    parameter_points : iterable of mapping, optional
        For a ParametricModel without a tolerance: values by name at which the components of the basis are made; by
        default the reference values.
    settings : Reduction, optional
        Keywords that are its fields replace them.
    factoring : Factoring, optional
        How to factor, and in how much memory.
    store : Store, optional
        Where blocks of points and sets of modes are kept from one reduction to the next, so that no point is factored
        twice; PointStore is one in a folder.
    progress : Progress, optional
        By default one that shows stages and times on stderr once they take long.
    deflation_tolerance, drop_above, projection, allow_unstable, groups, coordinates : optional
        See Reduction.

    Returns
    -------
    ReducedModel
        For a ParametricModel a ParametricReducedModel.

    Raises
    ------
    InputError
        For settings or models that do not fit, the same on all ranks.
    ComputationError
        If a computation fails, as for lack of memory.

    Notes
    -----
    Equations (20), (32), (41-50) and (52-54) of Lehner and Eberhard (2006); the error is (55) or that of docs/theory.
    """
    # every argument as its declared type, or refused
    refuse_file("model", model, "reduce_job")
    parametric = isinstance(model, ParametricModel)
    require_model(model.model if parametric else model)
    keywords = {key: value for key, value in asked.items() if value is not None}
    accuracy = {key: keywords.pop(key) for key in Accurately.__annotations__ if key in keywords}
    settings = replace(declared("settings", settings, Reduction | None) or Reduction(), **keywords)
    declared("factoring", factoring, Factoring | None)
    declared("progress", progress, Progress | None)
    if store is not None and not isinstance(store, Store):
        raise InputError(f"store: found {store!r}, expected a Store, such as PointStore(folder)")
    if isinstance(basis, Reductor):
        raise InputError(f"basis: found {type(basis).__name__}, a Reductor; call its method reduce(model)")
    if isinstance(basis, tuple):  # that of a record
        basis = tuple(map(_known_part, basis))
    basis = declared("basis", (basis,) if isinstance(basis, Component) else basis or (), tuple[Component, ...])
    adaptive = _asked_accuracy(declared("adaptive", adaptive, Adaptive | None), **accuracy)
    frame = declared("frame", frame, Frame | None) or NoFrame()
    damping = damping_or_given(model.model if parametric else model, damping)
    points = declared("parameter_points", tuple(map(dict, parameter_points or ())), tuple[dict[str, float], ...])
    for key, value in (("parameter_search", declared("parameter_search", parameter_search, ParameterSearch | None)),
                       ("parameter_points", points or None)):  # fmt: skip
        if value is not None and not parametric:
            raise InputError(f"{key}: found it for a model without parameters; leave it out")
    # the reductor of the kind of model and goal
    progress = progress or Progress(model.comm)
    chosen = {"basis": basis, "frame": frame, "damping": damping, "settings": settings,
              "factoring": factoring or Factoring(), "store": store,
              "progress": progress}  # fmt: skip
    if parametric:
        if adaptive is None:
            if parameter_search is not None:
                raise InputError("parameter_search: found it without a tolerance, to which it belongs; leave it out")
            return progress.found(ParametricBasisReductor(**chosen, parameter_points=points).reduce(model))
        if points:
            raise InputError("parameter_points: found it beside a tolerance, which chooses them; leave it out")
        search = parameter_search or ParameterSearch()
        return progress.found(ParametricReductor(**chosen, goal=adaptive, parameter_search=search).reduce(model))
    if settings.projection == "two_sided" and model.Ct is not None:
        if adaptive is not None:
            raise InputError("projection: a reduction to a tolerance is one-sided, which keeps stability; leave it out")
        return progress.found(TwoSidedReductor(**chosen).reduce(model))
    reductor = BasisReductor(**chosen) if adaptive is None else ToleranceReductor(**chosen, goal=adaptive)
    return progress.found(reductor.reduce(model))


def _known_part(component):
    """Return a part of a basis, made anew where a record was read before its class was known. Raises InputError."""
    if not isinstance(component, UnknownPart):
        return component
    try:
        part = from_table(BasisPart, UnknownPart, table_of(component))
    except ValueError as error:
        fault = f"found the kind '{component.kind}' with settings that it does not take"
        raise InputError(f"basis: {fault}: {error}") from error
    if isinstance(part, UnknownPart):
        raise InputError(f"basis: found the kind '{component.kind}', whose class is not known here; import it first")
    return part


def _asked_accuracy(adaptive, tolerance=None, band=None, **more) -> Adaptive | None:
    """Return the settings of a search: `adaptive`, or those of a tolerance, its band and `more`; None for neither."""
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


