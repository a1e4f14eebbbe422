"""Read what drives a reduced model: a .csv of spectral densities, of harmonic amplitudes, or of time histories.

The first column is the frequency, head "f [Hz]", or the time, head "t [s]". Each other column has the name of an input
and a unit in its head, which is required:

    base:z [g^2/Hz]                                  one-sided density; inputs without a column are at rest
    base:x/base:z coherence [1], .../... phase [deg]     of two inputs that have densities: coherence 0 to 1 (gamma^2)
    base:x/base:z re [g^2/Hz], base:x/base:z im [...]    or the cross spectrum G_xz = E[conj(X) Z]; default 0
    20:z [N], 20:z phase [deg]                       harmonic amplitude and phase (default 0)
    base:z [m/s^2]                                   over time, linear between its lines

Motions of bases may be accelerations, velocities or displacements over frequency.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass

import numpy as np

from ..fe.dofs import DIRECTIONS, target_of
from ..parallel.declared import nearest
from ..parallel.failures import InputError
from ..parallel.ranges import ANYTHING, within
from .text import is_cut_line, require_file
from .text_numbers import parse

G = 9.80665  # m/s^2
HEAD = re.compile(r"(?P<name>.*?)(?:\s+(?P<part>coherence|phase|re|im))?\s*\[(?P<unit>[^\]]*)\]")
FIRST = {"f [Hz]": "frequencies", "f_hz": "frequencies", "t [s]": "times", "t_s": "times"}
UNITS = {  # factor to SI, and how often an input that is an acceleration has been integrated
    "an acceleration": {"m/s^2": (1.0, 0), "g": (G, 0), "mm/s^2": (1e-3, 0), "m/s": (1.0, 1), "mm/s": (1e-3, 1),
                        "m": (1.0, 2), "mm": (1e-3, 2)},
    "an angular acceleration": {"rad/s^2": (1.0, 0), "rad/s": (1.0, 1), "rad": (1.0, 2)},
    "a force": {"N": (1.0, 0), "kN": (1e3, 0)},
    "a moment": {"N m": (1.0, 0), "kN m": (1e3, 0), "N mm": (1e-3, 0)},
    "a factor": {"1": (1.0, 0)},
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class DriveTable:
    """Columns (n, p) of all inputs of a model in SI, over frequencies in Hz or times in s (n,).

    Attributes
    ----------
    over : ndarray, shape (n,)
        Ascending.
    values : ndarray, shape (n, p), or (n, p, p) of spectral densities
        Real over time, else complex; Hermitian densities.
    orders : ndarray of int, shape (p,)
        How often an input has been integrated: a displacement of a base 2 times.
    """

    over: np.ndarray
    values: np.ndarray
    orders: np.ndarray


def unit_of_density(unit: str) -> str:
    """Return the unit of the density of a quantity with this unit."""
    power = "1" if unit == "1" else f"({unit})^2" if set(unit) & {"/", " "} else f"{unit}^2"
    return f"{power}/Hz"


def quantity_of_input(reduced, name: str) -> str:
    """Return what an input is, one of the keys of UNITS."""
    loads = {} if reduced.record is None else {item.name: item for item in reduced.record.loads if item.kind != "given"}
    target = target_of(name)
    turns = isinstance(target, tuple) and target[1].startswith("r")
    if name in loads:
        return ("an angular acceleration" if turns else "an acceleration") if loads[name].is_motion else "a factor"
    if not isinstance(target, tuple) or DIRECTIONS.index(target[1]) > 5:
        return "a factor"
    return "a moment" if turns else "a force"


def read_drive_table(path, reduced, kind: str) -> DriveTable:
    """Read a table of kind "psd", "harmonic" or "time" for the inputs of a ReducedModel, on one rank.

    Raises InputError for heads without units, inputs that the model does not have, units that are none of theirs, lines
    that are no numbers or do not ascend, negative densities, and cross spectra that are not positive semidefinite.
    """
    heads, over, columns = _read(path, "times" if kind == "time" else "frequencies", 1 if kind == "harmonic" else 2)
    p, names = len(reduced.input_names), list(reduced.input_names)
    orders, crossed, seen = np.zeros(p, int), [], {}
    for head, column in zip(heads, columns.T, strict=True):
        pair, part, unit = _parsed(path, head)
        if pair in names and part in ("", "phase" if kind == "harmonic" else ""):
            places = (names.index(pair),)
        else:
            if pair in names:
                expected = f"one of two, such as A/B {part}" if kind == "psd" else "none in a table of this kind"
                raise InputError(f"{path}: {head}: found the {part} of one input, expected {expected}")
            parts = next(((a, b) for a in names for b in names if a != b and pair == f"{a}/{b}"), None)
            if parts is None or kind != "psd" or not part:
                raise InputError(f"{path}: {head}: the model has no input '{pair}'{nearest(pair, names)}; it has "
                                 f"{', '.join(names)}")  # fmt: skip
            places = (names.index(parts[0]), names.index(parts[1]))
        if (part, *places) in seen:
            raise InputError(f"{path}: {head}: found a second column of this, expected one")
        factor, order = _factor(path, head, unit, part, kind, [quantity_of_input(reduced, names[j]) for j in places])
        if kind == "psd" and part in ("", "coherence") and (wrong := np.flatnonzero(column < 0)).size:
            raise InputError(f"{path}: {head}: found {column[wrong[0]]:g} at {over[wrong[0]]:g} Hz, expected none "
                             "below 0")  # fmt: skip
        seen[(part, *places)] = factor * column
        if not part:
            orders[places[0]] = order
        elif part in ("re", "im"):
            crossed.append((head, order, places))
    for head, order, places in crossed:
        if (orders[list(places)] != order).any():
            raise InputError(f"{path}: {head}: found the unit of another quantity than that of the densities of these "
                             "inputs, expected accelerations, velocities or displacements in both")  # fmt: skip
    if not any(not key[0] for key in seen):
        raise InputError(f"{path}: found no column of an input, expected such as {names[0]} [unit]")
    if kind == "time" and orders.any():
        raise InputError(f"{path}: found a velocity or a displacement of a base over time, expected its acceleration, "
                         "m/s^2 or g")  # fmt: skip
    values = _densities(path, over, seen, p, names) if kind == "psd" else _amplitudes(path, over, seen, p, names)
    return DriveTable(over, values.real if kind == "time" else values, orders)


def _read(path, expected, least):
    """Return the heads but the first, the first column (n,), and the others (n, k), of at least so many lines."""
    require_file(path)
    if is_cut_line(path):
        raise InputError(f"{path}: found no line break at its end; the file is cut off: write it again")
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: found no text of a table ({error}), expected a .csv") from error
    word = next(key for key, value in FIRST.items() if value == expected)
    heads = [item.strip() for item in rows[0][1]] if rows else []
    if not heads or FIRST.get(heads[0]) != expected:
        found = f"the first head '{heads[0][:40]}'" if heads else "no lines"
        raise InputError(f"{path}: found {found}, expected heads separated by commas, the first one '{word}'")
    table = np.array([_numbers(path, heads, *row) for row in rows[1:]]).reshape(-1, len(heads))
    if len(table) < least:
        raise InputError(f"{path}: found {len(table)} lines of numbers, expected {least} or more")
    falls = np.flatnonzero(np.diff(table[:, 0]) <= 0)
    if len(falls):
        raise InputError(f"{path}: {heads[0]}: found {table[falls[0] + 1, 0]:g} after {table[falls[0], 0]:g}, expected "
                         "ascending numbers")  # fmt: skip
    if expected == "frequencies" and table[0, 0] < 0:
        raise InputError(f"{path}: {heads[0]}: found {table[0, 0]:g}, expected frequencies of 0 or more")
    return heads[1:], table[:, 0], table[:, 1:]


def _numbers(path, heads, line, row):
    """Return the numbers of one line. Raises InputError."""
    if len(row) != len(heads):
        raise InputError(f"{path}: line {line}: found {len(row)} cells below {len(heads)} heads, expected a number "
                         "below each")  # fmt: skip
    found = []
    for head, cell in zip(heads, row, strict=True):
        values = parse(cell)  # as in other tables, where 1_0 and digits of other scripts are no numbers
        if values is None or len(values) != 1:
            raise InputError(f"{path}: line {line}: {head}: found '{cell.strip()[:40]}', expected a finite number")
        within(f"{path}: line {line}: {head}", float(values[0]), ANYTHING)
        found.append(values[0])
    return found


def _parsed(path, head):
    found = HEAD.fullmatch(head)
    if found is None:
        raise InputError(f"{path}: {head[:60]}: found no unit in this head, expected one in brackets, such as "
                         "base:z [g^2/Hz]")  # fmt: skip
    return found["name"].strip(), found["part"] or "", found["unit"].strip()


def _factor(path, head, unit, part, kind, quantities):
    """Return the factor to SI of a column, and how often its input has been integrated. Raises InputError."""
    if part in ("coherence", "phase"):
        known = {"coherence": {"1": 1.0}, "phase": {"deg": np.pi / 180, "rad": 1.0}}[part]
        if unit not in known:
            raise InputError(f"{path}: {head}: found the unit {unit}, expected {' or '.join(known)}")
        return known[unit], 0
    word = unit
    if kind == "psd":
        word = unit.removesuffix("/Hz") if unit.endswith("/Hz") else ""
        word = "" if not word.endswith("^2") and word != "1" else word.removesuffix("^2").strip("()")
    known = [UNITS[quantity].get(word) for quantity in quantities]
    if None in known or (part and known[0] != known[1]):
        expected = " or ".join(unit_of_density(item) if kind == "psd" else item for item in UNITS[quantities[0]])
        raise InputError(f"{path}: {head}: found the unit '{unit}' of an input that is {quantities[0]}, expected "
                         f"{expected}")  # fmt: skip
    factor, order = known[0]
    return (factor**2 if kind == "psd" else factor), order


def _amplitudes(path, over, seen, p, names):
    values = np.zeros((len(over), p), complex)
    for (part, j), column in seen.items():
        if part == "phase":
            if ("", j) not in seen:
                raise InputError(f"{path}: found a phase of {names[j]} without its amplitude, expected both")
            continue
        values[:, j] = column * np.exp(1j * seen.get(("phase", j), 0.0))
    return values


def _densities(path, over, seen, p, names):
    """Return Hermitian densities (n, p, p). Raises InputError where they are not positive semidefinite."""
    values = np.zeros((len(over), p, p), complex)
    for j in range(p):
        values[:, j, j] = seen.get(("", j), 0.0)
    for j, k in {key[1:] for key in seen if len(key) == 3}:
        get = {part: seen.get((part, j, k)) for part in ("coherence", "phase", "re", "im")}
        known = {part for part, column in get.items() if column is not None}
        if (known & {"re", "im"} and known & {"coherence", "phase"}) or known == {"phase"}:
            raise InputError(f"{path}: {names[j]}/{names[k]}: found {' and '.join(sorted(known))}, expected a "
                             "coherence with its phase, or the parts re and im")  # fmt: skip
        if values[:, k, j].any():
            raise InputError(f"{path}: {names[j]}/{names[k]}: found both orders of these inputs, expected one")
        if get["coherence"] is not None:
            size = np.sqrt(get["coherence"] * values[:, j, j].real * values[:, k, k].real)
            cross = size * np.exp(1j * (0.0 if get["phase"] is None else get["phase"]))
        else:
            cross = (0.0 if get["re"] is None else get["re"]) + 1j * (0.0 if get["im"] is None else get["im"])
        values[:, j, k], values[:, k, j] = cross, np.conj(cross)
    return values
