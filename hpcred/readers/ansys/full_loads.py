"""Read the load vector of ANSYS' assembled matrices (.full) of a static analysis.

It has a number for each row of K, along the axes of the node. Held dofs and those that follow others have no load.
"""

import numpy as np

from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up
from ..deck_loads import DeckLoads
from ..entries import label_name, label_of, node_and_direction, require_sane
from ..nodal_systems import AXES, ZERO
from .full import LINES, STATIC, header_of, rows_of
from .nodes import find_nodes
from .records import FULL, RecordFile

SIX = 2 * AXES


def read_loads(path, comm) -> DeckLoads:
    """Return the forces and moments of the load vector of a file. Collective. Raises InputError."""
    with agreed(comm):
        file = RecordFile(path, FULL)
        # a static analysis without parts, with real loads
        header = header_of(file, STATIC)
        if header.whole is not None:
            raise InputError(f"{path}: found the part of one process of a distributed run, expected the whole file; "
                             "join the parts by COMBINE,FULL in /AUX2, or run on one process (-smp)")  # fmt: skip
        if not header.loads[0]:
            raise InputError(f"{path}: found no load vector, expected one; {LINES[STATIC]}")
        if header.loads[1]:
            raise InputError(f"{path}: found an imaginary load vector, expected real loads")
    # whose axes nodes have is not in this file
    label, held, slaves = rows_of(comm, file, header)
    mesh = find_nodes(file.path, comm)
    if mesh is None:
        raise InputError(f"{path}: found neither .cdb nor .rst file beside it, which tells of nodes with axes of their "
                         f"own; write it by CDWRITE,DB,{file.path.stem},cdb")  # fmt: skip
    low = comm.exscan(len(label)) or 0
    row = low + np.arange(len(label))
    with agreed(comm):
        # loads on held rows and on those that follow others are reactions, or not known
        value = _share(file, header.loads[0], header.equations, low, len(label), "the load vector")
        require_sane(value, f"{path}: found, near word {header.loads[0]},", "load")
        _require_plain(file, header, held, low, len(label))
        follows, fixed = np.isin(row, slaves), np.isin(row, held)
        lost = label[follows & (value != 0)]
        if len(lost):
            raise InputError(f"{path}: found a load on {label_name(lost[0])}, which follows others by a constraint "
                             "equation or coupling, expected it on these; load other nodes")  # fmt: skip
    # a table of the nodes, in which their axes are turned into global ones
    node, place = np.unique(node_and_direction(label)[0], return_inverse=True)
    at = place.reshape(-1), node_and_direction(label)[1]
    table, unknown = np.zeros((len(node), SIX)), np.zeros((len(node), SIX), bool)
    unknown[at] = fixed | follows
    table[at] = np.where(unknown[at], 0.0, value)
    turned, columns = look_up(comm, mesh.turned, list(mesh.rotation.reshape(-1, AXES**2).T), node)
    rotation = np.array(columns).T.reshape(-1, AXES, AXES)
    for axes_of in (slice(0, AXES), slice(AXES, SIX)):
        axes, without = rotation[turned], unknown[turned, axes_of]
        table[turned, axes_of] = np.einsum("nij,nj->ni", axes, table[turned, axes_of])
        # turned, a component is unknown where any that it is made of is
        unknown[turned, axes_of] = ((np.abs(axes) > ZERO) & without[:, None]).any(axis=2)
    loaded = (table != 0).any(axis=1)
    which, direction = np.nonzero(unknown)
    remarks = [f"{path} has no loads on the {len(held)} dofs that are held there; its sums are without them"]
    return DeckLoads(nodal=[(node[loaded], table[loaded])], unknown=label_of(node[which], direction),
                     remarks=remarks if len(held) else [], nodes=mesh.nodes)  # fmt: skip


def _share(file, position, count, low, size, vector):
    """Return the floating-point numbers low..low+size of a record of `count`. Raises InputError."""
    if file.count(position) != count:
        raise file.damaged(position, f"{vector} of {file.count(position)} numbers, expected {count},")
    values = file.part(position, low, low + size)
    if values.dtype.kind != "f":
        raise file.damaged(position, f"{vector} of integers")
    return values.astype(float)


def _require_plain(file, header, held, low, size):
    """Raise InputError where prescribed displacements, constants of constraint equations or factors of rows would be in
    the load vector, of which it is not known how."""
    place = header.dofs
    for _ in range(3):  # dofs of nodes, their kinds, and which are held
        place += file.frame(place)[0] + 3
    prescribed, _ = file.record(place)
    if len(held) and (len(prescribed) != len(held) or prescribed.dtype.kind != "f"):
        raise file.damaged(place, f"{len(prescribed)} prescribed displacements of {len(held)} held dofs,")
    if len(held) and prescribed.any():
        raise InputError(f"{file.path}: found prescribed displacements that are not zero, expected forces only; delete "
                         "them (DDELE), or set them to zero")  # fmt: skip
    if header.equations_of_constraint:
        constants, _ = file.record(file.record(header.constraints)[1])
        if len(constants) != header.equations_of_constraint or constants.dtype.kind != "f":
            raise file.damaged(header.constraints, "constraint equations without their constants")
        if constants.any():
            raise InputError(f"{file.path}: found constraint equations with constants, expected homogeneous ones")
    if header.loads[2]:
        factors = _share(file, header.loads[2], header.equations, low, size, "a table of factors of rows")
        if (factors != 1).any():
            raise InputError(f"{file.path}: found rows that are scaled, expected the matrices and loads as they are")
