"""Print tables, and write the results of workflows as text or JSON, on rank 0."""

import json
import math
import re
import shutil
import sys
import textwrap

from ..files.hdf5 import written_by_one
from ..parallel.messages import folded, printable
from ..parallel.petsc import MPI
from ..parallel.progress import Timing

NAMES = {"mumps": "MUMPS", "cudss": "cuDSS", "superlu_dist": "SuperLU_DIST", "petsc": "PETSc"}  # of packages
NO_BREAK = "\N{NO-BREAK SPACE}"


def say(text: str, file=None):
    """Print sentences, a line each, folded to the width of the terminal. What is to be copied is printed as it is."""
    print(folded(text), file=file)


def show_table(title, rows: list[dict]):
    """Print rows, dicts with the same keys, as a table on rank 0; numbers are right-aligned.

    It is as wide as the terminal (or COLUMNS), 80 where there is none. Every row is one line: where the columns do not
    fit, the longest texts, or else the last columns, follow below, behind the first column again. Only texts that are
    longer than such a line take several, between their words, which are never parted, so that names can be copied.
    """
    if MPI.COMM_WORLD.rank or not rows:
        return
    columns = shutil.get_terminal_size().columns
    rows = [{printable(column): value for column, value in row.items()} for row in rows]
    if title:
        print(textwrap.fill(printable(title), columns, break_long_words=False, break_on_hyphens=False))
    first, *left = rows[0]
    whole = columns - 2
    start = _width(first, rows, whole // 3, True)
    room = whole - start - 2
    while True:
        widths = _fitting(left, rows, room)
        _show({first: start, **widths}, rows)
        left = [column for column in left if column not in widths]
        if not left:
            return


def _fitting(columns, rows, room) -> dict[str, int]:
    """Return the widths of those columns that fit beside each other, with two blanks before each; of one at least."""
    for head in (True, False):  # heads of texts take several lines only where that helps
        widths = {column: _width(column, rows, room - 2, head) for column in columns}
        if sum(widths.values()) + 2 * len(widths) <= room:
            return widths
    while len(widths) > 1 and sum(widths.values()) + 2 * len(widths) > room:
        texts = [column for column in widths if not _numeric(column, rows)]
        del widths[max(texts, key=widths.get) if texts else list(widths)[-1]]
    return widths


def _width(column, rows, most, head) -> int:
    """Return the width of a column with each row in one line of at most `most`, but for longer words; `head`: the head
    of texts too, while that of numbers always takes several."""
    longest = max(len(_cell(row[column])) for row in rows)
    if head and not _numeric(column, rows):
        longest = max(longest, len(column))
    return max(_widest_word(column, rows), min(longest, most))


def told_apart(names: list[str]) -> list[str]:
    """Return names of runs (see settings.sweep_file) by what tells them apart: basis-modal_order-1 among orders is 1,
    among bases and orders modal_1. Names of other forms stay as they are."""
    settings = [[word.partition("-") for word in name.split("_")] for name in names]
    if len({tuple(key for key, _, _ in row) for row in settings}) > 1 or len(set(names)) < 2:
        return names
    differing = [k for k, column in enumerate(zip(*settings, strict=True)) if len(set(column)) > 1]
    return ["_".join(row[k][2] or row[k][0] for k in differing) for row in settings]


def _numeric(column, rows):
    return all(isinstance(row[column], (int, float)) for row in rows)


def _widest_word(column, rows) -> int:
    """Return the length of the longest word of a column and its head, where a unit is one with its blanks."""
    words = " ".join(_cell(row[column]) for row in rows).split()
    return max(map(len, [*words, *_whole_units(column).split(" ")]), default=1)


def _whole_units(head) -> str:
    """Return a head whose texts in parentheses have blanks at which it is not parted."""
    return re.sub(r"\([^()]*\)", lambda match: match[0].replace(" ", NO_BREAK), head)


def _show(widths, rows):
    from rich import box  # not at the start of a run, most of which comes before its tables
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, header_style="", collapse_padding=True)
    for column, width in widths.items():
        blank = not table.columns  # before the first one, which rich forgets where padding collapses
        if _numeric(column, rows):
            head = textwrap.fill(_whole_units(column), width).replace(NO_BREAK, " ")
            table.add_column(head, justify="right", width=width + blank)
        else:
            table.add_column(column, width=width + blank)
    for row in rows:
        table.add_row(*(_cell(row[column]) for column in widths))
    wide = sum(widths.values()) + 2 * len(widths) + 2  # with blanks beside each
    sys.stdout.flush()  # else rich does so, and ends the process where nobody reads it any more
    console = Console(file=sys.stdout, width=wide, highlight=False, markup=False, emoji=False)
    with console.capture() as captured:
        console.print(table)
    print("\n".join(line.rstrip() for line in captured.get().splitlines()), flush=True)


