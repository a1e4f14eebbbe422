"""Collect the contents of the page of a report, as plain values for its template."""

from __future__ import annotations

import numpy as np

from ..fe.dofs import named_quantity, target_of
from ..model.units import unit_of_response
from ..reduction.result.accuracy import WORST
from ..reduction.result.directions import rows_of_directions
from ..reduction.result.parameter_accuracy import in_words as values_in_words
from ..reduction.result.record import MACHINE, version_of
from ..report.figures import UNKNOWN
from ..report.page import packed
from ..report.tables import in_words
from .report_campbell import shown_diagrams
from .report_sheets import kind_in_words


def page_of(sheets, chosen, full) -> tuple[dict, dict]:
    """Return the values that the template shows, and the data that its plots draw."""
    results, drawn = [], []
    for sheet, pairs in zip(sheets, chosen, strict=True):
        results.append(_shown(sheet))
        drawn.append(_drawn(sheet, pairs))
    # curves in common units are said to be once
    whose = {sheet.name: sheet.words for sheet in sheets}
    if len(set(whose.values())) == 1:
        whose = {"all curves": sheets[0].words}
    bands = [sheet.band for sheet in sheets]
    page = {
        "title": ", ".join(sheet.name for sheet in sheets),
        "made": f"hpcred {version_of('hpcred')}; " + ", ".join(str(sheet.result.path) for sheet in sheets)
                + (f"; full model {full}" if full else ""),
        "facts": list(dict.fromkeys(key for result in results for key in result["facts"])),
        "results": results,
        "notes": list(dict.fromkeys(note for sheet in sheets for note in sheet.notes)),
        "response_notes": [f"{name}: responses and errors are {words}" for name, words in whose.items()],
        "paper": [sheet.name for sheet in sheets if (known := sheet.record.accuracy) and known.measure.kind == "paper"],
        "worst": WORST,
        "searched": any(result["points"] for result in results),
        "shaped": any(result["shape"] for result in results),
        "stressed": any(sheet.has_stress for sheet in sheets),
        "moved": any(result["motion"] for result in results),
        "parametric": any(result["diagrams"] for result in results),
        "with_modes": any(sheet.full is not None and len(sheet.full.modes) for sheet in sheets),
    }  # fmt: skip
    # numbers for the pictures, apart from the text of the page
    several = sum(sheet.full is not None and not sheet.full_as_before for sheet in sheets) > 1
    data = {
        "results": drawn,
        "several_full": several,
        "band": [min(low for low, _ in bands), max(high for _, high in bands)],
    }
    return page, data


def _drawn(sheet, pairs):
    # what is drawn of the reduced model alone
    accuracy, H, full = sheet.record.accuracy, sheet.response, sheet.full
    F = None if full is None else full.response
    drawn = {
        "name": sheet.name,
        "frequencies": packed(sheet.frequencies),
        "pairs": [
            {"name": name, "unit": unit_of_response(*name.split("/", 1), sheet.record.loads) or UNKNOWN,
             "re": packed(H[:, i, j].real), "im": packed(H[:, i, j].imag)}
            | ({} if F is None else {"full_re": packed(F[:, i, j].real), "full_im": packed(F[:, i, j].imag)})
            for name, i, j in pairs
        ],
        "full_as_before": sheet.full_as_before,
        "pseudo": packed(sheet.reduced.frequencies),
        "points": [] if accuracy is None else [
            {"frequency": point.frequency, "estimate": _finite(point.estimate)} for point in accuracy.points
        ],
        "tolerance": accuracy.tolerance if accuracy is not None and accuracy.asked else None,
        "seconds": sheet.record.timing.seconds,
        "shape": sheet.body,
        "motion": sheet.motion,
        "stress_curves": None if sheet.moved is None else {
            "t": packed(sheet.moved.t), "curves": [{"name": name, "y": packed(y)} for name, y in sheet.moved.curves]
        },
    }
    # the estimated error, and what is known of the full model
    if accuracy is not None:
        drawn |= {"eps_frequencies": packed(accuracy.frequencies), "eps": packed(accuracy.eps)}
    if full is not None:
        drawn |= {
            "full_frequencies": packed(full.frequencies), "measured_eps": packed(sheet.errors.eps),
            "modes": packed(full.modes),
        }  # fmt: skip
    return drawn


def _finite(value):
    """Return a number that JSON can hold, or None."""
    return value if value is not None and np.isfinite(value) else None


