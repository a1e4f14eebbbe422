"""Read load vectors from files: columns of matrices, and the loads of input files of finite-element programs."""

from dataclasses import replace

import numpy as np

from ..fe.dofs import require_dofs
from ..fe.faces import placed_nodes, places_of
from ..files.text import end_to_end, first_bytes, pieces
from ..files.text_numbers import labels, numbers
from ..model.loads.columns import added, centrifugal_field, column_of, inertia_force, sums_of_column
from ..model.loads.kinds import DeckLoad, GivenLoad, LoadColumn, Temperature
from ..model.loads.on_faces import NodalForces, forces_on_faces
from ..model.loads.thermal import thermal_forces
from ..model.units import SI, Units, units_of
from ..parallel.declared import declared
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up, require_once
from . import same_mesh
from .abaqus import input_file as abaqus_input
from .abaqus import loads as abaqus_loads
from .ansys import full_loads
from .ansys import records as ansys_records
from .assembly import read_columns
from .calculix import matrix_storage
from .deck_loads import DeckLoads
from .entries import label_name, label_of, node_and_direction
from .nastran import bulk
from .nastran import loads as nastran_loads
from .unread import refuse_unread


def read_load(model, load: GivenLoad | DeckLoad | Temperature) -> tuple[np.ndarray, LoadColumn]:
    """Return the load vector of a file, or of temperatures in a file, and its sums. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The model that it acts on.
    load : GivenLoad, DeckLoad or Temperature
        The file, and which load of it.

    Returns
    -------
    column : ndarray, shape (rows of this rank,)
    sums : LoadColumn

    Raises
    ------
    InputError
        For files that cannot be read or do not fit the model, loads that are not there, and those that are not read.
    """
    load, where = declared("load", load, GivenLoad | DeckLoad | Temperature), f"load '{load.name}'"
    if isinstance(load, DeckLoad):
        require_dofs(model, where)
        return _placed(model, load, _deck(load, model.comm), units_of(model.converted_from or SI.name))
    if isinstance(load, Temperature):
        forces = thermal_forces(model, where, _temperatures(model.comm, load))
        return column_of(model, forces, load.name, load.kind)
    local = read_columns(model.comm, model.row_starts, model.size, load.file, right_hand_sides=True)
    if load.column > local.shape[1]:
        raise InputError(f"{where}: column: found {load.column}, but {load.file} has {local.shape[1]}")
    column = local[:, load.column - 1]
    return column, sums_of_column(model, column, load.name, load.kind)


def _temperatures(comm, load):
    """Return a function of nodes (k,) that gives the temperatures (k,) of a file. Collective, as the function is."""

    def decode(piece):
        values, lines = numbers(piece, 2)
        node = labels(piece, values[:, 0], lines)
        piece.require(np.isfinite(values[:, 1]), lines, "a finite temperature in K")
        return node, values[:, 1]

    with agreed(comm):
        node, rise = end_to_end(pieces(load.file, comm), decode)
    require_once(
        comm, node, lambda twice: f"{load.file}: found the node {twice} twice, expected one temperature for each node"
    )

    def at(nodes):
        there, (values,) = look_up(comm, node, [rise], nodes)
        with agreed(comm):
            if not there.all():
                raise InputError(f"{load.file}: found no temperature of the node {nodes[~there][0]}, expected one for "
                                 "each node of the solids")  # fmt: skip
        return load.value * values

    return at


def _deck(load, comm) -> DeckLoads:
    """Return the loads of an input file."""
    with agreed(comm):
        start = first_bytes(load.file)
        known = ((bulk.begins, "an input file of Nastran", "sid"),
                 (ansys_records.begins, "a .full file of ANSYS", None),
                 (abaqus_input.begins, "an input file of Abaqus or CalculiX", "step"))  # fmt: skip
        of, wanted = next(((of, wanted) for begins, of, wanted in known if begins(start)), (None, None))
        if of is None:
            refuse_unread(load.file)
            raise InputError(f"{load.file}: found no input file of Abaqus, CalculiX or Nastran, and no .full file of "
                             "ANSYS, whose loads are wanted")  # fmt: skip
        chosen = next((key for key in ("step", "sid") if getattr(load, key) is not None), None)
        if chosen != wanted:
            raise InputError(f"load '{load.name}': {load.file} is {of}; expected "
                             f"{f'`{wanted}`' if wanted else 'neither `step` nor `sid`'}")  # fmt: skip
    if wanted is None:
        return full_loads.read_loads(load.file, comm)
    if wanted == "sid":
        return replace(nastran_loads.read_loads(load.file, load.sid, comm), nodes=same_mesh.read_nodes(load.file, comm))
    of_calculix = "K" in matrix_storage.files_of(load.file)
    return abaqus_loads.read_loads(load.file, load.step, comm, calculix=of_calculix)


def _placed(model, load, loads: DeckLoads, units: Units):
    """Return the column of loads that are in other units than SI, and its LoadColumn. Collective."""
    where, forces = f"load '{load.name}'", []
    same_mesh.require_places(model.comm, load.file, loads.nodes, units, *placed_nodes(model), model.name)
    force, acceleration = units.energy / units.length, units.length / units.time**2
    node = np.concatenate([np.zeros(0, np.int64), *(nodes for nodes, _ in loads.nodal)])
    value = np.concatenate([np.zeros((0, 6)), *(values for _, values in loads.nodal)])
    value = value * np.repeat([force, units.energy], 3)
    _require_known(model, load, loads.unknown, where)
    there, position = places_of(model, node)
    with agreed(model.comm):
        if not there.all():
            raise InputError(f"{where}: node {node[~there][0]} of {load.file} has no row in {model.name}; it does not "
                             "exist, follows another one, or was condensed")  # fmt: skip
    nodal = NodalForces(node, value, position)
    faces, pressure = loads.faces
    pressed = forces_on_faces(model, faces, where, pressure=pressure * force / units.length**2)
    forces.append(column_of(model, replace(NodalForces.joined([nodal, pressed]), area=pressed.area), load.name, "deck"))
    if loads.acceleration.any():
        field = loads.acceleration * acceleration
        forces.append(inertia_force(model, load.name, lambda points: np.broadcast_to(field, points.shape), "deck"))
    if loads.spins:
        spins = [(square / units.time**2, point * units.length, axis) for square, point, axis in loads.spins]
        turning, sums = inertia_force(model, load.name, centrifugal_field(model, load.name, spins), "deck")
        forces.append((turning, replace(sums, spins=True)))
    column, sums = added(load.name, "deck", forces)
    return column, replace(sums, remark="; ".join([*loads.remarks, *([sums.remark] if sums.remark else [])]))


def _require_known(model, load, unknown, where):
    """Raise InputError where a dof of the model, that it does not hold, is one whose load the file does not have."""
    node, _ = node_and_direction(unknown)
    there, _ = places_of(model, node)
    held = label_of(model.held.node, model.held.direction) if model.held is not None else np.zeros(0, np.int64)
    alike, _ = look_up(model.comm, held, [], unknown)
    lost = unknown[there & ~alike]
    with agreed(model.comm):
        if len(lost):
            raise InputError(f"{where}: {label_name(lost[0])} is held, or follows others, in {load.file}, so that its "
                             f"load is not there, but it moves in {model.name}; take files with the same supports, "
                             "constraint equations and couplings")  # fmt: skip
