"""Read and write result.h5: a reduced model, its body and its basis.

attributes: format, version; loss_factor of structural damping
reduced/M, D, K (m, m), B (m, p), C (r, m), frequencies (m) in Hz, input_names, output_names; where not zero also Cv,
    Ca, and feedthrough (r, p), what outputs have of the inputs themselves
reduced/viscoelastic/K (v, m, m): of terms c(s) K_v that are added; reduced/viscoelastic/laws: JSON, names and laws
reduced/resultants (p, 6): force in N and moment about the origin in N m of each input, of a model with nodes
reduced/interfaces/name, node (k), position (k, 3): in interface coordinates, the nodes whose displacements come first
basis/V (m, n), one row a basis vector in the dofs of the full model (basis/W: the left one of a two-sided projection)
basis/stress (m, s, 6), where asked for: xx, yy, zz, xy, yz, zx in Pa of each basis vector at the nodes
    basis/stress_node (s); basis/stress_source: how they were made
dofs/node (n), dofs/direction (n) 0..5, dofs/position (n, 3) in m; elements/<kind> (elements, nodes), held/,
    sets/<name>, as in model.h5
floating_frame/: the quantities of body.floating_frame, for a one-sided basis of a model with nodes
interface/node (k), name (k), position (k, 3), phi (k, 3, m), psi (k, 3, m), rotates (k): displacements
phi q and rotations psi q of each node, which rotates where it has rotations
geometric_stiffness/state (s), matrices (s, m, m), origin (3): stiffness by unit states of load, see
    body.geometric_stiffness
parameters/name, unit (w), range (w, 2), reference (w): of a model that depends on parameters, at whose reference values
    reduced/ is; parameters/constant/M, D, K, B, C, Cv, Ca: as in reduced/, without terms; parameters/terms/of,
    factor (o): the matrices that terms add to, and their factors; parameters/terms/M, D, K, B, C (k, ., .): the
    matrices of the terms of each, in their order
record: JSON of reduction.result.record.Record
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ..body.body import Body, BodySurface, Prestress, body_of, number_of
from ..body.floating_frame import FloatingFrame
from ..body.geometric_stiffness import GeometricStiffness
from ..body.node_shapes import NodeShape, shapes_of_rows
from ..body.preload import Preload, forces_of, reduced_at, softening_of
from ..body.stress import StressModes
from ..fe.dofs import SCALAR
from ..fe.elements import surface_triangles
from ..linalg.blocks import create_block, local_rows
from ..linalg.pencil import modes_of
from ..model.interfaces.nodes import InterfaceNode
from ..model.laws.registry import laws_of
from ..model.operator import ADDED, Term
from ..model.parameters.definitions import checked_values
from ..model.second_order_model import listed, require_model
from ..parallel.declared import adapter_of, declared
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..parallel.shares import row_range
from ..reduction.parametric.reduced import ParametricReducedModel
from ..reduction.result.parameter_accuracy import in_words
from ..reduction.result.record import Record, difference_of
from ..reduction.result.reduced_model import ReducedModel
from .checked import CHECKSUM, Array, damaged
from .hdf5 import ALSO, reading, texts, writing
from .model_file import LAWS, NODES, read_laws, sets_of, write_nodes
from .result_parameters import SCHEMA as OF_PARAMETERS
from .result_parameters import with_parameters, write_parameters

FORMAT, VERSION = "hpcred-result", 2
LABELS = ("node", "direction", "position")
ARRAYS = ("M", "D", "K", "B", "C", "frequencies")
RATES = ("Cv", "Ca", "feedthrough")  # where they are not zero
NAMES = ("input_names", "output_names")
OF_NODES = ("node", "position", "phi", "psi", "rotates")
QUANTITIES = ("masses", "mc", "J", "Ct", "Cr", "N", "S", "Me", "origin")
SCHEMA = NODES | OF_PARAMETERS | {
    **{f"reduced/{key}": Array("real", ("m", "m"), needed=True) for key in "MDK"},
    "reduced/Cv": Array("real", ("r", "m")), "reduced/Ca": Array("real", ("r", "m")),
    "reduced/feedthrough": Array("real", ("r", "p")),
    "reduced/B": Array("real", ("m", "p"), needed=True), "reduced/C": Array("real", ("r", "m"), needed=True),
    "reduced/frequencies": Array("real", ("m",), needed=True), "reduced/resultants": Array("real", ("p", 6)),
    "reduced/input_names": Array("text", ("p",), needed=True),
    "reduced/output_names": Array("text", ("r",), needed=True),
    f"reduced/{ADDED}/K": Array("real", ("v", "m", "m")), f"reduced/{ADDED}/laws": Array("text", ()),
    "reduced/interfaces/name": Array("text", ("i",)), "reduced/interfaces/node": Array("integer", ("i",)),
    "reduced/interfaces/position": Array("real", ("i", 3)),
    "basis/V": Array("real", ("m", "n")), "basis/W": Array("real", ("m", "n")),
    "basis/stress": Array("real", ("m", "s", 6)), "basis/stress_node": Array("integer", ("s",)),
    "basis/stress_source": Array("text", ()),
    "interface/node": Array("integer", ("k",)), "interface/name": Array("text", ("k",)),
    "interface/position": Array("real", ("k", 3)), "interface/phi": Array("real", ("k", 3, "m")),
    "interface/psi": Array("real", ("k", 3, "m")), "interface/rotates": Array("flag", ("k",)),
    "floating_frame/masses": Array("real", (3,)), "floating_frame/integrals": Array("text", ()),
    "geometric_stiffness/state": Array("text", ("g",)), "geometric_stiffness/origin": Array("real", (3,)),
    "geometric_stiffness/matrices": Array("real", ("g", "m", "m")),
    "record": Array("text", (), needed=True),
}  # fmt: skip
ROWS_AT_A_TIME = 2**22  # that are looked through
NO_STRESS = (
    "no stress modes; reduce with stress = true, or let the finite-element program compute the stresses "
    "(`hpcred recover --deck`)"
)
LARGE = 100_000  # dofs of a body whose surface is no longer drawn without being asked for


@dataclass
class Result:
    """What a result file contains, but for the basis, which stays in the file: see shapes().

    Attributes
    ----------
    path : Path or None
        Of the file; None for a superelement in memory, which has no basis.
    reduced : ReducedModel
        With its record.
    floating_frame : FloatingFrame or None
        None where the model had no nodes or the projection was two-sided.
    nodes : list of NodeShape
        Shapes of the interface nodes, those of the inputs and outputs.
    geometric_stiffness : GeometricStiffness or None
        None where it was not asked for.
    values : dict
        Of the parameters at which `reduced` is, as `at` sets them; empty as read, where `reduced` may have parameters.
    turn : ndarray, shape (m, m), or None
        X of the coordinates X z of the basis at `values`.
    preload, prestress : Preload and Prestress, or None
        At which `reduced` is, as `at_preload` sets it.
    stress_nodes : int
        The number of nodes with stress modes.
    stress_source : str
        How these were made.
    """

    path: Path | None
    reduced: ReducedModel
    floating_frame: FloatingFrame | None = None
    nodes: list[NodeShape] = field(default_factory=list)
    geometric_stiffness: GeometricStiffness | None = None
    values: dict[str, float] = field(default_factory=dict)
    turn: np.ndarray | None = None
    preload: Preload | None = None
    prestress: Prestress | None = None
    stress_nodes: int = 0
    stress_source: str = ""

    def __str__(self):
        return f"{self.path}: {self.reduced}"

    def body(self, nodes=None) -> Body:
        """The body with chosen interface nodes, by default those of the inputs and outputs.

        `nodes`: numbers, names of interfaces, and names of node sets for all their nodes that have dofs; where an
        interface and a set have the same name it is that of the interface. On one rank. Raises InputError where the
        file has no floating-frame quantities or no such node.
        """
        # a floating frame needs one-sided coordinates with places of nodes, and one mass
        if self.floating_frame is None:
            two_sided = getattr(self.reduced.record, "projection", None) == "two_sided"
            why = "the projection was two-sided; reduce with projection = 'one_sided'" if two_sided else (
                "the model had no node coordinates, or was not written; give them (convert --nodes FILE, or in Python "
                "dofs = hpcred.Dofs(node, direction, position)), and reduce again; of a machine take a state space, an "
                "FMU or matrices"
            )  # fmt: skip
            raise InputError(f"{self.path}: no floating-frame quantities: {why}")
        Me = self.floating_frame.Me
        if self.values and np.abs(Me - self.reduced.M).max() > 1e-6 * np.abs(Me).max():
            raise InputError(
                f"{self.path}: the mass depends on parameters, and the floating-frame quantities are those at the "
                "reference values; leave the values out, or take a format without nodes, such as a state space or FMU"
            )
        # interfaces have their shapes in the file; those of other nodes are read from the basis
        known = {shape.node: shape for shape in self.nodes}
        members = {} if nodes is None else self._members({node for node in nodes if isinstance(node, str)})
        if nodes is None:
            chosen = list(known)
        else:
            chosen = [number for node in nodes for number in members.get(node) or [number_of(self.nodes, node)]]
            chosen = list(dict.fromkeys(chosen))
        missing = [node for node in chosen if node not in known]
        if missing:
            known |= {shape.node: shape for shape in self._shapes_of_nodes(missing)}
        return Body(
            self.reduced, self.floating_frame, [known[node] for node in chosen],
            geometric_stiffness=self.geometric_stiffness, prestress=self.prestress,
        )  # fmt: skip

    def at(self, **values: float) -> Result:
        """The result at values of its parameters, in pseudo-modal coordinates of its own; those that are not named have
        their reference values. On one rank, or on all. Raises InputError for a result without parameters, names that it
        does not have, and values outside of their ranges."""
        if not isinstance(self.reduced, ParametricReducedModel):
            why_not = f"it is at {in_words(self.values)} already" if self.values else "it has no parameters"
            raise InputError(f"{self.path}: {why_not}; read a result of a job with [[parameter]] and [[term]]")
        values, X = checked_values(self.reduced.parameters, values), self.reduced.turn(values)
        return replace(
            self, reduced=self.reduced.at(**values), values=values, turn=X,
            floating_frame=self.floating_frame and self.floating_frame.in_coordinates(X),
            nodes=[node.in_coordinates(X) for node in self.nodes],
            geometric_stiffness=self.geometric_stiffness and self.geometric_stiffness.in_coordinates(X),
        )  # fmt: skip

    def at_reference(self) -> Result:
        """The result as it is in the file, with a reduced model that has no parameters."""
        return replace(self, reduced=getattr(self.reduced, "base", self.reduced))

    def at_preload(self, preload: Preload) -> Result:
        """Return the result under a constant load, `preload`, by its geometric stiffness. The states of the preload are
        in K then, and no longer in the geometric stiffness. On one rank, or on all. Raises InputError."""
        reduced = reduced_at(self.body(), preload)
        nodes = [state.rpartition(":")[0] for state in preload.forces]
        body = self.body(list(dict.fromkeys(int(node) if node.isdecimal() else node for node in nodes)))
        return replace(
            self, reduced=reduced, preload=preload,
            prestress=Prestress(forces_of(body, preload), softening_of(body, preload), preload.words),
            geometric_stiffness=self.geometric_stiffness.without(tuple(preload.values)),
        )  # fmt: skip

    def _members(self, names) -> dict[str, list[int]]:
        """The nodes with dofs of the sets of these names, those of interfaces left out. Raises InputError."""
        interfaces = [shape.name for shape in self.nodes if shape.name]
        names = names.difference(interfaces)
        if not names:
            return {}
        with reading(self.path, FORMAT, VERSION, SCHEMA) as file:
            sets = sets_of(file)
            unknown = sorted(names.difference(sets))
            if unknown:
                raise InputError(
                    f"{self.path}: node '{unknown[0]}': no interface or node set of this name; interfaces: "
                    f"{listed(interfaces)}; node sets: {listed(sorted(sets))}"
                )
            members = {name: sets[name][...] for name in names}
            wanted = np.unique(np.concatenate(list(members.values())))
            nodes = file["dofs/node"]
            starts = range(0, len(nodes), ROWS_AT_A_TIME)
            there = [np.intersect1d(nodes[low : low + ROWS_AT_A_TIME], wanted) for low in starts]
            if "held" in file:
                there.append(np.intersect1d(file["held/node"][...], wanted))
        there = np.concatenate(there)
        members = {name: numbers[np.isin(numbers, there)].tolist() for name, numbers in members.items()}
        for name, numbers in members.items():
            if not numbers:
                raise InputError(f"{self.path}: no node of the set '{name}' has dofs; choose another")
        return members

    def _shapes_of_nodes(self, nodes):
        with reading(self.path, FORMAT, VERSION, SCHEMA) as file:
            if "basis/V" not in file or "dofs" not in file:
                raise InputError(
                    f"{self.path}: node {nodes[0]} is no interface node, and the file was written without basis"
                )
            columns, dofs = file["basis/V"], file["dofs"]
            rows = np.concatenate([
                low + np.flatnonzero(np.isin(dofs["node"][low : low + ROWS_AT_A_TIME], nodes))
                for low in range(0, columns.shape[1], ROWS_AT_A_TIME)
            ])  # fmt: skip
            labels = [dofs[key][rows] for key in LABELS] if len(rows) else [np.zeros((0, *dofs[key].shape[1:]))
                                                                           for key in LABELS]  # fmt: skip
            basis = columns[:, rows].T if len(rows) else np.zeros((0, columns.shape[0]))
            if "held" in file:
                held = np.flatnonzero(np.isin(file["held/node"][...], nodes))
                labels = [np.concatenate([array, file[f"held/{key}"][...][held]])
                         for key, array in zip(LABELS, labels, strict=True)]  # fmt: skip
                basis = np.concatenate([basis, np.zeros((len(held), basis.shape[1]))])
        basis = basis if self.turn is None else basis @ self.turn
        return shapes_of_rows(nodes, *labels, basis, str(self.path))

    def basis_digest(self) -> str:
        """Digits that tell this basis from others; empty without basis, or without checksums. On one rank."""
        with reading(self.path, FORMAT, VERSION, SCHEMA) as file:
            return file["basis/V"].digest if "basis/V" in file else ""

    def surface(self) -> BodySurface | None:
        """The surface of the body, or None: without elements or basis in the file, or above LARGE dofs. On one rank."""
        with reading(self.path, FORMAT, VERSION, SCHEMA) as file:
            if "basis/V" not in file or "elements" not in file or file["basis/V"].shape[1] > LARGE:
                return None
            shapes = self._shapes(file)
            triangles = surface_triangles(shapes.cells)
            nodes, places = np.unique(triangles, return_inverse=True)
            phi = [shapes.column(column)[nodes] for column in range(self.reduced.size)]
        if not len(nodes):
            return None
        triangles = places.reshape(triangles.shape)
        return BodySurface(shapes.points[nodes], triangles, np.stack(phi, axis=-1), shapes.nodes[nodes])

    def stress_modes(self, nodes=None) -> StressModes:
        """The stress modes, of chosen nodes by number or of all, with their nodes in ascending order. On one rank.

        Raises InputError where the file has none, or not of such a node.
        """
        with reading(self.path, FORMAT, VERSION, SCHEMA) as file:
            require_stress(file, self.path)
            known = file["basis/stress_node"][...]
            order = np.argsort(known)
            wanted = known[order] if nodes is None else np.unique(np.asarray(nodes, np.int64))
            place = order[np.searchsorted(known, wanted, sorter=order).clip(max=len(known) - 1)]
            if (lacking := wanted[known[place] != wanted]).size:
                raise InputError(f"{self.path}: no stress of node {lacking[0]}; it has those of {len(known)} nodes")
            rows, back = np.unique(place, return_inverse=True)
            stress = file["basis/stress"][:, rows][:, back]
            stress = stress if self.turn is None else np.tensordot(self.turn.T, stress, axes=1)
            return StressModes(wanted, stress, file["basis/stress_source"][()].decode())

    def stress_to_export(self) -> StressModes | None:
        """The stress modes of all their nodes, or None: without any in the file, or at nodes with more than LARGE dofs.
        On one rank."""
        return self.stress_modes() if 0 < 3 * self.stress_nodes <= LARGE else None

    @contextmanager
    def shapes(self):
        """The Shapes of all columns of the basis, while the file is open. On one rank. Raises InputError."""
        with reading(self.path, FORMAT, VERSION, SCHEMA) as file:
            yield self._shapes(file)

    def _shapes(self, file):
        if self.turn is None:
            return Shapes(file, self.path)
        return Shapes(file, self.path, self.turn, self.reduced)


def require_basis(file, name):
    """Raise InputError for an open result without basis or node coordinates."""
    if "basis/V" not in file or "dofs" not in file:
        raise InputError(
            f"{name}: no basis with node coordinates; reduce a model with nodes, and with write_basis = true"
        )


def require_stress(file, name):
    """Raise InputError for an open result without stress modes."""
    if "basis/stress" not in file:
        raise InputError(f"{name}: {NO_STRESS}")


class Shapes:
    """Shapes of the columns of a basis at the nodes, read from an open file one by one.

    `nodes` (k,) their numbers, with those that are held, which do not move; `points` (k, 3) in m, `cells` by kind
    as indices of points, `names` and `frequencies` (m,) of the shapes: pseudo-modes, which the columns of the basis
    are (54), but in interface coordinates, or the basis vectors of a two-sided projection. `first`: the number of the
    first shape. `has_stress`: whether there are stress modes. `mark_names` and `mark_points` (j, 3) in m: of the
    interface nodes, which need not be among the nodes. Made of an open result file, and at values of parameters with
    the coordinates `turn` (m, m) and the ReducedModel there.
    """

    def __init__(self, file, name, turn=None, reduced=None):
        require_basis(file, name)
        self._rows = np.flatnonzero(file["dofs/direction"][...] != SCALAR)  # scalar dofs have no place
        node, self._direction = (file[f"dofs/{key}"][...][self._rows] for key in ("node", "direction"))
        position = file["dofs/position"][...][self._rows]
        if "held" in file:
            node = np.concatenate([node, file["held/node"][...]])
            position = np.concatenate([position, file["held/position"][...]])
        self.nodes, first, place = np.unique(node, return_index=True, return_inverse=True)
        self.points = position[first]
        self._place = place[: len(self._direction)]
        # columns, and what shapes are made of them
        self._basis, self._name = file["basis/V"], name
        if turn is not None:
            self._basis = turn.T @ self._basis[...]
        self._turn = turn
        self.frequencies = file["reduced/frequencies"][...] if reduced is None else reduced.frequencies
        self.has_stress, self._stress = "basis/stress" in file, file["basis"]
        kind = "basis vector" if "basis/W" in file else "pseudo-mode"
        self._mixture = self._mixed = None
        if "reduced/interfaces" in file:
            K, M = (file[f"reduced/{key}"][...] if reduced is None else getattr(reduced, key) for key in "KM")
            self._mixture = modes_of(K, M)[1]
        width = len(str(len(self.frequencies)))
        self.first = int(file.attrs.get("first_number", 1))
        self.names = [f"{kind} {k:0{width}d}: {f:.6g} Hz" for k, f in enumerate(self.frequencies, self.first)]
        # interface nodes, and elements all of whose nodes are there
        self.mark_names, self.mark_points, self._mark_phi = [], np.zeros((0, 3)), np.zeros((0, 3, len(self.names)))
        if marks := file.get("interface"):
            numbers = list(map(str, marks["node"][...].tolist()))
            named = texts(marks["name"]) if "name" in marks else numbers
            self.mark_names = [name or number for name, number in zip(named, numbers, strict=True)]
            self.mark_points, self._mark_phi = marks["position"][...], marks["phi"][...]
            self._mark_phi = self._mark_phi if turn is None else self._mark_phi @ turn
        self.cells = {}
        for key, cells in file.get("elements", {}).items():
            cells = cells[...]
            index = np.searchsorted(self.nodes, cells).clip(max=len(self.nodes) - 1)
            there = (self.nodes[index] == cells).all(axis=1)  # a frame may hold all dofs of a node
            self.cells[key] = index[there]

    def displacement(self, number) -> np.ndarray:
        """(k, 3); the translational dofs of a shape."""
        if self._mixture is None:
            return self.column(number)
        if self._mixed is None:
            self._mixed = self._mixture.T @ self._basis[...]
        return self._placed(self._mixed[number])

    def mark_displacement(self, number) -> np.ndarray:
        """(j, 3); the displacements of the interface nodes of a shape."""
        return self._mark_phi[..., number] if self._mixture is None else self._mark_phi @ self._mixture[:, number]

    def coordinates_of(self, number) -> np.ndarray:
        """(m,); the coordinates whose displacements a shape is."""
        return np.eye(len(self.frequencies))[number] if self._mixture is None else self._mixture[:, number]

    def moved(self, q) -> tuple[np.ndarray, np.ndarray]:
        """(k, 3) and (j, 3); displacements of the nodes and of the interface nodes at coordinates q (m,)."""
        columns = (amplitude * self._basis[k] for k, amplitude in enumerate(q) if amplitude)
        return self._placed(sum(columns, np.zeros(self._basis.shape[1]))), self._mark_phi @ q

    def stress(self, q) -> np.ndarray:
        """(k, 6); stresses xx, yy, zz, xy, yz, zx in Pa at coordinates q (m,), NaN at nodes without stress modes.

        Raises InputError where the file has none.
        """
        if not self.has_stress:
            raise InputError(f"{self._name}: {NO_STRESS}")
        node, modes = self._stress["stress_node"][...], self._stress["stress"]
        place = np.searchsorted(self.nodes, node).clip(max=len(self.nodes) - 1)
        there = self.nodes[place] == node
        stresses = np.full((len(self.nodes), 6), np.nan)
        q = q if self._turn is None else self._turn @ q
        stresses[place[there]] = sum(amplitude * modes[k] for k, amplitude in enumerate(q) if amplitude)[there]
        return stresses

    def column(self, number) -> np.ndarray:
        """(k, 3); the translational dofs of a column of the basis, which belongs to a coordinate."""
        return self._placed(self._basis[number])

    def _placed(self, values):
        values, moved = values[self._rows], self._direction < 3
        displaced = np.zeros((len(self.nodes), 3))
        displaced[self._place[moved], self._direction[moved]] = values[moved]
        return displaced


def write_result(
    path, reduced: ReducedModel, model=None, *, basis=True, origin=(0.0, 0.0, 0.0), lumped=False,
    geometric_stiffness: GeometricStiffness | None = None, stress: StressModes | None = None, nodes=None, more=None,
) -> None:  # fmt: skip
    """Write what `reduce` made of a SecondOrderModel. Collective.

    Parameters
    ----------
    path : str or PathLike
    reduced : ReducedModel
    model : SecondOrderModel, optional
        With it come its nodes and elements, and the quantities that multibody programs need, for which the basis of
        `reduced` must not be closed.
    basis : bool
        Write V.
    origin : sequence of 3 floats
        Of the body frame in m.
    lumped : bool
        See floating_frame.
    geometric_stiffness : GeometricStiffness, optional
        Of this basis and this origin.
    stress : StressModes, optional
        Of this basis (see stress_modes).
    nodes : NodeShapes, optional
        Of a model that is not at hand.
    more : callable, optional
        Writes into the open file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    declared("reduced", reduced, ReducedModel)
    if model is not None:
        require_model(model)
        known = reduced.record is not None and reduced.record.knows_its_model
        key = difference_of(model.digests, reduced.record) if known else None
        if key in ("M", "K"):
            raise InputError(f"model: found another {key} than that which was reduced; give the model that was")
    comm = model.comm if model is not None else reduced.columns.comm.tompi4py() if reduced.columns else MPI.COMM_WORLD
    body = None
    if model is not None and model.dofs is not None and reduced.columns is not None and reduced.left_columns is None:
        body = body_of(model, reduced, origin=origin, lumped=lumped, geometric_stiffness=geometric_stiffness)
    # the reduced model
    version = ALSO[FORMAT] if reduced.added or reduced.feedthrough is not None else VERSION
    with writing(path, comm, FORMAT, version) as file:
        file.attribute("loss_factor", reduced.loss_factor)
        file.several({f"reduced/{key}": getattr(reduced, key) for key in (*ARRAYS, *RATES, "resultants")})
        file.several({f"reduced/{key}": list(getattr(reduced, key)) for key in NAMES})
        if isinstance(reduced, ParametricReducedModel):
            write_parameters(file, reduced)
        if reduced.added:
            file.small(f"reduced/{ADDED}/K", np.array([term.matrix for term in reduced.added]))
            file.small(f"reduced/{ADDED}/laws", adapter_of(LAWS).dump_json(laws_of(reduced.added)).decode())
        if reduced.interfaces:
            file.several({f"reduced/interfaces/{key}": [getattr(entry, key) for entry in reduced.interfaces]
                          for key in ("name", "node", "position")})  # fmt: skip
        # the basis in the dofs of the full model, and stresses of its columns
        if basis and reduced.columns is not None:
            _write_basis(file, reduced, model)
            if stress is not None:
                write_stress(file, stress)
        # what multibody programs need of the body
        if body is not None:
            arrays = body.floating_frame.arrays().items()  # gaps: what a body that is held here does not show
            file.several({f"floating_frame/{key}": value for key, value in arrays}, gaps=True)
            file.small("floating_frame/integrals", body.floating_frame.integrals)
            nodes = body.nodes
        if nodes:
            file.several({f"interface/{key}": np.array([getattr(shape, key) for shape in nodes]) for key in OF_NODES})
            file.small("interface/name", [shape.name for shape in nodes])
        if more is not None:
            more(file)
        if geometric_stiffness is not None:
            geometric_stiffness.check(reduced.size, origin)
            file.several({"geometric_stiffness/state": list(geometric_stiffness.states),
                          "geometric_stiffness/matrices": geometric_stiffness.matrices,
                          "geometric_stiffness/origin": geometric_stiffness.origin})  # fmt: skip
        file.small("record", adapter_of(Record | None).dump_json(reduced.record).decode())


