"""Results, and perhaps the full model, enter; one HTML file to look at leaves, and figures and tables for papers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from ..analysis.check import check
from ..analysis.error import relative_error
from ..analysis.error_check import BESIDE, measuring_damping
from ..analysis.frequency_response import frequency_response
from ..formats.hdf5 import atomic_output
from ..formats.locks import locks_given_back
from ..formats.outputs import HTML, check_outputs
from ..formats.result_file import Result, read_result
from ..linalg.factorisation import Factoring
from ..model.damping import Damping, ModalDamping
from ..model.dofs import target_of
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..reduction.interface_coordinates import elastic_part
from ..reduction.record import versions
from ..reduction.reduced_model import ReducedModel, as_measured
from ..report.page import MOST_POINTS, body_for_page, packed, render_page
from ..report.tables import in_words
from .evaluate import band_of, short_names
from .full_model import difference_of, factoring_of, full_of_record, start_for
from .pair_figures import pairs_by_name, pairs_to_show
from .report_files import check_drawing, draw_files, make_folder, write_tables

FREQUENCIES = 801  # equally spaced; more around the pseudo-frequencies
AROUND = 1e-4 * np.array([1, 3, 10, 30, 100])  # relative distances from a pseudo-frequency
MOST_PAIRS = 36  # responses on a page, the largest
BESIDE_AT_MOST = 8  # exact frequencies beside pseudo-frequencies
MOST_MODES = 40  # of the full model


@dataclass(frozen=True)
class Full:
    """The response (E, r, p) of a full model at `frequencies` (E,) in Hz, and its lowest `modes` in Hz."""

    frequencies: np.ndarray
    response: np.ndarray
    modes: np.ndarray


@dataclass
class Sheet:
    """What a report says of one result: the file, the reduced model as it is `measured` and the damping `law` of the
    full model for that, with `words` on it; its response (F, r, p) at `frequencies` (F,) in Hz over the band.

    With a full model: `full`, which may be that of a sheet before (`full_as_before`), and the error `eps` at its
    frequencies. `body`: shapes for the page and a sentence, by body_for_page.
    """

    name: str
    result: Result
    measured: ReducedModel
    law: Damping
    words: str
    band: tuple[float, float]
    frequencies: np.ndarray
    response: np.ndarray
    full: Full | None = None
    full_as_before: bool = False
    eps: np.ndarray | None = None
    body: dict | None = None
    body_sentence: str = ""
    notes: list = field(default_factory=list)

    @property
    def reduced(self):
        """Without the rigid-body motion that interface coordinates have, as estimates and the full response are."""
        return elastic_part(self.result.reduced)

    @property
    def record(self):
        return self.result.reduced.record


@locks_given_back()
def report_file(
    results, full=None, *, output="report.html", band=None, exact: int = 21, pairs=(), modes: int = 10,
    png=None, svg=None, csv=None, groups: int | None = None, factoring: Factoring | None = None, comm=None,
    progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Write a report on results, names of files, as one HTML file that needs no network. Collective.

    `full`: the model file that they were reduced from; its response is then computed at `exact` equally spaced
    frequencies and beside pseudo-frequencies, and its modes. `band` (Hz): default that of the job. `pairs`: names
    "output/input" of responses, by default the largest. `modes`: number of shapes that can be looked at. `png`, `svg`,
    `csv`: folders for figures and tables of the same. Returns the file, its size in MB, the names of figures and
    tables, and notes. Raises InputError.
    """
    comm = comm or startup.start_mpi()
    check_outputs({output: HTML}, comm, [*results, full], progress=progress)
    for folder in (png, svg, csv):
        if folder is not None:
            make_folder(folder, comm)
    if png is not None or svg is not None:
        check_drawing(comm)
    sheets = sheets_of(
        results, full, band=band, exact=exact, groups=groups, factoring=factoring, comm=comm, progress=progress
    )
    chosen = [choose_pairs(sheet, pairs) for sheet in sheets]
    report = None
    with atomic_output(output, comm) as temporary, agreed(comm):
        if comm.rank == 0:
            for sheet in sheets:
                _take_body(sheet, modes, MOST_POINTS // len(sheets))
            text = render_page(*page_of(sheets, chosen, full))
            temporary.write_text(text, encoding="utf-8")
            notes = list(dict.fromkeys(note for sheet in sheets for note in sheet.notes))
            report = {"output": str(output), "megabytes": len(text.encode()) / 1e6, "notes": notes, "files": []}
            for kind, folder in (("png", png), ("svg", svg)):
                report["files"] += draw_files(folder, kind, sheets, chosen) if folder is not None else []
            if csv is not None:
                report["files"] += write_tables(csv, sheets, frequency_rows)
    return comm.bcast(report)


def sheets_of(
    results, full=None, *, band=None, exact: int = 21, groups=None, factoring=None, comm=None, progress=None
) -> list[Sheet]:  # fmt: skip
    """A Sheet for every result, with the full model's response where `full` names its file. Collective."""
    progress = progress or Progress(comm, show=False)
    if not results:
        raise InputError("report: no result; give the name of at least one result.h5")
    if exact < 2:
        raise InputError(f"exact: found {exact}, expected at least 2 frequencies")
    read = [read_result(path, comm) for path in results]
    for result in read:
        if result.reduced.record is None:
            raise InputError(f"{result.path}: has no record of its reduction, which a report is about")
    sheets = [_sheet(name, result, read, band) for name, result in zip(short_names(results), read, strict=True)]
    if full is not None:
        start_for([sheet.law for sheet in sheets], factoring or factoring_of(sheets[0].record))
        for k, sheet in enumerate(sheets):
            with progress.stage("full model", sheet.name):
                _add_full(sheet, full, exact, sheets[:k], groups, factoring, comm, progress)
    return sheets


def _sheet(name, result, read, band):
    """The Sheet of one of the results, without the full model."""
    reduced, accuracy = elastic_part(result.reduced), _measuring(result, read)
    law = reduced.record.damping
    words = f"measured with the damping of the job: {_kind(law)}"
    if accuracy is not None:
        reduced, law, words = as_measured(reduced, accuracy), measuring_damping(accuracy, law), accuracy.measured
    limits = tuple(band or band_of(result.reduced, [other.reduced for other in read]))
    grid = _grid(limits, reduced.frequencies)
    return Sheet(name, result, reduced, law, words, limits, grid, frequency_response(reduced, grid))


def _measuring(result, read):
    """The accuracy that says with which damping a result is drawn: its own, or else, so that curves beside each other
    have one damping, that of another result with the same damping law. None where there is none."""
    own = result.reduced.record
    known = [record.accuracy for record in (other.reduced.record for other in read)
             if record.damping == own.damping and record.accuracy is not None]  # fmt: skip
    return own.accuracy or next(iter(known), None)


def _grid(band, pseudo):
    """Frequencies of the band, more of them at peaks; above 0 Hz, where free bodies have no response."""
    low, high = band
    inside = pseudo[(pseudo > low) & (pseudo < high)]
    near = (inside[:, None] * (1 + np.concatenate([-AROUND, AROUND]))).ravel()
    grid = np.concatenate([np.linspace(low or high / FREQUENCIES, high, FREQUENCIES), near])
    return np.unique(grid[(grid >= low) & (grid <= high)])


def _add_full(sheet, path, count, before, groups, factoring, comm, progress):
    """The response of the full model at some frequencies, its modes, and the error. Collective."""
    if isinstance(sheet.law, ModalDamping):
        sheet.notes.append(f"{sheet.name}: modal damping belongs to a reduced model; there is no full response with it")
        return
    same = next((item for item in before if item.full is not None and _same_question(item, sheet)), None)
    if same is not None:
        sheet.full, sheet.full_as_before = same.full, True
    else:
        with full_of_record(path, sheet.record, sheet.result.path, damping=sheet.law, factoring=factoring,
                            comm=comm) as full_model:  # fmt: skip
            sheet.full = _solved(full_model, sheet, count, groups, progress)
            units = check(full_model.model)["units"] if full_model.model.dofs is not None else None
        sheet.notes += [f"{path} looks like {units}: from its mass, size, and speed of waves"] if units else []
    found, accuracy = frequency_response(sheet.measured, sheet.full.frequencies), sheet.record.accuracy
    sheet.eps = relative_error(sheet.full.response, found, accuracy and accuracy.weights)


def _solved(full_model, sheet, count, groups, progress):
    """`count` frequencies of the band, and beside pseudo-frequencies, and the modes of the band. Collective."""
    low, high = sheet.band
    beside = BESIDE * sheet.reduced.frequencies
    beside = beside[(beside > low) & (beside < high)][:BESIDE_AT_MOST]
    frequencies = np.unique(np.concatenate([np.linspace(low or high / count, high, count), beside]))
    response = full_model.response(frequencies, groups, progress)
    # a few more than the reduced model has in the band, which some modes may be missing in
    wanted = min(2 * int((sheet.reduced.frequencies <= high).sum()) + 4, MOST_MODES)
    wanted = min(wanted, sheet.record.free_size - sheet.record.rigid_body_modes)
    with full_model.lowest_modes(wanted, progress) as modal:
        modes = modal.frequencies
    if modes[-1] < high:
        sheet.notes.append(f"{sheet.name}: the {wanted} lowest modes of the model are shown")
    return Full(frequencies, response, modes)


def _same_question(one, other):
    """Whether the full model has one response for two sheets."""
    keys = ("frame", "interfaces", "inputs", "outputs")
    same = all(getattr(one.record, key) == getattr(other.record, key) for key in keys)
    same &= (one.law, one.band) == (other.law, other.band)
    return same and difference_of(other.record.signature, one.record) is None


def _take_body(sheet, modes, most):
    """The shapes of a result that has nodes; on one rank."""
    try:
        with sheet.result.shapes() as shapes:
            sheet.body, sheet.body_sentence = body_for_page(shapes, modes, most)
    except InputError as error:
        sheet.body_sentence = str(error)


def choose_pairs(sheet, wanted=(), most=MOST_PAIRS) -> list[tuple[str, int, int]]:
    """Name, output and input of the responses that are shown: the `wanted` ones, or else those of pairs_to_show.

    Raises InputError."""
    outputs, inputs = sheet.reduced.output_names, sheet.reduced.input_names
    shown = pairs_by_name(wanted, outputs, inputs, sheet.name)
    shown = shown or pairs_to_show(sheet.response, outputs, inputs, most)
    if not wanted and len(shown) == most:
        sheet.notes.append(f"{sheet.name}: the {most} largest responses are shown; --pairs chooses others")
    return [(f"{outputs[i]}/{inputs[j]}", i, j) for i, j in shown]


def page_of(sheets, chosen, full) -> tuple[dict, dict]:
    """What the template shows, and what is drawn."""
    made = versions()
    results, drawn = [], []
    for sheet, pairs in zip(sheets, chosen, strict=True):
        results.append(_shown(sheet))
        drawn.append(_drawn(sheet, pairs))
    whose = {sheet.name: sheet.words for sheet in sheets}
    if len(set(whose.values())) == 1:
        whose = {"all curves": sheets[0].words}
    bands = [sheet.band for sheet in sheets]
    page = {
        "title": ", ".join(sheet.name for sheet in sheets),
        "made": f"hpcred {made['hpcred']}; " + ", ".join(str(sheet.result.path) for sheet in sheets)
                + (f"; full model {full}" if full else ""),
        "facts": list(results[0]["facts"]),
        "results": results,
        "notes": list(dict.fromkeys(note for sheet in sheets for note in sheet.notes)),
        "response_notes": [f"{name}: responses and errors are {words}" for name, words in whose.items()],
        "searched": any(result["points"] for result in results),
        "shaped": any(result["shape"] for result in results),
        "with_modes": any(sheet.full is not None for sheet in sheets),
    }  # fmt: skip
    several = sum(sheet.full is not None and not sheet.full_as_before for sheet in sheets) > 1
    data = {
        "results": drawn,
        "several_full": several,
        "band": [min(low for low, _ in bands), max(high for _, high in bands)],
    }
    return page, data


def _drawn(sheet, pairs):
    accuracy, H, full = sheet.record.accuracy, sheet.response, sheet.full
    F = None if full is None else full.response
    drawn = {
        "name": sheet.name,
        "frequencies": packed(sheet.frequencies),
        "pairs": [
            {"name": name, "re": packed(H[:, i, j].real), "im": packed(H[:, i, j].imag)}
            | ({} if F is None else {"full_re": packed(F[:, i, j].real), "full_im": packed(F[:, i, j].imag)})
            for name, i, j in pairs
        ],
        "full_as_before": sheet.full_as_before,
        "pseudo": packed(sheet.reduced.frequencies),
        "points": [] if accuracy is None else [
            {"frequency": point.frequency, "estimate": _finite(point.estimate)} for point in accuracy.points
        ],
        "tolerance": None if accuracy is None else accuracy.tolerance,
        "seconds": sheet.record.timing.seconds,
        "shape": sheet.body,
    }
    if accuracy is not None:
        drawn |= {"eps_frequencies": packed(accuracy.frequencies), "eps": packed(accuracy.eps)}
    if full is not None:
        drawn |= {
            "full_frequencies": packed(full.frequencies), "exact_eps": packed(sheet.eps), "modes": packed(full.modes)
        }  # fmt: skip
    return drawn


def _finite(value):
    """A number that JSON can hold, or None."""
    return value if value is not None and np.isfinite(value) else None


def _shown(sheet):
    record, accuracy = sheet.record, sheet.record.accuracy
    timing = record.timing
    effort = f"{timing.elapsed:.3g} s on {record.ranks} rank(s), at most {max(timing.memory_mb_per_rank):.0f} MB a rank"
    return {
        "name": sheet.name,
        "sentence": accuracy.sentence if accuracy is not None else "",
        "reached": accuracy is not None and accuracy.reached,
        "caveat": accuracy.caveat if accuracy is not None else "",
        "facts": _facts(sheet),
        "warnings": list(record.warnings),
        "exact": [] if sheet.eps is None else [
            {"f (Hz)": f, "exact eps": eps}
            for f, eps in zip(sheet.full.frequencies.tolist(), sheet.eps.tolist(), strict=True)
        ],
        "proofs": [] if accuracy is None else [
            {"f (Hz)": item.frequency, "said": item.said, "exact": item.exact} for item in accuracy.proofs
        ],
        "points": [] if accuracy is None else [
            {"point": k + 1, "f (Hz)": item.frequency, "columns": item.columns, "modes below": item.modes_below,
             "estimate after it": item.estimate, "factor": item.factor_in_words}
            for k, item in enumerate(accuracy.points)
        ],
        "stopped": f"{len(accuracy.points)} points, {accuracy.stopped}" if accuracy is not None else "",
        "frequencies": frequency_rows(sheet),
        "effort": effort,
        "stages": [{"stage": name, "seconds": value} for name, value in
                   sorted(timing.seconds.items(), key=lambda item: -item[1])],
        "factorisations": [
            {"of K + mass M, mass": item.mass, "ordering": item.ordering, "analysis (s)": item.analysis_seconds,
             "factor (s)": item.factor_seconds, "solves (s)": item.solve_seconds,
             "MB, all ranks": item.memory_mb_used_total, "columns": item.columns_solved, "residual": item.residual}
            for item in record.factorisations
        ],
        "shape": None if sheet.body is None else {"count": len(sheet.body["names"]), "start": sheet.body["start"] + 1},
        "shape_note": sheet.body_sentence,
    }  # fmt: skip


def frequency_rows(sheet) -> list[dict]:
    """Pseudo-frequencies; with the full model's modes each beside the nearest one, and their relative distance."""
    pseudo = sheet.reduced.frequencies
    if sheet.full is None:
        return [{"number": k + 1, "pseudo-frequency (Hz)": f} for k, f in enumerate(pseudo.tolist())]
    near = np.abs(pseudo[None] - sheet.full.modes[:, None]).argmin(axis=1)
    return [
        {"mode": k + 1, "of the model (Hz)": f, "nearest pseudo-frequency (Hz)": float(pseudo[j]),
         "relative distance": float(abs(pseudo[j] - f) / max(f, 1e-300))}
        for k, (f, j) in enumerate(zip(sheet.full.modes.tolist(), near, strict=True))
    ]  # fmt: skip


def _facts(sheet):
    record, reduced, frame = sheet.record, sheet.reduced, sheet.result.floating_frame
    body = dict.fromkeys(("mass (kg)", "centre of mass (m)", "inertia about the centre of mass (kg m^2)"), "not known")
    if frame is not None and frame.mass > 0:
        centre = frame.mc / frame.mass
        about = _clean(frame.J - frame.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)))
        body = {
            "mass (kg)": in_words(frame.mass) if np.ptp(frame.masses) <= 1e-9 * frame.mass
            else in_words(frame.masses.tolist()) + " in x, y, z",
            "centre of mass (m)": in_words(_clean(centre + frame.origin).tolist()),
            "inertia about the centre of mass (kg m^2)": in_words(
                {"xx": about[0, 0], "yy": about[1, 1], "zz": about[2, 2], "xy": about[0, 1], "xz": about[0, 2],
                 "yz": about[1, 2]}
            ),
        }  # fmt: skip
    interface = sorted({target[0] for name in (*record.inputs, *record.outputs)
                        if isinstance(target := target_of(name), tuple)},
                       key=lambda node: (isinstance(node, str), node))  # fmt: skip
    return {
        "model": f"{record.model}, {record.size} dofs, {record.nonzeros} nonzeros",
        "reduced model": sheet.result.reduced.size_in_words,
        **body,
        "units": "kg, m, s, if the model has them",
        "frame": _kind(record.frame),
        "damping": _kind(record.damping),
        "rigid-body modes": str(record.rigid_body_modes),
        "inputs": in_words(list(record.inputs)),
        "outputs": in_words(list(record.outputs)),
        "interface nodes": in_words(interface),
        "basis": "; ".join(_kind(item) for item in record.basis) or "chosen to a tolerance",
        "pseudo-frequencies (Hz)": f"{reduced.frequencies[0]:.6g} to {reduced.frequencies[-1]:.6g}",
        "band (Hz)": f"{sheet.band[0]:g} to {sheet.band[1]:g}",
        "max |V^T M V - I|": f"{record.orthonormality_defect:.1e}",
        "factorisations": record.effort,
        "made": f"{record.date}, {record.scalar} PETSc {record.versions['petsc']}, hpcred {record.versions['hpcred']}, "
                f"{record.ranks} rank(s)",
    }  # fmt: skip


def _clean(values):
    """Without round-off where there is nothing."""
    size = np.abs(values)
    return np.where(size <= 1e-12 * size.max(initial=0.0, where=np.isfinite(size)), 0.0, values)


def _kind(value):
    """A frame, a damping law or an ingredient in words."""
    given = {key: list(item) if isinstance(item, tuple) else item for key, item in asdict(value).items()
             if key != "kind" and item is not None}  # fmt: skip
    return value.kind.replace("_", " ") + (f" ({in_words(given)})" if given else "")
