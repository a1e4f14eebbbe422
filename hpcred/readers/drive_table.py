"""Read what drives a reduced model: a .csv of spectral densities, of harmonic amplitudes, or of time histories.

The first column is the frequency, head "f [Hz]", or the time, head "t [s]". Each other column has the name of an input
and a unit in its head, which is required:

    base:z [g^2/Hz]                                  one-sided density; inputs without a column are at rest
    base:x/base:z coherence [1], .../... phase [deg]     of two inputs that have densities: coherence 0 to 1 (gamma^2)
    base:x/base:z re [g^2/Hz], base:x/base:z im [...]    or the cross spectrum G_xz = E[conj(X) Z]; default 0
    20:z [N], 20:z phase [deg]                       harmonic amplitude and phase (default 0)
    base:z [m/s^2], base:z [mm]                      over time: linear between its lines, or a cubic spline

Motions of bases may be accelerations, velocities or displacements.
"""

import re
from dataclasses import dataclass

import numpy as np

from ..model.units import unit_of_input
from ..parallel.declared import nearest
from ..parallel.failures import InputError
from ..parallel.ranges import ANYTHING
from .motions.table import head_of, read_columns

HEAD = re.compile(r"(?P<name>.*?)(?:\s+(?P<part>coherence|phase|re|im))?\s*\[(?P<unit>[^\]]*)\]")
FIRST = {"f [Hz]": "frequency", "f_hz": "frequency", "t [s]": "time", "t_s": "time"}
LEAST = 1e-200  # of a number of a table but 0: quotients of smaller ones overflow
STARTS = 1e-6  # of the largest velocity: more at the first instant is a jump


def _of_motions(*steps):
    """Return by the unit of an input the factors to SI, and how often the input has been integrated, of all units that
    its column may have; `steps`: units of acceleration, velocity and displacement."""
    return {next(iter(step)): {unit: (factor, order) for order, later in enumerate(steps[k:])
                               for unit, factor in later.items()} for k, step in enumerate(steps)}  # fmt: skip


