"""The command line: parses, calls one public function, and prints what it gives."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Annotated

import typer

import hpcred

from . import session, words
from .parallel.failures import InputError
from .parallel.progress import counted
from .report.tables import in_words, show_table, show_timing, told_apart
from .settings.toml_file import check_file_names
from .writers.registry import WRITERS

HELP = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    no_args_is_help=False,
    rich_markup_mode=None,
    context_settings=HELP,
    help="Reduced flexible bodies by moment matching, in parallel. Without a command: the built-in example. "
    "PETSc, SLEPc and MUMPS options follow after --, such as: hpcred reduce job.toml -- -log_view",
    epilog="Everywhere: --verbose shows progress from the beginning, --quiet errors and warnings only, --json - the "
    "numbers alone on standard output; --keep replaces no file; --scalar real|complex insists on a PETSc build; "
    "--profile shows the events of PETSc in each stage, --traceback where an error arose.",
)
example = typer.Typer(help="Write a model to try things on.", rich_markup_mode=None, context_settings=HELP)
app.add_typer(example, name="example")
JsonFile = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the numbers; - prints them.", callback=session.checked),
]
Frequencies = Annotated[str | None, typer.Option(metavar="F1,F2,...", help="Frequencies in Hz.")]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: tolerance=1e-6, basis.0.order=2"),
]
Pairs = Annotated[
    str | None, typer.Option(metavar="OUT/IN,...", help="Responses to draw, such as 20:z/20:z,20:z/1:x.")
]
Full = Annotated[str | None, typer.Option(metavar="MODEL.h5", help="Compare with this full model.")]
Band = Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz; default: that of the job.")]
Points = Annotated[int, typer.Option(help="Number of equally spaced frequencies in the band.")]
Groups = Annotated[int | None, typer.Option(help="Groups of ranks that share the frequencies.")]
Seed = Annotated[int | None, typer.Option(help="The fresh frequencies of an earlier --check.")]
Inputs = Annotated[str | None, typer.Option("--inputs", help="Unit loads: 20:z,1:x or dof numbers 115,1")]
Outputs = Annotated[str | None, typer.Option("--outputs", help="Outputs that differ from inputs.")]
OutOfCore = Annotated[str | None, typer.Option(metavar="DIR", help="Keep the factors in files there.")]
LowRank = Annotated[float | None, typer.Option(metavar="EPS", help="Block low rank factors, such as 1e-8.")]
Package = Annotated[str | None, typer.Option(help="What factors: mumps, superlu_dist or petsc.")]
FORMATS = f"{', '.join(entry.name for entry in WRITERS.own)}; the last five of a model in interface coordinates."
DIRECTIONS = "Directions by themselves, the least accurate first (|H| in SI units: m/N, rad/(N m))"
INTERFACES = "Interfaces, and where their reference nodes are (m)"
NEXT = """next: hpcred report demo_result.h5   draws responses, error and shapes: report.html
      hpcred example crank           writes a model with bearings, model.h5
      hpcred info model.h5           says what a model is and needs
      hpcred --help                  lists all commands"""
MOST_SETS = 20  # node sets that info lists
ModelOutput = Annotated[str, typer.Option("-o", "--output", help="The model file to write.")]


def run(arguments: list[str]) -> int:
    """Run one command line on all ranks and return the exit status."""
    return session.run(arguments, _call)


def _call(arguments):
    """What the command returns, or the exit status of the parser."""
    if "_HPCRED_COMPLETE" in os.environ:
        return app(arguments, prog_name="hpcred", standalone_mode=False)
    command = typer.main.get_command(app)
    try:  # the parser's own way to call a command takes interruptions and broken pipes of one rank for an end
        with command.make_context("hpcred", arguments) as context:
            return command.invoke(context)
    except typer.Exit as error:
        return error.exit_code
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error of the parser
            command = getattr(error.ctx, "command_path", "hpcred")
            raise InputError(f"{error.format_message()} (see {command} --help)") from error
        raise


@app.callback(invoke_without_command=True)
def demo(context: typer.Context, version: Annotated[bool, typer.Option("--version")] = False, json: JsonFile = None):
    if version:
        from importlib.metadata import version as version_of

        print(f"hpcred {version_of('hpcred')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        progress, output = session.progress(), "demo_result.h5"
        rows = hpcred.run_demo(output, progress=progress)
        show_table("Stabilisation linkage, force at node 20, 0 to 300 Hz, and the paper's Table 1", rows)
        session.write_json(json, rows)
        timing = progress.timing()
        effort = f"{timing.elapsed:.3g} s, at most {max(timing.memory_mb_per_rank):.0f} MB a rank"
        print(f"model of row 0 written to {output}; {effort}")
        print(NEXT)
    elif json is not None:
        raise InputError("--json: found before the command; write it after the command")


@app.command()
def convert(
    files: Annotated[list[str] | None, typer.Argument(metavar="[EXPORT] MODEL.h5")] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", help="The model file to write.")] = None,
    stiffness: Annotated[str | None, typer.Option("-K", "--stiffness", help="Matrix file of K.")] = None,
    mass: Annotated[str | None, typer.Option("-M", "--mass", help="Matrix file of M.")] = None,
    damping: Annotated[str | None, typer.Option("-D", "--damping", help="Matrix file of D.")] = None,
    input_file: Annotated[str | None, typer.Option("-B", help="Matrix file of B (n, p).")] = None,
    output_file: Annotated[str | None, typer.Option("-C", help="Matrix file of C (r, n).")] = None,
    nodes: Annotated[str | None, typer.Option(help="Lines of node, x, y, z; or .inp, .bdf, .unv, .cdb, .frd.")] = None,
    dofs: Annotated[str | None, typer.Option(help="Lines of node, direction (1-6), one a row.")] = None,
    inputs: Inputs = None,
    outputs: Outputs = None,
    variables: Annotated[str | None, typer.Option(metavar="K=...,M=...", help="Names of matrices in a file.")] = None,
    units: Annotated[str, typer.Option(help="Units of the files: SI; mm,t,s; mm-kg-ms; inch-lbf-s; ...")] = "SI",
    list_formats: Annotated[bool, typer.Option("--list-formats", help="Say what can be read, and stop.")] = False,
    json: JsonFile = None,
):
    """Bring matrices of another program into a model file.

    Either the main file of a whole export (an Abaqus or CalculiX input file, ...), whose other files are found beside
    it, or single matrices given by -K and -M. See --list-formats.
    """
    if list_formats:
        from .readers.registry import READERS

        show_table("Formats, each told by what the file begins with", hpcred.list_formats())
        session.warn(READERS.broken)
        return
    files = list(files or [])
    if output is None:
        if not files or (len(files) == 1 and not (stiffness or mass) and os.path.exists(files[0])):
            raise InputError("convert: no model file to write; give its name last or by -o")
        output = files.pop()
    if files and (len(files) > 1 or stiffness or mass):
        raise InputError("convert: expected one input file, or the matrices by -K and -M")
    if not files and not (stiffness and mass):
        found = "no matrices" if not (stiffness or mass) else f"only {'K' if stiffness else 'M'}"
        raise InputError(f"convert: {found}; give the main file of an export, or K and M by -K and -M")
    given = {"-D": damping, "-B": input_file, "-C": output_file, "--nodes": nodes, "--dofs": dofs}
    if files and (besides := [option for option, value in given.items() if value]):
        raise InputError(f"convert: {', '.join(besides)} belong to -K and -M only, found with {files[0]}")
    names = words.names(variables, "--variables")
    source = files[0] if files else hpcred.Source(stiffness, mass, damping, input_file, output_file, nodes, dofs, names)
    report = hpcred.convert(
        source, output, inputs=words.targets(inputs, "--inputs"), outputs=words.targets(outputs, "--outputs"),
        variables=names, units=units, progress=session.progress(),
    )  # fmt: skip
    told = ("output", "sentences", "warnings")
    show_table(None, [{"": key.replace("_", " "), output: in_words(value)} for key, value in report.items()
                      if key not in told])  # fmt: skip
    for sentence in report["sentences"]:
        print(sentence)
    session.warn(report["warnings"])
    session.write_json(json, report)


@app.command()
def info(
    file: Annotated[str, typer.Argument(metavar="FILE")],
    below: Annotated[str | None, typer.Option(metavar="F1,F2", help="Count modes below (Hz).")] = None,
    band_top: Annotated[float | None, typer.Option(help="Upper end of the band (Hz): size hint.")] = None,
    modes: Annotated[int | None, typer.Option(help="Find so many of the lowest frequencies.")] = None,
    verify: Annotated[bool, typer.Option("--verify", help="Read all of it, and check all checksums.")] = False,
    figure: Annotated[
        str | None, typer.Option(metavar="FILE", help="Draw node sets, or the interfaces of a job: .png, .svg, .pdf.")
    ] = None,
    names: Annotated[str | None, typer.Option("--sets", metavar="A,B", help="Draw these node sets only.")] = None,
    json: JsonFile = None,
):
    """Say what a file is: what a model contains and needs, and the format and matrices of any other file."""
    if names and not figure:
        raise InputError("--sets: belongs to --figure")
    if verify and (below or band_top or modes or figure):
        raise InputError("--verify: cannot be combined with other questions; call info twice")
    report = hpcred.verify_file(file) if verify else hpcred.describe_file(
        file, frequencies=words.numbers(below, "--below"), band_top=band_top, modes=modes, figure=figure,
        sets=names.split(",") if names else None, progress=session.progress(),
    )  # fmt: skip
    below_it = ("sets", "interfaces", "warnings")
    rows = [{"": key.replace("_", " "), file: in_words(value)} for key, value in report.items() if key not in below_it]
    show_table(None, rows)
    show_table(INTERFACES, report.get("interfaces", []))
    sets = [{"node set": name, "nodes": count} for name, count in report.get("sets", {}).items()]
    show_table(None, sets[:MOST_SETS])
    if len(sets) > MOST_SETS:
        print(f"and {len(sets) - MOST_SETS} more node sets; --json - lists all")
    if figure:
        print(f"written to {figure}")
    session.warn(report["warnings"])
    session.write_json(json, report)


@app.command()
def bores(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    turn: Annotated[float, typer.Option(help="Degrees around its axis that a cylinder has at least.")] = 120.0,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="Draw them: .png, .svg, .pdf.")] = None,
    json: JsonFile = None,
):
    """Find the holes and pins of a model, and print them as interfaces for a job."""
    report = hpcred.bores_of_file(model, turn=turn, figure=figure, progress=session.progress())
    rows = [
        {"name": row["name"], **dict(zip(("centre x", "y", "z"), row["centre"], strict=True)),
         "axis": words.direction(row["axis"]), "radius": row["radius"], "length": row["length"],
         "turn": f"{row['turn']:g}", "nodes": row["nodes"]} for row in report["bores"]
    ]  # fmt: skip
    if rows:
        show_table(f"{model}: holes (bore) and pins; m, turn in degrees", rows)
        print(f"Lines for the job; give them names of your own, and leave out what is no bearing\n\n{report['job']}")
    else:
        print(f"{model}: no cylinder of {turn:g} degrees or more on its surface; --turn takes less")
    if figure:
        print(f"written to {figure}")
    session.warn(report["warnings"])
    session.write_json(json, report)


@app.command()
def modes(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    count: Annotated[int, typer.Option(help="How many of the lowest modes, rigid-body modes included.")] = 20,
    frame: Annotated[str, typer.Option(help="auto, or as for response.")] = "auto",
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="A .png of the first six elastic modes.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    package: Package = None,
    json: JsonFile = None,
):
    """Lowest natural frequencies, effective masses and participation factors of a model.

    A free body shows its rigid-body modes at 0 Hz, unless a frame other than auto holds it.
    """
    report = hpcred.modes_of_file(
        model, count, frame=None if frame == "auto" else words.frame(frame), figure=figure,
        factoring=words.factoring(out_of_core, low_rank, package), progress=session.progress(),
    )  # fmt: skip
    f = report["frequencies_hz"]
    if "masses" in report:
        share, factors = hpcred.tables_of_modes(report)
        show_table(f"{model}: effective masses in % of the mass along x, y, z and of the inertia about them", share)
        show_table("Participation factors (kg^(1/2); kg^(1/2) m)", factors)
        print(hpcred.mass_in_words(report))
    else:
        show_table(model, [{"mode": i, "f (Hz)": value} for i, value in enumerate(f, 1)])
    print(f"{report['rigid_body_modes']} rigid-body modes; largest residual {report['residual']:.1e}")
    if figure:
        print(f"written to {figure}")
    session.warn(report["warnings"])
    session.write_json(json, report)


@app.command()
def reduce(
    job: Annotated[str, typer.Argument(metavar="JOB.toml")],
    set_: Overrides = None,
    groups: Annotated[str | None, typer.Option(help="Groups of ranks for different points: a number or auto.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    store: Annotated[
        str | None,
        typer.Option("--store", "--restart", metavar="DIR", help="Keep expansion points there, and go on from those."),
    ] = None,
    json: JsonFile = None,
):
    """Reduce a model as a job file says."""
    folders = {"out_of_core": out_of_core, "store": store}  # of the command line, not of the job file
    given = {"groups": groups, "low_rank": low_rank}
    check_file_names(**{"--store": store, "--out-of-core": out_of_core})
    given |= {key: os.path.abspath(name) for key, name in folders.items() if name is not None}
    overrides = [*(set_ or []), *(f"{key}={value}" for key, value in given.items() if value is not None)]
    found = hpcred.reduce_job(job, overrides=overrides, progress=session.progress())
    record, accuracy = found.record, found.record.accuracy
    stored = any(item.from_store for item in record.components)
    if accuracy is not None:
        made = counted(accuracy.factorisations, "factorisation")
        session.verdict(f"{accuracy.sentence}, {made}, {found.size_in_words}", accuracy.reached)
        show_table(DIRECTIONS, accuracy.direction_rows)
    show_table(
        f"{found.output}: {found.size_in_words} for {record.size} dofs",
        [{"basis": item.where, "columns": item.columns, "new": item.kept, "dropped": item.columns - item.kept,
          **({"from": "store" if item.from_store else ""} if stored else {})} for item in record.components],
    )  # fmt: skip
    show_table(INTERFACES, record.interface_rows)
    if accuracy is not None:
        show_table("Expansion points", [
            {"f (Hz)": item.frequency, "columns": item.columns, "modes below": in_words(item.modes_below),
             "estimate after it": in_words(item.estimate), "factor": item.factor_in_words} for item in accuracy.points
        ])  # fmt: skip
        show_table("Each new point checks the model before it", [asdict(item) for item in accuracy.proofs])
        print(f"{accuracy.measured}; {accuracy.missing_modes} modes missing; round-off {accuracy.noise:.0e}; "
              f"{accuracy.big_size} columns before the compression")  # fmt: skip
    residual = max((item.residual for item in record.factorisations), default=0.0)
    print(
        f"pseudo-frequencies {found.frequencies[0]:.6g} to {found.frequencies[-1]:.6g} Hz; "
        f"max |V^T M V - I| = {record.orthonormality_defect:.1e}; "
        + (f"largest residual {residual:.1e}; " if record.factorisations else "")
        + record.effort
    )
    told = accuracy.sentence if accuracy is not None else None  # which the verdict has said
    session.warn([item for item in record.warnings if item != told])
    print(f"{record.scalar} PETSc {record.versions['petsc']}, {record.ranks} rank(s)")
    show_timing(record.timing, record.factorisations)
    session.list_all("hint", record.hints)
    session.write_json(json, {**asdict(record), "output": found.output, "reduced_size": found.size,
                              "frequencies_hz": found.frequencies})  # fmt: skip
    return int(accuracy is not None and not accuracy.reached)


@app.command()
def store(
    folder: Annotated[str, typer.Argument(metavar="DIR")],
    check: Annotated[bool, typer.Option("--check", help="Verify all checksums.")] = False,
    prune: Annotated[bool, typer.Option("--prune", help="Remove entries that fit all of the options below.")] = False,
    older: Annotated[str | None, typer.Option(metavar="30d", help="Not used for so long (m, h, d, w).")] = None,
    below: Annotated[
        str | None, typer.Option(metavar="10G", help="The longest unused, until no more than this is left.")
    ] = None,
    model: Annotated[str | None, typer.Option(metavar="NAME", help="Of the model of this name.")] = None,
    broken: Annotated[bool, typer.Option("--broken", help="Damaged, or left by a run that was killed.")] = False,
    json: JsonFile = None,
):
    """List, check and prune a folder of expansion points (reduce --store DIR)."""
    given = {"--older": older, "--below": below, "--model": model, "--broken": broken or None}
    if not prune and any(value is not None for value in given.values()):
        raise InputError(f"{next(key for key in given if given[key] is not None)}: belongs to --prune")
    if prune:
        rows = hpcred.prune_store(
            folder, older=words.amount(older, "--older", {"m": 60, "h": 3600, "d": 86400, "w": 604800}),
            below=words.amount(below, "--below", {"k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}), model=model, broken=broken,
        )  # fmt: skip
    else:
        rows = hpcred.list_store(folder, check=check)
    show_table(folder, [
        {"entry": row["kind"] if row["valid"] and row["kind"] else row["entry"],
         **{key: "" if row[key] is None else row[key] for key in ("model", "point", "blocks", "columns")},
         "MB": round(row["bytes"] / 1e6, 3), "date": (row["date"] or "")[:10],
         **({} if prune else {"valid": "yes" if row["valid"] else f"no: {row['reason']}"})} for row in rows
    ])  # fmt: skip
    total = sum(row["bytes"] for row in rows)
    print(f"{len(rows)} entries{' removed' if prune else ''}, {total / 1e6:.6g} MB")
    session.write_json(json, rows)
    return int(not prune and not all(row["valid"] for row in rows if ".tmp-" not in row["entry"]))


@app.command()
def sweep(
    file: Annotated[str, typer.Argument(metavar="SWEEP.toml")],
    parallel: Annotated[int | None, typer.Option(help="Runs at the same time.")] = None,
    index: Annotated[int | None, typer.Option(help="Only this share of the runs, from 1; with --of.")] = None,
    of: Annotated[int | None, typer.Option(help="Number of shares.")] = None,
    store: Annotated[str | None, typer.Option(metavar="DIR", help="Expansion points are kept and found there.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, list the runs, and stop.")] = False,
    slurm: Annotated[bool, typer.Option("--slurm", help="Write the array script for SLURM.")] = False,
    pbs: Annotated[bool, typer.Option("--pbs", help="Write the array script for PBS.")] = False,
    submit: Annotated[bool, typer.Option("--submit", help="Submit that script.")] = False,
    json: JsonFile = None,
):
    """Run many reductions that differ in some keys of the job; what is finished is skipped.

    On this machine, one after the other or --parallel; or as an array of a batch system. See docs/sweeps.md.
    """
    if slurm or pbs or submit:
        if slurm == pbs:
            raise InputError("--submit: belongs to --slurm or --pbs" if submit and not slurm else
                             "--slurm: write one script after the other, --slurm or --pbs")  # fmt: skip
        if dry_run or parallel is not None or index is not None or of is not None:
            raise InputError("--slurm, --pbs: a script is written and nothing runs; leave the other options out")
        report = hpcred.write_script(file, "slurm" if slurm else "pbs", store=store, submit=submit)
        print(f"{report['script']} written; " + (report["said"] or f"submit it by: {report['command']}"))
        session.write_json(json, report)
        return 0
    report = hpcred.run_sweep(
        file, parallel=parallel, index=index, of=of, store=store, dry_run=dry_run, progress=session.progress()
    )
    columns = [key for key in report["runs"][0] if key not in ("sentence", "output")] if report["runs"] else []
    show_table(report["folder"], _named_shortly([{key: row.get(key, "") for key in columns} for row in report["runs"]]))
    for row in report["failed"]:
        session.verdict(f"FAILED {row['run']}: {row['sentence']}", False)
    if not dry_run:
        print(f"{report['finished']} finished, {report['skipped']} skipped, {len(report['failed'])} failed; "
              f"{report['factorisations']} factorisations made, {report['factorisations_saved']} saved")  # fmt: skip
    session.write_json(json, report)
    return int(bool(report["failed"]) and not dry_run)


def _named_shortly(rows):
    """Rows of runs with as much of their names as tells them apart, and then the names of their files."""
    names = [row["run"] for row in rows]
    short = told_apart(names)
    files = [{"result": f"{name}.h5"} if short != names else {} for name in names]
    return [row | {"run": name} | file for row, name, file in zip(rows, short, files, strict=True)]


@app.command()
def collect(
    file: Annotated[str, typer.Argument(metavar="SWEEP.toml")],
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE", help=".csv, .json or .h5")] = None,
    figures: Annotated[str | None, typer.Option(metavar="DIR", help="Draw errors over size, keys, frequency.")] = None,
    store: Annotated[str | None, typer.Option(metavar="DIR", help="As for sweep.")] = None,
    json: JsonFile = None,
):
    """One table of the results of a sweep, and figures that compare them."""
    report = hpcred.collect_sweep(file, output=output, figures=figures, store=store)
    rows = report["rows"]
    short = {"factorisations": "factored", "factorisations_saved": "saved", "memory_mb": "MB"}
    known = [key for key in rows[0] if any(row[key] is not None for row in rows)]
    rows = [{short.get(key, key): "" if row[key] is None else row[key] for key in known} for row in rows]
    show_table(file, _named_shortly(rows))
    session.list_all("note", report["remarks"])
    for name in (*([output] if output else []), *report["figures"]):
        print(f"written to {name}")
    if missing := report["missing"]:
        few = ", ".join(missing[:8]) + ", ..." * (len(missing) > 8)
        session.verdict(f"{len(missing)} of {len(report['rows'])} runs have no result of their job: {few}", False)
    session.write_json(json, report)
    return int(bool(report["missing"]))


@app.command()
def evaluate(
    results: Annotated[list[str], typer.Argument(metavar="RESULT.h5 ...")],
    full: Full = None,
    frequencies: Frequencies = None,
    band: Band = None,
    points: Points = 61,
    output: Annotated[
        str | None, typer.Option("-o", "--output", metavar="FILE", help="Write the responses: a .csv or HDF5 file.")
    ] = None,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="Draw responses: .png, .svg, .pdf.")] = None,
    pairs: Pairs = None,
    measure: Annotated[
        str | None, typer.Option(help="What eps is: directions, or paper, the Frobenius norm (55).")
    ] = None,
    estimate: Annotated[bool, typer.Option("--estimate", help="eps(f) from the result alone.")] = False,
    check: Annotated[int | None, typer.Option(help="Set said against exact at so many fresh frequencies.")] = None,
    seed: Seed = None,
    groups: Groups = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    package: Package = None,
    json: JsonFile = None,
):
    """Frequency response of a reduced model; with --full its error eps(f) and Q (57).

    Several results of one model stand beside each other, with --full: sizes, errors, pseudo-modes against modes.

    Of a model that was reduced to a tolerance: --estimate shows the error that is known, largest in each of --points
    parts of the band; --full MODEL.h5 --check 5 sets it against full solves.
    """
    result = results[0]
    if len(results) > 1 and (estimate or figure or check is not None or full is None):
        raise InputError("evaluate: several results are compared with the model that --full names, and without "
                         "--estimate, --check or --figure; call evaluate once for each result")  # fmt: skip
    given = {"--band": band, "--frequencies": frequencies, "-o": output, "--full": full, "--check": check,
             "--figure": figure, "--pairs": pairs}
    allowed = ("--full", "--check") if check is not None else ("--frequencies",) if estimate else tuple(given)
    wrong = [option for option, value in given.items() if value is not None and option not in allowed]
    if wrong or (estimate and check is not None):
        raise InputError(f"{'--check' if check is not None else '--estimate'}: cannot be combined with "
                         f"{', '.join(wrong) or '--estimate'}; call evaluate twice")  # fmt: skip
    if pairs and not figure:
        raise InputError("--pairs: belongs to --figure")
    if check is not None and full is None:
        raise InputError("--check: the model file is missing; give it by --full MODEL.h5")
    if seed is not None and check is None:
        raise InputError("--seed: belongs to --check")
    if measure is not None and (full is None or check is not None):
        raise InputError("--measure: belongs to --full without --check")
    limits = words.band(band)
    factoring = words.factoring(out_of_core, low_rank, package)
    chosen = {"frequencies": words.numbers(frequencies, "--frequencies")}
    if estimate:
        session.write_json(json, _show_estimate(result, parts=points, **chosen))
        return 0
    solving = {"groups": groups, "factoring": factoring, "progress": session.progress()}
    if check is not None:
        report = _show_check(result, full, check, seed=seed, **solving)
    elif len(results) > 1:
        report = _show_comparison(results, full, band=limits, points=points, output=output, measure=measure,
                                  **chosen, **solving)  # fmt: skip
    else:
        pairs = pairs.split(",") if pairs else ()
        report = _show_responses(result, full, band=limits, points=points, output=output, figure=figure, pairs=pairs,
                                 measure=measure, **chosen, **solving)  # fmt: skip
    session.write_json(json, report)
    return int(not report.get("passed", True))


def _show_comparison(results, full, **keywords):
    report = hpcred.compare_results(results, full, **keywords)
    show_table(f"against {full}, {report['frequencies_hz'][0]:g} to {report['frequencies_hz'][-1]:g} Hz",
               report["rows"])  # fmt: skip
    show_table("lowest modes of the model", report["modes"])
    return report


def _show_estimate(result, **keywords):
    report = hpcred.estimate_of_result(result, **keywords)
    show_table(result, report["rows"])
    show_table(DIRECTIONS, report["direction_rows"])
    print(f"{report['sentence']}\nQ = {report['Q']:.6g}; {report['measured']}")
    session.warn([item for item in report["warnings"] if item != report["sentence"]])
    return report


def _show_check(result, full, count, **keywords):
    report = hpcred.check_result(result, full, count, **keywords)
    show_table(result, report["rows"])
    session.verdict(f"{report['claim']}\n{report['sentence']}; {report['measured']}", report["passed"])
    return report


def _show_responses(result, full, **keywords):
    report = hpcred.evaluate_result(result, full, **keywords)
    columns = {"f (Hz)": "frequencies_hz", "|H| reduced": "reduced_norm", "|H| full": "full_norm", "eps": "eps"}
    columns = {title: report[key] for title, key in columns.items() if key in report}
    show_table(result, [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)])
    if full:
        show_table(DIRECTIONS, report["direction_rows"])
        paper = " (55)" if report["measure"] == "paper" else ""
        print(f"Q = {report['Q']:.6g}, largest eps{paper} = {report['eps_max']:.6g}; {report['arithmetic']}")
    drawn = report.get("figures", ())
    session.list_all("drawn", drawn)
    if len(drawn) < report.get("responses", 0):
        print(f"the {len(drawn)} largest of {report['responses']} responses are drawn; --pairs OUTPUT/INPUT,... "
              "draws others")  # fmt: skip
    return report


@app.command()
def report(
    results: Annotated[list[str], typer.Argument(metavar="RESULT.h5 ...")],
    full: Full = None,
    output: Annotated[str, typer.Option("-o", "--output", metavar="FILE", help="The HTML file.")] = "report.html",
    band: Band = None,
    exact: Annotated[int, typer.Option(help="Frequencies at which the full model is solved.")] = 21,
    pairs: Pairs = None,
    modes: Annotated[int, typer.Option(help="Number of shapes to look at.")] = 10,
    png: Annotated[str | None, typer.Option(metavar="DIR", help="Figures for papers, too.")] = None,
    svg: Annotated[str | None, typer.Option(metavar="DIR", help="Figures for papers, too.")] = None,
    csv: Annotated[str | None, typer.Option(metavar="DIR", help="The numbers as tables, too.")] = None,
    groups: Groups = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    package: Package = None,
    json: JsonFile = None,
):
    """Write a report on results beside each other, one HTML file to look at in a browser, without a network."""
    told = hpcred.report_file(
        results, full, output=output, band=words.band(band), exact=exact, pairs=pairs.split(",") if pairs else (),
        modes=modes, png=png, svg=svg, csv=csv, groups=groups,
        factoring=words.factoring(out_of_core, low_rank, package),
        progress=session.progress(),
    )  # fmt: skip
    session.list_all("note", told["notes"])
    for name in told["files"]:
        print(name)
    print(f"{told['output']}: {told['megabytes']:.1f} MB")
    session.write_json(json, told)


@app.command()
def response(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    band: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz.")] = None,
    points: Points = 2001,
    frequencies: Frequencies = None,
    tolerance: Annotated[float, typer.Option(help="Relative error of the response.")] = 1e-6,
    frame: Annotated[str, typer.Option(help="none, buckens, tangent:NODE or chord:N1,N2,N3[:AXES].")] = "none",
    damping: Annotated[
        str | None,
        typer.Option(help="none, given, rayleigh:ALPHA,BETA or loss:FACTOR; given by default where the model has a D."),
    ] = None,
    inputs: Inputs = None,
    outputs: Outputs = None,
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE", help="A .csv or HDF5 file.")] = None,
    polar: Annotated[bool, typer.Option("--polar", help="Magnitude and phase in the .csv.")] = False,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="A .png, .svg or .pdf.")] = None,
    check: Annotated[int, typer.Option(help="Factor at so many fresh frequencies, and compare.")] = 0,
    seed: Seed = None,
    groups: Annotated[int | None, typer.Option(help="Groups of ranks that share those of --check.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    package: Package = None,
    json: JsonFile = None,
):
    """Frequency response of the full model at many frequencies, to a tolerance, from a handful of factorisations."""
    progress = session.progress()
    report = hpcred.response_file(
        model, frequencies=words.numbers(frequencies, "--frequencies"), band=words.band(band), points=points,
        tolerance=tolerance, frame=words.frame(frame), damping=None if damping is None else words.damping(damping),
        inputs=words.targets(inputs, "--inputs"), outputs=words.targets(outputs, "--outputs"), check=check, seed=seed,
        groups=groups, factoring=words.factoring(out_of_core, low_rank, package), output=output, polar=polar,
        figure=figure, progress=progress,
    )  # fmt: skip
    told = [*([] if report["reached"] else ["NOT REACHED everywhere:"]), *report["sentences"]]
    session.verdict("\n".join(told), report["reached"])
    show_table("Proofs: the model before a point, at the point", report["proofs"])
    if check:
        show_table("Fresh frequencies", report["check"]["rows"])
    made = counted(report["factorisations"], "factorisation")
    print(f"{len(report['frequencies_hz'])} frequencies from {made} and "
          f"{report['columns']} columns for {report['size']} dofs")  # fmt: skip
    for name in (output, figure):
        if name:
            print(f"written to {name}")
    session.warn(report["warnings"])
    show_timing(progress.timing())
    session.write_json(json, report)
    return 0 if report["reached"] else 1


class ExportCommand(typer.core.TyperCommand):
    """A command whose help ends with the formats of other packages."""

    def format_epilog(self, ctx, formatter):
        if others := ", ".join(f"{entry.name} ({entry.package})" for entry in WRITERS.others):
            formatter.write_paragraph()
            formatter.write_text(f"Formats of other packages: {others}")


@app.command(cls=ExportCommand, context_settings={"allow_extra_args": True})
def export(
    context: typer.Context,
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    kind: Annotated[str | None, typer.Option("--format", help=FORMATS)] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE")] = None,
    nodes: Annotated[
        str | None, typer.Option(help="Interface nodes 1,20 or by name, or sets; default: of inputs and outputs.")
    ] = None,
    units: Annotated[str, typer.Option(help="Units of the file: SI; mm,t,s; ...")] = "SI",
    modes: Annotated[str | None, typer.Option(help="Shapes of a picture, from 1, such as 7,8.")] = None,
    json: JsonFile = None,
):
    """Hand a reduced body over to another program."""
    if more := context.args:
        option = "-o" if os.path.splitext(more[0])[1] else "--format"
        raise InputError(f"export: found '{more[0]}' after {result}; a format is named by --format and the file to "
                         f"write by -o: hpcred export {result} {option} {more[0]}")  # fmt: skip
    chosen = [int(word) if word.strip().isdecimal() else word.strip() for word in nodes.split(",")] if nodes else None
    shapes = [int(number) for number in words.numbers(modes, "--modes")] if modes else None
    report = hpcred.export_result(
        result, kind, output, nodes=chosen, units=units, modes=shapes, progress=session.progress()
    )
    if "shapes" in report:
        print(f"{report['output']}: {', '.join(report['shapes'])}")
    else:
        ends = ", ".join(f"{key} {', '.join(map(str, report[key]))}" for key in ("nodes", "inputs", "outputs")
                         if key in report)  # fmt: skip
        print(f"{report['output']}: {report['coordinates']} coordinates, {ends}")
        for name in report.get("files", ()):
            print(f"with {name}")
        session.list_all("note", report["remarks"])
    session.write_json(json, report)


@app.command()
def simulate(
    file: Annotated[str, typer.Argument(metavar="SIM.toml")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: end=2.0, force.0.node=20"),
    ] = None,
    json: JsonFile = None,
):
    """Simulate a reduced body in time, with large rigid motion, loads, joints, drives and springs."""
    report = hpcred.simulate_file(file, overrides=set_ or [], progress=session.progress())
    rows = [{"node": node, "largest displacement (m)": value}
            for node, value in report["largest_displacement_m"].items()]  # fmt: skip
    show_table(", ".join(report["output"]), rows)
    print(f"constraint drift {report['constraint_drift_m']:.1e} m and {report['constraint_drift_rad']:.1e} rad, "
          f"energy defect {report['energy_defect']:.1e}")  # fmt: skip
    session.list_all("note", report["notes"])
    session.write_json(json, report)


@app.command()
def paper(
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and data.")
    ] = "paper",
    json: JsonFile = None,
):
    """Reproduce Section 5 of the paper on the built-in linkage: Tables 1 and 2, Figures 3 to 5."""
    progress = session.progress()
    data = hpcred.reproduce(output, progress=progress)
    show_table("Table 1. SISO: chord frame, force at node 20", data["table_1"])
    show_table("Table 2. MIMO: Buckens frame, seven inputs and outputs", data["table_2"])
    show_table("Figure 5. u_y of node 20 in time, against all elastic modes", data["figure_5"][1:])
    print(f"figures 3 to 5 (png, svg), section5.h5 and section5.json written to {output}")
    show_timing(progress.timing())
    session.write_json(json, data)


@app.command()
def bench(
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra of the block to try on.")] = (40, 16, 16),
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="Where to try writing and reading.")] = None,
    json: JsonFile = None,
):
    """Measure this machine: factorisation, solves, products, orthogonality, files."""
    report = hpcred.bench(cells, folder=folder, progress=session.progress())
    show_table("This machine", [{"": key.replace("_", " "), " ": in_words(item)} for key, item in report.items()
                                if key != "hints"])  # fmt: skip
    session.list_all("hint", report["hints"])
    session.write_json(json, report)


@example.command("solid")
def example_solid(
    output: ModelOutput = "model.h5",
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra along x, y, z.")] = (60, 24, 24),
    size: Annotated[tuple[float, float, float] | None, typer.Option(help="Edges in m.")] = None,
    inputs: Annotated[int, typer.Option(help="Forces at nodes of the face at the free end.")] = 6,
    free: Annotated[bool, typer.Option("--free", help="Do not clamp the face at x = 0.")] = False,
):
    """A block of 8-node hexahedra, clamped at x = 0."""
    _example("solid", output, cells=cells, size=size, inputs=inputs, clamped=not free)


@example.command("linkage")
def example_linkage(output: ModelOutput = "model.h5"):
    """The stabilisation linkage of the paper's Section 5, free, loaded at node 20 in z."""
    _example("linkage", output)


@example.command("crank")
def example_crank(
    output: ModelOutput = "model.h5",
    dofs: Annotated[int, typer.Option(help="About so many dofs.")] = 20_000,
):
    """A free connecting rod of hexahedra, with its bearings as the node sets BIG_EYE and SMALL_EYE."""
    _example("crank", output, dofs=dofs)


def _example(name, output, **keywords):
    report = hpcred.write_example(name, output, progress=session.progress(), **keywords)
    known = "; ".join(f"{key} {', '.join(report[key])}" for key in ("inputs", "sets") if report[key])
    print(f"{output}: {report['size']} dofs, {known}")
