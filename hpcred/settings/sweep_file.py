"""Read a sweep file (TOML) as a checked Sweep of named jobs; everything is refused before anything runs.

    job = "job.toml"                    # or a table [job] with the keys of a job file
    [[vary]]
    key = "damping.alpha"               # a place in the job; a list of keys gets the same value in each place
    values = [1.0, 10.0]                # or range = [start, stop, count] with spacing = "linear" | "log"
    [[vary]]
    key = "basis"
    values = [[{kind = "modes", count = 10}], [{kind = "krylov", frequency = 100.0, order = 2}]]
    names = ["modal", "krylov"]         # for the names of the results; tables and lists are numbered without

Axes later in the file go into what the axes before them put there. Instead of axes: a table [[run]] for each run, with
places as quoted keys, "basis.0.order" = 2, and perhaps a `name`.
"""

from __future__ import annotations

import copy
import itertools
import json
import os
import re
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..files.hdf5 import kind_of_file
from ..files.result_file import FORMAT as RESULT
from ..parallel.failures import InputError
from ..parallel.ranges import ANYTHING, SAMPLES, require_band, within
from .job_file import Job, job_from, plain
from .toml_file import CONFIG, as_value, check_file_names, parse, put, read_table, require_kind

RUNS = (1, 10**5, "")
NO_MATTER = ("output", "out_of_core", "memory_mb", "store")  # keys of a job that no number of its result depends on


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One [[vary]] of a sweep file: `values`, or a `range`, for a key or for several at once.

    Parameters
    ----------
    key : str or list of str
        The key of the job that varies, such as "damping.alpha"; of a list each value goes to all keys.
    values : list, optional
        The values, one after the other.
    range : [start, stop, count], optional
        In place of `values`.
    spacing : {"linear", "log"}
        Of a range.
    names : list of str, optional
        What the values are called in tables and names of results; by default themselves.
    """

    key: str | tuple[str, ...]
    values: tuple[Any, ...] | None = None
    range: tuple[int | float, int | float, int] | None = None
    spacing: Literal["linear", "log"] = "linear"
    names: tuple[str, ...] | None = None

    def __post_init__(self):
        where = f"vary '{self.title}'"
        if not self.keys or not all(key.strip() for key in self.keys):
            raise InputError("vary.key: found an empty text, expected a place in the job such as 'damping.alpha'")
        if (self.values is None) == (self.range is None):
            raise InputError(f"{where}: expected values, or range = [start, stop, count]")
        if self.range is not None:
            start, stop, count = self.range
            within(f"{where}.range: values", count, RUNS)
            within(f"{where}.range", (start, stop), ANYTHING)
            if self.spacing == "log" and min(start, stop) <= 0:
                raise InputError(f"{where}.range: found {start:g} to {stop:g}, spacing 'log' needs positive ends")
        if not self.points:
            raise InputError(f"{where}.values: the list is empty")
        if self.names is not None and len(self.names) != len(self.points):
            raise InputError(f"{where}.names: found {len(self.names)} names for {len(self.points)} values")

    @property
    def keys(self) -> tuple[str, ...]:
        return (self.key,) if isinstance(self.key, str) else self.key

    @property
    def title(self) -> str:
        return ", ".join(self.keys)

    @property
    def points(self) -> list:
        """The values. A linear range of whole numbers that meets only whole numbers has whole numbers."""
        if self.range is None:
            return list(self.values)
        start, stop, count = self.range
        spread = (np.geomspace if self.spacing == "log" else np.linspace)(start, stop, count)
        whole = self.spacing == "linear" and isinstance(start, int) and isinstance(stop, int)
        if whole and np.array_equal(spread, np.round(spread)):
            return [int(value) for value in spread]
        return [float(value) for value in spread]


@dataclass(frozen=True, kw_only=True)
class Launch:
    """How a site starts a run, and what a batch script needs.

    Parameters
    ----------
    ranks : int
        MPI ranks of a run.
    launcher : str
        The command before hpcred, with {ranks} in it; empty for none.
    nodes : int
        Nodes of a run, a divisor of `ranks`.
    memory_mb : int
        For each rank.
    time : str
        Limit of a run, hours:minutes:seconds.
    account, partition : str, optional
        Of the batch system.
    modules : list of str
        Loaded at the head of the script.
    setup : list of str
        Shell lines before the run.
    environment : table
        Variables of the run and their values.
    lines : list of str
        Lines for the head of the script, as they are.
    shares : int, optional
        Tasks of the array; by default one for each run.
    at_once : int, optional
        Tasks at the same time; by default as the batch system has room.
    parallel : int
        Runs at the same time without a batch system.
    """

    ranks: int = 1
    launcher: str = "mpiexec -n {ranks}"
    nodes: int = 1
    memory_mb: int = 4000
    time: str = "01:00:00"
    account: str | None = None
    partition: str | None = None
    modules: tuple[str, ...] = ()
    setup: tuple[str, ...] = ()
    environment: dict[str, str] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    shares: int | None = None
    at_once: int | None = None
    parallel: int = 1

    def __post_init__(self):
        for key in ("ranks", "nodes", "memory_mb", "shares", "at_once", "parallel"):
            if getattr(self, key) is not None and getattr(self, key) < 1:
                raise InputError(f"launch.{key}: found {getattr(self, key)}, expected at least 1")
        if self.ranks % self.nodes:
            raise InputError(f"launch.nodes: found {self.nodes} nodes for {self.ranks} ranks, expected a divisor")
        if not re.fullmatch(r"\d+:[0-5]\d:[0-5]\d", self.time):
            raise InputError(f"launch.time: found '{self.time}', expected hours:minutes:seconds such as '01:00:00'")
        for key in ("account", "partition", "modules"):
            for word in [getattr(self, key)] if isinstance(getattr(self, key), str) else getattr(self, key) or ():
                if not re.fullmatch(r"[\w./+@:=,-]+", word):
                    raise InputError(f"launch.{key}: found '{word}', expected a word without blanks")
        for key in ("setup", "lines"):
            if any("\n" in line for line in getattr(self, key)):
                raise InputError(f"launch.{key}: expected a list of lines, found one with a line break")
        if wrong := [name for name in self.environment if not re.fullmatch(r"[A-Za-z_]\w*", name)]:
            raise InputError(f"launch.environment: found '{wrong[0]}', expected names of variables")


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The full model that each result is compared with, and where.

    Parameters
    ----------
    full : str, optional
        A model file; by default that of the job.
    band : [lower, upper], optional
        Hz; by default that of the job.
    points : int
        Number of uniform frequencies over the band.
    frequencies : list of float, optional
        Hz, in place of `band` and `points`.
    """

    full: str | None = None
    band: tuple[float, float] | None = None
    points: int = 61
    frequencies: tuple[float, ...] | None = None

    def __post_init__(self):
        check_file_names(**{"evaluate.full": self.full})
        require_band("evaluate.band", self.band)
        within("evaluate.points", self.points, SAMPLES)
        if self.points < 2:
            raise InputError(f"evaluate.points: found {self.points}, expected at least 2 frequencies over the band")
        if self.frequencies is not None and not (self.frequencies and min(self.frequencies) >= 0):
            raise InputError("evaluate.frequencies: expected frequencies in Hz, none negative")


