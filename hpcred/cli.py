"""The command line: parses, chooses the PETSc build, and calls the public functions."""

import os
import sys
from typing import Annotated

import typer

from .parallel import startup as runtime
from .parallel.failures import InputError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=False,
    rich_markup_mode=None,
    help="Reduced flexible bodies by moment matching, in parallel. Without a command: the built-in example. "
    "PETSc, SLEPc and MUMPS options follow after --, such as: hpcred reduce job.toml -- -log_view",
    epilog="Everywhere: --scalar real|complex insists on a PETSc build, --traceback shows where an error arose, "
    "--profile the events of PETSc in each stage.",
)
example = typer.Typer(help="Write a model to try things on.", rich_markup_mode=None)
app.add_typer(example, name="example")

_petsc_args: list[str] = []
_profile = False
_progress = None
_scalar: str | None = None

JsonFile = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Write the numbers as JSON.")]
Frequencies = Annotated[str | None, typer.Option(metavar="F1,F2,...", help="Frequencies in Hz.")]


def run(arguments: list[str]) -> int:
    """Run one command line on all ranks and return the exit status."""
    global _petsc_args, _scalar, _profile
    try:
        runtime.start_mpi()
        arguments, _petsc_args = _split(arguments)
        _scalar = _take(arguments, "--scalar")
        if "--traceback" in arguments:
            arguments.remove("--traceback")
            os.environ["HPCRED_TRACEBACK"] = "1"
        _profile = "--profile" in arguments
        if _profile:
            arguments.remove("--profile")
        if runtime.rank():
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        try:
            status = app(arguments, prog_name="hpcred", standalone_mode=False)
        except Exception as error:
            if hasattr(error, "format_message"):  # a usage error of the parser
                raise InputError(f"{error.format_message()} (see hpcred --help)") from error
            raise
        if _profile and _progress is not None:
            from .report.profile import show_profile

            show_profile(_progress.comm, _progress)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except (Exception, KeyboardInterrupt) as error:
        return runtime.fail(error)


def _split(arguments):
    arguments = list(arguments)
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    return arguments[:cut], arguments[cut + 1 :]


def _take(arguments, option):
    """Remove an option with a value from the arguments, wherever it stands."""
    for i, word in enumerate(arguments):
        if word == option and i + 1 < len(arguments):
            del arguments[i]
            return arguments.pop(i)
        if word.startswith(option + "="):
            return arguments.pop(i).partition("=")[2]
    return None


def _start(preferred="real"):
    """PETSc with the build that fits; returns the world communicator and a progress display."""
    global _progress
    scalar = runtime.start(_scalar, _petsc_args, preferred)
    from .parallel.petsc import MPI
    from .parallel.progress import Progress

    if runtime.can_choose() and MPI.COMM_WORLD.rank == 0 and sys.stderr.isatty():
        print(f"hpcred: {scalar} PETSc, {MPI.COMM_WORLD.size} rank(s)", file=sys.stderr)
    if _profile:
        from .report.profile import start_profile

        start_profile()
    _progress = Progress(MPI.COMM_WORLD)
    return MPI.COMM_WORLD, _progress


def _numbers(text, option):
    """Numbers separated by commas."""
    try:
        return [float(part) for part in text.split(",")] if text else []
    except ValueError as error:
        raise InputError(f"{option}: found '{text}', expected numbers separated by commas") from error


