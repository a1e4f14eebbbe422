"""The job file: TOML enters, checked dataclasses of the public interface leave; no matrix is read here."""

import difflib
import sys
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import get_args, get_origin

from pydantic import ConfigDict, TypeAdapter, ValidationError

from .errors import InputError
from .formats.convert import Source
from .model.damping import Caughey, GivenDamping, ModalDamping, NoDamping, Rayleigh, Structural
from .model.frame import Buckens, Chord, NoFrame, Tangent
from .reduction.krylov import Krylov, StaticCorrection
from .reduction.modes import Modes
from .reduction.second_order import SecondOrderKrylov

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

CHOICES = {
    "frame": (NoFrame, Tangent, Chord, Buckens),
    "damping": (NoDamping, GivenDamping, Rayleigh, Caughey, ModalDamping, Structural),
    "basis": (Modes, Krylov, SecondOrderKrylov, StaticCorrection),
}

WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    Source: "a table of files (K, M, ...)",
}

Targets = str | tuple[int | tuple[int, str], ...]


@dataclass(frozen=True)
class Job:
    """One reduction. Relative file names are relative to the folder of the job file.

    `inputs` and `outputs`: a matrix file, or dofs as numbers from 1 or [node, direction]; without them those of
    the model are taken. `band`: Hz. `deflation_tolerance` and `drop_above`: see reduce. `write_basis`: whether V
    goes into the result. `body_origin` (m) and
    `lumped_integrals`: see multibody.floating_frame. `projection`, `allow_unstable`: see reduce.
    """

    model: str | Source
    basis: tuple
    output: str = "result.h5"
    band: tuple[float, float] | None = None
    inputs: Targets | None = None
    outputs: Targets | None = None
    frame: object = NoFrame()
    damping: object = NoDamping()
    deflation_tolerance: float = 1e-12
    drop_above: float | None = None
    write_basis: bool = True
    body_origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lumped_integrals: bool = False
    projection: str = "one_sided"
    allow_unstable: bool = False

    def __post_init__(self):
        if self.band is not None and not 0 <= self.band[0] < self.band[1]:
            raise InputError(f"band: found {list(self.band)}, expected 0 <= lower < upper in Hz")
        if self.projection not in ("one_sided", "two_sided"):
            raise InputError(f"projection: found '{self.projection}', expected 'one_sided' or 'two_sided'")
        if not 0 < self.deflation_tolerance < 1:
            raise InputError(f"deflation_tolerance: found {self.deflation_tolerance:g}, expected 0 to 1")
        if self.drop_above is not None and self.drop_above <= 0:
            raise InputError(f"drop_above: found {self.drop_above:g}, expected a positive frequency in Hz")


def read_job(path, overrides=()) -> Job:
    """Read and check a job file; `overrides` are texts "key.path=value" that replace or add single keys.

    Raises InputError that names the key, what was found and what was expected.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        table = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file: {error}") from error
    for text in overrides:
        _override(table, text)
    try:
        job = parse_job(table)
        return _relative_to(job, path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_job(table: dict) -> Job:
    """A Job from the tables of a job file. Raises InputError."""
    given = _tuples(table)
    _known(given, [field.name for field in fields(Job)], "")
    for key in ("frame", "damping"):
        if key in given:
            given[key] = parse_kind(given[key], key)
    basis = given.get("basis", ())
    if not isinstance(basis, tuple) or not basis:
        raise InputError("basis: expected at least one [[basis]] table")
    given["basis"] = tuple(parse_kind(item, "basis", f"basis[{i}]") for i, item in enumerate(basis))
    if isinstance(given.get("model"), dict):
        given["model"] = _validated(Source, given["model"], "model")
    checked = {key: given.pop(key) for key in ("frame", "damping", "basis") if key in given}
    return replace(_validated(Job, {**given, "basis": ()}, ""), **checked)


def parse_kind(item: dict, choice: str, where: str | None = None):
    """A frame, damping law or basis ingredient from a table with a key `kind`. Raises InputError."""
    where, item = where or choice, _tuples(item)
    kinds = {cls.kind: cls for cls in CHOICES[choice]}
    if not isinstance(item, dict):
        raise InputError(f"{where}: found {item!r}, expected a table with a key 'kind'")
    if "kind" not in item:
        raise InputError(f"{where}.kind: missing; expected one of {', '.join(kinds)}")
    kind = item["kind"]
    if kind not in kinds:
        raise InputError(f"{where}.kind: found {kind!r}, expected one of {', '.join(kinds)}{_near(kind, kinds)}")
    return _validated(kinds[kind], {key: value for key, value in item.items() if key != "kind"}, where)


def _validated(cls, values, where):
    """An instance of a dataclass from the values of a table, with strict types."""
    names = {field.name: field for field in fields(cls)}
    _known(values, names, where)
    checked = {}
    for name, field in names.items():
        place = f"{where}.{name}" if where else name
        if name in values:
            checked[name] = _checked(field.type, values[name], place)
        elif field.default is MISSING:
            raise InputError(f"{place}: missing; expected {_expected(field.type)}")
    return cls(**checked)


def _checked(kind, value, place):
    try:
        return TypeAdapter(kind, config=ConfigDict(strict=True)).validate_python(value)
    except ValidationError as error:
        raise InputError(f"{place}: found {_as_toml(value)}, expected {_expected(kind)}") from error


def _expected(kind) -> str:
    """A type in words."""
    if kind in WORDS:
        return WORDS[kind]
    parts = [part for part in get_args(kind) if part not in (type(None), ...)]
    if get_origin(kind) is tuple:
        if ... in get_args(kind):
            return f"a list of {' or '.join(_expected(part) for part in parts)}"
        return f"[{', '.join(_expected(part) for part in parts)}]"
    return " or ".join(_expected(part) for part in parts) or "a table"


def _as_toml(value):
    if isinstance(value, tuple):
        return "[" + ", ".join(_as_toml(item) for item in value) + "]"
    return f"'{value}'" if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)


def _known(table, names, where):
    for key in table:
        if key not in names:
            place = f"{where}.{key}" if where else key
            raise InputError(f"{place}: unknown key{_near(key, names)}; known are {', '.join(names)}")


def _near(word, words) -> str:
    close = difflib.get_close_matches(str(word), list(words), n=1, cutoff=0.5)
    return f" (did you mean '{close[0]}'?)" if close else ""


def _tuples(value):
    """Lists as tuples, at every depth, since the dataclasses are frozen."""
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _override(table, text):
    """Put the value of "a.b.0.c=value" (TOML, or a bare word) into the tables."""
    key, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"--set: found '{text}', expected key=value, such as basis.0.frequency=150.0")
    try:
        value = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        value = value.strip()
    *path, last = key.strip().split(".")
    try:
        for part in path:
            table = table[int(part)] if isinstance(table, list) else table.setdefault(part, {})
        table[int(last) if isinstance(table, list) else last] = value
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"--set: the job has no place '{key}'") from error


def _relative_to(job, folder):
    """The job with its file names relative to the current folder."""

    def at(name):
        return None if name is None else str(folder / name)

    model = at(job.model) if isinstance(job.model, str) else Source(
        *(at(getattr(job.model, field.name)) for field in fields(Source))
    )  # fmt: skip
    lists = {key: at(value) if isinstance(value, str) else value
             for key, value in (("inputs", job.inputs), ("outputs", job.outputs))}  # fmt: skip
    return replace(job, model=model, output=at(job.output), **lists)