@dataclass(frozen=True, kw_only=True)
class _File:
    """Many jobs that differ in some keys. File names are relative to the folder of the sweep file.

    Parameters
    ----------
    job : str or table
        A job file, or its tables, which all runs begin with.
    output : str, optional
        The folder of the results; by default the name of the sweep file without its ending.
    store : str, optional
        A folder that keeps expansion points, which all runs share.
    combine : {"grid", "zip"}
        All combinations of the [[vary]] tables, or their first values together, their second ones, and so on.
    vary : tables
        Keys that vary, and their values.
    run : tables
        In place of `vary`: single runs, each with the keys of the job that it changes, and a `name`.
    evaluate : bool or table
        Compare each result with the full model.
    launch : table
        How runs are started.
    """

    job: str | dict[str, Any]
    output: str | None = None
    store: str | None = None
    combine: Literal["grid", "zip"] = "grid"
    vary: tuple[Axis, ...] = ()
    run: tuple[dict[str, Any], ...] = ()
    evaluate: bool | Evaluation = False
    launch: Launch = field(default_factory=Launch)

    __pydantic_config__ = CONFIG

    def __post_init__(self):
        check_file_names(job=self.job, output=self.output, store=self.store)
        if bool(self.vary) == bool(self.run):
            raise InputError("vary: expected at least one [[vary]], or at least one [[run]], and not both")
        counts = [len(axis.points) for axis in self.vary]
        within("vary: runs", prod(counts) if self.combine == "grid" else max(counts, default=1), RUNS)
        if self.combine == "zip" and len(set(counts)) > 1:
            listed = ", ".join(f"{axis.title} {count}" for axis, count in zip(self.vary, counts, strict=True))
            raise InputError(f"combine: 'zip' needs lists of the same length, found {listed}")


