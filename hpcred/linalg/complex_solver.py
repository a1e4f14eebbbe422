"""Complex A(s) = s^2 M + s D + (1 + i eta) K in both builds of PETSc, for blocks of complex columns kept as pairs.

A complex build factors A(s) as it is (complex symmetric LDL^T, no conjugation). A real build takes the symmetric
real form of twice the size,

    [ Re A  -Im A ] [Re x]   [ Re b]
    [-Im A  -Re A ] [Im x] = [-Im b]      for A x = b,

in which each rank has its real rows first and its imaginary rows after them, so that no value moves between ranks.
"""

import numpy as np

from ..parallel.petsc import SAME, PETSc, is_complex
from .blocks import add_product, as_pairs, copy_of, create_block, inner, local_rows, unfold
from .factorisation import Factorisation


class DampedSolver:
    """Solves with A(s) for one s at a time; blocks are pairs Re, Im of complex columns (see block.fold).

    `rigid`: rigid-body modes of a free body: solutions are then those of the elastic part, x with R^T M x = 0 and
    A x - b in the span of M R. `form`: "native" or "real", by default what the build can. All methods are
    collective. Owns PETSc objects: call close().
    """

    def __init__(self, model, rigid=None, prefix="damped_", form=None, options=None):
        self.model, self.rigid = model, rigid
        form = form or ("native" if is_complex() else "real")
        self._form = NativeForm(model) if form == "native" else RealForm(model)
        matrix = self._form.matrix
        if model.symmetric:
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._factors = Factorisation(matrix, "cholesky" if model.symmetric else "lu", prefix, options=options)
        self._accelerated = self._factored = None

    @property
    def records(self) -> list[dict]:
        """One dict a factorisation, for the result file."""
        return self._factors.records

    @property
    def analyses(self) -> int:
        return self._factors.analyses

    def release(self):
        """Free the factor, for another solver to have the memory."""
        self._factored = None
        self._factors.release()
        self._forget()

    def close(self):
        self._factors.close()
        self._form.matrix.destroy()
        self._forget()

    def factor(self, s: complex, loss_factor: float = 0.0):
        """Factor A(s). Raises SingularMatrix or ComputationError."""
        self.factor_sum(s * s, s, 1 + 1j * loss_factor)

    def factor_sum(self, mass: complex, damping: complex = 0.0, stiffness: complex = 1.0):
        """Factor mass M + damping D + stiffness K instead, unless it is factored already."""
        if self._factored == (mass, damping, stiffness):
            return
        self._factored = None
        self._form.fill(mass, damping, stiffness)
        self._factors.factor(mass=str(mass), damping=str(damping), inertia_relief=False)
        self._forget()
        if self.rigid is not None:
            # A^-1 M R, which is R / s^2 when D R = 0
            loads = as_pairs(self.rigid.MR, self.model.K)
            self._accelerated = create_block(self.model.K, loads.getSizes()[1])
            self._solve(loads, self._accelerated)
            loads.destroy()
            self._held = self._momentum(self._accelerated)
        self._factored = mass, damping, stiffness

    def solve(self, right, solution):
        """solution = A^-1 right for all active columns at once, with the relative residual checked."""
        load = copy_of(right, self.model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(load)
        self._solve(load, solution)
        load.destroy()
        if self.rigid is not None:
            share = np.linalg.solve(self._held, self._momentum(solution))
            add_product(solution, self._accelerated, unfold(share), alpha=-1.0)

    def _solve(self, load, solution):
        matrix = self._form.matrix
        columns = load.getActiveColumns()[1] // 2
        b, x = create_block(matrix, columns), create_block(matrix, columns)
        self._form.put(load, b)
        self._factors.back_substitute(b, x)
        self._factors.refine(b, x, matrix, self._factors.back_substitute)
        self._form.get(x, solution)
        b.destroy()
        x.destroy()

    def _momentum(self, pairs):
        """R^T M x (count, columns) of complex columns."""
        gram = inner(self.rigid.MR, pairs)
        return gram[:, 0::2] + 1j * gram[:, 1::2]

    def _forget(self):
        if self._accelerated is not None:
            self._accelerated.destroy()
        self._accelerated = None


class NativeForm:
    """A(s) as a complex matrix of a complex build."""

    def __init__(self, model):
        self.model, self.matrix = model, model.K.duplicate(copy=False)

    def fill(self, mass, damping, stiffness):
        """matrix = mass M + damping D + stiffness K."""
        self.model.K.copy(self.matrix, structure=SAME)
        self.matrix.scale(stiffness)
        if self.model.D is not None:
            self.matrix.axpy(damping, self.model.D, structure=SAME)
        self.matrix.axpy(mass, self.model.M, structure=SAME)

    def put(self, pairs, block):
        """The complex columns of pairs."""
        with local_rows(pairs) as z, local_rows(block) as x:
            x[...] = z[:, 0::2].real + 1j * z[:, 1::2].real

    def get(self, block, pairs):
        """The pairs of complex columns."""
        with local_rows(block) as x, local_rows(pairs) as z:
            z[:, 0::2], z[:, 1::2] = x.real, x.imag


class RealForm:
    """A(s) as the symmetric real matrix of twice the size."""

    def __init__(self, model):
        self.model = model
        indptr, columns, _ = model.K.getValuesCSR()
        rows, size = model.local_rows, model.size
        starts = model.row_starts
        widths = np.append(starts[1:], size) - starts
        owner = np.searchsorted(starts, columns, side="right") - 1
        real = columns + starts[owner]
        imaginary = real + widths[owner]
        # positions that put the real and the imaginary columns of every row together, sorted
        row = np.repeat(np.arange(rows), np.diff(indptr))
        self._order = np.lexsort((np.concatenate([real, imaginary]), np.tile(row, 2)))
        indices = np.concatenate([real, imaginary])[self._order]
        self._indptr = np.concatenate([2 * indptr[:-1], 2 * indptr + 2 * indptr[-1]]).astype(PETSc.IntType)
        self._indices = np.tile(indices, 2).astype(PETSc.IntType)
        self.matrix = PETSc.Mat().createAIJ(
            ((2 * rows, 2 * size), (2 * rows, 2 * size)),
            csr=(self._indptr, self._indices, np.zeros(len(self._indices))),
            comm=model.K.comm,
        )

    def fill(self, mass, damping, stiffness):
        """matrix = the real form of mass M + damping D + stiffness K."""
        model = self.model
        values = stiffness * model.K.getValuesCSR()[2].real
        values = values + mass * model.M.getValuesCSR()[2].real
        if model.D is not None:
            values += damping * model.D.getValuesCSR()[2].real
        upper = np.concatenate([values.real, -values.imag])[self._order]
        lower = np.concatenate([-values.imag, -values.real])[self._order]
        self.matrix.setValuesCSR(self._indptr, self._indices, np.concatenate([upper, lower]))
        self.matrix.assemble()

    def put(self, pairs, block):
        """Columns (Re b, -Im b) of pairs."""
        rows = self.model.local_rows
        with local_rows(pairs) as z, local_rows(block) as x:
            x[:rows], x[rows:] = z[:, 0::2], -z[:, 1::2]

    def get(self, block, pairs):
        """The pairs of columns (Re x, Im x)."""
        rows = self.model.local_rows
        with local_rows(block) as x, local_rows(pairs) as z:
            z[:, 0::2], z[:, 1::2] = x[:rows], x[rows:]
