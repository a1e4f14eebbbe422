"""Run a command line. The modules beside this one have the commands: each calls one public function and prints."""

from __future__ import annotations

import os
from copy import copy
from functools import cache
from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..report.tables import say, show_table
from . import session
from .assemble import assemble
from .bench import bench, paper
from .campbell import campbell
from .convert import convert, crank, linkage, solid
from .evaluate import evaluate, response
from .export import ExportCommand, export
from .info import bores, info, modes
from .options import JsonFile
from .plan import plan
from .recover import recover
from .reduce import reduce, store
from .report import report
from .simulate import simulate
from .sweep import collect, sweep

HELP = {"help_option_names": ["-h", "--help"]}


class Commands(typer.core.TyperGroup):
    """Lists each command with its whole first sentence, in several lines where it needs them."""

    def format_commands(self, ctx, formatter):
        with formatter.section("Commands"):
            formatter.write_dl([(name, each.get_short_help_str(limit=1000)) for name, each in self.commands.items()])


app = typer.Typer(
    cls=Commands,
    no_args_is_help=False,
    rich_markup_mode=None,
    context_settings=HELP,
    help="Reduced flexible bodies by moment matching, in parallel. Without a command: the built-in example. "
    "PETSc, SLEPc and MUMPS options follow after --, such as: hpcred reduce job.toml -- -log_view",
    epilog="Everywhere: --verbose shows progress from the beginning, --quiet errors and warnings only, --json - the "
    "numbers alone on standard output; --keep replaces no file; --scalar real|complex insists on a PETSc build; "
    "--profile shows the events of PETSc in each stage, --traceback where an error arose.",
)
example = typer.Typer(
    cls=Commands, help="Write a model to try things on.", rich_markup_mode=None, context_settings=HELP
)
NEXT = """next: hpcred report demo_result.h5   draws responses, error and shapes: report.html
      hpcred example crank           writes a model with bearings, model.h5
      hpcred info model.h5           says what a model is and needs
      hpcred --help                  lists all commands"""


def run(arguments: list[str]) -> int:
    """Run one command line on all ranks and return the exit status."""
    return session.run(arguments, _call)


@cache
def _command(name):
    """The command of this name, or all where there is none, made once in a process: all take 40 ms."""
    commands = [each for each in app.registered_commands if each.callback.__name__ == name]
    if not commands:
        return typer.main.get_command(app)
    alone = copy(app)
    alone.registered_commands, alone.registered_groups = commands, []
    return typer.main.get_command(alone)


def _call(arguments):
    """What the command returns, or the exit status of the parser."""
    if "_HPCRED_COMPLETE" in os.environ:
        return app(arguments, prog_name="hpcred", standalone_mode=False)
    command = _command(next((word for word in arguments if not word.startswith("-")), None))
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
        print(f"hpcred {hpcred.__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        progress, output = session.progress(), "demo_result.h5"
        rows = hpcred.demo(output, progress=progress)
        show_table("Stabilisation linkage, force at node 20, 0 to 300 Hz, and the paper's Table 1", rows)
        session.write_json(json, rows)
        timing = progress.timing()
        effort = f"{timing.elapsed:.3g} s, at most {max(timing.memory_mb_per_rank):.0f} MB a rank"
        say(f"model of row 0 written to {printable(output)}; {effort}")
        print(NEXT)


app.add_typer(example, name="example")
for command in (convert, info, bores, modes, plan, reduce, store, sweep, collect, evaluate, report, response, campbell):
    app.command()(command)
app.command(cls=ExportCommand, context_settings={"allow_extra_args": True})(export)
for command in (assemble, simulate, recover, paper, bench):
    app.command()(command)
for command in (solid, linkage, crank):
    example.command()(command)
