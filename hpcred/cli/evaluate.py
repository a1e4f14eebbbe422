"""Compute frequency responses, of reduced models and of full ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..parallel.progress import counted
from ..report.tables import say, show_table, show_timing
from ..workflows.keywords import (
    At,
    Drive,
    FineGrid,
    FreshPoints,
    FullFile,
    Grid,
    Load,
    Measured,
    Pairs,
    ResponseFiles,
    State,
)
from . import session
from .options import DIRECTIONS, JsonFile, SharedSolving, Solving, command


@dataclass(frozen=True, kw_only=True)
class Checks(FreshPoints):
    """Options on errors that are known, and on what they are compared with."""

    estimate: Annotated[bool, typer.Option("--estimate", help="eps(f) from the result alone.")] = False
    check: Annotated[
        int | None, typer.Option(help="Compare the estimate with full solves at N random frequencies.")
    ] = None


@command
def evaluate(
    results: Annotated[list[str], typer.Argument(metavar="RESULT.h5 ...")],
    full: FullFile = None,
    *,
    grid: Grid,
    files: ResponseFiles,
    pairs: Pairs = (),
    measure: Measured = None,
    preload: Load = None,
    at: At = None,
    checks: Checks,
    solving: SharedSolving,
    json: JsonFile = None,
):
    """Frequency response of a reduced model; with --full its error eps(f) and Q (57).

    Several results of one model stand beside each other, with --full: sizes, errors, pseudo-modes against modes.

    Of a model that was reduced to a tolerance: --estimate shows the error that is known, largest in each of --points
    parts of the band; --full MODEL.h5 --check 5 sets it against full solves.
    """
    result, check, estimate, figure = results[0], checks.check, checks.estimate, files.figure
    # what cannot go together, each by the name of its option
    if len(results) > 1 and (estimate or figure or check is not None or full is None):
        raise InputError("evaluate: several results are compared with the model that --full names, and without "
                         "--estimate, --check or --figure; call evaluate once for each result")  # fmt: skip
    if len(results) > 1 and preload:
        raise InputError("--preload: of one result at a time; call evaluate once for each")
    if at and estimate:
        raise InputError("--at: cannot be combined with --estimate, which is over all values; call evaluate twice")
    by_option = {
        "--preload": preload,
        "--band": grid.band,
        "--frequencies": grid.frequencies or None,
        "-o": files.output,
        "--full": full,
        "--check": check,
        "--figure": figure,
        "--pairs": pairs or None,
    }
    allowed = ("--full", "--check") if check is not None else ("--frequencies",) if estimate else tuple(by_option)
    wrong = [option for option, value in by_option.items() if value is not None and option not in allowed]
    if wrong or (estimate and check is not None):
        raise InputError(f"{'--check' if check is not None else '--estimate'}: cannot be combined with "
                         f"{', '.join(wrong) or '--estimate'}; call evaluate twice")  # fmt: skip
    if check is not None and full is None:
        raise InputError("--check: the model file is missing; give it by --full MODEL.h5, or see --estimate for a "
                         "machine, which has none")  # fmt: skip
    if checks.seed is not None and check is None:
        raise InputError("--seed: belongs to --check")
    if measure is not None and (full is None or check is not None):
        raise InputError("--measure: belongs to --full without --check")
    # one of four tables, by the options
    if estimate:
        report = _show_estimate(result, parts=grid.points, frequencies=grid.frequencies)
        session.write_json(json, report)
        return 0
    how = solving.given | {"at": at}
    if check is not None:
        report = _show_check(result, full, check, seed=checks.seed, **how)
    elif len(results) > 1:
        report = _show_comparison(results, full, output=files.output, measure=measure, **grid.given, **how)
    else:
        report = _show_responses(result, full, pairs=pairs, measure=measure, preload=preload, **grid.given,
                                 **files.given, **how)  # fmt: skip
    session.write_json(json, report)
    return int(not report.get("passed", True))


def _show_comparison(results, full, **keywords):
    report = hpcred.workflows.compare_results(results, full, **keywords)
    show_table(f"against {full}, {report['frequencies_hz'][0]:g} to {report['frequencies_hz'][-1]:g} Hz",
               report["rows"])  # fmt: skip
    show_table("lowest modes of the model", report["modes"])
    for note in report["notes"]:
        say(note)
    return report


def _show_estimate(result, **keywords):
    report = hpcred.workflows.estimate_of_result(result, **keywords)
    session.verdict(report["sentence"], report["reached"])
    show_table(result, report["rows"])
    show_table(DIRECTIONS, report["direction_rows"])
    say(f"Q = {report['Q']:.6g}; {report['measured']}")
    session.warn([warning for warning in report["warnings"] if warning != report["sentence"]])
    return report


def _show_check(result, full, count, **keywords):
    report = hpcred.workflows.check_result(result, full, count, **keywords)
    session.verdict(f"{report['sentence']}\n{report['claim']}", report["passed"])
    show_table(result, report["rows"])
    say(report["measured"])
    return report


def _show_responses(result, full, **keywords):
    report = hpcred.evaluate(result, full, **keywords)
    # of pairs that were named their own responses, in place of norms over all, whose units may be mixed
    if "pairs" in report:
        sizes = {f"|H| {key} {row['pair']} ({row['unit']})": row[key]
                 for row in report["pairs"] for key in ("reduced", "full") if key in row}  # fmt: skip
    else:
        sizes = {f"|H| {key}": report[f"{key}_norm"] for key in ("reduced", "full") if f"{key}_norm" in report}
    columns = {"f (Hz)": report["frequencies_hz"], **sizes, **({"eps": report["eps"]} if "eps" in report else {})}
    show_table(result, [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)])
    if "pseudo_frequencies_hz" in report:
        frequencies = ", ".join(f"{f:.6g}" for f in report["pseudo_frequencies_hz"])
        say(f"pseudo-frequencies {'at the preload' if 'preload' in report else 'there'} (Hz): {frequencies}")
    session.warn(report.get("warnings", ()))
    if full:
        show_table(DIRECTIONS, report["direction_rows"])
        paper = " (55)" if report["measure"] == "paper" else ""
        say(f"Q = {report['Q']:.6g}, largest eps{paper} = {report['eps_max']:.6g}; {report['arithmetic']}")
    drawn = report.get("figures", ())
    session.list_all("drawn", drawn)
    if len(drawn) < report.get("responses", 0):
        say(f"the {len(drawn)} largest of {report['responses']} responses are drawn; --pairs OUTPUT/INPUT,... "
              "draws others")  # fmt: skip
    return report


@command
def response(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5|JOB.toml")],
    *,
    grid: FineGrid,
    tolerance: Annotated[float, typer.Option(help="Relative error of the response.")] = 1e-6,
    state: State,
    files: ResponseFiles,
    polar: Annotated[bool, typer.Option("--polar", help="Magnitude and phase in the .csv.")] = False,
    fresh: FreshPoints,
    groups: Annotated[int | None, typer.Option(help="Groups of ranks that share those of --check.")] = None,
    drive: Drive,
    solving: Solving,
    json: JsonFile = None,
):
    """Frequency response of the full model at many frequencies, to a tolerance, from a handful of factorisations.

    Of a RESULT.h5 with --psd, --harmonic or --srs: its response to loads of a table with units in its head.
    """
    # a result under loads of a table, which takes few of the options of a full model
    if drive.table is not None:
        full = [*grid.changed(), *state.changed(), *files.changed(), *fresh.changed()]
        others = {"--tolerance": tolerance != 1e-6, "--polar": polar, "--groups": groups is not None}
        others |= {f"--{key.replace('_', '-')}": value is not None for key, value in vars(solving).items()}
        full += [option for option, given in others.items() if given]
        if surplus := [option for option in full if option not in ("--band", "--output", "--figure", "--at")]:
            raise InputError(f"{surplus[0]}: belongs to a full model; leave it out with --{drive.table[0]}")
        report = hpcred.workflows.driven_response(
            model, band=grid.band, at=state.at, progress=session.progress(), **files.given, **drive.given
        )
        show_table(model, report["rows"])
        session.written(files.output, files.figure)
        session.warn(report["warnings"])
        session.write_json(json, report)
        return 0
    how = solving.given
    report = hpcred.response(model, tolerance=tolerance, polar=polar, groups=groups, **grid.given, **state.given,
                             **files.given, **fresh.given, **how)  # fmt: skip
    told = [*([] if report["reached"] else ["NOT REACHED everywhere:"]), *report["sentences"]]
    session.verdict("\n".join(told), report["reached"])
    show_table("Each new point checks the model before it", report["proofs"])
    if fresh.check:
        show_table("Fresh frequencies", report["check"]["rows"])
    made = counted(report["factorisations"], "factorisation")
    say(f"{len(report['frequencies_hz'])} frequencies from {made} and "
          f"{report['columns']} columns for {report['size']} dofs")  # fmt: skip
    session.written(files.output, files.figure)
    session.warn(report["warnings"])
    show_timing(how["progress"].timing())
    session.write_json(json, report)
    return 0 if report["reached"] else 1
