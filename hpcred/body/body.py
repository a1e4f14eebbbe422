"""Make a body for multibody programs from a reduced model: its floating-frame quantities and its interface nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..fe.dofs import DIRECTIONS, node_of
from ..model.loads.kinds import motions_of
from ..model.rigid_body.modes import SAME_MASS
from ..parallel.failures import InputError
from ..reduction.result.massless import require_mass
from ..reduction.result.reduced_model import ReducedModel, require_finite
from .floating_frame import FloatingFrame, floating_frame
from .geometric_stiffness import GeometricStiffness, StiffenedFrame, stiffened_node
from .node_shapes import NodeShape, interface_nodes, node_shapes
from .stress import StressModes

NO_INERTIA = 1e-12  # of the largest inertia: round-off


@dataclass
class BodySurface:
    """The drawn surface of a body: `points` (s, 3) in m, their displacements `phi` (s, 3, m), `triangles` (t, 3), and
    the numbers `nodes` (s,) of the points."""

    points: np.ndarray
    triangles: np.ndarray
    phi: np.ndarray
    nodes: np.ndarray


@dataclass
class Prestress:
    """A constant load in the stiffness of a body: its generalised `forces` (m,), spin `softening` (m, m), which is a
    part of K, and the `load` in words."""

    forces: np.ndarray
    softening: np.ndarray
    load: str = ""


@dataclass
class Body:
    """The data of a flexible body for a multibody program: plain arrays, the same on all ranks.

    Attributes
    ----------
    reduced : ReducedModel
    floating_frame : FloatingFrame
    nodes : list of NodeShape
        The interface nodes: position, displacement and rotation shapes.
    surface : Surface or None
        For pictures.
    geometric_stiffness : GeometricStiffness or None
        Stiffness by unit states of load, if it is known.
    stress : StressModes or None
        Stresses of the coordinates at nodes, if they are known.
    prestress : Prestress or None
        The preload at which `reduced` is.
    """

    reduced: ReducedModel
    floating_frame: FloatingFrame
    nodes: list[NodeShape]
    surface: BodySurface | None = None
    geometric_stiffness: GeometricStiffness | None = None
    stress: StressModes | None = None
    prestress: Prestress | None = None

    def __post_init__(self):
        if self.geometric_stiffness is not None:
            self.geometric_stiffness.check(self.reduced.size, self.floating_frame.origin)

    def stiffened(self) -> Body:
        """Return the body with displacements of second order in floating frame and nodes, if its geometric stiffness is
        known."""
        stiffness = self.geometric_stiffness
        if stiffness is None:
            return self
        return replace(
            self, floating_frame=StiffenedFrame(self.floating_frame, stiffness),
            nodes=[stiffened_node(node, stiffness) for node in self.nodes],
        )  # fmt: skip

    def number(self, node) -> int:
        """Return the number of a `node` that is given by number or name. Raises InputError for an unknown name."""
        return number_of(self.nodes, node)


def number_of(shapes, node) -> int:
    """Return the number of a node that is given by number or by the name of a NodeShape. Raises InputError."""
    if not isinstance(node, str):
        return int(node)
    names = {shape.name: shape.node for shape in shapes if shape.name}
    if node not in names:
        known = f"its interfaces are {', '.join(names)}" if names else "no node of the body has a name"
        raise InputError(f"node '{node}': no interface of this name; {known}")
    return names[node]


def body_of(
    model, reduced: ReducedModel, nodes=None, origin=(0.0, 0.0, 0.0), lumped=False, geometric_stiffness=None
) -> Body:
    """Return the Body of a model and its reduced model. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The full model, with nodes.
    reduced : ReducedModel
        What `reduce` returned for it, before close().
    nodes : iterable of int, optional
        Numbers of the interface nodes; by default those of the inputs and outputs.
    origin : array_like, shape (3,), default (0, 0, 0)
        Origin of the body frame in m.
    lumped : bool, default False
        Integrals with lumped masses, as of `floating_frame`.
    geometric_stiffness : GeometricStiffness, optional
        Of the same basis and origin.

    Raises
    ------
    InputError
        Without node coordinates, without a basis, after a two-sided projection, and for a node that does not exist.
    """
    if reduced.columns is None:
        raise InputError(f"{model.name}: the basis of the reduced model is closed; take its body before close()")
    if reduced.left_columns is not None:
        raise InputError(
            f"{model.name}: a two-sided projection has no floating frame of reference, which needs the mass matrix of "
            "the displacements V; reduce with projection = 'one_sided'"
        )
    nodes = interface_nodes(model) if nodes is None else list(nodes)
    return Body(
        reduced,
        floating_frame(model, reduced.columns, origin, lumped, reduced.M),
        node_shapes(model, reduced.columns, nodes),
        geometric_stiffness=geometric_stiffness,
    )


def check_moving(body: Body, where: str, laws=False):
    """Raise InputError unless the body can be used in time by `where` (such as "a SID file").

    It needs viscous damping, mass for every coordinate and in all directions, no rigid-body motion in its basis, and no
    added terms unless there is a place for their `laws`.
    """
    require_finite(body.reduced)
    require_mass(body.reduced, where)
    check_viscous(body.reduced, where)
    if not laws:
        require_no_laws(body.reduced, where)
    masses = body.floating_frame.masses
    missing = [name for name, mass in zip("xyz", masses, strict=True) if mass <= 0]
    if missing:
        raise InputError(
            f"the body has no mass in {' and '.join(missing)}, where no node can move, so its inertia is not known; "
            f"{where} needs all three directions: give the model its dofs in {' and '.join(missing)}, or take the "
            "arrays by format 'npz'"
        )
    check_elastic(body)


def check_viscous(reduced, where: str):
    """Raise InputError for a model with structural damping, which `where` (such as "a SID file") cannot contain."""
    if reduced.loss_factor:
        raise InputError(
            f"damping: structural damping (loss factor {reduced.loss_factor:g}) has no meaning in time and no place in "
            f"{where}; reduce with damping of kind 'modal' and ratio = {reduced.loss_factor / 2:g}, half the loss "
            "factor, which is the same at resonance"
        )


def require_no_laws(reduced, where: str):
    """Raise InputError for a model with added terms, which `where` (such as "a SID file") cannot contain."""
    if reduced.added:
        families = " and ".join(reduced.operator.families)
        raise InputError(
            f"{families}: {where} has no place for a stiffness that depends on frequency "
            f"({reduced.added.names}); laws of kind 'maxwell' go into state spaces, FMUs and simulations, and arrays "
            "(npz, mat) hold all"
        )


def check_elastic(body: Body):
    """Raise InputError if the basis contains rigid-body motion, which the floating frame describes already."""
    reduced = body.reduced
    M = body.floating_frame.mass_matrix(np.zeros(reduced.size))
    # displacements, angles and modal coordinates have units of their own, which must not count
    sizes = np.sqrt(np.abs(np.diag(M)))
    sizes[sizes == 0] = 1.0
    M = M / np.outer(sizes, sizes)
    rest = M[6:, 6:] - M[6:, :6] @ np.linalg.pinv(M[:6, :6], rcond=1e-12) @ M[:6, 6:]
    values, vectors = np.linalg.eigh(M[6:, 6:])
    shapes = vectors / np.sqrt(values.clip(min=NO_INERTIA))
    if values.min() < NO_INERTIA or np.linalg.eigvalsh(shapes.T @ rest @ shapes).min() < 1e-9:
        advice = (
            "leave coordinates = 'interface' out of the job" if reduced.interfaces
            else "reduce with frame 'buckens' and modes from number 7, or hold the body"
        )  # fmt: skip
        raise InputError(
            f"the reduced body contains rigid-body motions (lowest pseudo-frequency {reduced.frequencies.min():.3g} "
            f"Hz), which the floating frame has already; {advice}"
        )


def has_no_inertia(body: Body) -> bool:
    """Test whether the body has no inertia about some axis, as with all masses on a line."""
    frame = body.floating_frame
    if not np.isfinite(frame.J).all() or not frame.mass:
        return False
    centre = frame.mc / frame.mass
    about_centre = frame.J - frame.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return bool(np.linalg.eigvalsh(about_centre).min() < NO_INERTIA * np.abs(frame.J).max())


def remarks(body: Body) -> list[str]:
    """Return one sentence on each approximation and each missing quantity."""
    notes, masses = [], body.floating_frame.masses
    if masses.min() < (1 - SAME_MASS) * masses.max():
        listed = ", ".join(f"{mass:.6g}" for mass in masses)
        notes.append(f"the masses in x, y, z are {listed} kg, because not all nodes move in all directions")
    integrals, _, left_out = body.floating_frame.integrals.partition("; ")
    if integrals != "consistent":
        notes.append(f"integrals quadratic in the shapes: {integrals}, an approximation")
    if left_out:
        notes.append(left_out)
    if has_no_inertia(body):
        notes.append("the body has no inertia about one of its axes, as where every mass lies on a line; hold it there")
    if body.prestress is not None and body.prestress.load:
        notes.append(f"K has the stress of the preload {body.prestress.load}")
        if body.prestress.softening.any():
            notes.append("K has the spin softening of the preload, which programs that rotate the body add themselves")
    still = [str(shape.node) for shape in body.nodes if not shape.rotates]
    if still:
        notes.append(f"no rotational dofs at nodes {', '.join(still)}: psi is zero there")
    return notes + _follow_the_frame(body) + instability(body.reduced)


def _follow_the_frame(body) -> list[str]:
    """Return remarks on interfaces whose set does not move them in some directions: their shapes are zero there."""
    record, remarks = body.reduced.record, []
    known = {} if record is None else {interface.node: interface for interface in record.interface_nodes}
    for interface in (known[shape.node] for shape in body.nodes if shape.node in known):
        still = [name for name in DIRECTIONS[:6] if name not in interface.directions]
        if still:
            remarks.append(
                f"the set of interface '{interface.name}' does not move it in {', '.join(still)}, where it follows the "
                "body frame: let no joint or force act there"
            )
    return remarks


def resultants_of(body: Body) -> np.ndarray | None:
    """Return force and moment about the origin of the body frame (p, 6) of each input at 1; None where not known."""
    resultants = body.reduced.resultants
    if resultants is None:
        return None
    return np.hstack([resultants[:, :3], resultants[:, 3:] - np.cross(body.floating_frame.origin, resultants[:, :3])])


def without_node(names) -> list[str]:
    """Return which inputs or outputs belong to no node."""
    return [name for name in names if node_of(name) is None]


def inputs_without_node(body: Body) -> list[str]:
    """Return remarks on inputs and outputs that belong to no node, which formats of nodes leave out."""
    without, record = [], body.reduced.record
    moves = motions_of(record.loads) if record is not None else []
    for kind, names in (("inputs", body.reduced.input_names), ("outputs", body.reduced.output_names)):
        if lost := [name for name in names if name in moves or node_of(name) is None]:
            without.append(f"{kind} that belong to no node are left out: {', '.join(lost)}")
    return without


def instability(reduced: ReducedModel) -> list[str]:
    """Return a remark on poles in the right half-plane, if there are any."""
    count = len(reduced.unstable_poles())
    return [f"the model is unstable: {count} poles in the right half-plane, so that motion grows in time"] * bool(count)


def maker(reduced: ReducedModel) -> str:
    """Return program and version that made the reduced model."""
    return f"hpcred {reduced.record.versions['hpcred']}" if reduced.record is not None else "hpcred"
