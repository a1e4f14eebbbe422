"""Form complex A(s) = s^2 M + s D + (1 + i eta) K in either PETSc build, where complex columns are pairs of real ones.

A complex build has A(s) as it is (complex symmetric LDL^T, no conjugation), added terms with their coefficients. A real
build takes the symmetric real form of twice the size,

    [ Re A  -Im A ] [Re x]   [ Re b]
    [-Im A  -Re A ] [Im x] = [-Im b]      for A x = b,

in which each rank has its real rows first and its imaginary rows after them, so that no value moves between ranks.
"""

import numpy as np

from ..parallel.petsc import SAME, PETSc
from .blocks import local_rows


class NativeForm:
    """A(s) as a complex matrix of a complex build."""

    def __init__(self, model):
        self.model, self.matrix = model, model.K.duplicate(copy=False)

    def fill(self, coefficients):
        """matrix = the sum of coefficients times the terms of the model, by key."""
        self.model.K.copy(self.matrix, structure=SAME)
        self.matrix.scale(coefficients["K"])
        for key, mat in self.model.matrices.items():
            if key != "K" and key in coefficients:
                self.matrix.axpy(coefficients[key], mat, structure=SAME)

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
        # twice the entries of a rank may be more than 32 bits count
        indptr, columns = (array.astype(np.int64) for array in model.K.getValuesCSR()[:2])
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

    def fill(self, coefficients):
        """matrix = the real form of the sum of coefficients times the terms of the model, by key."""
        values = sum(coefficients[key] * mat.getValuesCSR()[2].real
                     for key, mat in self.model.matrices.items() if key in coefficients)  # fmt: skip
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
