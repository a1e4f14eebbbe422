"""Project the constant parts and the terms of a parametric model on a basis, and make models at values from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...linalg.blocks import Block, create_block, dense, from_dense, times, view_of
from ...model.operator import NOTHING, Operator
from ..run.independent_loads import independent_columns
from ..search.projections import Projected
from ..search.silent_outputs import QUIET, UNIT
from ..small.error_estimate import UNIFORM
from ..small.pseudo_modal import InputsOutputs, Proportional, PseudoModal, diagonalised
from .singular import factor_of_mass

KEPT = 2**24  # numbers of models at points that a rank keeps, of which
MATRICES, RESPONSES = 16, 4 * UNIFORM  # are m^2 and l^2 for m columns and l loads


class AffineForm:
    """The matrices of a parametric model, with the loads of all its inputs and outputs in the coordinates of a frame.

    `operators`: the constant one, with M unless it is the inner product of bases at all values, and with D only where
    `damped`, and that of each term, by their place among the factors 1, theta_1, theta_2, ...; `matrices` of them:
    (key, place, matrix, whether it is symmetric); `run`: that of the reference; `loads` L: independent columns of all
    parts of B and C^T, of which `inputs` and `outputs` (None for C = B^T) are lists of (place, factor); `restore`: see
    FramedModel. Collective.
    """

    def __init__(self, parametric, run, damped: bool):
        model, framed, tau, self.restore = parametric.model, run.framed, run.tau, run.framed.restore
        self.parametric, self.run, self.framed, self.tau = parametric, run, framed, tau
        terms = [(1 + k, term) for k, term in enumerate(parametric.terms)]
        left_out = {} if tau or any(term.of == "M" for term in parametric.terms) else {"M": None}
        left_out |= {} if damped else {"D": None}
        constant = model.operator.with_matrices(model.operator.matrices | left_out)
        self.operators = [constant, *(
            Operator.of(**{term.of: term.matrix}) if term.of in constant.terms else NOTHING for term in parametric.terms
        )]  # fmt: skip
        self._symmetric = [dict.fromkeys(constant.added.terms, True) | {of: model.is_symmetric(of) for of in "MDK"}]
        self._symmetric += [{term.of: is_so} for term, is_so in
                            zip(parametric.terms, parametric.symmetric_terms, strict=True)]  # fmt: skip
        self.matrices = [(key, place, mat, self.is_symmetric(place, key)) for key in constant.terms
                         for place, operator in enumerate(self.operators)
                         if (mat := operator.get(key)) is not None]  # fmt: skip
        blocks, places = [], {"B": [], "C": []}
        for of, mat in (("B", model.B), ("C", model.Ct)):
            if mat is not None:
                summands = [(0, mat), *((k, term.matrix) for k, term in terms if term.of == of)]
                blocks += [self._restricted(from_dense(each)) for _, each in summands]
                places[of] = [k for k, _ in summands]
        self.loads, factors = independent_columns(framed.model, framed.rigid, blocks)
        count = len(places["B"])
        self.inputs = list(zip(places["B"], factors[:count], strict=True))
        self.outputs = list(zip(places["C"], factors[count:], strict=True)) or None

    def is_symmetric(self, place: int, key: str) -> bool:
        """Whether a matrix of one of the operators is; local."""
        return self._symmetric[place][key]

    def theta(self, point) -> np.ndarray:
        """Return (1, theta_1, theta_2, ...) at a point; local."""
        return np.array([1.0, *self.parametric.factors(self.values(point))])

    def values(self, point) -> dict[str, float]:
        """Return the values of the parameters at a point by name; local."""
        return dict(zip((parameter.name for parameter in self.parametric.parameters), point, strict=True))

    def io(self, theta) -> InputsOutputs:
        """Return inputs and outputs in terms of the loads; local."""
        inputs = sum(theta[k] * factor for k, factor in self.inputs)
        outputs = inputs if self.outputs is None else sum(theta[k] * factor for k, factor in self.outputs)
        return InputsOutputs(inputs, outputs, self.parametric.model.rates)

    @property
    def has_mass(self) -> bool:
        """Whether M is projected, which is not the inner product of bases at all values."""
        return "M" in self.operators[0].terms

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
    `turn` (m, m), so that its first columns still span what those of the basis span; `tau`: where they are
    orthonormal in M + tau^2 K; `size_of_k`: the sum of the norms of what adds up to K; `made`: models of their first
    columns that were made. Local."""

    operator: Operator
    L: np.ndarray
    turn: np.ndarray
    damping: Proportional
    io: InputsOutputs
    symmetric: bool
    size_of_k: float
    tau: float
    made: dict[tuple, PseudoModal]

    @property
    def K(self) -> np.ndarray:
        """The stiffness (m, m)."""
        return self.operator["K"]

    def model(self, count: int | None = None) -> PseudoModal:
        """Return the model of the first `count` columns, by default of all."""
        k = slice(len(self.L) if count is None else count)
        if (key := (k.stop, self.damping)) not in self.made:
            alone = self.operator.map(lambda matrix: matrix[k, k])
            rest = alone.get("D"), self.damping, self.io, alone.added, self.symmetric
            mass = alone.get("M") if self.tau else None
            self.made[key] = diagonalised(alone["K"], self.L[k], *rest, mass, self.tau)
        return self.made[key]


