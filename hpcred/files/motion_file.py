"""Write the motion of a simulation: simulation.h5, and a table as .csv. SI units.

simulation.h5, with nt output times, m elastic coordinates, k nodes, c and d components of constraints, s springs:
t (nt); position (nt, 3) of the body frame in inertial axes; quaternion (nt, 4), scalar first, of the rotation from body
to inertial axes; velocity, angular_velocity (nt, 3) of the body frame in body axes; elastic, elastic_velocity (nt, m)
nodes/number, name (k); nodes/position, displacement, rotation, velocity, acceleration (nt, k, 3) in inertial axes;
rotation: a vector in rad, which goes on beyond pi
outputs/name (r); outputs/value (nt, r): of the reduced model, from the elastic coordinates
constraints/name (c), such as 7:x; constraints/force (nt, c) on the body; constraints/moment_name (d), such as 7:rx;
constraints/moment (nt, d) on the body; all joints and drives of a node together, in inertial axes
springs/name (s), such as 1:7 for the first one, at node 7; springs/force, moment (nt, s, 3) on the body; springs/energy
(nt, s)
energy/kinetic, elastic, gravity, springs, work (of forces and moments), drives (their work), dissipated (nt)
The datasets of vectors have the attribute `axes`: "inertial" or "body".
provenance: JSON with versions, setup, digest of the basis, largest errors, and where the time went
The .csv has one line a time: t, position, quaternion, elastic coordinates, displacements, rotations of nodes that have
some, outputs, forces, moments and energies.
"""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from ..body.coordinates import Coordinates, FrameMotion
from ..simulation.joints import AXES
from ..simulation.simulation import Motion
from .checked import Array
from .hdf5 import reading, writing
from .names import FileNames
from .text import write_table

FORMAT = "hpcred-simulation"
VERSION = 1
FRAME = ("position", "quaternion", "velocity", "angular_velocity")
AXES_OF = {"velocity": "body", "angular_velocity": "body", **dict.fromkeys((
    "position", "nodes/position", "nodes/displacement", "nodes/rotation", "nodes/velocity", "nodes/acceleration",
    "constraints/force", "constraints/moment",
    "springs/force", "springs/moment"), "inertial")}  # fmt: skip
SCHEMA = {
    "t": Array("real", ("t",), needed=True), "provenance": Array("text", (), needed=True),
    **{key: Array("real", ("t", size), needed=True) for key, size in (
        ("position", 3), ("quaternion", 4), ("velocity", 3), ("angular_velocity", 3), ("elastic", "m"),
        ("elastic_velocity", "m"))},
    "nodes/number": Array("integer", ("k",), needed=True), "nodes/position": Array("real", ("t", "k", 3), needed=True),
    "nodes/displacement": Array("real", ("t", "k", 3), needed=True), "nodes/rotation": Array("real", ("t", "k", 3)),
    "constraints/name": Array("text", ("c",), needed=True), "constraints/force": Array("real", ("t", "c"), needed=True),
    "energy/*": Array("real", ("t",)),
}  # fmt: skip


def write_motion(path, motion: Motion, provenance: dict, comm):
    """Write simulation.h5. Collective, with the same arguments on all ranks."""
    with writing(path, comm, FORMAT, VERSION) as file:
        for name, value in _arrays(motion).items():
            file.small(name, value, **{"axes": AXES_OF[name]} if name in AXES_OF else {})
        file.small("provenance", provenance)


def _arrays(motion) -> dict:
    """Everything by its place in the HDF5 file."""
    names = ("t", "position", "quaternion", "velocity", "angular_velocity", "elastic", "elastic_velocity")
    return {
        **{name: getattr(motion, name) for name in names},
        "nodes/number": np.array(motion.nodes, dtype=int),
        "nodes/name": motion.node_names,
        "nodes/position": motion.node_position,
        "nodes/displacement": motion.node_displacement,
        "nodes/rotation": motion.node_rotation,
        "nodes/velocity": motion.node_velocity,
        "nodes/acceleration": motion.node_acceleration,
        "outputs/name": motion.output_names,
        "outputs/value": motion.outputs,
        "constraints/name": motion.constraint_names,
        "constraints/force": motion.constraint_force,
        "constraints/moment_name": motion.moment_names,
        "constraints/moment": motion.constraint_moment,
        "springs/name": motion.spring_names,
        **{f"springs/{name}": getattr(motion, f"spring_{name}") for name in ("force", "moment", "energy")},
        **{f"energy/{name}": value for name, value in motion.energies.items()},
    }


def coordinates_of(motion) -> Coordinates:
    """Return the elastic coordinates of a Motion with the motion of the frame."""
    frame = {key: getattr(motion, key) for key in FRAME}
    return Coordinates(t=motion.t, q=motion.elastic, velocity=motion.elastic_velocity, frame=FrameMotion(**frame))


def read_coordinates(path) -> Coordinates:
    """Read the elastic coordinates and the motion of the frame of simulation.h5, on this rank. Raises InputError."""
    with reading(path, FORMAT, VERSION, SCHEMA) as file:
        motion = SimpleNamespace(**{key: file[key][...] for key in ("t", "elastic", "elastic_velocity", *FRAME)})
        return replace(coordinates_of(motion), basis=file.table("provenance").get("basis", ""))


def write_motion_csv(path, motion: Motion):
    """One line an output time, one column a number, named in the first line; call it on one rank."""
    columns = {"t": motion.t}
    columns |= {f"position_{a}": motion.position[:, i] for i, a in enumerate(AXES)}
    columns |= {f"quaternion_{a}": motion.quaternion[:, i] for i, a in enumerate("wxyz")}
    columns |= {f"q{k + 1}": motion.elastic[:, k] for k in range(motion.elastic.shape[1])}
    for kind, values in (("displacement", motion.node_displacement), ("rotation", motion.node_rotation)):
        for j, name in enumerate(motion.node_names):
            if kind == "displacement" or motion.node_rotates[j]:
                columns |= {f"{kind}_{name}_{a}": values[:, j, i] for i, a in enumerate(AXES)}
    once = FileNames()
    for name, values in zip(motion.output_names, motion.outputs.T, strict=True):
        columns[once.of_column("output_" + re.sub(r"[\s:,]", "_", name))] = values
    for kind, names in (("force", motion.constraint_names), ("moment", motion.moment_names)):
        values = getattr(motion, f"constraint_{kind}")
        columns |= {f"constraint_{kind}_{name.replace(':', '_')}": values[:, i] for i, name in enumerate(names)}
    for kind in ("force", "moment"):
        values = getattr(motion, f"spring_{kind}")
        for j, name in enumerate(motion.spring_names):
            columns |= {f"spring_{kind}_{name.replace(':', '_')}_{a}": values[:, j, i] for i, a in enumerate(AXES)}
    columns |= {f"energy_{name}": value for name, value in motion.energies.items()}
    write_table(path, columns, 10)
