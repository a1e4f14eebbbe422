"""The job file: TOML enters, checked dataclasses of the public interface leave; no matrix is read here."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

from ..model.damping import Caughey, GivenDamping, ModalDamping, NoDamping, Rayleigh, Structural
from ..model.frames import Buckens, Chord, NoFrame, Tangent
from ..parallel.failures import InputError
from ..reduction.krylov import Krylov, StaticCorrection
from ..reduction.modes import Modes
from ..reduction.second_order_krylov import SecondOrderKrylov
from ..workflows.convert import Source
from .toml_file import as_kind, as_table, check_known, read_table, tuples

CHOICES = {
    "frame": (NoFrame, Tangent, Chord, Buckens),
    "damping": (NoDamping, GivenDamping, Rayleigh, Caughey, ModalDamping, Structural),
    "basis": (Modes, Krylov, SecondOrderKrylov, StaticCorrection),
}

Targets = str | tuple[int | tuple[int, str], ...]


@dataclass(frozen=True)
class Job:
    """One reduction. Relative file names are relative to the folder of the job file.

    `inputs` and `outputs`: a matrix file, or dofs as numbers from 1 or [node, direction]; without them those of
    the model are taken. `band`: Hz. `deflation_tolerance` and `drop_above`: see reduce. `write_basis`: whether V
    goes into the result. `body_origin` (m) and `lumped_integrals`: see
    multibody.floating_frame. `projection`, `allow_unstable`, `groups`: see reduce. `out_of_core`, `low_rank`: see
    linalg.mumps.SolverOptions.
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
    groups: int | str = 1
    out_of_core: str | None = None
    low_rank: float | None = None

    def __post_init__(self):
        if self.band is not None and not 0 <= self.band[0] < self.band[1]:
            raise InputError(f"band: found {list(self.band)}, expected 0 <= lower < upper in Hz")
        if self.projection not in ("one_sided", "two_sided"):
            raise InputError(f"projection: found '{self.projection}', expected 'one_sided' or 'two_sided'")
        if self.groups != "auto" and (isinstance(self.groups, str) or self.groups < 1):
            raise InputError(f"groups: found {self.groups!r}, expected a whole number of at least 1, or 'auto'")
        if not 0 < self.deflation_tolerance < 1:
            raise InputError(f"deflation_tolerance: found {self.deflation_tolerance:g}, expected 0 to 1")
        if self.drop_above is not None and self.drop_above <= 0:
            raise InputError(f"drop_above: found {self.drop_above:g}, expected a positive frequency in Hz")


def read_job(path, overrides=()) -> Job:
    """Read and check a job file; `overrides` are texts "key.path=value" that replace or add single keys.

    Raises InputError that names the key, what was found and what was expected.
    """
    path, table = Path(path), read_table(path, overrides)
    try:
        job = parse_job(table)
        return _relative_to(job, path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_job(table: dict) -> Job:
    """A Job from the tables of a job file. Raises InputError."""
    given = tuples(table)
    check_known(given, [field.name for field in fields(Job)], "")
    for key in ("frame", "damping"):
        if key in given:
            given[key] = as_kind(CHOICES[key], given[key], key)
    basis = given.get("basis", ())
    if not isinstance(basis, tuple) or not basis:
        raise InputError("basis: expected at least one [[basis]] table")
    given["basis"] = tuple(as_kind(CHOICES["basis"], item, f"basis[{i}]") for i, item in enumerate(basis))
    if isinstance(given.get("model"), dict):
        given["model"] = as_table(Source, given["model"], "model")
    checked = {key: given.pop(key) for key in ("frame", "damping", "basis") if key in given}
    return replace(as_table(Job, {**given, "basis": ()}, ""), **checked)


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