UNITS = {
    **_of_motions({"m/s^2": 1.0, "g": 9.80665, "mm/s^2": 1e-3}, {"m/s": 1.0, "mm/s": 1e-3}, {"m": 1.0, "mm": 1e-3}),
    **_of_motions({"rad/s^2": 1.0}, {"rad/s": 1.0}, {"rad": 1.0}),
    "N": {"N": (1.0, 0), "kN": (1e3, 0)}, "N m": {"N m": (1.0, 0), "kN m": (1e3, 0), "N mm": (1e-3, 0)},
    "1": {"1": (1.0, 0)},
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class DriveTable:
    """Columns of all inputs of a model in SI, `over` frequencies in Hz or times in s (n,), ascending.

    `values` (n, p), real over time, else complex, or (n, p, p) of Hermitian spectral densities. `orders` (p,): how
    often an input has been integrated: the displacement of a base 2 times.
    """

    over: np.ndarray
    values: np.ndarray
    orders: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return the inputs (k, p) at instants t (k,) in s, zero after the last line: linear between the lines, or by
        splines through velocities and displacements, which are at rest at both ends."""
        from scipy.interpolate import CubicSpline  # which few runs need

        columns = np.zeros((len(t), len(self.orders)))
        for j, order in enumerate(self.orders):
            if not order:
                columns[:, j] = np.interp(t, self.over, self.values[:, j], right=0.0)
                continue
            spline = CubicSpline(self.over, self.values[:, j], bc_type="clamped")
            columns[:, j] = np.where(t <= self.over[-1], spline(t, order), 0.0)
        return columns


def unit_of_density(unit: str) -> str:
    """Return the unit of the density of a quantity with this unit."""
    power = "1" if unit == "1" else f"({unit})^2" if set(unit) & {"/", " "} else f"{unit}^2"
    return f"{power}/Hz"


def units_of_inputs(reduced) -> list[str]:
    """Return the SI units of the inputs of a ReducedModel, 1 of loads."""
    loads = () if reduced.record is None else reduced.record.loads
    return [unit_of_input(name, loads) or "1" for name in reduced.input_names]


def read_drive_table(path, reduced, kind: str) -> DriveTable:
    """Read a table of kind "psd", "harmonic" or "time" for the inputs of a ReducedModel, on one rank.

    Raises InputError for heads without units, inputs that the model does not have, units that are none of theirs, lines
    that are no numbers or do not ascend, negative densities, and parts of cross spectra that do not go together.
    """
    heads, over, columns = _read(path, "time" if kind == "time" else "frequency", 1 if kind == "harmonic" else 2)
    names, units = list(reduced.input_names), units_of_inputs(reduced)
    pairs = {f"{a}/{b}": (i, j) for i, a in enumerate(names) for j, b in enumerate(names) if i != j}
    orders, seen, crossed = np.zeros(len(names), int), {}, []
    for head, column in zip(heads, columns.T, strict=True):
        # an input, or two inputs in a table of densities
        if (words := HEAD.fullmatch(head)) is None:
            raise InputError(f"{path}: {head[:60]}: found no unit in this head, expected one in brackets, such as "
                             "base:z [g^2/Hz]")  # fmt: skip
        name, part, unit = words["name"].strip(), words["part"] or "", words["unit"].strip()
        alone = part in ("", "phase" if kind == "harmonic" else "")
        if name in names and not alone:
            expected = f"one of two, such as A/B {part}" if kind == "psd" else "none in a table of this kind"
            raise InputError(f"{path}: {head}: found the {part} of one input, expected {expected}")
        if name not in (names if alone else pairs) or (not alone and kind != "psd"):
            raise InputError(f"{path}: {head}: the model has no input '{name}'{nearest(name, names)}; it has "
                             f"{', '.join(names)}")  # fmt: skip
        places = (names.index(name),) if alone else pairs[name]
        if (part, *places) in seen:
            raise InputError(f"{path}: {head}: found a second column of this, expected one")
        # its numbers in SI
        factor, order = _factor(path, head, unit, part, kind, [units[j] for j in places])
        if kind == "psd" and part in ("", "coherence") and (wrong := np.flatnonzero(column < 0)).size:
            raise InputError(f"{path}: {head}: found {column[wrong[0]]:g} at {over[wrong[0]]:g} Hz, expected none "
                             "below 0")  # fmt: skip
        if kind == "time" and order == 1 and abs(column[0]) > STARTS * np.abs(column).max():
            raise InputError(f"{path}: {head}: found {column[0]:g} at first, expected 0, since the base is at rest "
                             "before; begin with a line at rest")  # fmt: skip
        seen[(part, *places)] = factor * column
        if not part:
            orders[places[0]] = order
        elif part in ("re", "im"):
            crossed.append((head, order, places))
    if other := next((head for head, order, places in crossed if (orders[list(places)] != order).any()), None):
        raise InputError(f"{path}: {other}: found the unit of another quantity than that of the densities of these "
                         "inputs, expected accelerations, velocities or displacements in both")  # fmt: skip
    if not any(not key[0] for key in seen):
        raise InputError(f"{path}: found no column of an input, expected such as {names[0]} [unit]")
    values = (_densities if kind == "psd" else _amplitudes)(path, len(over), seen, names)
    return DriveTable(over, values.real if kind == "time" else values, orders)


def _read(path, expected, least):
    """Return the heads but the first, the first column (n,), and the others (n, k), of at least so many lines."""
    heads, start = head_of(path)
    if not heads or FIRST.get(heads[0]) != expected:
        word = next(key for key, value in FIRST.items() if value == expected)
        first = f"the first head '{heads[0][:40]}'" if heads else "no heads"
        raise InputError(f"{path}: found {first}, expected heads separated by commas, the "
                         f"first one '{word}'")  # fmt: skip
    table = read_columns(path, start, len(heads))
    if len(table) < least:
        raise InputError(f"{path}: found {len(table)} lines of numbers, expected {least} or more")
    sizes = np.abs(table)
    if (wrong := np.argwhere(~((sizes == 0) | ((sizes >= LEAST) & (sizes <= ANYTHING[1]))))).size:  # NaN too
        line, column = wrong[0]
        raise InputError(f"{path}: {heads[column]}: found {table[line, column]:g} in the {line + 1}. line of numbers, "
                         f"expected finite ones of {ANYTHING[0]:g} to {ANYTHING[1]:g}, 0 or at least {LEAST:g} in size"
                         )  # fmt: skip
    falls = np.flatnonzero(np.diff(table[:, 0]) <= 0)
    if len(falls):
        raise InputError(f"{path}: {heads[0]}: found {table[falls[0] + 1, 0]:g} after {table[falls[0], 0]:g}, expected "
                         "ascending numbers")  # fmt: skip
    if expected == "frequency" and table[0, 0] < 0:
        raise InputError(f"{path}: {heads[0]}: found {table[0, 0]:g}, expected frequencies of 0 or more")
    return heads[1:], table[:, 0], table[:, 1:]


def _factor(path, head, unit, part, kind, of_inputs):
    """Return the factor to SI of a column, and how often its inputs have been integrated, by the units of these. Raises
    InputError."""
    if part in ("coherence", "phase"):
        known = {"coherence": {"1": 1.0}, "phase": {"deg": np.pi / 180, "rad": 1.0}}[part]
        if unit not in known:
            raise InputError(f"{path}: {head}: found the unit {unit}, expected {' or '.join(known)}")
        return known[unit], 0
    unit_in_table = unit_of_density if kind == "psd" else str
    factors = [{unit_in_table(word): value for word, value in UNITS[own].items()}.get(unit) for own in of_inputs]
    if None in factors or factors[0] != factors[-1]:
        raise InputError(f"{path}: {head}: found the unit '{unit}' of an input in {of_inputs[0]}, expected "
                         f"{' or '.join(map(unit_in_table, UNITS[of_inputs[0]]))}")  # fmt: skip
    factor, order = factors[0]
    return (factor**2 if kind == "psd" else factor), order


def _amplitudes(path, count, seen, names):
    """Return amplitudes (count, p) with their phases."""
    values = np.zeros((count, len(names)), complex)
    if (without := next((j for part, j in seen if part and ("", j) not in seen), None)) is not None:
        raise InputError(f"{path}: found a phase of {names[without]} without its amplitude, expected both")
    for _, j in seen:
        values[:, j] = seen["", j] * np.exp(1j * seen.get(("phase", j), 0.0))
    return values


def _densities(path, count, seen, names):
    """Return Hermitian densities (count, p, p)."""
    values = np.zeros((count, len(names), len(names)), complex)
    for j in range(len(names)):
        values[:, j, j] = seen.get(("", j), 0.0)
    for j, k in {key[1:] for key in seen if len(key) == 3}:
        known = {part: column for (part, *pair), column in seen.items() if pair == [j, k]}
        if set(known) == {"phase"} or (known.keys() & {"re", "im"} and known.keys() & {"coherence", "phase"}):
            raise InputError(f"{path}: {names[j]}/{names[k]}: found {' and '.join(sorted(known))}, expected a "
                             "coherence with its phase, or the parts re and im")  # fmt: skip
        if values[:, k, j].any():
            raise InputError(f"{path}: {names[j]}/{names[k]}: found both orders of these inputs, expected one")
        cross = known.get("re", 0.0) + 1j * known.get("im", 0.0)
        if "coherence" in known:
            size = np.sqrt(known["coherence"] * values[:, j, j].real * values[:, k, k].real)
            cross = size * np.exp(1j * known.get("phase", 0.0))
        values[:, j, k], values[:, k, j] = cross, np.conj(cross)
    return values
