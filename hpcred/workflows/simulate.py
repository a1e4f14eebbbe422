"""Simulate a body by a file such as sim.toml, and write simulation.h5, a .csv and a picture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..body.recovery import start_places
from ..body.spin_stress import warnings_of_spin
from ..files.hdf5 import written_by_one
from ..files.motion_file import FORMAT, coordinates_of, write_motion, write_motion_csv
from ..files.outputs import CSV_OF_MOTION, PNG, VTK, check_outputs, hdf5_kind
from ..files.result_file import result_at
from ..files.result_points import read_points
from ..files.together import rescued, together
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..reduction.result.record import versions
from ..report.figures import has_matplotlib, motion_figure
from ..settings.simulation_file import read_simulation
from ..simulation.simulation import simulate
from ..writers.recovered import write_recovered
from ..writers.vtk_series import check_series
from .workflow import workflow


@workflow
def simulate_file(path, *, overrides=(), comm=None, progress=None) -> dict:
    """Simulate a reduced body in time as a file says. Rank 0 computes. Collective.

    Parameters
    ----------
    path : str or PathLike
        The file of the simulation.
    overrides : sequence of str
        "key.path=value", which replace keys of the file.

    Returns
    -------
    dict
        The files written, the largest errors and displacements, notes on what was changed or approximated, and
        warnings.

    Raises
    ------
    InputError, ComputationError
        For a file that does not fit, and a motion that cannot be integrated.
    """
    with agreed(comm):
        setup = read_simulation(path, overrides)
    output = Path(setup.output)
    if not output.name:
        raise InputError(f"output {output}: this is a folder, expected a file name")
    written = {output: hdf5_kind(FORMAT), output.with_suffix(".csv"): CSV_OF_MOTION}
    if has_matplotlib():
        written[output.with_suffix(".png")] = PNG
    if setup.paraview:
        written[output.with_suffix(".pvd")] = VTK
    check_outputs(written, comm, [path, setup.body], progress=progress)
    if setup.paraview:
        check_series(output.with_suffix(".pvd"), comm, progress)
    motion = basis = None
    # the stage on all ranks, because the first one starts PETSc, which is collective
    with progress.stage("simulate", setup.body), agreed(comm):
        if comm.rank == 0:
            result = result_at(setup.body, setup.at, MPI.COMM_SELF)
            body, basis = result.body(setup.nodes), result.basis_digest()
            if setup.paraview:
                with result.shapes():
                    pass  # refused early where the file has no basis
            motion = simulate(body, setup, progress)
            if result.stress_nodes:
                motion.warnings += warnings_of_spin(body, motion.angular_velocity, motion.energies["elastic"].max())
            if result.turn is not None:  # coordinates of the basis in the file, for whoever reads the motion
                motion.elastic, motion.elastic_velocity = (
                    rows @ result.turn.T for rows in (motion.elastic, motion.elastic_velocity)
                )
    motion, basis = comm.bcast((motion, basis))
    files = [(output.with_suffix(".csv"), write_motion_csv)]
    notes = list(motion.notes) if setup.observe else [*motion.notes, _on_nodes(motion)]
    if comm.bcast(has_matplotlib()):
        files.append((output.with_suffix(".png"), motion_figure))
    else:
        notes.append("no picture was drawn, which needs matplotlib: pip install 'hpcred[plots]'")
    report = {"output": [str(output), *(str(name) for name, _ in files)], **_figures(motion), "notes": notes,
              "warnings": list(motion.warnings)}
    with together(comm), progress.stage("write", str(output)):
        record = {"versions": versions(), "setup": asdict(setup), "basis": basis, **report,
                  "timing": asdict(progress.timing())}  # fmt: skip
        rescued(lambda place: write_motion(place, motion, record, comm), output, comm)
        for target, write in files:
            written_by_one(target, comm, write, motion)
        if setup.paraview:
            target = output.with_suffix(".pvd")
            with progress.stage("write", str(target)):
                report["output"].append(str(target))
                _write_paraview(target, setup.body, motion, comm)
    return report


def _on_nodes(motion) -> str:
    """Return a sentence on what the result of a simulation has that observes no node."""
    names = motion.node_names
    nodes = f"node{'s' * (len(names) > 1)} {', '.join(names)}" if names else "no node"
    return f"the result has the motion of the body frame, of the shapes and of {nodes}; observe = [...] adds nodes"


def _write_paraview(target, body, motion, comm):
    """Write a .pvd, and one .vtu a time in a new folder beside it. Collective."""
    coordinates = coordinates_of(motion)
    points, origin = read_points(body, comm), result_at(body, None, comm).floating_frame.origin
    start = start_places(points.position - origin, coordinates)
    write_recovered(target, points, coordinates, ("displacement",), {}, comm, origin=origin, start=start)


def _figures(motion):
    return {
        "constraint_drift_m": motion.drift,
        "constraint_drift_rad": motion.rotation_drift,
        "energy_defect": motion.balance,
        "integrator_steps": motion.integrator_steps,
        "factorisations": motion.factorisations,
        "largest_displacement_m": {
            name: float(np.linalg.norm(motion.node_displacement[:, i], axis=-1).max())
            for i, name in enumerate(motion.node_names)
        },
    }
