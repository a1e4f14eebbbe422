"""Drive a reduced model by the displacements or velocities of its bases, in place of their accelerations.

Where a model answers to the acceleration b'' of a base with y, it answers to b with y'': an output of a displacement
becomes that of an acceleration of the same coordinates, and an absolute acceleration an absolute displacement. Forces
beside a base keep their responses, by a second set of the same coordinates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from ...fe.dofs import ABSOLUTE, QUANTITIES
from ...model.loads.kinds import motions_of
from ...parallel.failures import InputError


def with_base_motion(reduced, quantity: str):
    """Return the model with other motions of its bases as inputs: see ReducedModel.driven_by."""
    if quantity not in QUANTITIES:
        raise InputError(f"quantity: found '{quantity}', expected one of {', '.join(QUANTITIES)}")
    moves = motions_of(reduced.record.loads) if reduced.record is not None else []
    if not moves:
        raise InputError("quantity: the model has no base that moves; reduce with [[base]] in the job")
    if hasattr(reduced, "parameters"):
        raise InputError("quantity: found a model with parameters, whose matrices these inputs change; choose their "
                         "values first")  # fmt: skip
    if any(load.integrated for load in reduced.record.loads):
        raise InputError("quantity: the inputs are no accelerations of bases any more; take the model from before")
    order = len(QUANTITIES) - 1 - QUANTITIES.index(quantity)
    if not order:
        return reduced
    # rows (3, r, m) of outputs to motions, and to forces; what would need derivatives of the motion is left out
    by_order, absolute = reduced.output_parts, np.array([name.startswith(ABSOLUTE) for name in reduced.output_names])
    of_motion = np.where(absolute[:, None], by_order, np.roll(by_order, order, axis=0))
    of_force = np.where(absolute[:, None], np.roll(by_order, -order, axis=0), by_order)
    kept = absolute | ~by_order[-order:].any(axis=(0, 2))
    if not kept.any():
        raise InputError(f"quantity: all outputs ({', '.join(reduced.output_names)}) would need derivatives of the "
                         f"{quantity} of the base; reduce with displacements as outputs")  # fmt: skip
    known = {
        "output_names": tuple(
            name.replace(f"{ABSOLUTE}{QUANTITIES[-1]}", f"{ABSOLUTE}{quantity}", 1)
            for name, there in zip(reduced.output_names, kept, strict=True) if there),
        "feedthrough": None if reduced.feedthrough is None else reduced.feedthrough[kept],
        "record": replace(reduced.record, loads=tuple(
            replace(load, integrated=order) if load.is_motion else load for load in reduced.record.loads)),
        "columns": None, "left_columns": None, "model": None,
    }  # fmt: skip
    B, forces = reduced.B, np.array([name not in moves for name in reduced.input_names])
    rows, frequencies, operator = of_motion[:, kept], reduced.frequencies, reduced.operator
    if forces.any():
        operator = operator.map(lambda matrix: block_diag(matrix, matrix))
        frequencies, rows = np.tile(frequencies, 2), np.concatenate([rows, of_force[:, kept]], axis=2)
        B = np.vstack([np.where(forces, 0.0, B), np.where(forces, B, 0.0)])
        known["interfaces"] = ()
    outputs = {key: part if key == "C" or part.any() else None
               for key, part in zip(("C", "Cv", "Ca"), rows, strict=True)}  # fmt: skip
    driven = replace(reduced, operator=operator, B=B, frequencies=frequencies, **outputs, **known)
    last = np.argsort(~driven.M.any(axis=0), kind="stable")  # coordinates without mass, which stand behind the others
    return driven.in_coordinates(np.eye(driven.size)[:, last], frequencies=frequencies[last])