def _cell(value) -> str:
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))


def in_words(value) -> str:
    """Return a number, text, list or dict of a report in a line."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {in_words(entry)}" for key, entry in value.items())
    if isinstance(value, list):
        if not value:
            return "none"
        return ("; " if isinstance(value[0], list) else ", ").join(in_words(entry) for entry in value)
    if value is None or value != value:  # NaN
        return "not known"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def write_json(path, data, comm=MPI.COMM_WORLD):
    """Write data as JSON on rank 0, whole or not at all. Collective. Raises InputError."""
    if path is None:
        return
    written_by_one(path, comm, lambda temporary: temporary.write_text(as_json(data) + "\n"))


def as_json(data) -> str:
    """Return plain data as JSON, which has no NaN and no Inf: null stands for them."""
    return json.dumps(_finite(data), indent=1, allow_nan=False)


def _finite(data):
    if isinstance(data, dict):
        return {key: _finite(entry) for key, entry in data.items()}
    if isinstance(data, (list, tuple)):
        return [_finite(entry) for entry in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def show_timing(timing: Timing, factorisations=()):
    """Print the time of each stage of a run, the share of factors in it, and their memory."""
    if MPI.COMM_WORLD.rank:
        return
    # stages, the longest first
    spent = sorted(timing.seconds.items(), key=lambda entry: -entry[1])
    total = timing.elapsed
    listed = ", ".join(f"{name} {value:.2f} s ({100 * value / total:.0f} %)" for name, value in spent if value > 0)
    say(f"time {total:.2f} s: {listed}; at most {max(timing.memory_mb_per_rank):.0f} MB a rank")
    # within these, multigrid
    rest = [entry for entry in factorisations if not entry.direct]
    if rest:
        keys = ("factor_seconds", "solve_seconds")
        spent = [sum(getattr(entry, key) for entry in rest) for key in keys]
        say(
            f"multigrid {sum(spent):.2f} s of it ({100 * sum(spent) / total:.0f} %): levels {spent[0]:.2f} s, solves "
            f"{spent[1]:.2f} s for {sum(entry.columns_solved for entry in rest)} columns; levels of "
            f"{max(entry.memory_mb_used_max_rank for entry in rest)} MB a rank"
        )
    # and the direct solver, whose memory is the largest of all factors
    factorisations = [entry for entry in factorisations if entry.direct]
    if factorisations:
        keys = ("analysis_seconds", "factor_seconds", "solve_seconds")
        spent = [sum(getattr(entry, key) for entry in factorisations) for key in keys]
        used = max(entry.memory_mb_used_max_rank for entry in factorisations)
        last = factorisations[-1]
        where = "a rank" if last.package != "cudss" else "of the GPU and the host" if last.in_host else "of the GPU"
        memory = f"; {used} MB {where}" if used else ""
        if last.package == "cudss" or last.gpu_failed:
            memory += f" ({last.package_because})" if last.package_because else ""
        say(
            f"{NAMES.get(last.package, last.package)} {sum(spent):.2f} s of it "
            f"({100 * sum(spent) / total:.0f} %): analysis {spent[0]:.2f} s, factorisations {spent[1]:.2f} s, solves "
            f"{spent[2]:.2f} s{memory}"
        )
