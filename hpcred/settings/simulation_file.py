"""Read the file of a simulation (sim.toml) as a SimulationJob.

Its keys are those of SimulationJob, with the tables [[force]], [[moment]], [[constraint]], [[drive]] and [[spring]];
docs/simulate.md lists them. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from ..parallel.failures import InputError
from ..simulation.simulation import Simulation
from .toml_file import CONFIG, check_file_names, parse, read_table, require_kind


@dataclass(frozen=True, kw_only=True)
class SimulationJob(Simulation):
    """A Simulation and its files. In sim.toml, file names are relative to the folder of that file.

    Parameters
    ----------
    body : str
        A result of a reduction, result.h5.
    output : str
        An HDF5 file; a .csv and a .png are written beside it.
    paraview : bool
        Also a .pvd with the motion of all nodes, one .vtu a time in a folder.
    at : dict of float
        Values of the parameters of the body by name, such as {omega = 300.0}; by default those of reference.
    """

    body: str
    output: str = "simulation.h5"
    paraview: bool = False
    at: dict[str, float] = field(default_factory=dict)

    __pydantic_config__ = CONFIG

    def __post_init__(self):
        check_file_names(body=self.body, output=self.output)
        super().__post_init__()


def read_simulation(path, overrides=()) -> SimulationJob:
    """Read and check a file of a simulation; `overrides` as for read_job. Raises InputError."""
    path, table = Path(path), read_table(path, overrides)
    require_kind(path, table, "body")
    try:
        setup = parse(SimulationJob, table)
        if Path(setup.output).suffix in (".csv", ".png", ".pvd"):
            raise InputError(f"output: found '{setup.output}', expected an HDF5 file such as simulation.h5")
        if Path(setup.output) == Path(setup.body):
            raise InputError(f"output: found '{setup.output}', which is the body; choose another name")
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(setup, body=str(path.parent / setup.body), output=str(path.parent / setup.output))
