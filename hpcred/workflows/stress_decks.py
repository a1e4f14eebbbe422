"""Let a finite-element program compute the stresses of a basis: write its input files, and read its answers."""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np

from ..body.stress import StressModes
from ..fe.dofs import SCALAR
from ..files.folders import atomic_folder, check_folder, folder_for
from ..files.hdf5 import reading, require_name
from ..files.included import Included
from ..files.outputs import check_outputs, hdf5_kind
from ..files.result_file import FORMAT, ROWS_AT_A_TIME, SCHEMA, VERSION, Result, copy_with_stress, require_basis
from ..files.result_points import read_points
from ..files.system_errors import open_input, writing_to
from ..model.units import units_of
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up
from ..readers.same_mesh import read_nodes, require_places
from ..readers.stresses.source import read_answers
from ..writers.decks import OWN_SET, SET, CalculixDeck, deck_called
from .workflow import workflow

AT_ONCE = 2**18  # rows of text
DIGITS = 2e-5  # of the largest displacement of a column: two numbers of six digits


@workflow
def write_deck(result, program: str, original, folder, *, units: str = "SI", comm=None, progress=None) -> dict:
    """Write input files by which a finite-element program computes the stresses of the columns of a basis. Collective.

    Parameters
    ----------
    result : Result or path
        result.h5, with its basis and nodes.
    program : {"calculix", "calculix-dat", "ansys", "nastran"}
    original : path
        The input file that the matrices came from; its model is taken, and its steps are left out.
    folder : path
        A new or empty folder.
    units : str, default "SI"
        Those of the original, as they were given to `convert`, such as "mm,t,s".

    Returns
    -------
    dict
        folder, files, columns, run: what to run there.

    Raises
    ------
    InputError
        For a result without nodes or basis, an unknown program, an original that is no input file of it or has another
        mesh or other units, and a folder with files in it.

    Notes
    -----
    Each column is a step with all displacements prescribed: exact for any element and any basis. `add_stresses` reads
    the answers.
    """
    system = units_of(units)
    deck, source, folder = deck_called(program), result.path if isinstance(result, Result) else result, Path(folder)
    require_name(source)
    with agreed(comm):
        check_folder(folder, None)
        count = _check_rows(source)
        names = [deck.column % number for number in range(1, count + 1)]
        main = _main_text(deck, Path(original), names) if comm.rank == 0 else ""
    with progress.stage("read", str(original)):
        nodes = read_nodes(original, comm, calculix=isinstance(deck, CalculixDeck))
        require_places(comm, original, nodes, system, *_places(source, comm), str(source))
    with folder_for(folder.parent, comm, "output "), atomic_folder(folder, comm, _is_of(deck), False) as made:
        with agreed(comm), writing_to(folder):
            if comm.rank == 0:
                (made / deck.job).write_text(main, encoding="latin-1")
        comm.Barrier()
        with agreed(comm), progress.stage("write", str(folder)), writing_to(folder):
            _write_columns(source, range(comm.rank, count, comm.size), system.length, deck, made)
            if deck.supports and comm.rank == comm.size - 1:
                _write_supports(source, deck, made / deck.supports)
    return {"folder": str(folder), "files": [deck.job, *names], "columns": count, "run": deck.run}


@workflow
def add_stresses(result, answers, output, *, units: str = "SI", comm=None, progress=None) -> dict:
    """Write a copy of a result with the stresses that a finite-element program computed from the input of write_deck.
    Collective.

    Parameters
    ----------
    result : Result or path
        The result.h5 that write_deck was given.
    answers : path
        The results of the program: .frd of CalculiX, or .dat beside its input file, .rst of ANSYS, punch file or
        OP2 of Nastran.
    output : path
        A new result.h5, with `basis/stress`.
    units : str, default "SI"
        Those of write_deck.

    Returns
    -------
    dict
        output, columns, nodes: the number with stresses, source.

    Raises
    ------
    InputError
        For answers of another number of steps or of other displacements than the columns of the basis.
    """
    system = units_of(units)
    source, output = result.path if isinstance(result, Result) else result, Path(output)
    require_name(source)
    check_outputs({output: hdf5_kind(FORMAT)}, comm, [source, answers], progress=progress)
    with progress.stage("read", str(answers)):
        read = read_answers(answers, comm)
        points = read_points(source, comm)
    count = len(points.shapes)
    if len(read.stress) != count:
        raise InputError(f"{answers}: found {len(read.stress)} steps with stresses, expected {count}, one a column of "
                         f"{source}")  # fmt: skip
    _check_displacements(answers, source, read, points, system.length, comm)
    with progress.stage("write", str(output)):
        pascal = system.mass / (system.length * system.time**2)
        modes = StressModes(read.node, read.stress * pascal, read.source)
        copy_with_stress(source, output, modes, comm)
    return {"output": str(output), "columns": count, "nodes": comm.allreduce(len(read.node)), "source": read.source}


def _is_of(deck):
    """Return a function that tells whether a file has a name of those that are written for a program."""
    column = re.escape(deck.column).replace("%04d", r"\d+")
    names = re.compile("|".join([re.escape(deck.job), re.escape(deck.supports or deck.job), column]))
    return lambda path: bool(names.fullmatch(path.name))


