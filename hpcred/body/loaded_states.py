"""Compute the geometric stiffness of single states of load that the finite-element program has computed.

Stresses at integration points give K_sigma of solids by their shape functions, without a material. Differences of the
stiffness under load and without give K_sigma beside the stiffness of the displacements of the load: these are small for
axial and centrifugal loads, and for others a hundred times K_sigma, so that these are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fe.dofs import position_of_node, row_of, target_of
from ..fe.element_rows import ValuesAtRows, element_rows
from ..fe.element_rules import UNIFORM, Rule
from ..fe.materials import NUMBER
from ..fe.point_stresses import PointStresses
from ..linalg.blocks import real_rows, times
from ..model.interfaces.nodes import find_interface, node_number
from ..model.rigid_body.modes import rigid_body_quantities, rigid_motions
from ..model.rotation import spin_softening
from ..model.units import units_of
from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from ..parallel.lookup import look_up
from ..parallel.petsc import PETSc
from ..parallel.ranges import Number
from ..parallel.sums import summed
from ..reduction.run.projection import project
from .geometric_stiffness import ACCELERATIONS, SIX, check_state
from .stress_stiffness import node_stiffness, projected
from .unit_states import unit_loads

AXIAL = 0.02  # sine of the angle, and offset in radii of gyration, up to which a load counts as axial
SLENDER = 0.2  # of the other moments of inertia: the largest one about the axis of a slender body
NO_CHANGE = 1e-13  # ||K - K'|| / ||K|| of the digits of files, without a load
SAME = 1e-6  # ||M - M'|| / ||M|| that digits explain
STRIDE = 8  # of keys of node and direction
NEAR = 1e-6  # of the norm of the matrix: rows that a translation loads stand beside a support
LUMPED = 0.02  # difference of forces, relative to all, that lumped masses and digits explain


@dataclass(frozen=True, kw_only=True)
class LoadedState:
    """A state of load whose stress or stiffness the finite-element program has computed.

    Parameters
    ----------
    state : str
        Such as "wz^2", "ax" or "crank:x".
    value : float
        Of the state in that run, in SI: 1e4 for 100 rad/s of "wz^2".
    stresses : str, optional
        File of CalculiX with the stresses of all solids at their integration points: *EL PRINT with S.
    file : str, optional
        Model under the load, with K of the loaded state: an export or a model.h5; or the .full file of a buckling
        analysis of ANSYS, with the stiffness of the stress. Exactly one of `stresses` and `file`.
    opposite : str, optional
        The same under the opposite load, which takes the even part of the change of K out.
    matrix : str, optional
        Name of a matrix of `file` that is the stiffness of the stress itself, as Nastran's KDGG.
    units : str, optional
        Units of these files, such as "mm,t,s"; by default those from which the model was converted.
    spin_softening : bool, default True
        Whether K of a centrifugal state contains spin softening, as that of CalculiX does.

    Raises
    ------
    InputError
        For unknown states, a value of 0 or of a square below 0, and both files or none.
    """

    state: str
    value: Number
    stresses: str | None = None
    file: str | None = None
    opposite: str | None = None
    matrix: str | None = None
    units: str | None = None
    spin_softening: bool = True

    def __post_init__(self):
        as_declared(self, "geometric_stiffness.")
        check_state(self.state)
        if self.units is not None:
            units_of(self.units)
        if not self.value or (self.value < 0 and self.state.endswith("^2")):
            raise InputError(
                f"geometric_stiffness.value: found {self.value:g}, expected the value of the state '{self.state}' in "
                "the loaded run"
            )
        if (self.stresses is None) == (self.file is None):
            raise InputError("geometric_stiffness: expected one of `stresses` and `file`, found both or neither")
        for key in ("opposite", "matrix"):
            if getattr(self, key) is not None and self.file is None:
                raise InputError(f"geometric_stiffness.{key}: belongs to `file`; leave it out")
        if self.matrix is not None and self.opposite is not None:
            raise InputError("geometric_stiffness.opposite: the stiffness of the stress needs none; leave it out")


def stiffness_of_stresses(model, columns, element, point, stress, name) -> np.ndarray:
    """Return V^T K_sigma V (m, m) of printed stresses.

    `element`, `point` (r,) from 1, and `stress` (r, 6) in Pa, xx, yy, zz, xy, yz, zx, of some integration points; those
    of all ranks belong to all solids of the model. `name` of the file, for messages. Collective. Raises InputError for
    stresses of another mesh.
    """
    if model.properties is None:
        raise InputError(f"{name}: the elements of {model.name} have no numbers; convert it from its input file")
    count = int(np.diff(columns.getActiveColumns())[0])
    total, stresses = np.zeros((1, count, count)), PointStresses(model.comm, element, point, stress, name, model.name)
    for kind, cells in element_rows(model).items():
        number = model.properties.table[kind][:, NUMBER]
        shapes = ValuesAtRows(model, cells.rows).of(columns)
        for scheme, mine, sigma in stresses.of_elements(kind, number, cells.placed):
            rule = UNIFORM if (kind, scheme) == ("hexahedron", "reduced") else Rule(scheme)
            matrices = node_stiffness(kind, rule, cells.position[mine], sigma[..., None])
            total += projected(matrices, shapes[mine])
    stresses.require_all()
    return _symmetric(model, summed(model.comm, total)[0])


def stiffness_of_difference(model, columns, state: LoadedState, loaded, opposite=None) -> np.ndarray:
    """Return V^T (K' - K) V (m, m) of K' under a load, or half the difference of those of opposite loads.

    `loaded`, `opposite`: models under load, with the rows of `model`; with state.matrix K' is the stiffness of the
    stress itself. Collective. Raises InputError for other rows or masses, and for loads that are not axial or
    centrifugal.
    """
    if state.matrix is None:
        require_axial(model, state.state)
    for other, name in ((loaded, state.file), (opposite, state.opposite)):
        if other is not None:
            _require_rows(model, other, name)
            _require_alike(model, other.M, model.M, name, "mass")
    if state.matrix is not None:
        return _symmetric(model, project(_alike_distributed(model, loaded.K), columns))
    change = _alike_distributed(model, loaded.K)
    change.axpy(-1.0, model.K if opposite is None else _alike_distributed(model, opposite.K))
    if opposite is not None:
        change.scale(0.5)
    if change.norm(PETSc.NormType.FROBENIUS) <= NO_CHANGE * model.K.norm(PETSc.NormType.FROBENIUS):
        raise InputError(
            f"{state.file}: found the K of {state.opposite or model.name}, expected that under the load "
            f"'{state.state}'; let the program write K of a step behind the loaded one"
        )
    axis = "xyz".find(state.state[1]) if state.state.endswith("^2") else -1
    if axis >= 0 and state.spin_softening:
        spin = np.zeros(3)
        spin[axis] = np.sqrt(state.value)
        change.axpy(-1.0, spin_softening(model, spin))
    return _symmetric(model, project(change, columns))


def stiffness_of_stress(model, columns, state: LoadedState, stressed, elastic: PETSc.Mat) -> np.ndarray:
    """Return V^T K_sigma V (m, m) of a state; its K_sigma, whose sign is not known, is the K of `stressed`.

    `elastic`: K of the same file. Collective. Raises InputError for other rows or another K than those of `model`, and
    for a matrix that is not in equilibrium with the state.
    """
    _require_rows(model, stressed, state.file)
    _require_alike(model, elastic, model.K, state.file, "stiffness")
    stiffness = _alike_distributed(model, stressed.K)
    sign = sign_of_stress_stiffness(model, stiffness, state.state, state.value, state.file)
    return sign * _symmetric(model, project(stiffness, columns))


def require_state(model, state):
    """Raise InputError for a force at a node or interface that the model does not have. Collective."""
    target = target_of(state)
    if isinstance(target, tuple) and find_interface(model, node_number(model, target[0])) is None:
        row_of(model, target)


def require_axial(model, state):
    """Raise InputError for states whose difference of matrices is no geometric stiffness. Collective."""
    if state.endswith("^2"):
        return
    why = (
        f"geometric_stiffness: '{state}': a difference of matrices holds the stiffness of the displacements of the "
        "load too, which couples stretching and bending and is a hundred times that of the stress unless the load is "
        "axial or centrifugal; take the stresses of the finite-element program (`stresses`)"
    )
    target = target_of(state)
    direction = state[1] if state in ACCELERATIONS else target[1] if isinstance(target, tuple) else ""
    if direction not in SIX[:3] or (state not in ACCELERATIONS and not isinstance(target, tuple)):
        raise InputError(why)
    body = rigid_body_quantities(model)
    values, axes = np.linalg.eigh(body.inertia)
    along = np.eye(3)["xyz".index(direction)]
    axial = values[0] < SLENDER * values[1] and np.linalg.norm(np.cross(along, axes[:, 0])) < AXIAL
    if axial and state not in ACCELERATIONS:
        known = {interface.name: np.array(interface.position) for interface in model.interfaces}
        place = known[target[0]] if target[0] in known else position_of_node(model, int(target[0]))
        radius = np.sqrt(values[2] / body.mass)
        axial = np.linalg.norm(np.cross(place - body.centre, along)) < AXIAL * radius
    if not axial:
        raise InputError(why)


def _require_rows(model, other, name):
    """Raise InputError unless a model has the rows of another. Collective."""
    if other.size != model.size or other.digest_of("labels") != model.digest_of("labels"):
        raise InputError(
            f"{name}: found {other.size} rows, expected the {model.size} rows of {model.name} with the same nodes and "
            "directions: it is the stiffness of another mesh, or of other supports"
        )


def _alike_distributed(model, matrix) -> PETSc.Mat:
    """Return a new matrix of which each rank has the rows that it has of the model. Collective."""
    first, last = model.K.getOwnershipRange()
    if all(model.comm.allgather(matrix.getOwnershipRange() == (first, last))):
        return matrix.copy()  # of which createSubMatrix returns the matrix itself
    rows = PETSc.IS().createStride(last - first, first, 1, comm=matrix.comm)
    return matrix.createSubMatrix(rows, rows)


def _require_alike(model, matrix, own, name, kind):
    """Raise InputError unless a matrix is the `own` mass or stiffness of the model. Collective."""
    change = _alike_distributed(model, matrix)
    change.axpy(-1.0, own)
    difference = change.norm(PETSc.NormType.FROBENIUS) / own.norm(PETSc.NormType.FROBENIUS)
    if not difference <= SAME:
        raise InputError(
            f"{name}: found another {kind} matrix than that of {model.name} (by {difference:.1e}), expected the same: "
            "it is of another mesh, or in other units"
        )


def _symmetric(model, matrix):
    """Return the symmetric part, the same on all ranks."""
    return model.comm.bcast((matrix + matrix.T) / 2)


# Tell by the equilibrium of a state of load whether a matrix is the stiffness of its stress, and of which sign.
# A small rotation of the whole body turns its stress, and so the nodal forces f that the stress holds: at each node
# K_sigma (theta x r) = theta x f, for any element, and K_sigma is zero for translations. At nodes beside a support,
# whose columns are missing, neither holds; these are found by the translations.


def sign_of_stress_stiffness(model, stiffness: PETSc.Mat, state: str, value: float, name) -> float:
    """Return 1 for the stiffness (n, n) of the stress of a state of load with a value, and -1 for its opposite.

    `name` of its file, for messages. Collective. Raises InputError for a matrix of another state or value.
    """
    target = target_of(state)
    loads, names = unit_loads(model, np.zeros(3), [target[0]] if isinstance(target, tuple) else [])
    force = value * loads[:, names.index(state)]
    held = real_rows(times(stiffness, rigid_motions(model)))  # (rows, 6)
    dofs = model.dofs
    moved = dofs.direction < 3
    key = STRIDE * dofs.node.astype(np.int64) + dofs.direction
    others = np.where(moved[:, None], key[:, None] - dofs.direction[:, None] + np.arange(3), 0)
    there, (forces,) = look_up(model.comm, key, [force], others.ravel())
    there, forces = there.reshape(-1, 3), forces.reshape(-1, 3)
    inside = moved & there.all(axis=1)
    inside &= np.abs(held[:, :3]).max(axis=1) <= NEAR * stiffness.norm(PETSc.NormType.INFINITY)
    turned = np.cross(np.eye(3)[None], forces[inside, None])  # (rows, 3, 3): of each theta, all components
    wanted = np.take_along_axis(turned, dofs.direction[inside, None, None].astype(np.int64), axis=2)[..., 0]
    actual = held[inside, 3:]
    sums = [(actual * wanted).sum(), (wanted**2).sum(), (actual**2).sum()]
    both, square, of_given = model.comm.bcast(summed(model.comm, np.array(sums)))
    sign = 1.0 if both > 0 else -1.0
    left = max(of_given - 2 * sign * both + square, 0.0)
    if not square or not left <= LUMPED**2 * square:
        how = f"{np.sqrt(left / square):.1e} of its forces are left" if square else "its forces act on supports only"
        raise InputError(
            f"{name}: found a stiffness of stress that is not in equilibrium with the state '{state}' of {value:g} "
            f"({how}), expected that of its stress on the supports of {model.name}; check state, value and units"
        )
    return sign
