"""What a published model is: where its file is to be had, and how M, D, K, B and C are read from it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse

import hpcred

ROOT = Path(__file__).resolve().parents[2]


def find(name: str, folder: str | os.PathLike | None = None) -> Path | None:
    """The path of a file in a folder, or by default in that of HPCRED_SHARED_DATA or shared/data beside the checkout;
    None where it is not."""
    beside = [place / "shared/data" for place in (ROOT, *ROOT.parents[:2])]
    folders = [folder] if folder else [os.environ.get("HPCRED_SHARED_DATA"), *beside]
    paths = [Path(each) / below / name for each in folders if each for below in ("", "real")]
    return next((path for path in paths if path.is_file()), None)


@dataclass(kw_only=True)
class Arrays:
    """M, D, K (n, n), sparse, D or None; B (n, p), and C, Cv (r, n), each or None: both None for C = B^T.

    `viscoelastic`: matrices K_v with their laws; `circulatory`: whether K is unsymmetric on purpose.
    """

    M: scipy.sparse.csr_matrix
    D: scipy.sparse.csr_matrix | None
    K: scipy.sparse.csr_matrix
    B: np.ndarray
    C: np.ndarray | None = None
    Cv: np.ndarray | None = None
    viscoelastic: tuple[hpcred.Viscoelastic, ...] = ()
    circulatory: bool = False

    def dynamic_stiffness(self, s: complex, loss_factor: float = 0.0):
        """s^2 M + s D + (1 + i eta) K, sparse."""
        A = s * s * self.M + (1 + 1j * loss_factor) * self.K
        return (A if self.D is None else A + s * self.D).tocsc()

    def outputs(self, s: complex) -> np.ndarray:
        """C + s Cv, (r, n)."""
        if self.C is None and self.Cv is None:
            return self.B.T
        return sum(factor * rows for factor, rows in ((1, self.C), (s, self.Cv)) if rows is not None)

    def response(self, frequency: float, loss_factor: float = 0.0) -> np.ndarray:
        """H (r, p) at a frequency in Hz, by SciPy's sparse LU."""
        s = 2j * np.pi * frequency
        lu = scipy.sparse.linalg.splu(self.dynamic_stiffness(s, loss_factor))
        return self.outputs(s) @ lu.solve(self.B.astype(complex))


@dataclass(frozen=True, kw_only=True)
class Published:
    """A published model.

    `name`: as `make` takes it; `what`: in a sentence; `n`: unknowns; `file`: the name of its file; `source`: who
    published it; `licence`; `where`: where to download it; `band`: Hz, of its reduction; `loss_factor`: of structural
    damping, which a job states beside the model; `read`: Arrays from the path.
    """

    name: str
    what: str
    n: int
    file: str
    source: str
    licence: str
    where: str
    band: tuple[float, float]
    read: Callable[[Path], Arrays]
    loss_factor: float = 0.0
    tolerance: float = 1e-4

    def path(self, folder: str | os.PathLike | None = None) -> Path:
        """The path of its file; InputError where it is not."""
        found = find(self.file, folder)
        if found is None:
            place = folder or "the shared data"
            raise hpcred.InputError(
                f"{self.name}: found no {self.file} in {place}; download it from {self.where} and name its folder"
            )
        return found

    def matrices(self, folder: str | os.PathLike | None = None) -> Arrays:
        """M, D, K, B and C as SciPy and NumPy have them, the same on all ranks."""
        return self.read(self.path(folder))

    def model(self, comm=None, folder: str | os.PathLike | None = None) -> hpcred.SecondOrderModel:
        """The model, distributed over the ranks of `comm`, by default all. Collective."""
        given = self.matrices(folder)
        more = {"Cv": given.Cv, "name": self.name, "comm": comm, "circulatory": given.circulatory}
        model = hpcred.SecondOrderModel(given.M, given.D, given.K, given.B, given.C, **more)
        if not given.viscoelastic:
            return model
        with model:
            return model.with_viscoelastic(given.viscoelastic)

    @property
    def damping(self) -> hpcred.GivenDamping | None:
        """That of reductions and responses beside the D of the model; None for no more than D."""
        if not self.loss_factor:
            return None
        return hpcred.GivenDamping(loss_factor=self.loss_factor)

    def reduce(self, model, **more) -> hpcred.ReducedModel:
        """Reduce the model to its tolerance over its band. Collective."""
        return hpcred.reduce(model, **{"tolerance": self.tolerance, "band": self.band, "damping": self.damping, **more})

    def job(self, model: str, output: str = "result.h5") -> str:
        """The job file of that reduction."""
        lines = [f"model = {_text(model)}", f"output = {_text(output)}", f"band = [{self.band[0]}, {self.band[1]}]",
                 f"tolerance = {self.tolerance}"]  # fmt: skip
        if self.loss_factor:
            lines += ["[damping]", 'kind = "given"', f"loss_factor = {self.loss_factor}"]
        return "\n".join([*lines, ""])


def _text(value: str) -> str:
    """A string of TOML; JSON writes quotes and backslashes alike."""
    return json.dumps(value, ensure_ascii=False)


def all_ranks(comm):
    """The ranks that were named, by default all."""
    from hpcred.parallel.petsc import MPI

    return comm or MPI.COMM_WORLD


def unit_columns(n: int, rows) -> np.ndarray:
    """B (n, p) of unit loads on some rows, from 0."""
    B = np.zeros((n, len(rows)))
    B[rows, np.arange(len(rows))] = 1.0
    return B


def variables(path: Path, *names: str) -> list:
    """Variables of a .mat file, those that are sparse as CSR; InputError where one is missing or the file damaged."""
    try:
        found = scipy.io.loadmat(path)
    except Exception as error:  # each damage has an exception of its own
        raise hpcred.InputError(
            f"{path}: {error}; expected a whole MATLAB .mat file of version 4 to 7, as published"
        ) from error
    if missing := [name for name in names if name not in found]:
        has = ", ".join(sorted(key for key in found if not key.startswith("__")))
        raise hpcred.InputError(f"{path}: found no variable {', '.join(missing)}, only {has}")
    for name in names:
        if found[name].dtype.kind not in "biufc":
            raise hpcred.InputError(f"{path}: variable {name} has the type {found[name].dtype}, expected numbers")
    return [found[name].tocsr() if scipy.sparse.issparse(found[name]) else np.asarray(found[name]) for name in names]
