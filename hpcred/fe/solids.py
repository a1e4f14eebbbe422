"""Find the solid elements of a model whose stresses follow from displacements of nodes, with their types and materials.

Of other elements, and where a material is not known, a stress is refused by name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..linalg.blocks import create_block, local_rows, real_rows, times
from ..parallel.failures import InputError
from ..parallel.lookup import look_up, number_over_ranks
from ..parallel.sums import anywhere, joined
from .dofs import require_dofs
from .element_rows import ValuesAtRows, node_rows
from .element_rules import UNIFORM, Rule, rule_of
from .materials import MATERIAL, TYPE, Material
from .shape_functions import SOLIDS
from .strain_matrices import SHEAR, elasticity, nodal_stress_matrices, strain_matrices

SAME_FORCE = 1e-2  # of the forces of the elements at a node: a larger difference from those of K is said
AT_ONCE = 2**22  # numbers of the matrices of elements that are held at a time
BY_PROGRAM = "let the finite-element program compute the stresses (`hpcred recover --deck`)"
NO_NODES, NO_TABLE = np.zeros(0, np.int64), np.zeros((0, 3), np.int64)


@dataclass(frozen=True)
class Group:
    """Elements of one type and material of this rank: local nodes (e, k), places in those of a Solids."""

    kind: str
    rule: Rule
    material: Material
    nodes: np.ndarray

    @cached_property
    def elastic(self) -> np.ndarray:
        return elasticity(self.material.young, self.material.poisson)

    def pieces(self) -> Iterator[np.ndarray]:
        """Yield the nodes (some, k) of some elements at a time, as memory allows."""
        step = max(1, AT_ONCE // (18 * self.nodes.shape[1] ** 2))
        for low in range(0, len(self.nodes), step):
            yield self.nodes[low : low + step]


class Solids:
    """The solid elements of a model that give the stresses of nodes: of all nodes of solids, or of chosen ones.

    Collective. Raises InputError for a model or nodes without them, and for types and materials of elements whose
    stresses cannot be computed from displacements of nodes.

    `groups` of the elements of this rank; `number` (l,) of their nodes, `position` (l, 3), `rows` (l, 3) as of
    element_rows; `wanted` (l,): whether the stress of the node is asked for.
    """

    def __init__(self, model, nodes: Iterable[int | str] | None = None):
        # elements that touch a wanted node
        require_dofs(model, "a stress")
        self.model, self.remarks = model, []
        cells = {kind: np.asarray(table, np.int64) for kind, table in model.elements.items()
                 if kind in (*SOLIDS, "pyramid")}  # fmt: skip
        self._require_solids(cells)
        inside = self._elements_at(cells, nodes)
        keys = self._types(cells, inside)
        # their nodes as local indices, places and rows
        chosen = {kind: cells[kind][mask] for kind, mask in inside.items()}
        every = np.concatenate([NO_NODES, *(nodes_of_kind.ravel() for nodes_of_kind in chosen.values())])
        self.number, place = np.unique(every, return_inverse=True)
        self.position, self.rows = node_rows(model, self.number)
        self.wanted = self._wanted(self.number)
        # elements of one kind, rule and material together, without those whose nodes have no place
        self.groups, start = [], 0
        for kind, nodes_of_kind in chosen.items():
            local = place.reshape(-1)[start : start + nodes_of_kind.size].reshape(nodes_of_kind.shape)
            start += nodes_of_kind.size
            table = model.properties.table.get(kind, NO_TABLE)[inside[kind]]
            placed = np.isfinite(self.position[local]).all(axis=(1, 2))
            for type_, material in sorted((t, m) for k, t, m in keys if k == kind):
                mine = (table[:, TYPE] == type_) & (table[:, MATERIAL] == material) & placed
                rule = rule_of(model.properties.program, model.properties.types[type_], kind)
                self.groups.append(Group(kind, rule, model.properties.materials[material], local[mine]))
        self._require_places()

    def _require_solids(self, cells):
        """Refuse a model without solids, or without their types and materials."""
        model = self.model
        if not anywhere(model.comm, [len(table) for table in cells.values()]):
            there = ", ".join(sorted(set().union(*model.comm.allgather(set(model.elements))))) or "no elements"
            raise InputError(
                f"{model.name}: stress: found {there}, expected solids ({', '.join(SOLIDS)}); of other elements "
                + BY_PROGRAM
            )
        if model.properties is None:
            raise InputError(
                f"{model.name}: stress: found elements whose types and materials are not known; convert the model from "
                f"its input file, give it a material in Python (with_material), or {BY_PROGRAM}"
            )

    def _elements_at(self, cells, nodes) -> dict[str, np.ndarray]:
        """Return which elements (e,) of each kind have a wanted node."""
        model, self._chosen = self.model, None
        if nodes is None:
            return {kind: np.ones(len(table), bool) for kind, table in cells.items()}
        nodes = [nodes] if isinstance(nodes, (int, str)) else list(nodes)
        numbers = [np.array([int(node) for node in nodes if not isinstance(node, str)], np.int64)]
        known = model.set_sizes
        for name in (node for node in nodes if isinstance(node, str)):
            if name not in known:
                raise InputError(f"stress: {model.name} has no node set '{name}'; it has {', '.join(known) or 'none'}")
            numbers.append(model.sets.get(name, NO_NODES))
        self._chosen, _ = number_over_ranks(model.comm, np.concatenate(numbers))
        inside = {}
        for kind in sorted(set().union(*model.comm.allgather(set(cells)))):
            table = cells.setdefault(kind, np.zeros((0, 1), np.int64))
            inside[kind] = self._wanted(table.ravel()).reshape(table.shape).any(axis=1)
        touched = np.unique(np.concatenate([NO_NODES, *(cells[kind][mask].ravel() for kind, mask in inside.items())]))
        touched_here = np.intersect1d(numbers[0], touched).tolist()
        if lacking := set(numbers[0].tolist()).difference(*model.comm.allgather(touched_here)):
            raise InputError(f"stress: node {min(lacking)} of {model.name} belongs to no solid element; choose another")
        if not anywhere(model.comm, len(touched)):
            raise InputError(f"stress: no node of {', '.join(map(str, nodes))} belongs to a solid element")
        return inside

    def _wanted(self, numbers) -> np.ndarray:
        """Return which of these nodes are asked for. Collective."""
        if self._chosen is None:
            return np.ones(len(numbers), bool)
        return look_up(self.model.comm, self._chosen, [], numbers)[0]

    def _types(self, cells, inside) -> set[tuple[str, int, int]]:
        """Return kind, type and material of the elements of all ranks, refused where there is no rule or material."""
        model, properties = self.model, self.model.properties
        mine = set()
        for kind, mask in inside.items():
            pairs = properties.table.get(kind, NO_TABLE)[mask][:, [TYPE, MATERIAL]]
            mine |= {(kind, *pair) for pair in np.unique(pairs, axis=0).tolist()}
        keys = set().union(*model.comm.allgather(mine))
        for kind, type_, material in sorted(keys):
            name = properties.types[type_]
            if rule_of(properties.program, name, kind) is None:
                raise InputError(
                    f"{model.name}: stress: found elements {name} of {properties.program} ({kind}), whose stresses "
                    f"are not those of the displacements of their nodes alone, or not known to be; {BY_PROGRAM}, or "
                    "choose nodes of other elements"
                )
            if material < 0 or not properties.materials[material].isotropic:
                known = None if material < 0 else properties.materials[material]
                what = f"of the material '{known.name}' ({known.reason})" if known else "without a material"
                raise InputError(
                    f"{model.name}: stress: found elements {name} {what}, expected Young's modulus and Poisson's "
                    f"ratio; give them in Python (with_material), or {BY_PROGRAM}"
                )
        return keys

    def _require_places(self):
        """Note elements with nodes that have no displacement; refused where there are no others."""
        comm = self.model.comm
        kept = comm.allreduce(sum(len(group.nodes) for group in self.groups))
        lost, _ = number_over_ranks(comm, self.number[~np.isfinite(self.position).all(axis=1)])
        lost = comm.allreduce(len(lost))
        if not kept:
            raise InputError(
                f"{self.model.name}: stress: found only elements with nodes that have no row, as those of rigid "
                f"bodies; {BY_PROGRAM}"
            )
        if lost:
            self.remarks.append(
                f"stress: elements at {lost} nodes that have no row, as nodes that follow others in a rigid body or "
                "coupling, are left out"
            )

    def used(self) -> np.ndarray:
        """Return which nodes (l,) are asked for and belong to an element with stresses."""
        used = np.zeros(len(self.number), bool)
        for group in self.groups:
            used[group.nodes] = True
        return used & self.wanted

    def sums(self, field: np.ndarray) -> np.ndarray:
        """Return the sums (l, 6, c) over the elements of this rank of the stresses at their nodes, for displacements
        `field` (l, 3, c)."""
        total = np.zeros((len(self.number), 6, field.shape[2]))
        for group in self.groups:
            for nodes in group.pieces():
                matrices = nodal_stress_matrices(group.kind, group.rule, self.position[nodes], group.elastic)
                size = nodes.shape[1]
                moved = field[nodes].reshape(len(nodes), 3 * size, -1)
                stress = matrices.reshape(len(nodes), 6 * size, 3 * size) @ moved
                at = csr_array((np.ones(nodes.size), nodes.ravel(), np.arange(nodes.size + 1)),
                               (nodes.size, len(self.number)))  # fmt: skip
                total += (at.T @ stress.reshape(nodes.size, -1)).reshape(total.shape)
        return total

    def warnings(self) -> list[str]:
        """Return the remarks, with a sentence on wanted nodes where the forces of their elements are not those of K.

        Uniform strains tell of elements that are missing, as beside supports, and of other elements, not of hourglass
        stiffness. Collective.
        """
        # uniform strains about the middle of the body, zero at held dofs
        model, dofs = self.model, self.model.dofs
        moved = np.flatnonzero(dofs.direction < 3)
        middle = model.comm.allreduce(dofs.position[moved].sum(axis=0)) / model.comm.allreduce(len(moved))
        fields = create_block(model.K, 6)
        with local_rows(fields) as rows:
            rows[...] = 0.0
            for column, (a, b) in enumerate((*((k, k) for k in range(3)), *SHEAR)):
                for at, along in {(a, b), (b, a)}:
                    chosen = moved[dofs.direction[moved] == at]
                    rows[chosen, column] = dofs.position[chosen, along] - middle[along]
        of_K = real_rows(times(model.K, fields))
        # the forces of the elements, their sizes, and whether they are to be compared, at rows of wanted nodes
        at_rows = ValuesAtRows(model, self.rows)
        forces = at_rows.added(self._forces(at_rows.of(fields)))
        of_elements, size, judged = forces[:, :6], forces[:, 6:12].sum(axis=1), forces[:, 12] > 0
        judged &= forces[:, 13] == 0
        size = np.where(size > 0, size, 1.0)
        # another material throughout, whose forces are in one proportion, is no matter of missing elements
        sums = (of_elements[judged] * of_K[judged]).sum(), (of_K[judged] ** 2).sum()
        both, whole = model.comm.allreduce(np.array(sums))
        apart = np.abs(of_elements - (both / whole if whole > 0 else 1.0) * of_K).max(axis=1, initial=0.0) / size
        if not anywhere(model.comm, judged & (apart > SAME_FORCE)):
            return list(self.remarks)
        off = np.abs(of_elements - of_K).max(axis=1, initial=0.0) / size
        bad, worst = judged & (off > SAME_FORCE), []
        if bad.any():
            row = int(np.where(judged, off, 0.0).argmax())
            worst = [(float(off[row]), int(dofs.node[row]), len(np.unique(dofs.node[bad])))]
        if not (worst := joined(model.comm, worst)):
            return list(self.remarks)
        count = sum(nodes for *_, nodes in worst)
        error, node, _ = max(worst, key=lambda of_rank: of_rank[0])
        return [*self.remarks, (
            f"stress: the forces of the solid elements of {model.name} are not those of K at {count} "
            f"node{'s' * (count > 1)}, most at node {node} (by {min(error, 1.0):.0%}): elements are missing "
            "there, as beside supports, or K has springs or other elements; where elements are missing the stress is "
            "that of the others"
        )]

    def _forces(self, field) -> np.ndarray:
        """Return the forces (l, 3, 6) of the elements of this rank for displacements `field` (l, 3, 6), their sizes,
        whether a node is wanted, and whether it has hourglass stiffness beside a support: (l, 3, 14).

        The size is the sum of the absolute forces, of each element at least a tenth of its largest: uniform strains of
        straight tetrahedra with ten nodes have none at the corners, where round-off would be compared with round-off.
        """
        total = np.zeros((len(self.number), 3, 14))
        for group in self.groups:
            for nodes in group.pieces():
                B, volumes = strain_matrices(group.kind, group.rule, self.position[nodes])
                moved = field[nodes].reshape(len(nodes), B.shape[3], 6)
                forces = np.einsum("eg,egia,ij,egjb,ebc->eac", volumes, B, group.elastic, B, moved, optimize=True)
                forces = forces.reshape(*nodes.shape, 3, 6)
                size = np.abs(forces)
                size = np.maximum(size, 0.1 * size.max(axis=(1, 2), keepdims=True))
                held = (self.rows[nodes] < 0).any(axis=(1, 2)) & (group.rule == UNIFORM)
                np.add.at(total, nodes, np.concatenate([
                    forces, size, np.broadcast_to(self.wanted[nodes][..., None, None], (*nodes.shape, 3, 1)),
                    np.broadcast_to(held[:, None, None, None], (*nodes.shape, 3, 1)),
                ], axis=3))  # fmt: skip
        return total

    def counts(self) -> np.ndarray:
        """Return how many elements (l,) of this rank give a stress at each node."""
        return sum((np.bincount(group.nodes.ravel(), minlength=len(self.number)) for group in self.groups),
                   np.zeros(len(self.number), int))  # fmt: skip

    def energies(self, field: np.ndarray) -> np.ndarray:
        """Return u^T K u (c,) in J of the elements of this rank, for displacements `field` (l, 3, c)."""
        total = np.zeros(field.shape[2])
        for group in self.groups:
            for nodes in group.pieces():
                B, volumes = strain_matrices(group.kind, group.rule, self.position[nodes])
                strain = np.einsum("egia,eac->egic", B, field[nodes].reshape(len(nodes), B.shape[3], -1), optimize=True)
                total += np.einsum("eg,egic,ij,egjc->c", volumes, strain, group.elastic, strain, optimize=True)
        return total
