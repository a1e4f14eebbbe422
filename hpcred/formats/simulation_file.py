"""Files of a simulation: sim.toml enters as a SimulationJob; simulation.h5 and a .csv leave. SI units.

simulation.h5, with nt output times, m elastic coordinates, k nodes, c constrained directions:
t (nt); position (nt, 3) of the body frame; quaternion (nt, 4), scalar first; velocity, angular_velocity (nt, 3) in body
axes; elastic, elastic_velocity (nt, m)
nodes/number (k); nodes/position (nt, k, 3), nodes/displacement (nt, k, 3) in inertial axes
constraints/name (c), such as 7:x; constraints/force (nt, c) on the body
energy/kinetic, elastic, gravity, work, dissipated (nt)
provenance: JSON with versions, setup, largest errors, and where the time went
The .csv has one line a time: t, position, quaternion, elastic coordinates, displacements, forces and energies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..multibody.simulation import AXES, Motion, Simulation
from ..parallel.failures import InputError
from .hdf5 import writing
from .toml_file import CONFIG, parse, read_table

FORMAT = "hpcred-simulation"
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class SimulationJob(Simulation):
    """A Simulation and its files. `body`: result.h5. `output`: an HDF5 file; .csv and .png are written beside it, and
    with `paraview` a .pvd with the motion of all nodes, one file a time in a folder.

    In sim.toml, file names are relative to the folder of that file.
    """

    body: str
    output: str = "simulation.h5"
    paraview: bool = False

    __pydantic_config__ = CONFIG


def read_simulation(path, overrides=()) -> SimulationJob:
    """Read and check a file of a simulation; `overrides` as for read_job. Raises InputError."""
    path, table = Path(path), read_table(path, overrides)
    try:
        setup = parse(SimulationJob, table)
        if Path(setup.output).suffix in (".csv", ".png"):
            raise InputError(f"output: found '{setup.output}', expected an HDF5 file such as simulation.h5")
        if Path(setup.output) == Path(setup.body):
            raise InputError(f"output: found '{setup.output}', which is the body; choose another name")
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(setup, body=str(path.parent / setup.body), output=str(path.parent / setup.output))


def write_motion(path, motion: Motion, provenance: dict, comm):
    """Write simulation.h5. Collective, with the same arguments on all ranks."""
    with writing(path, comm) as file:
        file.attribute("format", FORMAT)
        file.attribute("version", VERSION)
        for name, value in _arrays(motion).items():
            file.small(name, value)
        file.small("provenance", provenance)


def _arrays(motion) -> dict:
    """Everything by its place in the HDF5 file."""
    names = ("t", "position", "quaternion", "velocity", "angular_velocity", "elastic", "elastic_velocity")
    return {
        **{name: getattr(motion, name) for name in names},
        "nodes/number": np.array(motion.nodes, dtype=int),
        "nodes/position": motion.node_position,
        "nodes/displacement": motion.node_displacement,
        "constraints/name": motion.constraint_names,
        "constraints/force": motion.constraint_force,
        **{f"energy/{name}": value for name, value in motion.energies.items()},
    }


def write_motion_csv(path, motion: Motion):
    """One line an output time, one column a number, named in the first line; call it on one rank."""
    columns = {"t": motion.t}
    columns |= {f"position_{a}": motion.position[:, i] for i, a in enumerate(AXES)}
    columns |= {f"quaternion_{a}": motion.quaternion[:, i] for i, a in enumerate("wxyz")}
    columns |= {f"q{k + 1}": motion.elastic[:, k] for k in range(motion.elastic.shape[1])}
    for j, node in enumerate(motion.nodes):
        columns |= {f"displacement_{node}_{a}": motion.node_displacement[:, j, i] for i, a in enumerate(AXES)}
    columns |= {
        f"constraint_force_{name.replace(':', '_')}": motion.constraint_force[:, i]
        for i, name in enumerate(motion.constraint_names)
    }
    columns |= {f"energy_{name}": value for name, value in motion.energies.items()}
    np.savetxt(path, np.array(list(columns.values())).T, "%.10e", ",", header=",".join(columns), comments="")