class AffineProjections(Projected):
    """Projections of the operators of an affine form, of which those at values of the parameters are sums.

    `damping`: the proportional damping of the models; `limits` of quiet columns of C^T, QUIET for those that are
    `silent` at all points that were looked at; `quiet`: whether others are not silent somewhere (see InputsOutputs),
    and the `round_off` of these, by that of columns that other values of the parameters mix. Models at points are kept,
    also while the basis grows, as there is room.
    """

    def __init__(self, form: AffineForm, basis, damping: Proportional):
        self.form, self.damping = form, damping
        self.silent: set[int] | None = None
        self.quiet, self.round_off = False, 0.0
        self._limits: dict[int, float] = {}
        super().__init__(form.run, basis, form.loads, form.operators, form.is_symmetric, form.in_all_dofs)

    def note_quiet(self, columns: dict[int, tuple[float, float]]):
        """Keep what is known of quiet columns of C^T at one more point (see quiet_columns); local."""
        before = self.limits, self.quiet
        silent = {column for column, (ratio, limit) in columns.items() if ratio <= limit}
        self.silent = silent if self.silent is None else self.silent & silent
        self.quiet |= len(silent) < len(columns)
        for column, (ratio, limit) in columns.items():
            self._limits[column] = max(limit, self._limits.get(column, 0.0))
            self.round_off = max(self.round_off, UNIT / ratio if ratio > limit else 0.0)
        if (self.limits, self.quiet) != before:
            self._made.clear()

    @property
    def limits(self) -> dict[int, float]:
        """The quietness of columns of C^T below which it is round-off; local."""
        return self._limits | dict.fromkeys(self.silent or (), QUIET)

    def turn(self, factor: np.ndarray):
        """Follow a basis V that has become V factor; local."""
        self.L = factor.T @ self.L
        self.small = [small.projected(factor) for small in self.small]
        self._made.clear()

    def restart(self):
        self._made: dict[tuple, dict] = {}  # models by point
        super().restart()

    def at(self, point) -> PointModels:
        """Return the projections at a point; local. Raises InputError where M is not positive definite."""
        theta, tau, constant = self.form.theta(point), self.form.tau, self.small[0]
        L, turn = self.L, np.eye(len(self.L))
        summed = constant.with_matrices({
            key: sum(factor * small[key] for factor, small in zip(theta, self.small, strict=True) if key in small.terms)
            for key in constant.terms
        })  # fmt: skip
        if self.form.has_mass:
            M, K = summed["M"], summed["K"]
            inner = M + tau**2 * (K + K.T) / 2 if tau else M
            turn = np.linalg.inv(factor_of_mass(inner, self.form.values(point))).T
            summed, L = summed.projected(turn), turn.T @ L
        symmetric = all(symmetric for key, *_, symmetric in self.form.matrices if key == "K")
        size = sum(abs(factor) * np.linalg.norm(small["K"])
                   for factor, small in zip(theta, self.small, strict=True) if "K" in small.terms)  # fmt: skip
        io = self.form.io(theta)._replace(limits=self.limits, quiet=self.quiet)
        return PointModels(summed, L, turn, self.damping, io, symmetric, float(size), tau, self._kept(point))

    def _kept(self, point) -> dict:
        """Return the models at a point that are kept; those of the points that were asked for first make room."""
        self._made[point] = made = self._made.pop(point, {})
        m, l = self.L.shape
        while len(self._made) * (MATRICES * m * m + RESPONSES * l * l) > KEPT and len(self._made) > 1:
            del self._made[next(iter(self._made))]
        return made