@app.callback(invoke_without_command=True)
def demo(context: typer.Context, version: Annotated[bool, typer.Option("--version")] = False, json: JsonFile = None):
    if version:
        from importlib.metadata import version as version_of

        print(f"hpcred {version_of('hpcred')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        comm, progress = _start()
        from .workflows.demo import run_demo

        run_demo(comm, "result.h5", progress, json)


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

    Either an Abaqus input file with the matrices that Abaqus wrote beside it, or files given by -K and -M: Matrix
    Market (also .gz), PETSc binary, SciPy .npz, or text lines of row, column, value.
    """
    from pathlib import Path

    files = list(files or [])
    if output is None:
        if not files:
            raise InputError("convert: no model file to write; give its name last or by -o")
        output = files.pop()
    comm, progress = _start()
    from .formats.hdf5 import check_writable
    from .formats.model_file import write_model
    from .report.tables import write_json
    from .workflows.convert import Source, abaqus_source
    from .workflows.convert import convert as read

    check_writable(output, comm)
    if files:
        if len(files) > 1 or stiffness or mass:
            raise InputError("convert: expected one input file, or the matrices by -K and -M")
        source = abaqus_source(files[0])
    elif stiffness and mass:
        source = Source(stiffness, mass, damping, input_file, output_file, nodes, dofs)
    else:
        raise InputError("convert: no matrices; give an Abaqus input file, or K and M by -K and -M")
    with progress.stage("read"), read(source, comm, Path(output).name) as model:
        if inputs:
            model.set_inputs(_targets(inputs, "--inputs"))
        if outputs:
            model.set_outputs(_targets(outputs, "--outputs"))
        with progress.stage("write"):
            write_model(output, model)
        summary = {"output": output, "size": model.size, "inputs": model.input_names}
        print(f"{output}: {model.size} dofs, matrices {', '.join(sorted(model.matrices))}, "
              f"{len(model.input_names)} inputs, {'with' if model.dofs else 'without'} nodes")  # fmt: skip
        write_json(comm, json, summary)


def _targets(text, option):
    """Dof numbers and node:direction pairs, separated by commas."""
    try:
        return [(int(part.partition(":")[0]), part.partition(":")[2].strip()) if ":" in part else int(part)
                for part in text.split(",")]  # fmt: skip
    except ValueError as error:
        raise InputError(f"{option}: found '{text}', expected such as 20:z,1:x or dof numbers 115,1") from error


@app.command()
def info(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    below: Annotated[str | None, typer.Option(metavar="F1,F2", help="Count modes below (Hz).")] = None,
    band_top: Annotated[float | None, typer.Option(help="Upper end of the band (Hz): size hint.")] = None,
    json: JsonFile = None,
):
    """Say what a model file contains, and what it needs."""
    frequencies = _numbers(below, "--below")
    if band_top is not None and band_top <= 0 or any(f <= 0 for f in frequencies):
        raise InputError("info: frequencies must be positive")
    comm, progress = _start()
    from .analysis.summary import inspect
    from .formats.model_file import read_model
    from .report.tables import show_table, write_json

    with progress.stage("read"):
        body = read_model(model, comm)
    with body, progress.stage("inspect"):
        report = inspect(body, frequencies, band_top, progress)
    rows = [[key.replace("_", " "), _plain(value)] for key, value in report.items()]
    show_table(comm, None, ["", model], rows)
    write_json(comm, json, report)


def _plain(value):
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(_plain(item) for item in value) if not value or not isinstance(value[0], list) else (
            "; ".join(_plain(item) for item in value)
        )  # fmt: skip
    return f"{value:.6g}" if isinstance(value, float) else "not known" if value is None else str(value)


@app.command()
def reduce(
    job: Annotated[str, typer.Argument(metavar="JOB.toml")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the job: basis.0.order=2"),
    ] = None,
    groups: Annotated[str | None, typer.Option(help="Groups of ranks for different points: a number or auto.")] = None,
    out_of_core: Annotated[str | None, typer.Option(metavar="DIR", help="Keep the factors in files there.")] = None,
    low_rank: Annotated[float | None, typer.Option(metavar="EPS", help="Block low rank factors, such as 1e-8.")] = None,
    json: JsonFile = None,
):
    """Reduce a model as a job file says."""
    from .formats.toml_file import read_table
    from .parallel.failures import agreed

    given = {"groups": groups, "out_of_core": out_of_core, "low_rank": low_rank}
    overrides = [*(set_ or []), *(f"{key}={value}" for key, value in given.items() if value is not None)]
    with agreed(runtime.start_mpi()):
        if read_table(job, overrides).get("low_rank") is not None:
            os.environ.setdefault("HPCRED_SCOTCH", "0")  # see SolverOptions
    comm, progress = _start()
    from .report.tables import show_table, show_timings, write_json
    from .workflows.reduce import run_job

    rom, output = run_job(job, overrides, comm, progress)
    with rom:
        record = rom.provenance
        show_table(
            comm,
            f"{output}: {rom.size} coordinates for {record['size']} dofs",
            ["basis", "columns", "new", "dropped"],
            [[item["where"], item["columns"], item["kept"], item["columns"] - item["kept"]]
             for item in record["ingredients"]],
        )  # fmt: skip
        residual = max((item["residual"] for item in record["factorisations"]), default=0.0)
        print(
            f"pseudo-frequencies {rom.frequencies[0]:.6g} to {rom.frequencies[-1]:.6g} Hz; "
            f"max |V^T M V - I| = {record['orthonormality_defect']:.1e}; largest residual {residual:.1e}; "
            f"{len(record['factorisations'])} factorisations, {record['symbolic_analyses']} analysis "
            f"({record['ordering']})"
        )
        show_timings(comm, record["run"], record["factorisations"])
        write_json(comm, json, {**record, "output": output, "reduced_size": rom.size,
                                "frequencies_hz": rom.frequencies.tolist()})  # fmt: skip


@app.command()
def evaluate(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    full: Annotated[str | None, typer.Option(metavar="MODEL.h5", help="Compare with this full model.")] = None,
    frequencies: Frequencies = None,
    band: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz; default: that of the job.")] = None,
    points: Annotated[int, typer.Option(help="Number of equally spaced frequencies in the band.")] = 61,
    output: Annotated[str | None, typer.Option("-o", help="Write the responses to this HDF5 file.")] = None,
    groups: Annotated[int | None, typer.Option(help="Groups of ranks that share the frequencies.")] = None,
    json: JsonFile = None,
):
    """Frequency response of a reduced model; with --full its error eps(f) (55) and Q (57)."""
    comm, progress = _start("complex" if full else "real")
    from .report.tables import show_table, write_json
    from .workflows.evaluate import evaluate_result

    limits = _numbers(band, "--band")
    if limits and (len(limits) != 2 or not 0 <= limits[0] < limits[1]):
        raise InputError(f"--band: found '{band}', expected 0 <= lower < upper in Hz, such as 0,300")
    report = evaluate_result(
        result, full, _numbers(frequencies, "--frequencies"), limits, points, comm, progress, output, groups
    )
    columns = ["f (Hz)", "|Hr|_F"] + (["|H|_F", "eps"] if full else [])
    rows = zip(*(report[key] for key in ("frequencies_hz", "reduced_norm", "full_norm", "eps") if key in report),
               strict=True)  # fmt: skip
    show_table(comm, result, columns, list(rows))
    if full:
        print(f"Q = {report['Q']:.6g}, largest eps = {report['eps_max']:.6g}; {report['arithmetic']}")
    write_json(comm, json, report)


@app.command()
def export(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    kind: Annotated[str, typer.Option("--format", help="sid, matlab, npz, exudyn, vtk or png.")] = "sid",
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE")] = None,
    nodes: Annotated[str | None, typer.Option(help="Interface nodes 1,20; default: of inputs and outputs.")] = None,
    json: JsonFile = None,
):
    """Hand a reduced body over to another program."""
    comm, _ = _start()
    from .report.tables import write_json
    from .workflows.export import export_result

    chosen = [int(number) for number in _numbers(nodes, "--nodes")] if nodes else None
    report = export_result(result, kind, output, chosen, comm)
    if "shapes" in report:
        print(f"{report['output']}: {', '.join(report['shapes'])}")
    else:
        print(f"{report['output']}: {report['coordinates']} elastic coordinates, nodes {report['nodes']}")
        for line in report["remarks"]:
            print(f"note: {line}")
    write_json(comm, json, report)


@app.command()
def simulate(
    file: Annotated[str, typer.Argument(metavar="SIM.toml")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: force.0.frequency=2.0"),
    ] = None,
    json: JsonFile = None,
):
    """Simulate a reduced body in time, with large rigid motion, forces and point constraints."""
    comm, progress = _start()
    from .multibody.simulation import run_simulation
    from .report.tables import show_table, write_json

    report = run_simulation(file, set_ or [], comm, progress)
    rows = [[int(node), value] for node, value in report["largest_displacement_m"].items()]
    show_table(comm, f"{', '.join(report['output'])}", ["node", "largest displacement (m)"], rows)
    print(f"constraint drift {report['constraint_drift_m']:.1e} m, energy defect {report['energy_defect']:.1e}")
    for line in report["notes"]:
        print(f"note: {line}")
    write_json(comm, json, report)


@app.command()
def paper(
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and data.")
    ] = "paper",
    json: JsonFile = None,
):
    """Reproduce Section 5 of the paper on the built-in linkage: Tables 1 and 2, Figures 3 to 5."""
    comm, progress = _start("complex")
    from .workflows.paper import reproduce

    reproduce(output, comm, progress, json)


@app.command()
def bench(
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra of the block to try on.")] = (40, 16, 16),
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="Where to try writing and reading.")] = None,
    json: JsonFile = None,
):
    """Measure this machine: factorisation, solves, products, orthogonality, files."""
    import tempfile
    from pathlib import Path

    comm, progress = _start()
    from .parallel.failures import agreed
    from .report.tables import show_table, write_json
    from .workflows.bench import bench as measure
    from .workflows.bench import hints

    with agreed(comm):
        if folder is not None and not Path(folder).is_dir():
            raise InputError(f"--folder: found '{folder}', expected a folder that exists")
    place = tempfile.TemporaryDirectory(prefix="hpcred-", dir=folder) if comm.rank == 0 else None
    try:
        report = comm.bcast(measure(cells, Path(comm.bcast(place.name if place else None)), comm, progress))
    finally:
        if place is not None:
            place.cleanup()
    show_table(comm, "This machine", ["", ""], [[key.replace("_", " "), _plain(item)] for key, item in report.items()])
    for line in hints(report):
        print(f"hint: {line}")
    write_json(comm, json, report)


@example.command("solid")
def example_solid(
    output: Annotated[str, typer.Option("-o", "--output", help="The model file to write.")] = "model.h5",
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra along x, y, z.")] = (60, 24, 24),
    size: Annotated[tuple[float, float, float] | None, typer.Option(help="Edges in m.")] = None,
    inputs: Annotated[int, typer.Option(help="Forces at nodes of the face at the free end.")] = 6,
    free: Annotated[bool, typer.Option("--free", help="Do not clamp the face at x = 0.")] = False,
):
    """A block of 8-node hexahedra, clamped at x = 0."""
    comm, _ = _start()
    from .examples.solid import solid

    _write_example(output, lambda: solid(cells, size, inputs, not free, comm), comm)


@example.command("linkage")
def example_linkage(
    output: Annotated[str, typer.Option("-o", "--output", help="The model file to write.")] = "model.h5",
):
    """The stabilisation linkage of the paper's Section 5, free, loaded at node 20 in z."""
    comm, _ = _start()
    from .examples.linkage import linkage

    _write_example(output, lambda: linkage(comm), comm)


def _write_example(output, make, comm):
    from .formats.hdf5 import check_writable
    from .formats.model_file import write_model

    check_writable(output, comm)
    with make() as model:
        write_model(output, model)
        print(f"{output}: {model.size} dofs, inputs {', '.join(model.input_names)}")
