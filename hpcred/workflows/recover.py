"""Recover the motion of the nodes of a reduced body from its coordinates over time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..body.coordinates import Coordinates
from ..body.recovery import QUANTITIES, require_frame, start_places
from ..files.hdf5 import require_name
from ..files.outputs import check_outputs
from ..files.result_file import Result, read_result
from ..files.result_points import read_points
from ..parallel.declared import declared, flattened, nearest
from ..parallel.failures import InputError, agreed
from ..readers.motions.source import read_coordinates
from ..reduction.result.record import versions
from ..writers.fmu import output_rows
from ..writers.recovered import kind_of_recovery, write_recovered
from ..writers.vtk_series import check_series
from .keywords import Motion, Recovered
from .workflow import workflow


@workflow
@flattened
def recover(
    result,
    motion,
    output,
    *,
    recovered: Recovered,
    taken: Motion,
    comm=None,
    progress=None,
) -> dict:
    """Recover the motion of nodes, u = V q, from reduced coordinates over time, and write it. Collective.

    Parameters
    ----------
    result : Result or path
        result.h5, with its basis and nodes.
    motion : path
        simulation.h5, a solution of Exudyn, a .csv with t, q1, q2, ... (or time, q[1], ... of an FMU), or HDF5 with t
        (nt) and q (nt, m); velocities and accelerations perhaps, see docs/recover.md.
    output : path
        .pvd for ParaView (a .vtu an instant in a folder beside it), .vtu for one instant, .h5, or .csv.
    nodes : sequence of int or str, optional
        Numbers, names of interfaces and of node sets; by default all nodes of the mesh.
    quantities : sequence of {"displacement", "velocity", "acceleration"}, default ("displacement",)
        In m, m/s, m/s^2.
    inertial : bool, default False
        Whether in inertial axes, displacements since the start with the motion of the frame; needs simulation.h5. By
        default in the body frame, without its motion.
    stress : bool, default False
        Whether stresses are recovered, from the stress modes of the result.
    start, end : float, optional
        First and last instant in s.
    every : int, default 1
        One of so many instants is written.
    single : bool, default False
        Whether numbers are written in single precision, which halves the file.
    first : int, optional
        Of Exudyn: number, from 0, of the first reduced coordinate among the coordinates of the system.

    Returns
    -------
    dict
        output, instants, nodes, axes, remarks, largest_displacement_m with its node and time; with stresses
        largest_von_mises_pa likewise.

    Raises
    ------
    InputError
        For a result without nodes or basis, a motion of another body, unknown nodes, and numbers that are not finite.
    """
    # what is asked for, and whether it can be written
    source, output = result.path if isinstance(result, Result) else result, Path(output)
    require_name(source)
    require_name(motion)
    quantities, inertial, stress = _quantities(recovered.quantities), recovered.inertial, recovered.stress
    every = declared("every", taken.every, int)
    if every < 1:
        raise InputError(f"every: found {every}, expected at least 1")
    check_outputs({output: kind_of_recovery(output)}, comm, [source, motion], progress=progress)
    if output.suffix.lower() == ".pvd":
        check_series(output, comm, progress)
    with progress.stage("read", str(source)):
        # coordinates over time, of the instants that are wanted, and rates where these are needed
        result = read_result(source, comm)
        whole = coordinates_of(result, motion, comm, taken.first)
        if inertial:
            require_frame(motion, whole)
        else:
            whole = replace(whole, frame=None)
        whole = whole.with_rates(motion, "velocity" in quantities or (inertial and "acceleration" in quantities),
                                 "acceleration" in quantities)  # fmt: skip
        coordinates = whole.thinned(motion, taken.start, taken.end, every)
        points = read_points(source, comm, recovered.nodes, stress)
    # places of the nodes in the body's frame, and where they are in inertial axes at the start
    origin = result.floating_frame.origin if result.floating_frame is not None else np.zeros(3)
    begin = start_places(points.position - origin, whole) if inertial else None
    remarks = list(coordinates.remarks)
    if stress and result.reduced.record is not None:
        remarks += [f"load '{load.name}': {load.remark}" for load in result.reduced.record.loads
                    if load.kind == "temperature"]  # fmt: skip
    record = {"result": str(source), "motion": str(motion), "axes": "inertial" if inertial else "body",
              "remarks": remarks, "versions": versions()}  # fmt: skip
    with progress.stage("recover", str(output)):
        report = write_recovered(output, points, coordinates, quantities, record, comm, origin=origin, start=begin,
                                 dtype="<f4" if recovered.single else "<f8", progress=progress)  # fmt: skip
    return {"output": str(output), "instants": len(coordinates.t), "nodes": points.total, "axes": record["axes"],
            **report, "remarks": record["remarks"]}  # fmt: skip


def coordinates_of(result: Result, motion, comm, first: int | None = None) -> Coordinates:
    """Return the coordinates of a motion of the body of a result; `first`: see recover. Collective. Raises
    InputError for that of another body."""
    digest = None
    with agreed(comm):
        if comm.rank == 0:
            digest = result.basis_digest()
    reduced = result.reduced
    return read_coordinates(motion, reduced.size, comm.bcast(digest), output_rows(reduced), comm, first)


def _quantities(words) -> tuple[str, ...]:
    """Return the quantities that are asked for, in the order of QUANTITIES. Raises InputError."""
    words = declared("quantities", words, tuple[str, ...])
    for word in words:
        if word not in QUANTITIES:
            raise InputError(f"quantities: found '{word}', expected {', '.join(QUANTITIES)}{nearest(word, QUANTITIES)}")
    if not words:
        raise InputError(f"quantities: found none, expected some of {', '.join(QUANTITIES)}")
    return tuple(word for word in QUANTITIES if word in words)
