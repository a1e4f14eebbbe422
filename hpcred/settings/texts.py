"""Parse texts of a command line: numbers, dofs, frames, damping models. Each function takes the text and the name of
its option, and raises InputError."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass

from ..body.preload import Preload
from ..linalg.solvers.settings import Factoring, LinearSolver
from ..model.damping import GivenDamping, NoDamping, Rayleigh, Structural
from ..model.frames import Buckens, Chord, NoFrame, Tangent
from ..model.outputs.motions import motion_output_of
from ..parallel.failures import InputError
from ..parallel.ranges import ANYTHING, COUNT, FREQUENCY, within
from .toml_file import CONFIG, parse, table_around


def numbers(text, option):
    """Finite numbers separated by commas."""
    try:
        values = [float(word) for word in text.split(",")] if text else []
    except ValueError as error:
        raise InputError(f"{option}: found '{text[:80]}', expected numbers separated by commas") from error
    within(option, values, ANYTHING)
    return values


def targets(text, option):
    """Dof numbers and node:direction pairs, as outputs also their velocities and accelerations, separated by commas."""
    try:
        return [_target(word.strip()) for word in text.split(",")]
    except ValueError as error:
        rates = ", or velocity 20:z, acceleration dof 115" if option == "--outputs" else ""
        expected = f"such as 20:z,1:x or dof numbers 115,1{rates}"
        raise InputError(f"{option}: found '{text[:80]}', expected {expected}") from error


def _target(text):
    """A dof or the output of that name. Raises ValueError."""
    if output := motion_output_of(text):
        return output
    node, colon, direction = text.partition(":")
    return (int(node), direction.strip()) if colon else int(node)


def labels(text, _option):
    """Numbers of nodes, and names of interfaces and node sets, separated by commas."""
    words = [word.strip() for word in text.split(",")]
    return [int(word) if re.fullmatch("[0-9]{1,18}", word) else word for word in words]


def whole_numbers(text, option):
    """Whole numbers from 1 separated by commas."""
    values = numbers(text, option)
    if not all(number % 1 == 0 and 1 <= number <= COUNT[1] for number in values):
        raise InputError(f"{option}: found '{text[:80]}', expected whole numbers from 1 separated by commas")
    return [int(number) for number in values]


def amount(text, option, units):
    """A number with a unit, or None."""
    if text is None:
        return None
    with suppress(ValueError):
        if text[-1:] in units and 0 <= (number := float(text[:-1])) < float("inf"):
            return number * units[text[-1]]
    raise InputError(f"{option}: found '{text}', expected a number and one of the units {', '.join(units)}")


def words(text, _option):
    """Words separated by commas."""
    return tuple(text.split(","))


def band(text, option):
    """Two frequencies."""
    limits = numbers(text, option)
    within(option, limits, FREQUENCY)
    if len(limits) != 2 or not 0 <= limits[0] < limits[1]:
        expected = "two frequencies in Hz, the lower one first, such as 0,300"
        raise InputError(f"{option}: found '{text}', expected {expected}")
    return tuple(limits)


def interval(text, option):
    """Two numbers."""
    limits = numbers(text, option)
    if len(limits) != 2:
        raise InputError(f"{option}: found '{text}', expected two values, the lower one first, such as 0,800")
    return limits


def axis(text, option):
    """One of x, y and z, or the numbers of a vector."""
    return text if text in ("x", "y", "z") else numbers(text, option)


def factoring(out_of_core, low_rank, package):
    """How to factor, or None for the default."""
    if out_of_core is None and low_rank is None and package is None:
        return None
    solver = LinearSolver(package=package or LinearSolver.package)
    return Factoring(out_of_core=out_of_core, low_rank=low_rank, solver=solver)


def frame(text, option):
    """A reference frame from none, buckens, tangent:7 or chord:1,7,14:yxz."""
    kind, *details = text.split(":")
    try:
        if kind in ("none", "buckens") and not details:
            return Buckens() if kind == "buckens" else NoFrame()
        if kind == "tangent" and len(details) == 1:
            return Tangent(node=int(details[0]))
        if kind == "chord" and len(details) in (1, 2):
            first, second, third = (int(node) for node in details[0].split(","))
            return Chord(nodes=(first, second, third), axes=details[1] if details[1:] else None)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
    raise InputError(f"{option}: found '{text}', expected none, buckens, tangent:NODE or chord:N1,N2,N3[:AXES]")


def damping(text, option):
    """A damping model from none, given, rayleigh:20,1e-7 or loss:0.02."""
    kind, colon, rest = text.partition(":")
    values = numbers(rest, option)
    if kind in ("none", "given") and not colon:
        return GivenDamping() if kind == "given" else NoDamping()
    if kind == "rayleigh" and len(values) == 2:
        return Rayleigh(*values)
    if kind == "loss" and len(values) == 1:
        return Structural(*values)
    raise InputError(f"{option}: found '{text}', expected none, given, rayleigh:ALPHA,BETA or loss:FACTOR")


def parameters(text, option):
    """Values of parameters by name, from such as omega=300,stiffness=1.2."""
    pairs = [pair.partition("=") for pair in text.split(",")]
    values = {key.strip(): numbers(value, option) for key, _, value in pairs}
    if not all(values) or not all(map(len, values.values())) or len(values) < len(pairs):
        raise InputError(f"{option}: found '{text[:80]}', expected such as omega=300,stiffness=1.2")
    return {key: value[0] for key, value in values.items()}


def names(text, option):
    """Names by K, M, D, B, C, Cv, Ca, from such as K=kaa,M=maa."""
    pairs = [pair.partition("=") for pair in text.split(",")]
    named = {key.strip(): name.strip() for key, _, name in pairs}
    if not all(named.values()) or not set(named) <= {*"KMDBC", "Cv", "Ca"} or len(named) < len(pairs):
        raise InputError(f"{option}: found '{text}', expected such as K=nas.kaa,M=nas.maa (K, M, D, B, C, Cv or Ca)")
    return named


@dataclass(frozen=True, kw_only=True)
class _Holder:
    """The table around a preload."""

    preload: Preload

    __pydantic_config__ = CONFIG


def preload(text, option):
    """A preload from a table in TOML, such as {omega = [0, 0, 300]}."""
    examples = "'{omega = [0, 0, 300]}' or '{forces = {\"crank:x\" = 100.0}}'"
    return parse(_Holder, table_around(option.strip("-"), text, examples)).preload
