"""Make outputs of section forces: rows of C that take displacements to force and moment through a cut of the body.

The cut divides the nodes: a node set S on one side, all others on the other. With the rigid-body motions R_S of the
side S about a point, zero elsewhere, R_S^T K q are force and moment that the side exerts on the rest: elements whose
nodes are all in S contribute nothing, since R^T K_e = 0, so that only elements through the cut remain.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite
from typing import Literal

import numpy as np

from ...fe.dofs import SCALAR, require_dofs
from ...linalg.blocks import create_block, local_rows, real_rows, times
from ...linalg.csr import absolute
from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from ...parallel.lookup import look_up, number_over_ranks
from ...parallel.petsc import PETSc
from ...parallel.sums import anywhere
from ..interfaces.motion import numbers_of_set
from ..rigid_body.modes import rigid_motions

COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
NAME = re.compile(r"cut (.+?)(?: at ([^ :]+) ([^ :]+) ([^ :]+))?:([fm][xyz])")
ROUND_OFF = 64 * np.finfo(float).eps  # of the absolute values that add up to an entry
FORCE_FREE = 1e-6  # the same, to the digits of files: more is the force of a support


@dataclass(frozen=True, kw_only=True)
class CutOutput:
    """Outputs that are force (N) and moment (N m) which a side of a cut exerts on the rest of the body.

    Parameters
    ----------
    cut : str
        Name of the set of all nodes on one side; the elements between these and other nodes are those of the cut.
    about : tuple of three floats, optional
        Reference point of moments in m; by default the mean place of the dofs of the side that such an element has.
    component : {"all", "fx", "fy", "fz", "mx", "my", "mz"}, default "all"
        The components, in the axes of the body.

    Raises
    ------
    InputError
        For other components and points that are not finite.

    Notes
    -----
    The force is that of the stiffness, as stresses are. By the equations of motion of the side it is the sum of its
    loads less the forces of its inertia and damping.
    """

    cut: str
    about: tuple[float, float, float] | None = None
    component: Literal["all", "fx", "fy", "fz", "mx", "my", "mz"] = "all"

    def __post_init__(self):
        as_declared(self, "outputs.")
        if self.about is not None and not all(map(isfinite, self.about)):
            raise InputError(f"outputs.about: found {self.about}, expected three finite numbers in m")

    @property
    def components(self) -> tuple[str, ...]:
        return COMPONENTS if self.component == "all" else (self.component,)

    @property
    def names(self) -> list[str]:
        """The names as outputs: "cut TIP:fx", or "cut TIP at 0.1 0.0 0.0:fx" with a point that is given."""
        at = "" if self.about is None else f" at {' '.join(map(repr, self.about))}"
        return [f"cut {self.cut}{at}:{component}" for component in self.components]


def cut_output_of(name: str) -> CutOutput | None:
    """Return the section force that an output is by its name, or None."""
    match = NAME.fullmatch(name)
    if match is None:
        return None
    about = None if match[2] is None else tuple(map(float, match.group(2, 3, 4)))
    return CutOutput(cut=match[1], about=about, component=match[5])


def cuts_refused(model, added) -> InputError:
    """Return the error for section forces of a model with `added` terms."""
    return InputError(
        f"outputs: {model.name} has {added.plural}, and the force of a cut is that of the static stiffness alone; "
        "leave the outputs of cuts out"
    )


def cut_columns(model, cut: CutOutput) -> np.ndarray:
    """Return the rows of this rank of the columns of C^T (rows, components) of a cut.

    Collective. Raises InputError for sets that do not exist or have nodes without rows, and a side with supports.
    """
    comm, dofs, where = model.comm, require_dofs(model, "the force of a cut"), f"outputs: cut '{cut.cut}'"
    side = _side(model, cut, where)
    K = model.K if model.symmetric else model.K.transpose(PETSc.Mat())
    size = absolute(K)
    others, motions = create_block(K, 1), rigid_motions(model)
    with local_rows(others) as rows:
        rows[:, 0] = ~side & (dofs.direction != SCALAR)
    touching = real_rows(times(size, others))[:, 0] > 0  # rows with an element that has nodes of the other side
    at_cut = side & touching
    crossed = anywhere(comm, at_cut)
    # the force on each row in a rigid-body motion of all, which only supports and springs to the ground give
    forces, bound = real_rows(times(K, motions)), real_rows(times(size, _magnitudes(K, motions)))
    if crossed and anywhere(comm, (np.abs(forces) > FORCE_FREE * bound)[side]):
        raise InputError(f"{where}: this side has supports, or springs to the ground, whose forces are not those of "
                         "the cut; name the set of the nodes on the other side")  # fmt: skip
    about = cut.about
    if about is None:
        chosen = at_cut if crossed else side
        total = comm.allreduce(np.append(dofs.position[chosen].sum(axis=0), np.count_nonzero(chosen)))
        about = total[:3] / total[3]
    motions = rigid_motions(model, about)
    with local_rows(motions) as rows:
        rows[~side] = 0.0
    columns, bound = real_rows(times(K, motions)), real_rows(times(size, _magnitudes(K, motions)))
    columns[np.abs(columns) <= ROUND_OFF * bound] = 0.0
    if crossed:
        columns[side & ~touching] = 0.0  # to the digits of a file
    if not anywhere(comm, columns):
        raise InputError(f"{where}: no element connects its nodes to others or to the ground; expected the nodes on "
                         "one side of a cut through the body")  # fmt: skip
    return columns[:, [COMPONENTS.index(name) for name in cut.components]]


def _side(model, cut, where) -> np.ndarray:
    """Return which rows of this rank belong to nodes of the set (rows,). Collective. Raises InputError."""
    comm, dofs = model.comm, model.dofs
    numbers = numbers_of_set(model, cut.cut, where)
    known = look_up(comm, number_over_ranks(comm, dofs.node)[0], [], numbers)[0]
    lost = comm.allreduce(int(np.count_nonzero(~known)))
    if lost:
        raise InputError(
            f"{where}: {lost} of the {model.set_sizes[cut.cut]} nodes of the set have no row in {model.name}, since "
            "they are held or follow others; name the set of the nodes on the other side, or one without them"
        )
    return look_up(comm, numbers, [], dofs.node)[0] & (dofs.direction != SCALAR)


def _magnitudes(mat, block):
    """Return |X| of a block. Collective."""
    result = create_block(mat, 6)
    with local_rows(block) as columns, local_rows(result) as rows:
        rows[...] = np.abs(columns)
    return result
