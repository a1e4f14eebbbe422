"""Complex A(s) in a real build of PETSc: the symmetric real form of twice the size.

    [ Re A  -Im A ] [Re x]   [ Re b]
    [-Im A  -Re A ] [Im x] = [-Im b]      for A x = b

Each rank has its real rows first and its imaginary rows after them, so that no value moves between ranks.
"""

import numpy as np

from ..petsc import SCALAR, PETSc
from .block import copy_of, create_block, local_rows
from .mumps import Factorisation
from .shifted import ShiftedSolver


def solver_for(model, rigid, damped: bool):
    """A solver with solve_at(s, right, real, imaginary), records and close() for the build at hand."""
    if SCALAR == "real" and damped:
        return RealFormSolver(model, rigid)
    return ShiftedSolver(model, rigid, prefix="response_")


class RealFormSolver:
    """Solves with A(s) = K + s D + s^2 M, s complex, in real arithmetic. Collective. Call close()."""

    def __init__(self, model, rigid=None, prefix="response_"):
        self.model, self.rigid, self._prefix = model, rigid, prefix
        self._static = None
        indptr, columns, _ = model.K.getValuesCSR()
        rows, size = model.local_rows, model.size
        starts = np.array(model.comm.allgather(model.first_row))
        widths = np.append(starts[1:], size) - starts
        owner = np.searchsorted(starts, columns, side="right") - 1
        # ranks without rows share their start with the next one; the last of them owns the column
        real = columns + starts[owner]
        imaginary = real + widths[owner]
        self._left = self._order(indptr, real, imaginary)
        indices = np.concatenate([real, imaginary])[self._left]
        twice = np.concatenate([indptr[:-1] * 2, indptr[-1:] * 2])
        integer = PETSc.IntType
        self._indptr = np.concatenate([twice[:-1], twice + 2 * indptr[-1]]).astype(integer)
        self._indices = np.tile(indices, 2).astype(integer)
        self._matrix = PETSc.Mat().createAIJ(
            ((2 * rows, 2 * size), (2 * rows, 2 * size)),
            csr=(self._indptr, self._indices, np.zeros(len(self._indices))),
            comm=model.K.comm,
        )
        if model.symmetric:
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._factors = Factorisation(self._matrix, "cholesky" if model.symmetric else "lu", prefix)

    @staticmethod
    def _order(indptr, real, imaginary):
        """Positions that put the real and the imaginary columns of every row together, sorted."""
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        return np.lexsort((np.concatenate([real, imaginary]), np.tile(rows, 2)))

    @property
    def records(self):
        return self._factors.records

    @property
    def analyses(self):
        return self._factors.analyses

    def close(self):
        self._factors.close()
        self._matrix.destroy()
        if self._static is not None:
            self._static.close()

    def solve_at(self, s: complex, right, real, imaginary):
        """Factor A(s), and put the two parts of A(s)^-1 right into `real` and `imaginary`; right is real."""
        if s == 0:
            self._static = self._static or ShiftedSolver(self.model, self.rigid, prefix=self._prefix)
            self._static.solve_at(s, right, real, imaginary)
            return
        model, rows = self.model, self.model.local_rows
        values = model.K.getValuesCSR()[2].astype(complex)
        values += s * s * model.M.getValuesCSR()[2]
        if model.D is not None:
            values += s * model.D.getValuesCSR()[2]
        upper = np.concatenate([values.real, -values.imag])[self._left]
        lower = np.concatenate([-values.imag, -values.real])[self._left]
        self._matrix.setValuesCSR(self._indptr, self._indices, np.concatenate([upper, lower]))
        self._matrix.assemble()
        self._factors.factor(mass=str(s * s), damping=str(s), inertia_relief=False)
        columns = right.getActiveColumns()[1]
        load, solution = create_block(self._matrix, columns), create_block(self._matrix, columns)
        elastic = copy_of(right, model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(elastic)
        with local_rows(elastic) as b, local_rows(load) as twice:
            twice[:rows] = b
            twice[rows:] = 0.0
        elastic.destroy()
        self._factors.back_substitute(load, solution)
        self._factors.refine(load, solution, self._matrix, self._factors.back_substitute)
        with local_rows(solution) as twice, local_rows(real) as x, local_rows(imaginary) as y:
            x[...], y[...] = twice[:rows], twice[rows:]
        for item in (load, solution):
            item.destroy()
        if self.rigid is not None:
            self.rigid.project(real)
            self.rigid.project(imaginary)