def _check_rows(source) -> int:
    """Return the number of columns of a basis. Raises InputError where rows are no directions of nodes.

    Scalar rows, such as internal modes of elements, may be there: the program computes these at rest.
    """
    with reading(source, FORMAT, VERSION, SCHEMA) as file:
        require_basis(file, source)
        rows = file["basis/V"].shape[1]
        for low in range(0, rows, ROWS_AT_A_TIME):
            if (file["dofs/direction"][low : low + ROWS_AT_A_TIME] > SCALAR).any():
                raise InputError(
                    f"{source}: found rows that are no displacements or rotations of nodes in the axes of the model "
                    "(of expanded shells and beams), which no input file can prescribe"
                )
        return file["basis/V"].shape[0]


def _main_text(deck, original, names) -> str:
    """Return the text of the main file. Raises InputError."""
    text = _whole_text(original, deck.include)
    try:
        return deck.main(text, names)
    except InputError as error:
        raise InputError(f"{original}: {error}") from error


def _places(source, comm):
    """Return nodes (k,) of a result and their positions (k, 3) in m, a share of them on each rank."""
    placed = []
    with agreed(comm), reading(source, FORMAT, VERSION, SCHEMA) as file:
        for group in ("dofs", "held"):
            if group in file:
                count = len(file[f"{group}/node"])
                mine = slice(count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size)
                node, direction, position = (file[f"{group}/{key}"][mine] for key in ("node", "direction", "position"))
                placed.append((node[direction < SCALAR], position[direction < SCALAR]))
    node, position = map(np.concatenate, zip(*placed, strict=True))
    node, first = np.unique(node.astype(np.int64), return_index=True)
    return node, position[first]


def _whole_text(path, include) -> str:
    """Return the text of an input file, with those that it includes. Raises InputError."""
    included = Included(path)

    def whole(file, above=()):
        name = included.add(file, above)
        if name not in included.own:
            with open_input(file) as text:
                included.own[name] = text.read().decode("latin-1").replace("\r\n", "\n")
        if include is None:
            return included.own[name]

        def text_of(match):
            words = "".join(line.strip() for line in match[1].splitlines()).strip("\"' ")
            return whole(file.parent / words, (*above, name)).rstrip() + "\n"

        return include.sub(text_of, included.own[name])

    return whole(path)


def _write_columns(source, numbers, length, deck, folder):
    """Write the files of columns of these numbers, from 0: displacements in a unit of length (m), and rotations.

    The text of a piece but for the values is made once for all columns, and filled by one format operation.
    """
    with reading(source, FORMAT, VERSION, SCHEMA) as file:
        for rows, placed, node, direction in _rows(file, "dofs"):
            text = deck.line * len(node) % _paired(node.tolist(), _words(deck, direction))
            for number in numbers:
                values = file["basis/V"][number, rows][placed]
                values[direction < 3] /= length
                with open(folder / (deck.column % (number + 1)), "a", encoding="ascii") as lines:
                    lines.write(text.replace(OWN_SET, f"{SET + number + 1:16d}") % tuple(values.tolist()))


def _write_supports(source, deck, path):
    """Write a line for each dof, also for those that are held."""
    with reading(source, FORMAT, VERSION, SCHEMA) as file, open(path, "w", encoding="ascii") as lines:
        for group in ("dofs", "held"):
            for *_, node, direction in _rows(file, group) if group in file else ():
                lines.write(deck.support * len(node) % _paired(_words(deck, direction), node.tolist()))


def _paired(first, second) -> tuple:
    """Return items of two lists in turns."""
    return tuple(chain.from_iterable(zip(first, second, strict=True)))


def _words(deck, direction) -> list:
    """Return what a program calls directions (k,)."""
    return np.array(deck.directions)[direction].tolist()


def _rows(file, group):
    """Yield some rows of a group at a time: their part of all, which have places, their nodes and directions."""
    for low in range(0, len(file[f"{group}/node"]), AT_ONCE):
        rows = slice(low, low + AT_ONCE)
        node, direction = (file[f"{group}/{key}"][rows] for key in ("node", "direction"))
        placed = direction < SCALAR
        yield rows, placed, node[placed], direction[placed]


def _check_displacements(answers, source, read, points, length, comm):
    """Raise InputError where the displacements of the answers are not those of the columns of the basis."""
    count, nodes = len(points.shapes), len(points.node)
    moved = points.shapes.reshape(count, nodes, 3).transpose(0, 2, 1).reshape(3 * count, nodes)
    there, values = look_up(comm, points.node, list(moved), read.node)
    if not comm.allreduce(int(there.sum())):
        raise InputError(f"{answers}: found none of the nodes of {source}; it belongs to another model")
    expected = np.array(values).reshape(count, 3, -1).transpose(0, 2, 1)[:, there]
    off = np.abs(read.displacement[:, there] * length - expected).max(axis=(1, 2), initial=0.0)
    size = np.abs(expected).max(axis=(1, 2), initial=0.0)
    off, size = (np.max(comm.allgather(largest), axis=0) for largest in (off, size))
    if (wrong := off > DIGITS * size).any():
        k = int(np.flatnonzero(wrong)[0])
        raise InputError(f"{answers}: found displacements in step {k + 1} that differ by {off[k] / size[k]:.1e} of the "
                         f"largest one from column {k + 1} of {source}; the answers are those of another basis or "
                         "model")  # fmt: skip