def _shown(sheet):
    record, accuracy = sheet.record, sheet.record.accuracy
    timing = record.timing
    # the rows of each table of the page, which leaves empty ones out
    effort = f"{timing.elapsed:.3g} s on {record.ranks} rank(s), at most {max(timing.memory_mb_per_rank):.0f} MB a rank"
    return {
        "name": sheet.name,
        "sentence": accuracy.sentence if accuracy is not None else "",
        "claim": "" if accuracy is None or not accuracy.asked else
        "reached" if accuracy.reached and not accuracy.warnings else "missed",
        "alarms": list(accuracy.warnings) if accuracy is not None and accuracy.reached else [],
        "directions": directions_of(sheet),
        "facts": _facts(sheet),
        "joints": [entry.row | ({} if entry.apart is not None else {"apart (m)": ""}) for entry in record.joints],
        "warnings": [entry for entry in record.warnings if accuracy is None or entry not in accuracy.warnings],
        "errors": [] if sheet.errors is None else [
            {"f (Hz)": f, "measured eps": eps}
            for f, eps in zip(sheet.full.frequencies.tolist(), sheet.errors.eps.tolist(), strict=True)
        ],
        "proofs": [] if accuracy is None else [
            {"f (Hz)": entry.frequency, "estimated": entry.estimated, "measured": entry.measured}
            for entry in accuracy.proofs
        ],
        "points": [] if accuracy is None else [
            {"point": k + 1, "f (Hz)": entry.frequency, "columns": entry.columns, "modes below": entry.modes_below,
             "estimate after it": entry.estimate, "factor": entry.factor_in_words}
            for k, entry in enumerate(accuracy.points)
        ],
        "stopped": f"{len(accuracy.points)} points, {accuracy.stopped}" if accuracy is not None else "",
        "frequencies": frequency_rows(sheet),
        "effort": effort,
        "stages": [{"stage": name, "seconds": value} for name, value in
                   sorted(timing.seconds.items(), key=lambda entry: -entry[1])],
        "factorisations": [
            {"of K + mass M, mass": entry.mass, "ordering": entry.ordering, "analysis (s)": entry.analysis_seconds,
             "factor (s)": entry.factor_seconds, "solves (s)": entry.solve_seconds,
             "MB, all ranks": entry.memory_mb_used_total, "columns": entry.columns_solved, "residual": entry.residual}
            for entry in record.factorisations
        ],
        "shape": None if sheet.body is None else {"count": len(sheet.body["names"]), "start": sheet.body["start"] + 1},
        "shape_note": sheet.body_sentence,
        "motion": None if sheet.motion is None else {
            "title": sheet.moved.title, "count": len(sheet.motion["times"]), "start": sheet.motion["start"],
            "ticks": [(100 * tick / max(sheet.motion["largest"], 1e-300), f"{tick:g}")
                      for tick in sheet.motion["ticks"]],
        },
        "diagrams": shown_diagrams(sheet),
    }  # fmt: skip


def directions_of(sheet) -> list[dict]:
    """Return the directions of a sheet for a table."""
    band = sheet.full.frequencies if sheet.full is not None else sheet.band
    if sheet.full is None and sheet.record.accuracy is not None:
        band = sheet.record.accuracy.band
    return rows_of_directions(sheet.directions, band)


def frequency_rows(sheet) -> list[dict]:
    """Return rows of pseudo-frequencies; with the full model's modes each beside the nearest one, and their relative
    distance."""
    pseudo = sheet.reduced.frequencies
    if sheet.full is None or not len(sheet.full.modes):
        return [{"number": k + 1, "pseudo-frequency (Hz)": f} for k, f in enumerate(pseudo.tolist())]
    near = np.abs(pseudo[None] - sheet.full.modes[:, None]).argmin(axis=1)
    return [
        {"mode": k + 1, "of the model (Hz)": f, "nearest pseudo-frequency (Hz)": float(pseudo[j]),
         "relative distance": float(abs(pseudo[j] - f) / max(f, 1e-300))}
        for k, (f, j) in enumerate(zip(sheet.full.modes.tolist(), near, strict=True))
    ]  # fmt: skip


def _facts(sheet):
    record, reduced, frame = sheet.record, sheet.reduced, sheet.result.floating_frame
    machine = record.model.startswith(MACHINE)  # of which no model was reduced
    # the rigid body: mass, centre, inertia
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
    elif machine:
        body = {}
    # the nodes that inputs and outputs name
    interface = sorted({target[0] for name in (*record.inputs, *record.outputs)
                        if isinstance(target := target_of(named_quantity(name)[1]), tuple)},
                       key=lambda node: (isinstance(node, str), node))  # fmt: skip
    return {
        "model": f"{record.model}, {record.size} dofs, {record.nonzeros} nonzeros",
        "reduced model": sheet.result.reduced.size_in_words,
        **body,
        "units": f"kg, m, s, converted from {record.units}" if record.units else "kg, m, s, if the model has them",
        "frame": kind_in_words(record.frame),
        "damping": kind_in_words(record.damping),
        **({"at": values_in_words(sheet.result.values)} if sheet.result.values else {}),
        **{family: "; ".join(words) for family, words in reduced.operator.families.items()},
        "rigid-body modes": str(record.rigid_body_modes),
        "inputs": in_words(list(record.inputs)),
        "outputs": in_words(list(record.outputs)),
        "interface nodes": in_words(interface),
        **({} if machine else {
            "basis": "; ".join(kind_in_words(component) for component in record.basis) or "chosen to a tolerance",
            "modes of the band": "not counted" if record.accuracy is None else record.accuracy.modes_in_words,
        }),
        "pseudo-frequencies (Hz)": f"{reduced.frequencies[0]:.6g} to {reduced.frequencies[-1]:.6g}",
        "band (Hz)": f"{sheet.band[0]:g} to {sheet.band[1]:g}",
        **({} if machine else {
            "max |V^T M V - I|": f"{record.orthonormality_defect:.1e}", "factorisations": record.effort,
        }),
        "made": f"{record.date}, {record.scalar} PETSc {record.versions['petsc']}, hpcred {record.versions['hpcred']}, "
                f"{record.ranks} rank(s)",
    }  # fmt: skip


def _clean(values):
    """Set round-off of zeros to zero."""
    size = np.abs(values)
    return np.where(size <= 1e-12 * size.max(initial=0.0, where=np.isfinite(size)), 0.0, values)
