"""What belongs to matrices that are there: motions, answers of programs, loads, includes and factors, most damaged."""

import functools
import io
import math
import tempfile
from pathlib import Path

import h5py
import numpy as np
import scipy.sparse
from ansys_files import archive
from calculix_prints import DECK as BRICKS
from op2_files import displaced, op2, stressed

from hpcred import Dofs, InputError, SecondOrderModel, write_model
from hpcred.model.parameters.expressions import Expression

from . import test_deck_loads as deck_loads
from . import test_motions as motions
from .containers import outcome
from .judge import Case, inside, run_good, write
from .matrices import chosen
from .mutations import bytes_changed, damaged_text
from .readings import Nonsense, require
from .tables import CHORD, good_files
from .test_answers import OP2

HEAD = 'output = "new.h5"\nmodel = "model.h5"\n'
MODAL = HEAD + 'inputs = [[20, "z"]]\n[frame]\nkind = "buckens"\n[[basis]]\nkind = "modes"\nindex = [7, 8, 9]\n'
FACTOR = f"""{HEAD}inputs = [[20, "z"]]
at = {{a = 0.5, bc = 2.0}}
{CHORD}[[basis]]
kind = "modes"
count = 2
[[parameter]]
name = "a"
range = [0.1, 1.0]
reference = 0.5
[[parameter]]
name = "bc"
range = [1.0, 3.0]
reference = 2.0
[[term]]
of = "K"
file = "k.mtx"
factor = '''@@'''
"""
UNIT = "%%MatrixMarket matrix coordinate real symmetric\n120 120 1\n115 115 1e3\n"
FORMULAS = ("1 + 0.2*a/bc", "-bc^2 + 4.5 + a", "sqrt(a)*exp(-bc)/3", "(a + bc)*(a - bc)**2", "abs(sin(pi*a)) + log(bc)",
            "2^-a + 1e-3*bc", "cos(a)^2 + tan(bc/4)")  # fmt: skip
NAMES = {name: getattr(math, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "pi")} | {"abs": abs}


@functools.cache
def _result() -> bytes:
    """A result of three coordinates."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        write(Case("", {**good_files(), "new.toml": MODAL.encode()}, [], None, outcome), Path(name))
        run_good(["reduce", "new.toml"])
        return Path("new.h5").read_bytes()


@functools.cache
def _of_factor(value: float) -> dict:
    """What a reduction gives whose term has a number as its factor."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        job = FACTOR.replace("@@", f"{value!r} + 0*a + 0*bc")
        write(Case("", {**good_files(), "k.mtx": UNIT.encode(), "new.toml": job.encode()}, [], None, outcome),
              Path(name))  # fmt: skip
        run_good(["reduce", "new.toml"])
        with h5py.File("new.h5") as file:
            return {"K": file["reduced/K"][...]}


def motion(rng, kind):
    """Displacements recovered of a motion are V q of what a second reading finds."""
    good = chosen(rng, motions.OURS, motions.FMU)
    note, content = ("good", good) if rng.random() < 0.125 else damaged_text(good, rng)
    with h5py.File(io.BytesIO(_result())) as result:
        V, node, direction = (result[key][...] for key in ("basis/V", "dofs/node", "dofs/direction"))
    places = np.flatnonzero(direction < 3)
    columns = np.where(direction < 3, V, 0.0)
    try:
        t, q, *_ = motions.second(content)
        expected = {"t": t, "moved": q @ columns} if len(t) and np.abs(q).max() < 1e100 else None
    except (Nonsense, ValueError, KeyError, UnicodeDecodeError):
        expected = None
    command = ["recover", "new.h5", "m.csv", "-o", "out.h5"]

    def read(folder):
        with h5py.File(folder / "out.h5") as out:
            t, number, found = (out[key][...] for key in ("t", "nodes/number", "displacement"))
        moved = np.zeros((len(found), len(node)))
        moved[:, places] = found[:, np.argmax(number == node[places, None], axis=1), direction[places]]
        return {"t": t, "moved": moved}

    return Case(f"m.csv: {note}", {"new.h5": _result(), "m.csv": content}, command, expected, read, note == "good")


@functools.cache
def _arrays() -> bytes:
    with tempfile.TemporaryDirectory() as name:
        with h5py.File(Path(name) / "m.h5", "w") as file:
            file["t"], file["q"], file["qdot"] = np.arange(5.0), np.ones((5, 3)), np.ones((5, 3))
        return (Path(name) / "m.h5").read_bytes()


def arrays(rng, kind):
    """A damaged HDF5 file of another program: refused, or taken with whatever numbers it has now."""
    note, content = bytes_changed(_arrays(), rng)
    command = ["recover", "new.h5", "m.h5", "-o", "out.h5", "--nodes", "20"]
    return Case(f"m.h5: {note}", {"new.h5": _result(), "m.h5": content}, command, {}, lambda folder: {})


def answers(rng, kind):
    """Damaged results of programs, of another body than the result's: refused, whatever their damage."""
    name, good = chosen(rng, ("a.op2", OP2), ("a.op2", _op2()), ("a.cdb", archive({1: (0, 0, 0)}).encode()))
    note, content = damaged_text(good, rng) if b"\0" not in good else bytes_changed(good, rng)
    files = {"new.h5": _result(), name: content, "a.inp": BRICKS.encode()}
    command = ["recover", "new.h5", "--answers", name, "-o", "out.h5"]
    return Case(f"{name}: {note}", files, command, None, outcome)


def _op2():
    moved = {grid: np.arange(3.0) + grid for grid in range(1, 9)}
    return op2([("OUGV1", displaced(1, moved)), ("OES1X1", stressed(1, {7: {k: np.ones(6) for k in range(1, 9)}}))])


