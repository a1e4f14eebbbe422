"""Read the file of a machine (machine.toml) as a MachineJob; docs/assembly.md shows one. SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ..assembly.joints import BushingJoint, MachineBody, PointMass, RigidJoint
from ..parallel.failures import InputError
from ..parallel.ranges import require_band
from .toml_file import CONFIG, check_file_names, parse, read_table

AnyJoint = Annotated[RigidJoint | BushingJoint, Field(discriminator="kind")]


@dataclass(frozen=True, kw_only=True)
class MachineJob:
    """Bodies put together, and what is asked of the whole. File names are relative to the folder of the file.

    `body`, `joint`, `mass`: what the machine is made of. `output`: a result file as that of a reduction; with measured
    bodies the responses of the machine, HDF5 or .csv. `band` (Hz): over which the error is estimated, and tables must
    reach; by default what the bodies were reduced for. `tolerance`: of the machine's responses; the estimate is
    compared with it, and tells which bodies to reduce again. `inputs`, `outputs`: of the machine, such as
    "spindle.tool:z", or "spindle.tool" for all directions; by default all of the bodies. `write_basis`: whether the
    shapes of the bodies go into the result.
    """

    body: tuple[MachineBody, ...]
    joint: tuple[AnyJoint, ...] = ()
    mass: tuple[PointMass, ...] = ()
    output: str = "machine.h5"
    band: tuple[float, float] | None = None
    tolerance: float | None = None
    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    write_basis: bool = True

    __pydantic_config__ = CONFIG

    def __post_init__(self):
        check_file_names(output=self.output, **{f"body[{k}].result": entry.result for k, entry in enumerate(self.body)},
                         **{f"joint[{k}].table": getattr(entry, "table", None) for k, entry in enumerate(self.joint)})
        check_machine(self.band, self.tolerance, self.inputs, self.outputs)
        if not self.write_basis and any(entry.kind == "measured" for entry in self.body):
            raise InputError("write_basis: a machine with measured bodies has no basis; leave it out")
        if not self.body:
            raise InputError("body: found none, expected at least one table [[body]]")


def check_machine(band, tolerance, inputs=None, outputs=None):
    """Raise InputError for a band, a tolerance, or inputs and outputs that make no sense."""
    for key, names in (("inputs", inputs), ("outputs", outputs)):
        if names is not None and not len(names):
            raise InputError(f"{key}: found none, expected some; leave it out for all")
    require_band("band", band)
    if tolerance is not None and not 1e-15 <= tolerance < 1:
        raise InputError(f"tolerance: found {tolerance:g}, expected a relative error such as 1e-3")


def read_machine(path, overrides=()) -> MachineJob:
    """Read and check the file of a machine; `overrides` as for read_job. Raises InputError."""
    path, table = Path(path), read_table(path, overrides)
    try:
        job = parse(MachineJob, table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    bodies = tuple(replace(entry, result=str(path.parent / entry.result)) for entry in job.body)
    joints = tuple(replace(entry, table=str(path.parent / entry.table)) if getattr(entry, "table", None) else entry
                   for entry in job.joint)  # fmt: skip
    return replace(job, body=bodies, joint=joints, output=str(path.parent / job.output))
