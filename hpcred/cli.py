"""The command line: parses, calls one public function, and prints what it gives."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict
from typing import Annotated

import typer

import hpcred

from .parallel import startup
from .parallel.failures import InputError, fail
from .report.profile import show_profile, start_profile
from .report.tables import in_words, show_table, show_timing, write_json

app = typer.Typer(
    add_completion=False,
    no_args_is_help=False,
    rich_markup_mode=None,
    help="Reduced flexible bodies by moment matching, in parallel. Without a command: the built-in example. "
    "PETSc, SLEPc and MUMPS options follow after --, such as: hpcred reduce job.toml -- -log_view",
    epilog="Everywhere: --scalar real|complex insists on a PETSc build, --traceback shows where an error arose, "
    "--profile the events of PETSc in each stage, --quiet no progress.",
)
example = typer.Typer(help="Write a model to try things on.", rich_markup_mode=None)
app.add_typer(example, name="example")

JsonFile = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Write the numbers as JSON.")]
Frequencies = Annotated[str | None, typer.Option(metavar="F1,F2,...", help="Frequencies in Hz.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: basis.0.order=2")
]
OutOfCore = Annotated[str | None, typer.Option(metavar="DIR", help="Keep the factors in files there.")]
LowRank = Annotated[float | None, typer.Option(metavar="EPS", help="Block low rank factors, such as 1e-8.")]
ModelOutput = Annotated[str, typer.Option("-o", "--output", help="The model file to write.")]


class _Session:
    """What the options that stand everywhere say, and the progress of the command."""

    profile = quiet = False
    progress: hpcred.Progress


def run(arguments: list[str]) -> int:
    """Run one command line on all ranks and return the exit status."""
    try:
        comm = startup.start_mpi()
        arguments = list(arguments)
        cut = arguments.index("--") if "--" in arguments else len(arguments)
        arguments, petsc_args = arguments[:cut], arguments[cut + 1 :]
        startup.insist(_take(arguments, "--scalar"), petsc_args)
        for word in ("--traceback", "--profile", "--quiet"):
            given = word in arguments
            if given:
                arguments.remove(word)
            if word == "--traceback" and given:
                os.environ["HPCRED_TRACEBACK"] = "1"
            setattr(_Session, word[2:], given)
        _Session.progress = hpcred.Progress(comm, show=False if _Session.quiet else None)
        if comm.rank:
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        try:
            status = app(arguments, prog_name="hpcred", standalone_mode=False)
        except Exception as error:
            if hasattr(error, "format_message"):  # a usage error of the parser
                raise InputError(f"{error.format_message()} (see hpcred --help)") from error
            raise
        if _Session.profile and startup.started():
            show_profile(comm, _Session.progress)
        for name in startup.unused_options():
            print(f"hpcred: warning: nothing used the PETSc option -{name}", file=sys.stderr)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except (Exception, KeyboardInterrupt) as error:
        return fail(error)


def _take(arguments, option):
    """Remove an option with a value from the arguments, wherever it stands."""
    for i, word in enumerate(arguments):
        if word == option and i + 1 < len(arguments):
            del arguments[i]
            return arguments.pop(i)
        if word.startswith(option + "="):
            return arguments.pop(i).partition("=")[2]
    return None


def _progress():
    if _Session.profile:
        start_profile()
    return _Session.progress


def _warn(sentences):
    for sentence in sentences:
        print(f"warning: {sentence}")


def _numbers(text, option):
    """Numbers separated by commas."""
    try:
        return [float(part) for part in text.split(",")] if text else []
    except ValueError as error:
        raise InputError(f"{option}: found '{text}', expected numbers separated by commas") from error


def _targets(text, option):
    """Dof numbers and node:direction pairs, separated by commas."""
    try:
        return [(int(part.partition(":")[0]), part.partition(":")[2].strip()) if ":" in part else int(part)
                for part in text.split(",")] if text else None  # fmt: skip
    except ValueError as error:
        raise InputError(f"{option}: found '{text}', expected such as 20:z,1:x or dof numbers 115,1") from error


@app.callback(invoke_without_command=True)
def demo(context: typer.Context, version: Annotated[bool, typer.Option("--version")] = False, json: JsonFile = None):
    if version:
        from importlib.metadata import version as version_of

        print(f"hpcred {version_of('hpcred')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        progress, output = _progress(), "result.h5"
        rows = hpcred.run_demo(output, progress=progress)
        show_table("Stabilisation linkage, Table 1 of the paper: force at node 20, chord frame, 0 to 300 Hz", rows)
        write_json(json, rows)
        print(f"model of row 1 written to {output}")
        show_timing(progress.timing())


@app.command()
def convert(
    files: Annotated[list[str] | None, typer.Argument(metavar="[BLOCK.inp] MODEL.h5")] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", help="The model file to write.")] = None,
    stiffness: Annotated[str | None, typer.Option("-K", "--stiffness", help="Matrix file of K.")] = None,
    mass: Annotated[str | None, typer.Option("-M", "--mass", help="Matrix file of M.")] = None,
    damping: Annotated[str | None, typer.Option("-D", "--damping", help="Matrix file of D.")] = None,
    input_file: Annotated[str | None, typer.Option("-B", help="Matrix file of B (n, p).")] = None,
    output_file: Annotated[str | None, typer.Option("-C", help="Matrix file of C (r, n).")] = None,
    nodes: Annotated[str | None, typer.Option(help="Lines of node, x, y, z; or an Abaqus .inp.")] = None,
    dofs: Annotated[str | None, typer.Option(help="Lines of node, direction (1-6), one a row.")] = None,
    inputs: Annotated[str | None, typer.Option("--inputs", help="Unit loads: 20:z,1:x or dof numbers 115,1")] = None,
    outputs: Annotated[str | None, typer.Option("--outputs", help="Outputs that differ from inputs.")] = None,
    json: JsonFile = None,
):
    """Bring matrices of another program into a model file.

    Either the main file of an export: an Abaqus input file with the matrices that Abaqus wrote beside it, ANSYS' .full,
    or a matrix of its HBMAT or *EXPORT; or files given by -K and -M: Matrix Market (also .gz), PETSc binary, SciPy
    .npz, Harwell-Boeing, or Abaqus' text of row, column, value or node, dof, node, dof, value.
    """
    files = list(files or [])
    if output is None:
        if not files:
            raise InputError("convert: no model file to write; give its name last or by -o")
        output = files.pop()
    if files and (len(files) > 1 or stiffness or mass):
        raise InputError("convert: expected one input file, or the matrices by -K and -M")
    if not files and not (stiffness and mass):
        raise InputError("convert: no matrices; give an Abaqus input file, or K and M by -K and -M")
    source = files[0] if files else hpcred.Source(stiffness, mass, damping, input_file, output_file, nodes, dofs)
    report = hpcred.convert(
        source, output, inputs=_targets(inputs, "--inputs"), outputs=_targets(outputs, "--outputs"),
        progress=_progress(),
    )  # fmt: skip
    print(f"{output}: {report['size']} dofs, matrices {', '.join(report['matrices'])}, "
          f"{len(report['inputs'])} inputs, {'with' if report['nodes'] else 'without'} nodes")  # fmt: skip
    _warn(report["warnings"])
    write_json(json, report)


@app.command()
def info(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    below: Annotated[str | None, typer.Option(metavar="F1,F2", help="Count modes below (Hz).")] = None,
    band_top: Annotated[float | None, typer.Option(help="Upper end of the band (Hz): size hint.")] = None,
    json: JsonFile = None,
):
    """Say what a model file contains, and what it needs."""
    report = hpcred.inspect_file(
        model, frequencies=_numbers(below, "--below"), band_top=band_top, progress=_progress()
    )
    rows = [{"": key.replace("_", " "), model: in_words(value)} for key, value in report.items() if key != "warnings"]
    show_table(None, rows)
    _warn(report["warnings"])
    write_json(json, report)


@app.command()
def reduce(
    job: Annotated[str, typer.Argument(metavar="JOB.toml")],
    set_: Overrides = None,
    groups: Annotated[str | None, typer.Option(help="Groups of ranks for different points: a number or auto.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    json: JsonFile = None,
):
    """Reduce a model as a job file says."""
    folder = out_of_core and os.path.abspath(out_of_core)  # of the command line, not of the job file
    given = {"groups": groups, "out_of_core": folder, "low_rank": low_rank}
    overrides = [*(set_ or []), *(f"{key}={value}" for key, value in given.items() if value is not None)]
    found = hpcred.reduce_job(job, overrides=overrides, progress=_progress())
    record = found.record
    show_table(
        f"{found.output}: {found.size} coordinates for {record.size} dofs",
        [{"basis": item.where, "columns": item.columns, "new": item.kept, "dropped": item.columns - item.kept}
         for item in record.ingredients],
    )  # fmt: skip
    residual = max((item.residual for item in record.factorisations), default=0.0)
    print(
        f"pseudo-frequencies {found.frequencies[0]:.6g} to {found.frequencies[-1]:.6g} Hz; "
        f"max |V^T M V - I| = {record.orthonormality_defect:.1e}; largest residual {residual:.1e}; "
        f"{len(record.factorisations)} factorisations, {record.symbolic_analyses} analysis ({record.ordering})"
    )
    _warn(record.warnings)
    print(f"{record.scalar} PETSc {record.versions['petsc']}, {record.ranks} rank(s)")
    show_timing(record.timing, record.factorisations)
    write_json(json, {**asdict(record), "output": found.output, "reduced_size": found.size,
                      "frequencies_hz": found.frequencies})  # fmt: skip


@app.command()
def evaluate(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    full: Annotated[str | None, typer.Option(metavar="MODEL.h5", help="Compare with this full model.")] = None,
    frequencies: Frequencies = None,
    band: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz; default: that of the job.")] = None,
    points: Annotated[int, typer.Option(help="Number of equally spaced frequencies in the band.")] = 61,
    output: Annotated[str | None, typer.Option("-o", help="Write the responses to this HDF5 file.")] = None,
    groups: Annotated[int | None, typer.Option(help="Groups of ranks that share the frequencies.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    json: JsonFile = None,
):
    """Frequency response of a reduced model; with --full its error eps(f) (55) and Q (57)."""
    limits = _numbers(band, "--band")
    if limits and (len(limits) != 2 or not 0 <= limits[0] < limits[1]):
        raise InputError(f"--band: found '{band}', expected two frequencies in Hz such as 0,300")
    factoring = hpcred.Factoring(out_of_core=out_of_core, low_rank=low_rank) if out_of_core or low_rank else None
    report = hpcred.evaluate_result(
        result, full, frequencies=_numbers(frequencies, "--frequencies"), band=limits or None, points=points,
        output=output, groups=groups, factoring=factoring, progress=_progress(),
    )  # fmt: skip
    columns = {"f (Hz)": "frequencies_hz", "|H| reduced": "reduced_norm", "|H| full": "full_norm", "eps": "eps"}
    columns = {title: report[key] for title, key in columns.items() if key in report}
    show_table(result, [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)])
    if full:
        print(f"Q = {report['Q']:.6g}, largest eps = {report['eps_max']:.6g}; {report['arithmetic']}")
    write_json(json, report)


@app.command()
def export(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    kind: Annotated[str, typer.Option("--format", help="sid, matlab, npz, exudyn, vtk or png.")] = "sid",
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE")] = None,
    nodes: Annotated[str | None, typer.Option(help="Interface nodes 1,20; default: of inputs and outputs.")] = None,
    json: JsonFile = None,
):
    """Hand a reduced body over to another program."""
    chosen = [int(number) for number in _numbers(nodes, "--nodes")] if nodes else None
    report = hpcred.export_result(result, kind, output, nodes=chosen, progress=_progress())
    if "shapes" in report:
        print(f"{report['output']}: {', '.join(report['shapes'])}")
    else:
        print(f"{report['output']}: {report['coordinates']} elastic coordinates, nodes {report['nodes']}")
        for line in report["remarks"]:
            print(f"note: {line}")
    write_json(json, report)


@app.command()
def simulate(
    file: Annotated[str, typer.Argument(metavar="SIM.toml")],
    set_: Overrides = None,
    json: JsonFile = None,
):
    """Simulate a reduced body in time, with large rigid motion, forces and point constraints."""
    report = hpcred.simulate_file(file, overrides=set_ or [], progress=_progress())
    rows = [{"node": int(node), "largest displacement (m)": value}
            for node, value in report["largest_displacement_m"].items()]  # fmt: skip
    show_table(", ".join(report["output"]), rows)
    print(f"constraint drift {report['constraint_drift_m']:.1e} m, energy defect {report['energy_defect']:.1e}")
    for line in report["notes"]:
        print(f"note: {line}")
    write_json(json, report)


@app.command()
def paper(
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and data.")
    ] = "paper",
    json: JsonFile = None,
):
    """Reproduce Section 5 of the paper on the built-in linkage: Tables 1 and 2, Figures 3 to 5."""
    progress = _progress()
    data = hpcred.reproduce(output, progress=progress)
    show_table("Table 1. SISO: chord frame, force at node 20", data["table_1"])
    show_table("Table 2. MIMO: Buckens frame, seven inputs and outputs", data["table_2"])
    show_table("Figure 5. u_y of node 20 in time, against all elastic modes", data["figure_5"][1:])
    print(f"figures 3 to 5 (png, svg), section5.h5 and section5.json written to {output}")
    show_timing(progress.timing())
    write_json(json, data)


@app.command()
def bench(
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra of the block to try on.")] = (40, 16, 16),
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="Where to try writing and reading.")] = None,
    json: JsonFile = None,
):
    """Measure this machine: factorisation, solves, products, orthogonality, files."""
    report = hpcred.bench(cells, folder=folder, progress=_progress())
    show_table("This machine", [{"": key.replace("_", " "), " ": in_words(item)} for key, item in report.items()
                                if key != "hints"])  # fmt: skip
    for line in report["hints"]:
        print(f"hint: {line}")
    write_json(json, report)


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


def _example(name, output, **keywords):
    report = hpcred.write_example(name, output, **keywords)
    print(f"{output}: {report['size']} dofs, inputs {', '.join(report['inputs'])}")
