"""Collect the contents of a report for each result, as a Sheet with its responses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..analysis.campbell_diagram import Campbell
from ..analysis.error import Errors, as_compared, errors_of
from ..analysis.error_check import measuring_damping
from ..analysis.frequency_response import frequencies_to_draw, frequency_response, resonances_of
from ..analysis.likely_units import extent, likely_units
from ..files.result_file import Result, read_result
from ..model.damping import Damping
from ..model.rigid_body.modes import rigid_body_quantities
from ..parallel.declared import declared
from ..parallel.failures import InputError
from ..parallel.progress import Progress
from ..parallel.ranges import SAMPLES, within
from ..reduction.interface_coordinates import elastic_part
from ..reduction.result.kinds import table_of
from ..reduction.result.record import difference_between
from ..reduction.result.reduced_model import ReducedModel, as_measured
from ..report.tables import in_words
from .evaluate import band_of, short_names
from .full_model import factoring_of, full_of_record, start_for
from .report_campbell import diagrams_of
from .stress_state import StressOfMotion

BESIDE = 1.0003  # times a pseudo-frequency
BESIDE_AT_MOST = 8  # frequencies beside pseudo-frequencies
MOST_MODES = 40  # of the full model


@dataclass(frozen=True)
class FullSolution:
    """The response (E, r, p) of a full model at `frequencies` (E,) in Hz, that of its inputs where they act (E, p), and
    its lowest `modes` in Hz."""

    frequencies: np.ndarray
    response: np.ndarray
    drive: np.ndarray
    modes: np.ndarray


@dataclass
class Sheet:
    """What a report says of one result: the file, the reduced model as it is `measured`, the `damping` of the full
    model for that, with `words` on it; its response (F, r, p) at `frequencies` (F,) in Hz over the band.

    With a full model: `full`, which may be that of a sheet before (`full_as_before`), and the `errors` at its
    frequencies. `body`: shapes for the page and a sentence, by body_for_page. `has_stress`: whether the result has
    stress modes. `moved`: stresses of a motion, and `motion` their picture for the page, by motion_for_page.
    `diagrams`: poles over each parameter.
    """

    name: str
    result: Result
    measured: ReducedModel
    damping: Damping
    words: str
    band: tuple[float, float]
    frequencies: np.ndarray
    response: np.ndarray
    full: FullSolution | None = None
    full_as_before: bool = False
    errors: Errors | None = None
    body: dict | None = None
    body_sentence: str = ""
    has_stress: bool = False
    moved: StressOfMotion | None = None
    motion: dict | None = None
    diagrams: list[Campbell] = field(default_factory=list)
    notes: list = field(default_factory=list)

    @property
    def reduced(self):
        """Without the rigid-body motion that interface coordinates have, as estimates and the full response are."""
        return elastic_part(self.result.reduced)

    @property
    def directions(self):
        """How well each output is known, the worst first: against the full model, else as estimated."""
        if self.errors is not None:
            return self.errors.directions
        return self.record.accuracy.directions if self.record.accuracy is not None else ()

    @property
    def record(self):
        return self.result.reduced.record


def sheets_of(
    results, full=None, *, band=None, solves: int = 21, groups=None, factoring=None, at=None, comm=None, progress=None
) -> list[Sheet]:  # fmt: skip
    """Return a Sheet for every result, at values of its parameters, with the full model's response where `full` names
    its file. Collective."""
    progress = progress or Progress(comm, show=False)
    if not results:
        raise InputError("report: no result; give the name of at least one result.h5")
    within("solves", declared("solves", solves, int), SAMPLES)
    if solves < 2:
        raise InputError(f"solves: found {solves}, expected at least 2 frequencies")
    whole = [read_result(path, comm) for path in results]
    read = [result.at(**at) if at else result.at_reference() for result in whole]
    for result in read:
        if result.reduced.record is None:
            raise InputError(f"{result.path}: has no record of its reduction, which a report is about")
    sheets = [_sheet(name, result, read, band) for name, result in zip(short_names(results), read, strict=True)]
    for sheet, result in zip(sheets, whole, strict=True):
        sheet.diagrams = diagrams_of(result, sheet.notes, at or {})
    if full is not None:
        start_for([sheet.damping for sheet in sheets], factoring or factoring_of(sheets[0].record))
        for k, sheet in enumerate(sheets):
            with progress.stage("full model", sheet.name):
                _add_full(sheet, full, solves, sheets[:k], groups, factoring, comm, progress)
    return sheets


def _sheet(name, result, read, band):
    """Return the Sheet of one of the results, without the full model."""
    reduced, accuracy = elastic_part(result.reduced), _measuring(result, read)
    damping = reduced.record.damping
    words = f"measured with the damping of the job: {kind_in_words(damping)}"
    if accuracy is not None:
        reduced, damping = as_measured(reduced, accuracy), measuring_damping(accuracy, damping)
        words = accuracy.measured
    limits = tuple(band or band_of(result.reduced, [other.reduced for other in read]))
    if accuracy is None:
        reduced, damping, told = as_compared(reduced, limits)
        words = told or words
    grid = frequencies_to_draw(limits, resonances_of(reduced))
    return Sheet(name, result, reduced, damping, words, limits, grid, frequency_response(reduced, grid))


def _measuring(result, read):
    """Return the accuracy whose damping a result is drawn with: its own, or else that of another result with the same
    damping model, so that all curves have one damping. None where there is none."""
    own = result.reduced.record
    known = [record.accuracy for record in (other.reduced.record for other in read)
             if record.damping == own.damping and record.accuracy is not None]  # fmt: skip
    return own.accuracy or next(iter(known), None)


def _add_full(sheet, path, count, before, groups, factoring, comm, progress):
    """Add to a sheet the response of the full model at some frequencies, its modes, and the error. Collective."""
    same = next((earlier for earlier in before if earlier.full is not None and _same_question(earlier, sheet)), None)
    if same is not None:
        sheet.full, sheet.full_as_before = same.full, True
    else:
        with full_of_record(path, sheet.record, sheet.result.path, damping=sheet.damping, factoring=factoring,
                            at=sheet.result.values, comm=comm) as full_model:  # fmt: skip
            sheet.full = _solved(full_model, sheet, count, groups, progress)
            units = _likely_units(full_model.model)
        sheet.notes += [f"{path} looks like {units}: from its mass, size, and speed of waves"] if units else []
    response = frequency_response(sheet.measured, sheet.full.frequencies)
    sheet.errors = errors_of(sheet.measured, sheet.full.frequencies, sheet.full.response, response, sheet.full.drive)


def _likely_units(model):
    """Return the units that a model looks like, None where it has no nodes or the numbers do not tell. Collective."""
    if model.dofs is None:
        return None
    low, high = extent(model)
    return likely_units(model, rigid_body_quantities(model).mass, high - low)


def _solved(full_model, sheet, count, groups, progress):
    """Solve at `count` frequencies of the band and beside pseudo-frequencies, and find the modes of the band.
    Collective."""
    low, high = sheet.band
    beside = BESIDE * sheet.reduced.frequencies
    beside = beside[(beside > low) & (beside < high)][:BESIDE_AT_MOST]
    frequencies = np.unique(np.concatenate([np.linspace(low or high / count, high, count), beside]))
    response, drive = full_model.response(frequencies, groups, progress)
    # a few more than the reduced model has in the band, which some modes may be missing in
    wanted = min(2 * int((sheet.reduced.frequencies <= high).sum()) + 4, MOST_MODES)
    wanted = min(wanted, sheet.record.free_size - sheet.record.rigid_body_modes)
    if not full_model.model.is_symmetric("K"):
        sheet.notes.append(f"{sheet.name}: K is not symmetric, so that the model has no real modes to compare with")
        return FullSolution(frequencies, response, drive, np.zeros(0))
    with full_model.lowest_modes(wanted, progress) as modal:
        modes = modal.frequencies
    if modes[-1] < high:
        sheet.notes.append(f"{sheet.name}: the {wanted} lowest modes of the model are shown")
    return FullSolution(frequencies, response, drive, modes)


def _same_question(one, other):
    """Test whether the full model has one response for two sheets."""
    keys = ("frame", "interfaces", "inputs", "outputs")
    same = all(getattr(one.record, key) == getattr(other.record, key) for key in keys)
    same &= (one.damping, one.band, one.result.values) == (other.damping, other.band, other.result.values)
    return same and difference_between(other.record, one.record) is None


def kind_in_words(value) -> str:
    """Return a frame, a damping model or a component in words."""
    settings = {key: list(item) if isinstance(item, tuple) else item for key, item in table_of(value).items()
             if key != "kind" and item is not None}  # fmt: skip
    return value.kind.replace("_", " ") + (f" ({in_words(settings)})" if settings else "")