def _write_basis(file, reduced, model):
    for key, block in (("V", reduced.columns), ("W", reduced.left_columns)):
        if block is not None:
            with local_rows(block) as rows:
                file.rows(f"basis/{key}", np.ascontiguousarray(rows.real.T), axis=1)
    if model is not None and model.dofs is not None:
        write_nodes(file, model)


def write_stress(file, stress: StressModes):
    """Write stress modes, the nodes of all ranks, into a file that is being written. Collective."""
    file.rows("basis/stress", stress.stress, axis=1)
    file.rows("basis/stress_node", stress.node)
    file.small("basis/stress_source", stress.source)


def copy_with_stress(source, output, stress, comm):
    """Write `output`, a result with the contents of `source` and the StressModes of all ranks. Collective.

    Raises InputError for a source that is no result.
    """
    with agreed(comm), reading(source, FORMAT, VERSION, SCHEMA) as old:
        names = [name for name in old.datasets if not name.startswith("basis/stress")]
        attributes = {key: value for key, value in old.attrs.items() if key not in (CHECKSUM, "format")}
    version = int(attributes.pop("version"))
    with writing(output, comm, FORMAT, version) as file, reading(source, FORMAT, VERSION, SCHEMA) as old:
        for key, value in attributes.items():
            file.attribute(key, value)
        for name in names:
            dataset = old[name]
            if dataset.axis < 0:
                value = dataset[()]
                file.small(name, value.decode() if isinstance(value, bytes) else value, gaps=True)
            else:
                share = slice(*row_range(comm, dataset.shape[dataset.axis]))
                file.rows(name, dataset[(slice(None),) * dataset.axis + (share,)], axis=dataset.axis)
        write_stress(file, stress)


