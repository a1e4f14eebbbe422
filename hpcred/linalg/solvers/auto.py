"""Factor on a GPU where there is one that the factor fits, else by MUMPS."""

from __future__ import annotations

from functools import partial

from ...parallel.decisions import decided
from ...parallel.failures import ComputationError
from . import cudss
from .base import FAILED_ON_GPU, Factorisation
from .cudss import Cudss
from .mumps import Mumps
from .settings import Factoring

SMALL = 20_000  # rows up to which MUMPS is done while a GPU is being started


def _of_present(name):
    """Return a method of the package that factors at present."""
    return lambda self, *arguments: getattr(self._factors, name)(*arguments)


class Auto(Factorisation):
    """Factors by `Cudss`, and by `Mumps` after the GPU failed; where there is none, Auto(...) is a `Mumps`.

    Records say which package was taken, and why. See Factorisation.
    """

    name = "auto"
    has_single = True
    # what MUMPS can, which takes over where a GPU fails
    check, counts, source_of, check_build = Mumps.check, Mumps.counts, Mumps.source_of, Mumps.check_build

    def __new__(cls, matrix, symmetric, prefix, factoring=None, *arguments, **keywords):
        against = decided(matrix.comm.tompi4py(), _against_gpu, factoring or Factoring(), matrix.getSize()[0])
        if not against:
            return super().__new__(cls)
        mumps = Mumps(matrix, symmetric, prefix, factoring, *arguments, **keywords)
        mumps.because = against
        return mumps

    def __init__(self, matrix, symmetric, prefix, factoring=None, *arguments, **keywords):
        super().__init__(matrix, symmetric, prefix, factoring, *arguments, **keywords)
        self._by_mumps = partial(Mumps, matrix, symmetric, prefix, factoring, *arguments, **keywords)
        self._factors: Factorisation = Cudss(matrix, symmetric, prefix, factoring, *arguments, **keywords)
        self._factors.because = "there is a GPU that the factor fits"

    @classmethod
    def slicing(cls, factoring, comm):
        return Mumps.slicing(factoring, comm) if decided(comm, _against_gpu, factoring) else None

    @property
    def analyses(self):
        return self._factors.analyses

    def estimate(self):
        return self._on_gpu_or_not(lambda: self._factors.estimate())

    def known(self):
        words, left = self._factors.known()
        if words and isinstance(self._factors, Mumps):
            words += f", by MUMPS, since {self._factors.because}"
        return words, left

    def factor(self, **labels):
        self._labels = labels
        self._on_gpu_or_not(lambda: self._factors.factor(**labels))
        self.source = self._factors.source
        self.records.append(self._factors.records[-1])

    def _on_gpu_or_not(self, function):
        """What a function gives; by MUMPS from now on if the GPU fails."""
        try:
            return function()
        except ComputationError as error:
            if isinstance(self._factors, Mumps):
                raise
            self._factors.close()
            self._factors = self._by_mumps()
            self._factors.because = f"{FAILED_ON_GPU}{str(error).partition('; take')[0]}"
            return function()

    def back_substitute(self, load, solution):
        self._on_gpu_or_not(lambda: self._by_present_factor(load, solution))

    def _by_present_factor(self, load, solution):
        if not self._factors.records:  # MUMPS, after the GPU failed in a solve
            self.factor(**self._labels)
        self._factors.back_substitute(load, solution)

    approximate, side_by_side, _factor, _solve, release, close = map(
        _of_present, ("approximate", "side_by_side", "_factor", "_solve", "release", "close")
    )


def _against_gpu(factoring, size=None) -> str | None:
    """Why factors of `size` rows are not made on a GPU; None where they can be."""
    for key in ("out_of_core", "low_rank", "memory_mb"):
        if getattr(factoring, key) is not None:
            return f"{key} is for MUMPS"
    if size is not None and size <= SMALL:
        return f"{size} rows are done before a GPU is started"
    reason = cudss.unusable()
    return reason and f"cuDSS {reason}"