@dataclass(frozen=True)
class SweepRun:
    """One job of a sweep: its name, what it changes, {key: value} and in words {key: label}, and the job."""

    name: str
    values: dict[str, Any]
    labels: dict[str, str]
    job: Job

    @property
    def output(self) -> Path:
        return Path(self.job.output)

    def beside(self, suffix) -> Path:
        """A file of the run beside its result."""
        return self.output.with_suffix(suffix)

    def same_job(self, recorded: dict | None, contents: dict | None, content) -> bool:
        """Whether a record is that of this job, by what it says; files count by their contents, not by their names.

        `content(path)`: what the file has now.
        """
        if recorded is None or contents is None:
            return False
        return all(_by_contents(recorded.get(key), contents) == value for key, value in self.known_by(content).items())

    def known_by(self, content) -> dict:
        """What tells the job from others: its keys, with the contents of files in place of their names."""
        own = json.loads(json.dumps(plain(self.job)))
        now = {str(Path(name).absolute()): content(name) for name in self.job.files}
        return {key: _by_contents(value, now) for key, value in own.items() if key not in NO_MATTER}

    def job_text(self) -> str:
        """The job as a job file of its own."""
        lines = [f"{key} = {as_value(value)}" for key, value in plain(self.job).items() if value is not None]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Sweep:
    """A checked sweep: the file, the folder of its results, its runs, the keys that vary, and the rest of the file."""

    path: Path
    folder: Path
    runs: tuple[SweepRun, ...]
    keys: tuple[str, ...]
    launch: Launch
    evaluate: Evaluation | None


def _by_contents(value, contents):
    """Plain types with the contents in place of the names of files."""
    if isinstance(value, dict):
        return {key: _by_contents(entry, contents) for key, entry in value.items()}
    if isinstance(value, list):
        return [_by_contents(entry, contents) for entry in value]
    return ("contents", contents[value]) if isinstance(value, str) and value in contents else value


def read_sweep(path, store=None, *, runs_come=True) -> Sweep:
    """Read a sweep file and check every job in it. File names are relative to the folder of the sweep file.

    `store`: a folder that replaces that of the file. `runs_come`: whether files in the place of results, which are
    none, are refused. Nothing is written. Raises InputError.
    """
    path = Path(path)
    check_file_names(**{"--store": store})
    table = read_table(path)
    require_kind(path, table, "job")
    try:
        file = parse(_File, table)
        folder = path.parent / (file.output or path.stem)
        base, base_folder = file.job, path.parent
        if isinstance(base, str):
            base_file = path.parent / base
            base, base_folder = read_table(base_file), base_file.parent
        store = store or file.store and os.path.join(path.parent, file.store)
        if store:
            base["store"] = os.path.abspath(store)
        evaluation = _evaluation(file.evaluate, path.parent)
        runs = _runs(file, base, base_folder, folder)
        _check_outputs(runs, [path, base_file if isinstance(file.job, str) else path], runs_come)
        _check_evaluation(evaluation, runs)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    keys = tuple(dict.fromkeys(key for run in runs for key in run.values))
    return Sweep(path, folder, tuple(runs), keys, file.launch, evaluation)


def _evaluation(table, folder):
    if not isinstance(table, Evaluation):
        return Evaluation() if table else None
    full = os.path.join(folder, table.full) if table.full else None
    return Evaluation(full=full, band=table.band, points=table.points, frequencies=table.frequencies)


def _runs(file, base, base_folder, folder):
    """The runs by name, each with its job checked."""
    runs = []
    for name, changes, labels in _listed(file) if file.run else _crossed(file):
        table = copy.deepcopy(base)
        try:
            for key, value in changes.items():
                put(table, key, copy.deepcopy(value))
            table["output"] = "result.h5"
            job = job_from(table, base_folder, folder / f"{name}.h5")
            job.factoring  # noqa: B018  (refused early)
            for named in job.files:
                if not Path(named).is_file():
                    raise InputError(f"{named}: no such file")
        except InputError as error:
            raise InputError(f"run {name}: {error}") from error
        runs.append(SweepRun(name, changes, labels, job))
    return runs


def _listed(file):
    """Name, changes and labels of each [[run]]."""
    for number, changes in enumerate(file.run, 1):
        changes = {key.strip(): value for key, value in changes.items()}
        name = changes.pop("name", None)
        if not changes or "output" in changes:
            raise InputError(
                f"run[{number - 1}]: expected keys of the job such as \"damping.alpha\" = 1.0, and for the name of the "
                "result the key 'name'"
            )
        labels = {key: _label(value, number) for key, value in changes.items()}
        if name is not None and not isinstance(name, str):
            raise InputError(f"run[{number - 1}].name: found {name}, expected a text")
        yield _file_name([name] if name is not None else _pairs(labels)), changes, labels