def read_result(path, comm=MPI.COMM_WORLD) -> Result:
    """Read a result on every rank, without its basis. Collective.

    Parameters
    ----------
    path : str or PathLike
    comm : MPI communicator
        By default all ranks.

    Raises
    ------
    InputError
        For a file that is no result, or damaged.
    """
    with agreed(comm), reading(path, FORMAT, VERSION, SCHEMA) as file:
        group = file["reduced"]
        try:
            # the record is text of its own, checked as settings are
            record = adapter_of(Record | None).validate_json(file["record"][()])
        except ValidationError as error:
            raise InputError(f"{path}: the record of the run is damaged: {error.errors()[0]['msg']}") from error
        # the reduced model, with parameters where the file has their terms
        reduced = ReducedModel(
            **{key: group[key][...] for key in ARRAYS},
            **{key: group[key][...] for key in (*RATES, "resultants") if key in group},
            **{key: tuple(texts(group[key])) for key in NAMES},
            interfaces=_interfaces(group["interfaces"]) if "interfaces" in group else (),
            loss_factor=file.attribute("loss_factor", float),
            record=record,
            **{ADDED: _added(group[ADDED]) if ADDED in group else ()},
        )
        result = Result(Path(path), with_parameters(file, reduced, path))
        # what a body has beside it: stresses, floating frame, geometric stiffness, shapes of nodes
        if "basis/stress" in file:
            result.stress_nodes = file["basis/stress_node"].shape[0]
            result.stress_source = file["basis/stress_source"][()].decode()
        if "floating_frame" in file:
            quantities = file["floating_frame"]
            result.floating_frame = FloatingFrame(
                **{key: quantities[key][()] for key in QUANTITIES}, integrals=quantities["integrals"][()].decode()
            )
        if "geometric_stiffness" in file:
            group = file["geometric_stiffness"]
            result.geometric_stiffness = GeometricStiffness(
                tuple(texts(group["state"])), group["matrices"][...], group["origin"][...]
            )
        if "interface" in file:
            arrays = [file[f"interface/{key}"][...] for key in OF_NODES]
            names = texts(file["interface/name"]) if "name" in file["interface"] else [""] * len(arrays[0])
            result.nodes = [
                NodeShape(int(node), position, phi, psi, bool(rotates), name)
                for node, position, phi, psi, rotates, name in zip(*arrays, names, strict=True)
            ]
        return result