@functools.cache
def _brick() -> bytes:
    """A model of the nodes of the decks of loads, with masses of 1 kg and modes along single dofs."""
    node, direction = np.repeat(np.arange(1, 9), 3), np.tile(np.arange(3), 8)
    dofs = Dofs(node, direction, np.repeat(np.array(deck_loads.POINTS, float), 3, axis=0))
    with tempfile.TemporaryDirectory() as name:
        with SecondOrderModel(scipy.sparse.eye(24), None, scipy.sparse.diags(1e4 * np.arange(1.0, 25)), np.eye(24, 1),
                              dofs=dofs) as model:  # fmt: skip
            write_model(Path(name) / "model.h5", model)
        return (Path(name) / "model.h5").read_bytes()


def loads(rng, kind):
    """A damaged deck of loads: the forces of the input are those that a second reading finds."""
    abaqus = rng.random() < 0.5
    form = deck_loads.INP.encode() + b"%s" if abaqus else deck_loads.BDF.encode() + b"%s\nENDDATA\n"
    good = deck_loads.STEP if abaqus else deck_loads.CARDS
    note, content = ("good", good) if rng.random() < 0.125 else damaged_text(good, rng)
    name, key = ("d.inp", "step = 1") if abaqus else ("d.bdf", "sid = 3")
    job = f'{HEAD}[[basis]]\nkind = "modes"\ncount = 24\n[[load]]\nkind = "deck"\nname = "l"\nfile = "{name}"\n{key}\n'
    try:
        second = deck_loads.second_of_abaqus if abaqus else deck_loads.second_of_nastran
        expected = {"b": _forces(*second(content))}
    except (Nonsense, ValueError, LookupError):  # of cards of Nastran more may be read than the second reading knows
        expected = None if abaqus else {}

    def read(folder):
        with h5py.File(folder / "new.h5") as file:
            return {"b": file["basis/V"][...].T @ file["reduced/B"][:, -1]}

    files = {"model.h5": _brick(), name: form % content, "new.toml": job.encode()}
    return Case(f"{name}: {note}", files, ["reduce", "new.toml"], expected, read, note == "good")


def _forces(forces, pressures, acceleration) -> np.ndarray:
    """Forces (24,) on the nodes of the brick, each with a mass of 1 kg, pressures shared out to the corners alike."""
    b, points = np.tile(acceleration, (8, 1)), np.array(deck_loads.POINTS)
    require(all(1 <= node <= 8 for node, _ in forces))
    for (node, direction), value in forces.items():
        b[node - 1, direction] += value
    for corners, pressure in pressures.items():
        at = np.array(corners) - 1
        axis = int(np.flatnonzero(np.ptp(points[at], axis=0) == 0)[0])
        b[at, axis] += pressure / 4 * (1 if points[at[0], axis] == 0 else -1)
    return b.ravel()


def includes(rng, kind):
    """Files that include each other in any way: an end, and the nodes where all are there once or again."""
    count, nastran = int(rng.integers(1, 9)), rng.random() < 0.5
    files, edges = {}, {}
    for k in range(count):
        later = [int(j) for j in rng.integers(k + 1, count + 1, int(rng.integers(3))) if j < count]
        edges[k] = later if rng.random() < 0.9 else [*later, int(rng.integers(count))]
        form = "INCLUDE 'f{}.dat'\n" if nastran else "*INCLUDE, INPUT=f{}.dat\n"
        own = "$ nothing\n" if nastran else "** nothing\n"
        files[f"f{k}.dat"] = (own + "".join(form.format(j) for j in edges[k])).encode()
    top = form.format(0)
    main = f"BEGIN BULK\nGRID,1,,0.,0.,0.\n{top}ENDDATA\n" if nastran else f"*NODE\n1, 0., 0., 0.\n{top}"
    note, damaged = ("as made", main.encode()) if rng.random() < 0.7 else damaged_text(main.encode(), rng)
    one = b"%%MatrixMarket matrix coordinate real general\n3 3 3\n1 1 1\n2 2 1\n3 3 1\n"
    command = ["convert", "-K", "k.mtx", "-M", "k.mtx", "--nodes", "main.dat", "--dofs", "d.txt", "out.h5"]

    def ends(k, above=()):
        return k not in above and all(ends(j, (*above, k)) for j in edges[k])

    expected = None if note == "as made" and not ends(0) else {}
    return Case(f"main.dat: {note}", {**files, "main.dat": damaged, "k.mtx": one, "d.txt": b"1 1\n1 2\n1 3\n"}, command,
                expected, lambda folder: {}, note == "as made" and ends(0))  # fmt: skip


def factors(rng, kind):
    """A term with a formula has the K of one with the number that Python's own evaluation gives."""
    good = chosen(rng, *FORMULAS).encode()
    note, content = ("good", good) if rng.random() < 0.25 else damaged_text(good, rng)
    content = content.replace(b"'", b"")
    try:
        text = content.decode()
        Expression(text)
        value = float(eval(text.strip().replace("^", "**"), {"__builtins__": {}}, {**NAMES, "a": 0.5, "bc": 2.0}))
        expected = _of_factor(value) if abs(value) < 1e6 else {}
    except (InputError, UnicodeDecodeError):
        expected = None
    except Exception:
        expected = {}
    job = FACTOR.encode().replace(b"@@", content)

    def read(folder):
        with h5py.File(folder / "new.h5") as file:
            return {"K": file["reduced/K"][...]}

    files = {**good_files(), "k.mtx": UNIT.encode(), "new.toml": job}
    return Case(f"factor {content!r}: {note}", files, ["reduce", "new.toml"], expected, read)


KINDS = {"motion table": motion, "motion arrays": arrays, "answers": answers, "loads of decks": loads,
         "includes": includes, "factors": factors}  # fmt: skip
