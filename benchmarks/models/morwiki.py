"""Models of the MOR Wiki (Oberwolfach collection) in Matrix Market files NAME.M, NAME.K, NAME.B and NAME.C.

The butterfly gyroscope: J. Lienemann, D. Billger, E. B. Rudnyi, A. Greiner and J. G. Korvink (2004). The bones: B. van
Rietbergen, E. B. Rudnyi and J. G. Korvink, six micro-finite element models of trabecular bone, for harmonic responses
of 1 to 100 Hz. hpcred reads the files in slices, so that no rank holds a whole matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import scipy.sparse

import hpcred
from hpcred.parallel.petsc import MPI
from hpcred.readers.matrices import matrix_market

from .published import Arrays, Published, all_ranks

WHERE = "modelreduction.org/morwiki"
BONES = {"BS01": 127_224, "BS10": 914_898, "B010": 986_703, "B025": 2_159_661, "B050": 4_934_244, "B120": 11_969_688}
COMPONENTS = "MKBC"


@dataclass(frozen=True, kw_only=True)
class MatrixMarket(Published):
    """A model of four files, of which `file` is that of M; `beta`: of D = beta K, in s."""

    read: None = None
    beta: float = 0.0

    def paths(self, folder=None) -> dict[str, str]:
        """The files by M, K, B and C; InputError where one is not there."""
        first = self.path(folder)
        found = {key: first.with_suffix(f".{key}") for key in COMPONENTS}
        if missing := [path.name for path in found.values() if not path.is_file()]:
            raise hpcred.InputError(
                f"{self.name}: found no {', '.join(missing)} beside {first}, expected {first.stem}.M, .K, .B and .C"
            )
        return {key: str(path) for key, path in found.items()}

    def matrices(self, folder=None) -> Arrays:
        M, K, B, C = (_read(path) for path in self.paths(folder).values())
        return Arrays(M=M, D=self.beta * K if self.beta else None, K=K, B=B.toarray(), C=C.toarray())

    def model(self, comm=None, folder=None) -> hpcred.SecondOrderModel:
        return hpcred.readers.load_source(hpcred.settings.Source(**self.paths(folder)), all_ranks(comm), self.name)

    @property
    def damping(self) -> hpcred.Rayleigh | None:
        return hpcred.Rayleigh(alpha=0.0, beta=self.beta) if self.beta else None

    def job(self, model, output="result.h5"):
        damping = f'[damping]\nkind = "rayleigh"\nalpha = 0.0\nbeta = {self.beta}\n' if self.beta else ""
        return super().job(model, output) + damping


def _read(path):
    """A matrix by the reader of hpcred, sparse; all of it on this rank. InputError where the file is damaged."""
    found = matrix_market.read(path, MPI.COMM_SELF)
    return scipy.sparse.csr_matrix((found.values, (found.rows, found.columns)), shape=found.shape)


_bone = partial(MatrixMarket, source="van Rietbergen, Rudnyi and Korvink", licence="GPL-2.0", where=WHERE)
MODELS = (
    MatrixMarket(name="gyro", what="butterfly gyroscope, D = 1e-6 s K", n=17_361, file="gyro.M", beta=1e-6,
                 source="Lienemann, Billger, Rudnyi, Greiner and Korvink", licence="stated there", where=WHERE,
                 band=(0.0, 1.6e5)),
    *(_bone(name=name, what="trabecular bone", n=n, file=f"{name}.M", band=(1.0, 100.0)) for name, n in BONES.items()),
)  # fmt: skip
