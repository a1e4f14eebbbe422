"""Recover the motion of nodes and their stresses in blocks of instants, and write each block: HDF5, .csv or ParaView.

Each rank does its nodes: what it holds is its rows of the basis, and a block of instants of its nodes.
"""

from pathlib import Path

import numpy as np

from ..body.coordinates import LARGEST, Coordinates
from ..body.recovery import QUANTITIES, Recovery, inertial_motion
from ..files.outputs import CSV_OF_RECOVERY, VTK, check_room, hdf5_kind
from ..files.recovered_file import FORMAT, recovered_file, recovered_table
from ..files.result_points import Points
from ..parallel.failures import ComputationError, InputError, agreed
from .vtk_series import series, single

AT_ONCE, FEWEST = 2**22, 16  # numbers of a field of a rank at a time, and instants: products of fewer are slow
ENDINGS = {".pvd": VTK, ".vtu": VTK, ".csv": CSV_OF_RECOVERY, ".h5": hdf5_kind(FORMAT), ".hdf5": hdf5_kind(FORMAT)}
STRESSES = ("stress", "von_mises")
UNITS = {"displacement": "largest_displacement_m", "velocity": "largest_velocity_m_s",
         "acceleration": "largest_acceleration_m_s2", "von_mises": "largest_von_mises_pa"}  # fmt: skip


def kind_of_recovery(path) -> str:
    """Return the kind of an output by its ending, see outputs.kind_of. Raises InputError for other endings."""
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"output {path}: found a name that ends in {ending or 'nothing'}, expected one of "
                         f"{', '.join(ENDINGS)}")  # fmt: skip
    return ENDINGS[ending]


def write_recovered(path, points: Points, coordinates: Coordinates, quantities, record: dict, comm, *, origin,
                    start=None, dtype="<f8", progress=None) -> dict:  # fmt: skip
    """Write the motion of points, in inertial axes where their places at the `start` (k, 3) are given.

    `origin` (3,) of the body frame. Returns the largest values with their nodes and instants. Collective.
    """
    path, t = Path(path), coordinates.t
    # what is written, and where to: the ending says how
    keys = (*quantities, *(STRESSES if points.stress is not None else ()))
    if not comm.allreduce(len(points.stressed)) and points.stress is not None:
        raise InputError("stress: none of the nodes has stresses; choose others, or leave out --nodes")
    ending, largest = path.suffix.lower(), {}
    shown = ending in (".pvd", ".vtu")
    if ending == ".vtu" and len(t) > 1:
        raise InputError(f"output {path}: found {len(t)} instants, and a .vtu has one; choose .pvd, or one instant by "
                         "--from and --to")  # fmt: skip
    # a series of pictures may be larger than the disk, which is told before
    if ending == ".pvd":
        needed = len(t) * points.total * np.dtype(dtype).itemsize * (3 * len(quantities) + 3)
        with agreed(comm):
            if comm.rank == 0:
                check_room(path, needed)
        output = series(path, points, t, comm, dtype)
    elif ending == ".vtu":
        output = single(path, points, comm, dtype)
    elif ending == ".csv":
        output = recovered_table(path, points, t, keys, comm)
    else:
        places = points.position if start is None else start
        output = recovered_file(path, points, places, t, keys, record, comm, dtype)
    # motion in inertial axes needs the displacement, velocity too for accelerations
    local, moved = points.position - origin, start is not None
    needed = {*quantities, *(QUANTITIES[: QUANTITIES.index(quantities[-1]) + 1] if moved else ())}
    wanted = [key for key in QUANTITIES if key in needed]
    chosen = ("place", "elastic", *keys) if moved and shown else keys
    # instants go in blocks whose size bounds the memory, whatever the number of points
    step = min(max(AT_ONCE * comm.size // max(3 * points.total, 1), FEWEST), len(t))
    recovery = Recovery(coordinates, step)
    with output as put:
        for first in range(0, len(t), step):
            instants = slice(first, min(first + step, len(t)))
            fields = recovery.motion(points.shapes, instants, wanted)
            if moved:
                fields = inertial_motion(fields, local, start, coordinates, instants)
            if points.stress is not None:
                fields |= recovery.stresses(points.stress, instants)
            with agreed(comm):
                _require_numbers(fields, dtype)
            _keep_largest(largest, {key: fields[key] for key in keys if key != "stress"}, points, t[instants])
            fields = {key: fields[key] for key in chosen}
            put(_at_all(fields, points) if shown else fields)
            if progress is not None:
                progress.step("instants", instants.stop, len(t))
        # the largest of all ranks
        report = _all_largest(largest, comm)
        record |= report
    return report


def _require_numbers(fields, dtype):
    """Raise ComputationError for fields that overflow, as numbers or as their squares."""
    most = min(np.finfo(dtype).max, LARGEST)
    for key, values in fields.items():
        if not (np.abs(values) <= most).all():
            raise ComputationError(f"the recovered {key} is beyond {most:.2g}, and is not written; the motion is too "
                                   "large for this body, or for --single")  # fmt: skip


def _at_all(fields, points) -> dict:
    """Return fields for all nodes of this rank, NaN where there are no stresses."""
    result = dict(fields)
    for key in set(STRESSES).intersection(fields):
        values = fields[key]
        result[key] = np.full((len(values), len(points.node), *values.shape[2:]), np.nan)
        result[key][:, points.stressed] = values
    return result


def _keep_largest(largest, fields, points, t):
    """Keep (value, node, instant) of the largest of each field of this rank; nodes that rest have zero, at the first.
    """
    for key, values in fields.items():
        known = largest.setdefault(key, (-1.0, None, float(t[0])))
        if not values.size:
            continue
        size = values if values.ndim == 2 else np.sqrt(np.einsum("tki,tki->tk", values, values))
        i, place = np.unravel_index(size.argmax(), size.shape)
        if size[i, place] > known[0]:
            node = int(points.node[points.stressed[place] if key in STRESSES else place])
            largest[key] = (float(size[i, place]), points.names.get(node, node), float(t[i]))


def _all_largest(largest, comm) -> dict:
    """Return the largest of each field over the ranks, by the names of UNITS. Collective."""
    of_ranks = comm.allgather(largest)
    largest_of_all = {key: max((own[key] for own in of_ranks), key=lambda peak: peak[0]) for key in largest}
    return {UNITS[key]: {"value": value, "node": node, "t_s": t} for key, (value, node, t) in largest_of_all.items()}
