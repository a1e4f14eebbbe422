"""Read a job file (TOML) as one checked Job of the public interface; no matrix is read here."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from ..body.loaded_states import LoadedState
from ..fe.dofs import direction_index, target_of
from ..linalg.solvers.settings import Factoring, LinearSolver
from ..model.damping import Damping, NoDamping
from ..model.frames import Frame, NoFrame
from ..model.interfaces.nodes import Interface
from ..model.loads.base import Base
from ..model.loads.kinds import AnyLoad
from ..model.outputs.cuts import CutOutput
from ..model.outputs.motions import MotionOutput
from ..model.outputs.stresses import StressOutput
from ..model.parameters.definitions import Parameter, check_terms, checked_values
from ..parallel.failures import InputError
from ..parallel.ranges import COORDINATE, LABEL, require_band, within
from ..reduction.components.craig_bampton import (
    ConstraintModes,
    CraigBampton,
    FixedInterfaceModes,
    Guyan,
    ResidualAttachment,
)
from ..reduction.components.krylov import Krylov, StaticCorrection
from ..reduction.components.modes import Modes
from ..reduction.components.second_order_krylov import SecondOrderKrylov
from ..reduction.parametric.settings import ParameterSearch
from ..reduction.search.goal import Adaptive, Limits
from ..reduction.settings import Reduction
from .declared_terms import ViscoelasticPart
from .source import Source
from .term_table import TermTable
from .toml_file import CONFIG, check_file_names, parse, read_table, require_kind

FILES_OF_STATE = ("stresses", "file", "opposite")
PLACES = ("output", "inputs", "outputs", "out_of_core", "store")  # keys that may be names of files, besides `model`
Targets = str | tuple[int | str | tuple[int | str, str], ...]


def _kind_of_output(table) -> str | None:
    """Return the tag of the kind of output that a table has the keys of."""
    if not isinstance(table, dict):
        return None
    return "StressOutput" if "stress" in table else "CutOutput" if "cut" in table else "MotionOutput"


AnyOutput = Annotated[
    Annotated[MotionOutput, Tag("MotionOutput")] | Annotated[StressOutput, Tag("StressOutput")]
    | Annotated[CutOutput, Tag("CutOutput")],
    Discriminator(_kind_of_output),
]
OutputTargets = str | tuple[int | str | tuple[int | str, str] | AnyOutput, ...]


AnyComponent = Annotated[
    Modes | Krylov | SecondOrderKrylov | StaticCorrection | ConstraintModes | FixedInterfaceModes | CraigBampton | Guyan
    | ResidualAttachment,
    Field(discriminator="kind"),
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Job:
    """One reduction: settings and files. Relative file names in a job file are relative to its folder.

    For further keys see reduction.settings.Reduction, and see linalg.solvers.settings.Factoring.

    Parameters
    ----------
    model : str or table
        A file model.h5, or matrix files.
    basis : tables
        Components of the basis, each of which extends the basis of those before; without any a tolerance chooses.
    output : str
        The result, an HDF5 file.
    band : [lower, upper], optional
        Hz.
    tolerance : float, optional
        The eps that points, orders and size are chosen for, over the band.
    measure : {"directions", "paper"}
        What eps is: each response over the drive points of its input and output, or the norm (55).
    static : {"tolerance", "exact"}
        With "exact" the deflection at 0 Hz under every input is that of the full model to round-off, which takes a
        factor of K and at least as many coordinates as there are inputs.
    adaptive : table
        Limits of the search for the tolerance: see reduction.search.goal.Limits.
    unreached : {"mark", "write", "refuse"}
        Where the tolerance is not reached, write the model under a name that says so, or as `output`, or not at all.
    inputs : str or list, optional
        A matrix file, or a list of dofs as numbers from 1 or [node, direction], and of names of interfaces, for all of
        their directions; by default those of the model, or all directions of all interfaces.
    outputs : str or list, optional
        As `inputs`, by default at the same places; also velocities and accelerations, {node = 20, direction = "z",
        quantity = "acceleration"}, stresses at nodes, {node = 20, stress = "xx"}, and the forces of a cut, {cut =
        "TIP", about = [0.1, 0.0, 0.0]}.
    interface : tables
        Many nodes that move as one, whose name stands for a node in inputs, outputs and frames.
    load : tables
        Further inputs, behind `inputs`.
    base : tables
        Nodes whose motion is given, as on a shaker: their accelerations are further inputs, behind those of loads.
    parameter : tables
        What the matrices depend on (docs/parameters.md).
    term : tables
        Matrices that are added to those of the model, each times its factor of the parameters.
    parameter_search : table
        At how many values of the parameters the error is looked at.
    at : table
        Values of the parameters by name, at which the model is reduced as one without parameters.
    frame : table
        The reference frame of the body; by default none.
    damping : table, optional
        In place of the damping matrix of the model, which is taken by default.
    viscoelastic : tables
        Parts with a stiffness that depends on frequency.
    circulatory : bool
        Whether K, and its terms, may be unsymmetric, as with damping that turns with a shaft, oil films or friction;
        without it they are refused, since damaged files look like that too. A skew-symmetric term needs no declaration.
    write_basis : bool
        Write the basis V into the result.
    stress : bool or list
        Write the stresses of its columns too, at all nodes of solid elements, or at a list of nodes and names of node
        sets.
    report : bool
        Write an HTML report beside the result.
    body_origin : [x, y, z]
        Origin of the body frame in m.
    lumped_integrals : bool
        Volume integrals of multibody programs as sums over the nodes, with lumped masses, instead of exact ones.
    geometric_stiffness : bool or tables
        Write the stiffness of unit states of load into the result, by the stresses of solid elements; or tables of
        states that the finite-element program has computed (docs/geometric-stiffness.md).
    store : str, optional
        A folder that keeps expansion points for the next run.
    """

    model: str | Source
    basis: tuple[AnyComponent, ...] = ()
    output: str = "result.h5"
    band: tuple[float, float] | None = None
    tolerance: float | None = None
    measure: Literal["directions", "paper"] = Adaptive.measure
    static: Literal["tolerance", "exact"] = Adaptive.static
    adaptive: Limits = Limits()
    unreached: Literal["mark", "write", "refuse"] = "mark"
    inputs: Targets | None = None
    outputs: OutputTargets | None = None
    interface: tuple[Interface, ...] = ()
    load: tuple[AnyLoad, ...] = ()
    base: tuple[Base, ...] = ()
    parameter: tuple[Parameter, ...] = ()
    term: tuple[TermTable, ...] = ()
    parameter_search: ParameterSearch = ParameterSearch()
    at: dict[str, float] = field(default_factory=dict)
    frame: Frame = NoFrame()
    damping: Damping | None = None
    viscoelastic: tuple[ViscoelasticPart, ...] = ()
    circulatory: bool = False
    deflation_tolerance: float = Reduction.deflation_tolerance
    drop_above: float | None = None
    write_basis: bool = True
    stress: bool | tuple[int | str, ...] = False
    report: bool = False
    body_origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lumped_integrals: bool = False
    geometric_stiffness: bool | tuple[LoadedState, ...] = False
    projection: str = Reduction.projection
    allow_unstable: bool = False
    groups: int | str = 1
    coordinates: str = Reduction.coordinates
    out_of_core: str | None = None
    low_rank: float | None = None
    memory_mb: float | None = None
    solver: LinearSolver = LinearSolver()
    store: str | None = None

    __pydantic_config__ = CONFIG

    def __post_init__(self):
        check_file_names(
            model=self.model, output=self.output, inputs=self.inputs, outputs=self.outputs,
            out_of_core=self.out_of_core, store=self.store,
            **{f"interface '{table.name}': nodes": table.nodes for table in self.interface},
            **{f"load '{table.name}': file": table.file for table in self.load if hasattr(table, "file")},
            **{f"geometric_stiffness '{table.state}': {key}": getattr(table, key) for table in self.loaded_states
               for key in FILES_OF_STATE},
        )  # fmt: skip
        # keys by themselves
        for key in ("inputs", "outputs"):
            _check_targets(key, getattr(self, key))
        within("body_origin", self.body_origin, COORDINATE)
        if isinstance(self.stress, tuple):
            within("stress", [node for node in self.stress if not isinstance(node, str)], LABEL)
            if not self.stress:
                raise InputError("stress: found an empty list, expected nodes and names of node sets, true or false")
        if self.stress and not self.write_basis:
            raise InputError("stress: found it with write_basis = false; stresses belong to the basis, so write it too")
        # a basis or a tolerance, and what belongs to a tolerance only
        if not self.basis and self.tolerance is None:
            raise InputError("basis: expected at least one [[basis]] table, or a tolerance with a band")
        if self.tolerance is not None and self.band is None:
            raise InputError("band: missing; a tolerance is over a band, [lower, upper] in Hz")
        for key in ("measure", "static"):
            if self.tolerance is None and getattr(self, key) != getattr(Adaptive, key):
                raise InputError(f"{key}: found it without a tolerance, to which it belongs; give both or neither")
        if self.tolerance is None and self.adaptive != Limits():
            raise InputError(
                "adaptive: found limits of a search, but no tolerance that it is to reach; write tolerance and band "
                "above the first table, or leave [adaptive] out"
            )
        # parameters, and what belongs to them only
        if self.parameter or self.term:
            check_terms(self.parameter, [table.with_matrix(None) for table in self.term])
            checked_values(self.parameter, self.at)
            of_K = any(table.with_matrix(None).of == "K" for table in self.term)
            if self.geometric_stiffness and not self.at and of_K:
                raise InputError(
                    "geometric_stiffness: found it beside terms of K, on which the stress under a load depends; leave "
                    "it out, or reduce at one value by `at`"
                )
        for key, default in (("at", {}), ("parameter_search", ParameterSearch())):
            if getattr(self, key) != default and not self.parameter:
                raise InputError(f"{key}: found it without [[parameter]], to which it belongs; leave it out")
        if self.parameter_search != ParameterSearch() and self.tolerance is None:
            raise InputError("parameter_search: found it without a tolerance, to which it belongs; leave it out")
        require_band("band", self.band)
        self.settings, self.search  # noqa: B018  (refused early)

    @property
    def settings(self) -> Reduction:
        """How to reduce."""
        return self._part(Reduction)

    @property
    def search(self) -> Adaptive | None:
        """What an automatic reduction is to reach, None without a tolerance."""
        if self.tolerance is None:
            return None
        return Adaptive(
            tolerance=self.tolerance, band=self.band, measure=self.measure, static=self.static, **asdict(self.adaptive)
        )

    @property
    def loaded_states(self) -> tuple[LoadedState, ...]:
        """States of geometric stiffness that files give."""
        return self.geometric_stiffness if isinstance(self.geometric_stiffness, tuple) else ()

    @property
    def factoring(self) -> Factoring:
        """How to factor. Raises InputError where the folder for factors cannot be written."""
        return self._part(Factoring)

    def _part(self, kind):
        return kind(**{setting.name: getattr(self, setting.name) for setting in fields(kind)})

    @property
    def preferred_scalar(self) -> str:
        """The PETSc build that fits: complex where a component needs a complex A(s)."""
        damped = bool(self.viscoelastic) or not isinstance(self.damping, NoDamping | None)
        return "complex" if any(component.complex_shift(damped) for component in self.basis) else "real"

    @property
    def files(self) -> list[str]:
        """All files that the run reads."""
        model = [self.model] if isinstance(self.model, str) else self.model.files
        named = (self.inputs, self.outputs, *(entry.nodes for entry in self.interface),
                 *(getattr(entry, "file", None) for entry in (*self.load, *self.term, *self.viscoelastic)),
                 *(getattr(entry, key) for entry in self.loaded_states for key in FILES_OF_STATE))  # fmt: skip
        return list(dict.fromkeys([*model, *(entry for entry in named if isinstance(entry, str))]))


def _check_targets(key, targets):
    if isinstance(targets, str) and (target := target_of(targets)) and isinstance(target, tuple):
        sentence = f"found '{targets}', expected a list such as [{list(target)}], or the name of a matrix file"
        raise InputError(f"{key}: {sentence}")
    if targets is None or isinstance(targets, str):
        return
    if not targets:
        raise InputError(f"{key}: found an empty list, expected dof numbers or [node, direction]; or leave it out")
    for target in targets:
        if isinstance(target, MotionOutput | StressOutput | CutOutput):
            continue
        within(key, target[0] if isinstance(target, tuple) else target, LABEL)  # a name of an interface passes
        if isinstance(target, tuple) and target[1] != "all":  # of a node, whose directions the model knows
            direction_index(target[1], key)


# keys that change the model
TERMS_OF_MODEL = ("load", "base", "viscoelastic", "parameter", "term", "at", "circulatory")


def read_job(path, overrides=()) -> Job:
    """Read and check a job file.

    Parameters
    ----------
    path : str or PathLike
    overrides : sequence of str
        "key.path=value", which replace or add single keys.

    Raises
    ------
    InputError
        That names the key, what was found and what was expected.
    """
    path, table = Path(path), read_table(path, overrides)
    require_kind(path, table, "model")
    try:
        return _with_folder(parse(Job, table), path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def job_from(table: dict, folder, output) -> Job:
    """A checked Job from the tables of a job file in `folder`, with its result at `output`. Raises InputError."""
    return replace(_with_folder(parse(Job, table), folder), output=str(output))


def _with_folder(job, folder):
    """The job with its file names relative to the current folder."""

    def at(name):
        return os.path.join(folder, name) if isinstance(name, str) else name

    model = at(job.model) if isinstance(job.model, str) else Source(
        **{key: at(name) for key, name in asdict(job.model).items()}
    )  # fmt: skip
    moved = {key: at(getattr(job, key)) for key in PLACES}
    interface = tuple(replace(entry, nodes=at(entry.nodes)) for entry in job.interface)
    load, term = (tuple(replace(entry, file=at(entry.file)) if hasattr(entry, "file") else entry for entry in entries)
                  for entries in (job.load, job.term))  # fmt: skip
    moved["viscoelastic"] = tuple(replace(entry, file=at(entry.file)) for entry in job.viscoelastic)
    if job.loaded_states:
        moved["geometric_stiffness"] = tuple(
            replace(entry, **{key: at(getattr(entry, key)) for key in FILES_OF_STATE}) for entry in job.loaded_states
        )
    return replace(job, model=model, interface=interface, load=load, term=term, **moved)


def plain(job: Job) -> dict:
    """The job as plain types, with absolute names of files, which stay right wherever they are used."""
    table = asdict(job)

    def absolute(name):
        return str(Path(name).absolute()) if isinstance(name, str) else name

    for key in (*PLACES, "model"):
        if key in table:
            table[key] = absolute(table[key])
    if isinstance(table["model"], dict):
        table["model"] = {key: absolute(name) for key, name in table["model"].items()}
    for entry in table["interface"]:
        entry["nodes"] = absolute(entry["nodes"])
    for entry in [*table["load"], *table["term"]]:
        if "file" in entry:
            entry["file"] = absolute(entry["file"])
    for entry in table["viscoelastic"]:
        entry["file"] = absolute(entry["file"])
    if job.loaded_states:
        for entry in table["geometric_stiffness"]:
            entry |= {key: absolute(entry[key]) for key in FILES_OF_STATE}
    return table
