"""Results, and perhaps the full model, enter; one HTML file to look at leaves, and figures and tables for papers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from ..analysis.check import check
from ..analysis.error import relative_error
from ..analysis.error_check import BESIDE, as_measured, measuring_damping
from ..analysis.frequency_response import frequency_response
from ..formats.hdf5 import atomic_output
from ..formats.outputs import HTML, check_outputs
from ..formats.result_file import Result, read_result
from ..linalg.factorisation import Factoring
from ..model.damping import ModalDamping, NoDamping
from ..model.dofs import target_of
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..reduction.interface_coordinates import elastic_part
from ..reduction.modes import Modes
from ..reduction.record import versions
from ..reduction.reduce import reduce
from ..report.page import MOST_POINTS, body_for_page, packed, render_page
from ..report.tables import in_words
from .evaluate import band_of, factoring_of, model_of_record
from .pair_figures import pairs_to_show
from .report_files import check_drawing, draw_files, make_folder, write_tables

FREQUENCIES = 801  # equally spaced; more around the pseudo-frequencies
AROUND = 1e-4 * np.array([1, 3, 10, 30, 100])  # relative distances from a pseudo-frequency
MOST_PAIRS = 36  # responses on a page, the largest
BESIDE_AT_MOST = 8  # exact frequencies beside pseudo-frequencies
MOST_MODES = 40  # of the full model


@dataclass
class Sheet:
    """What a report says of one result: the file, the reduced model as its error was measured, its responses.

    `response` (F, r, p) at `frequencies` (F,) in Hz. With a full model: its response `full` and the error `eps` at
    `exact` (E,), and its `modes` in Hz. `body`: shapes for the page and a sentence, by body_for_page.
    """

    name: str
    result: Result
    band: tuple[float, float]
    frequencies: np.ndarray
    response: np.ndarray
    exact: np.ndarray | None = None
    full: np.ndarray | None = None
    full_as_before: bool = False
    eps: np.ndarray | None = None
    modes: np.ndarray | None = None
    body: dict | None = None
    body_sentence: str = ""
    notes: list = field(default_factory=list)

    @property
    def reduced(self):
        """Without the rigid-body motion that interface coordinates have, as estimates and the full response are."""
        return elastic_part(self.result.reduced)

    @property
    def record(self):
        return self.reduced.record


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
    if full is not None:
        damped = any(not isinstance(_law(result), NoDamping) for result in read)
        given = factoring or factoring_of(read[0].reduced.record)
        startup.start(preferred="complex" if damped else "real", low_rank=given.low_rank is not None)
    sheets = []
    for name, result in zip(_names(read), read, strict=True):
        limits = tuple(band or band_of(result.reduced))
        grid = _grid(limits, elastic_part(result.reduced).frequencies)
        sheet = Sheet(name, result, limits, grid, frequency_response(_measured(result), grid))
        if full is not None:
            with progress.stage("full model", name):
                _add_full(sheet, full, exact, sheets, groups, factoring, comm, progress)
        sheets.append(sheet)
    return sheets


def _names(read):
    """Short names, each once."""
    stems = [result.path.stem for result in read]
    if len(set(stems)) == len(stems):
        return stems
    return [str(result.path) for result in read]


def _measured(result):
    reduced, accuracy = elastic_part(result.reduced), result.reduced.record.accuracy
    return as_measured(reduced, accuracy) if accuracy is not None else reduced


def _law(result):
    """The damping law of the full response that the reduced one is compared with."""
    record = result.reduced.record
    return measuring_damping(record.accuracy, record.damping) if record.accuracy is not None else record.damping


def _grid(band, pseudo):
    """Frequencies of the band, more of them at peaks; above 0 Hz, where free bodies have no response."""
    low, high = band
    inside = pseudo[(pseudo > low) & (pseudo < high)]
    near = (inside[:, None] * (1 + np.concatenate([-AROUND, AROUND]))).ravel()
    grid = np.concatenate([np.linspace(low or high / FREQUENCIES, high, FREQUENCIES), near])
    return np.unique(grid[(grid >= low) & (grid <= high)])


def _add_full(sheet, path, count, before, groups, factoring, comm, progress):
    """The response of the full model at some frequencies, its modes, and the error. Collective."""
    record, law = sheet.record, _law(sheet.result)
    low, high = sheet.band
    if isinstance(law, ModalDamping):
        sheet.notes.append(f"{sheet.name}: modal damping belongs to a reduced model; there is no full response with it")
        return
    beside = BESIDE * sheet.reduced.frequencies
    beside = beside[(beside > low) & (beside < high)][:BESIDE_AT_MOST]
    same = next((item for item in before if item.full is not None and _question(item) == _question(sheet)), None)
    factoring = factoring or factoring_of(record)
    with model_of_record(path, record, sheet.result.path, comm) as model:
        if same is not None:
            sheet.exact, sheet.full, sheet.modes, sheet.full_as_before = same.exact, same.full, same.modes, True
        else:
            sheet.exact = np.unique(np.concatenate([np.linspace(low or high / count, high, count), beside]))
            sheet.full = frequency_response(
                model, sheet.exact, record.frame, law, factoring=factoring, groups=groups, progress=progress
            )
            # a few more than the reduced model has in the band, which some modes may be missing in
            wanted = min(2 * int((sheet.reduced.frequencies <= high).sum()) + 4, MOST_MODES)
            wanted = min(wanted, record.free_size - record.rigid_body_modes)
            with reduce(model, [Modes(count=wanted)], record.frame, factoring=factoring, progress=progress) as modal:
                sheet.modes = modal.frequencies
            if sheet.modes[-1] < high:
                sheet.notes.append(f"{sheet.name}: the {wanted} lowest modes of the model are shown")
        if model.dofs is not None:
            units = check(model)["units"]
            sheet.notes += [f"{path} looks like {units}: from its mass, size, and speed of waves"] if units else []
    sheet.eps = relative_error(sheet.full, frequency_response(_measured(sheet.result), sheet.exact))


def _question(sheet):
    """What the response of the full model depends on."""
    record = sheet.record
    return record.frame, _law(sheet.result), record.inputs, record.outputs, sheet.band


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
    known = {f"{outputs[i]}/{inputs[j]}": (i, j) for i in range(len(outputs)) for j in range(len(inputs))}
    for name in wanted:
        if name not in known:
            first = next(iter(known))
            raise InputError(f"pairs: found '{name}', expected output/input of {sheet.name}, such as {first}")
    shown = [known[name] for name in wanted] or pairs_to_show(sheet.response, outputs, inputs, most)
    if not wanted and len(shown) == most:
        sheet.notes.append(f"{sheet.name}: the {most} largest responses are shown")
    return [(f"{outputs[i]}/{inputs[j]}", i, j) for i, j in shown]


def page_of(sheets, chosen, full) -> tuple[dict, dict]:
    """What the template shows, and what is drawn."""
    made = versions()
    results, drawn = [], []
    for sheet, pairs in zip(sheets, chosen, strict=True):
        results.append(_shown(sheet))
        drawn.append(_drawn(sheet, pairs))
    measured = {sheet.name: sheet.record.accuracy.measured for sheet in sheets if sheet.record.accuracy is not None}
    bands = [sheet.band for sheet in sheets]
    page = {
        "title": ", ".join(sheet.name for sheet in sheets),
        "made": f"hpcred {made['hpcred']}; " + ", ".join(str(sheet.result.path) for sheet in sheets)
                + (f"; full model {full}" if full else ""),
        "facts": list(results[0]["facts"]),
        "results": results,
        "notes": list(dict.fromkeys(note for sheet in sheets for note in sheet.notes)),
        "response_notes": [f"{name}: responses and errors are {words}" for name, words in measured.items()],
        "searched": any(result["points"] for result in results),
        "shaped": any(result["shape"] for result in results),
        "with_modes": any(sheet.modes is not None for sheet in sheets),
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
    drawn = {
        "name": sheet.name,
        "frequencies": packed(sheet.frequencies),
        "pairs": [
            {"name": name, "re": packed(H[:, i, j].real), "im": packed(H[:, i, j].imag)}
            | ({} if full is None else {"full_re": packed(full[:, i, j].real), "full_im": packed(full[:, i, j].imag)})
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
            "full_frequencies": packed(sheet.exact), "exact_eps": packed(sheet.eps), "modes": packed(sheet.modes)
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
        "facts": _facts(sheet),
        "warnings": list(record.warnings),
        "exact": [] if sheet.eps is None else [
            {"f (Hz)": f, "exact eps": eps} for f, eps in zip(sheet.exact.tolist(), sheet.eps.tolist(), strict=True)
        ],
        "proofs": [] if accuracy is None else [
            {"f (Hz)": item.frequency, "said": item.said, "exact": item.exact} for item in accuracy.proofs
        ],
        "points": [] if accuracy is None else [
            {"point": k + 1, "f (Hz)": item.frequency, "columns": item.columns, "modes below": item.modes_below,
             "estimate after it": item.estimate, "seconds": item.factor_seconds}
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
        "shape": None if sheet.body is None else {"count": len(sheet.body["names"])},
        "shape_note": sheet.body_sentence,
    }  # fmt: skip


def frequency_rows(sheet) -> list[dict]:
    """Pseudo-frequencies; with the full model's modes each beside the nearest one, and their relative distance."""
    pseudo = sheet.reduced.frequencies
    if sheet.modes is None:
        return [{"number": k + 1, "pseudo-frequency (Hz)": f} for k, f in enumerate(pseudo.tolist())]
    near = np.abs(pseudo[None] - sheet.modes[:, None]).argmin(axis=1)
    return [
        {"mode": k + 1, "of the model (Hz)": f, "nearest pseudo-frequency (Hz)": float(pseudo[j]),
         "relative distance": float(abs(pseudo[j] - f) / max(f, 1e-300))}
        for k, (f, j) in enumerate(zip(sheet.modes.tolist(), near, strict=True))
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
                        if isinstance(target := target_of(name), tuple)})  # fmt: skip
    return {
        "model": f"{record.model}, {record.size} dofs, {record.nonzeros} nonzeros",
        "reduced model": f"{reduced.size} coordinates",
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
    return np.where(np.abs(values) > 1e-12 * np.abs(values).max(), values, 0.0)


def _kind(value):
    """A frame, a damping law or an ingredient in words."""
    given = {key: list(item) if isinstance(item, tuple) else item for key, item in asdict(value).items()
             if key != "kind" and item is not None}  # fmt: skip
    return value.kind.replace("_", " ") + (f" ({in_words(given)})" if given else "")
