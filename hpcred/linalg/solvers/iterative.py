"""Solve by preconditioned conjugate gradients, to a small true residual where a subclass has no other measure."""

from __future__ import annotations

import time
from contextlib import ExitStack
from math import inf

import numpy as np

from ...parallel.decisions import decided
from ...parallel.sums import summed
from ..blocks import column_norms, copy_of, create_dense, local_rows
from ..conjugate_gradients import NotSolved, conjugate_gradients

WIDTH = 16  # columns solved for at once
RESTARTS = 3  # from the true residual
BACKWARD = 1e-14  # backward error that a solution may end with, as of refined ones
ROUND_OFF = 1e-16  # backward error below which no residual can be asked for


class IterativeSolves:
    """Solves with sums of K, M and D that are positive definite, or are so beside a basis.

    `model`, `rigid`: as of a Solver. `goal`: the relative residual that solutions are refined to, as far as
    round-off lets them; it may end with the residual `accepted`, or with the backward error ||r|| / (||A|| ||x|| +
    ||b||) that is BACKWARD. `most`: iterations, from each restart. A subclass has `_norm`, an estimate of ||A||, and
    what it says where solutions stay bad. All methods are collective.
    """

    def __init__(self, model, rigid, goal, accepted, most):
        self.model, self.rigid, self._norm = model, rigid, 0.0
        self._goal, self._accepted, self._most = goal, accepted, most

    # what a subclass has

    def _preconditioner(self, columns):
        """A function r, z -> z = P r for rows of this rank (rows, columns)."""
        raise NotImplementedError

    def _note(self, columns, seconds, iterations, residual):
        """Record solves."""
        raise NotImplementedError

    advice = ""  # follows on the sentence that a solution is bad

    # the solves

    def solve_below(self, mass, right, solution, basis, small, rough=0.0):
        """solution = (K + mass M)^-1 right for a mass < 0, with what there is for another mass, where a basis V (a
        block) has all modes below: what is left of the matrix beside V is positive definite.

        `small`: V^T (K + mass M) V (m, m); `rough`: the residual beside V may end with so much of what it begins with.
        Deflated conjugate gradients (Nicolaides, SIAM J. Numer. Anal. 24(2), 1987). Raises NegativeCurvature where V
        lacks a mode that the loads move, or NotSolved.
        """
        terms = [(1.0, self.model.K), (mass, self.model.M)]
        self._solve(right, solution, terms, (basis, decided(self.model.comm, _inverse, small)), rough)

    def _solve(self, right, solution, terms, deflation=None, rough=0.0):
        start = time.perf_counter()
        iterations, residual = 0, 0.0
        load = copy_of(right, self.model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(load)
        scale = column_norms(right)
        with ExitStack() as views:
            b, x = (views.enter_context(local_rows(block)) for block in (load, solution))
            if deflation is not None:
                deflation = views.enter_context(local_rows(deflation[0])), deflation[1]
            for low in range(0, b.shape[1], WIDTH):
                columns = slice(low, low + WIDTH)
                steps, left = self._solve_columns(b[:, columns], x[:, columns], scale[columns], terms, deflation, rough)
                iterations, residual = max(iterations, steps), max(residual, left)
        if self.rigid is not None:
            self.rigid.project(solution)
        self._note(len(scale), time.perf_counter() - start, iterations, 0.0 if rough else residual)

    def _solve_columns(self, b, x, scale, terms, deflation, rough):
        """x = A^-1 b for the rows of this rank; returns the iterations, and the relative residual."""
        comm = self.model.comm
        x[...] = 0.0
        r, before, first, loaded = b.copy(order="F"), inf, 0.0, scale > 0
        iterations = np.zeros(b.shape[1], dtype=int)
        # the known directions that multigrid cannot see are solved for beside it
        multiply = self._multiplication(b.shape[1], terms)
        precondition = self._preconditioner(b.shape[1])
        if deflation is not None:
            V, inverse = deflation
            momentum = self._multiplication(b.shape[1], [(1.0, self.model.M)])
            precondition = self._beside(V, inverse, multiply, None if rough else momentum, precondition)
        # the recursive residual drifts, so it is formed anew, and iterated on while that halves it
        for turn in range(RESTARTS + 2):
            if deflation is not None:
                x += V @ (inverse @ summed(comm, V.T @ r))
                residual_of(multiply, b, x, r)
            size, far = self._norms(r), self._norms(x)
            first = first if turn else rough * size
            floor = np.maximum(np.maximum(self._goal * scale, first), ROUND_OFF * self._norm * far)
            relative = float((size[loaded] / scale[loaded]).max(initial=0.0))
            backward = float((size / np.maximum(self._norm * far + scale, 1e-300)).max(initial=0.0))
            if (size <= floor).all() or not relative < before / 2 or turn > RESTARTS:
                break
            before = relative
            iterations += conjugate_gradients(comm, multiply, precondition, r, x, floor, self._most)
            residual_of(multiply, b, x, r)
        # a column that is stuck above round-off is no solution
        if not ((size <= floor).all() or relative <= self._accepted or backward <= BACKWARD):
            raise NotSolved(
                f"the relative residual stays at {relative:.1e} (backward error {backward:.1e}) after "
                f"{iterations.max()} iterations of conjugate gradients{self.advice}"
            )
        return int(iterations.max(initial=0)), relative

    def _beside(self, V, inverse, multiply, momentum, precondition):
        """The preconditioner whose results are A-orthogonal to V, for residuals orthogonal to V, which `momentum` (or
        None) keeps them."""
        comm = self.model.comm

        def deflated(r, z):
            product = np.empty_like(r)
            if momentum is not None:
                # what round-off brings back of V, whose modes are soft, would soon be all that is seen
                momentum(V @ summed(comm, V.T @ r), product)
                r -= product
            precondition(r, z)
            multiply(z, product)
            z -= V @ (inverse @ summed(comm, V.T @ product))

        return deflated

    def _norms(self, rows):
        squared = np.array([np.vdot(column, column).real for column in rows.T])
        return np.sqrt(summed(self.model.comm, squared))

    def _multiplication(self, columns, terms):
        """p, q -> q = A p for the rows of this rank."""
        source, target = (create_dense(self.model.K, columns) for _ in range(2))

        def multiply(p, q):
            source.getDenseArray()[...] = p
            q[...] = 0.0
            for factor, mat in terms:
                mat.matMult(source, target)
                q += factor * target.getDenseArray() if factor != 1 else target.getDenseArray()

        return multiply


def _inverse(small):
    try:
        return np.linalg.inv((small + small.T) / 2)
    except np.linalg.LinAlgError:
        raise NotSolved("the basis has a mode at the point") from None


def residual_of(multiply, b, x, r):
    """r = b - A x."""
    multiply(x, r)
    np.subtract(b, r, out=r)
