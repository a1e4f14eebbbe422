"""Copies of a model on groups of ranks, so that the groups can factor different matrices at the same time."""

import numpy as np

from ..model.dofs import Dofs
from ..model.frames import FramedModel
from ..model.rigid_body_modes import RigidBodyModes
from ..model.second_order_model import SecondOrderModel, dense_matrix
from ..parallel.exchange import exchange
from ..parallel.petsc import PETSc


def copy_to_group(framed: FramedModel, groups: int):
    """The framed model on the group of this rank, and the number of the group. Collective.

    The ranks are split into `groups` groups of consecutive ranks, as equal as possible; each group holds the whole
    model, distributed over its ranks. The caller closes the copy and its model (all ranks of a group together).
    """
    model = framed.model
    comm = model.comm
    number = comm.rank * groups // comm.size
    group = comm.Split(number, comm.rank)
    mats = {key: mat.getRedundantMatrix(groups, subcomm=PETSc.Comm(group)) for key, mat in model.matrices.items()}
    # rows of B, C^T and the labels go to the rank that has the row, in every group
    starts = np.array(mats["K"].getOwnershipRanges()[:-1])
    layouts = comm.allgather((number, group.rank, starts))
    columns = [np.arange(model.first_row, model.first_row + model.local_rows)]
    dense = [mat for mat in (model.B, model.Ct) if mat is not None]
    for mat in dense:
        columns += list(mat.getDenseArray().real.T)
    if model.dofs is not None:
        columns += [model.dofs.node, model.dofs.direction, *model.dofs.position.T]
    received = None
    for target in range(groups):
        ranks = np.array([rank for rank, (owner, _, _) in enumerate(layouts) if owner == target])
        limits = layouts[ranks[0]][2]
        owner = ranks[np.searchsorted(limits, columns[0], side="right") - 1]
        parts = exchange(comm, owner, [np.ascontiguousarray(column) for column in columns])
        if target == number:
            order = np.argsort(parts[0])
            received = [part[order] for part in parts[1:]]
    blocks = []
    for mat in dense:
        count = mat.getSize()[1]
        blocks.append(dense_matrix(mats["K"], np.array(received[:count]).T.reshape(-1, count)))
        received = received[count:]
    dofs = None
    if model.dofs is not None:
        dofs = Dofs(received[0], received[1], np.array(received[2:]).T.reshape(-1, 3))
    copy = SecondOrderModel(
        mats["M"], mats["K"], mats.get("D"), blocks[0], blocks[1] if model.Ct is not None else None, dofs,
        model.input_names, model.output_names, model.name,
    )  # fmt: skip
    result = FramedModel(copy, rigid=RigidBodyModes(copy) if framed.rigid is not None else None)
    result.damping = framed.damping
    return result, number