def _crossed(file):
    """Name, changes and labels of each point of the grid, or of the lists side by side."""
    keys = [key.strip() for axis in file.vary for key in axis.keys]
    for i, key in enumerate(keys):
        if key == "output" or key in keys[:i]:
            raise InputError(
                f"vary.key: found '{key}' twice" if key != "output" else
                "vary.key: found 'output'; results are named by what varies, in the folder `output` of the sweep"
            )  # fmt: skip
        if inside := [other for other in keys[:i] if other.startswith(key + ".")]:
            raise InputError(f"vary: '{key}' would replace what '{inside[0]}' varies; put it before in the file")
    points = [list(zip(axis.points, _labels(axis), strict=True)) for axis in file.vary]
    for chosen in zip(*points, strict=True) if file.combine == "zip" else itertools.product(*points):
        changes, labels, first = {}, {}, {}
        for axis, (value, label) in zip(file.vary, chosen, strict=True):
            changes |= {key.strip(): value for key in axis.keys}
            labels |= {key.strip(): label for key in axis.keys}
            first[axis.keys[0].strip()] = label
        yield _file_name(_pairs(first, keys)), changes, labels


def _labels(axis):
    if axis.names is not None:
        return list(axis.names)
    points = axis.points
    labels = [_label(value, number) for number, value in enumerate(points, 1)]
    exact = len(set(labels)) == len(labels)  # else six digits do not tell them apart
    return labels if exact else [repr(value) if isinstance(value, float) else label
                                 for value, label in zip(points, labels, strict=True)]  # fmt: skip


def _label(value, number) -> str:
    """A value in words; a table or a list of tables is its number."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list) and not any(isinstance(entry, (dict, list)) for entry in value):
        return "-".join(_label(entry, number) for entry in value)
    return str(number) if isinstance(value, (dict, list)) else str(value)


def _pairs(labels, keys=None):
    """Parts of a name, key and label, with as little of each key as tells it from the others."""
    keys = list(keys or labels)
    for key, label in labels.items():
        steps = key.split(".")
        tails = [".".join(steps[i:]) for i in reversed(range(len(steps)))]
        alone = [tail for tail in tails if sum(f".{other}".endswith(f".{tail}") for other in keys) == 1]
        short = next((tail for tail in alone if not tail[0].isdigit()), key)
        yield f"{short}-{label}"


def _file_name(words) -> str:
    name = re.sub(r"[^\w.+-]+", "_", "_".join(words)).strip("._")
    if not name or len(name) > 150:
        raise InputError(f"vary: the name '{name}' of a result is no good; give `names` for the values")
    return name


def _check_outputs(runs, own, runs_come):
    """Refuse equal names of results, results that would replace what a run reads, and, where `runs_come`, what is no
    result; `own`: files of the sweep."""
    seen = {}
    for run in runs:
        if run.name.lower() in seen:
            raise InputError(
                f"two runs would write {run.output}: {_changes(seen[run.name.lower()])}, and {_changes(run)}; leave "
                "one out, or give them names"
            )
        seen |= {run.name.lower(): run, f"{run.name.lower()}.not-reached": run}
        reads = {Path(name).absolute() for name in (*run.job.files, *own)}
        for written in (run.output, run.beside(".toml"), run.beside(".log")):
            if written.absolute() in reads:
                raise InputError(f"run {run.name} would replace {written}, which it reads; choose another `output`")
        if runs_come and run.output.exists() and kind_of_file(run.output) != RESULT:
            raise InputError(f"{run.output}: is there and no result of a reduction; remove it, or choose another "
                             "`output`")


def _changes(run):
    return ", ".join(f"{key} = {as_value(value)}" for key, value in run.values.items())


def _check_evaluation(evaluation, runs):
    if evaluation is None:
        return
    for run in runs:
        if evaluation.full is None and not isinstance(run.job.model, str):
            raise InputError("evaluate.full: missing; the job has single matrices, name the model file")
        if evaluation.frequencies is None and evaluation.band is None and run.job.band is None:
            raise InputError("evaluate.band: missing, and the job has none; give [lower, upper] in Hz")
    if evaluation.full is not None and not Path(evaluation.full).is_file():
        raise InputError(f"evaluate.full: {evaluation.full}: no such file")
