"""Project the constant parts and the terms of a parametric model on a basis, and make models at values from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...linalg.blocks import Block, copy_of, create_block, dense, from_dense, inner, times, view_of
from ...model.operator import Operator, congruent
from ..tolerance.independent_loads import independent_columns
from ..tolerance.projections import extended
from ..tolerance.pseudo_modal import InputsOutputs, Proportional, PseudoModal, diagonalised
from .singular import factor_of_mass


class Part(NamedTuple):
    """A matrix of the affine form: its place among the factors (1, theta_1, theta_2, ...), and whether it is symmetric.
    """

    place: int
    mat: object
    symmetric: bool = True


class AffineForm:
    """The matrices of a parametric model, with the loads of all its inputs and outputs in the coordinates of a frame.

    `parts`: of M (none where it does not depend on parameters), K and D (none unless `damped`), and K_v of added
    terms as Kv1, Kv2, ..., which are constant; `loads` L: independent columns of all parts of B and C^T, of which
    `inputs` and `outputs` (None for C = B^T) are lists of (place, factor); `restore`: see FramedModel. Collective.
    """

    def __init__(self, parametric, framed, damped: bool):
        model, self.restore = parametric.model, framed.restore
        self.parametric, self.framed = parametric, framed
        terms = [(1 + k, item) for k, item in enumerate(parametric.terms)]
        symmetric = (True, *parametric.symmetric_terms)
        self.parts: dict[str, list[Part]] = {"M": [], "K": [], "D": []}
        for of, mat in (("M", model.M), ("K", model.K), ("D", model.D)):
            own = [Part(k, item.matrix, symmetric[k]) for k, item in terms if item.of == of]
            if of == "K" or (of == "M" and own) or (of == "D" and damped):
                self.parts[of] = [Part(0, mat, model.is_symmetric(of)), *own]
        self.parts |= {key: [Part(0, mat)] for key, mat in model.added.matrices.items()}
        blocks, places = [], {"B": [], "C": []}
        for of, mat in (("B", model.B), ("C", model.Ct)):
            if mat is not None:
                own = [(0, mat), *((k, item.matrix) for k, item in terms if item.of == of)]
                blocks += [self._restricted(from_dense(each)) for _, each in own]
                places[of] = [k for k, _ in own]
        self.loads, factors = independent_columns(framed.model, framed.rigid, blocks)
        count = len(places["B"])
        self.inputs = list(zip(places["B"], factors[:count], strict=True))
        self.outputs = list(zip(places["C"], factors[count:], strict=True)) or None

    def theta(self, point) -> np.ndarray:
        """Return (1, theta_1, theta_2, ...) at a point; local."""
        return np.array([1.0, *self.parametric.factors(self.values(point))])

    def values(self, point) -> dict[str, float]:
        """Return the values of the parameters at a point by name; local."""
        return dict(zip((item.name for item in self.parametric.parameters), point, strict=True))

    def io(self, theta) -> InputsOutputs:
        """Return inputs and outputs in terms of the loads; local."""
        inputs = sum(theta[k] * factor for k, factor in self.inputs)
        outputs = inputs if self.outputs is None else sum(theta[k] * factor for k, factor in self.outputs)
        return InputsOutputs(inputs, outputs, self.parametric.model.rates)

    def has_responses(self, point) -> bool:
        """Test whether factors of loads or outputs leave any response at a point; local."""
        io = self.io(self.theta(point))
        return bool(io.inputs.any() and io.outputs.any())

    def in_all_dofs(self, block: Block) -> Block:
        """Return columns in all dofs of the model, which those of the matrices are."""
        return view_of(block if self.restore is None else times(self.restore, block))

    def _restricted(self, block):
        if self.restore is None:
            return block
        result = create_block(self.framed.model.K, block.getActiveColumns()[1])
        with dense(block) as source, dense(result) as target:
            self.restore.transposeMatMult(source).copy(target)
        return result


class PointModels(NamedTuple):
    """Projections at values of the parameters on a basis that was made orthonormal there, by the upper triangular
    `turn` (m, m), so that its first columns still span what those of the basis span; `size_of_k`: the sum of the norms
    of what adds up to K. Local."""

    K: np.ndarray
    L: np.ndarray
    D: np.ndarray | None
    turn: np.ndarray
    damping: Proportional
    io: InputsOutputs
    symmetric: bool
    added: Operator
    size_of_k: float

    def model(self, count: int | None = None) -> PseudoModal:
        """Return the model of the first `count` columns, by default of all."""
        k = slice(count)
        D = None if self.D is None else self.D[k, k]
        added = self.added.map(lambda matrix: matrix[k, k])
        return diagonalised(self.K[k, k], self.L[k], D, self.damping, self.io, added, self.symmetric)


class AffineProjections:
    """Small projections of the parts of an affine form on a basis that grows, the same on all ranks.

    `small`: as the parts of the form; `L` (m, l) = V^T L; `damping`: the proportional damping of the models.
    """

    def __init__(self, form: AffineForm, basis, damping: Proportional):
        self.form, self.basis, self.damping = form, basis, damping
        self.restart()

    def restart(self):
        """Project on the whole basis. Collective."""
        self.small = {of: [np.zeros((0, 0)) for _ in parts] for of, parts in self.form.parts.items()}
        self.L = np.zeros((0, self.form.loads.getActiveColumns()[1]))
        self.extend()

    def extend(self):
        """Project on the columns of the basis that are new. Collective."""
        start, stop, form = len(self.L), self.basis.size, self.form
        if start == stop:
            return
        new = copy_of(self.basis.columns_between(start, stop), form.framed.model.K)
        self.L = np.vstack([self.L, inner(new, form.loads)])
        new, columns = form.in_all_dofs(new), form.in_all_dofs(self.basis.columns)
        for of, parts in form.parts.items():
            small = self.small[of]
            for i, part in enumerate(parts):
                small[i] = extended(small[i], part.mat, new, columns, part.symmetric)

    def turn(self, factor: np.ndarray):
        """Follow a basis V that has become V factor; local."""
        self.L = factor.T @ self.L
        self.small = {of: [congruent(part, factor) for part in parts] for of, parts in self.small.items()}

    def at(self, point) -> PointModels:
        """Return the projections at a point; local. Raises InputError where M is not positive definite."""
        theta = self.form.theta(point)
        summed = {of: found for of in self.form.parts if (found := self._sum(of, theta)) is not None}
        M, L, turn = summed.pop("M", None), self.L, np.eye(len(self.L))
        if M is not None:
            turn = np.linalg.inv(factor_of_mass(M, self.form.values(point))).T
            summed, L = {of: congruent(part, turn) for of, part in summed.items()}, turn.T @ L
        symmetric = all(part.symmetric for part in self.form.parts["K"])
        added = self.form.parametric.model.added.with_matrices(summed).added
        size = sum(abs(theta[part.place]) * np.linalg.norm(small)
                   for part, small in zip(self.form.parts["K"], self.small["K"], strict=True))  # fmt: skip
        return PointModels(
            summed["K"], L, summed.get("D"), turn, self.damping, self.form.io(theta), symmetric, added, float(size)
        )

    def _sum(self, of, theta):
        parts = self.form.parts[of]
        if not parts:
            return None
        return sum(theta[part.place] * small for part, small in zip(parts, self.small[of], strict=True))