def result_at(path, values: dict[str, float] | None, comm=MPI.COMM_WORLD) -> Result:
    """Read a result at values of its parameters, at the reference values without any. Collective. Raises InputError."""
    result = read_result(path, comm)
    return result.at(**values) if values else result.at_reference()


def read_basis(path, model):
    """The basis V (n, m) as a block with the rows of the model, or None where the file has none.

    Collective. Raises InputError.
    """
    with agreed(model.comm), reading(path, FORMAT, VERSION, SCHEMA) as file:
        rows_here = None
        if "basis/V" in file:
            if file["basis/V"].shape[1] != model.size:
                raise InputError(f"{path}: its basis has {file['basis/V'].shape[1]} rows, expected {model.size}")
            rows_here = file["basis/V"][:, model.first_row : model.first_row + model.local_rows].T
    if rows_here is None:
        return None
    block = create_block(model.K, rows_here.shape[1])
    with local_rows(block) as rows:
        rows[...] = rows_here
    return block


def _added(group) -> tuple[Term, ...]:
    """The added terms of a reduced model. Raises InputError."""
    laws, matrices = read_laws(group["laws"]), group["K"][...]
    if len(laws) != len(matrices):
        raise damaged(group.path, f"{group.name}: found {len(matrices)} matrices and {len(laws)} laws")
    return tuple(Term(matrix, law.law, law.name) for matrix, law in zip(matrices, laws, strict=True))


def _interfaces(group) -> tuple[InterfaceNode, ...]:
    """The nodes of interface coordinates."""
    rows = zip(texts(group["name"]), group["node"][...].tolist(), group["position"][...].tolist(), strict=True)
    return tuple(InterfaceNode(name, node, tuple(position)) for name, node, position in rows)
