"""Hold the keywords that several workflows share: which frequencies, how to compute, where to write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from ..analysis.frequency_response import checked_frequencies
from ..files.campbell_file import kind_of_campbell
from ..files.outputs import check_outputs
from ..files.response_file import check_response_name, kind_of_responses
from ..linalg.solvers.settings import Factoring
from ..parallel import startup
from ..parallel.declared import Keywords, declared
from ..parallel.failures import InputError
from ..parallel.ranges import FREQUENCY, SAMPLES, within
from .pair_figures import check_figure


@dataclass(frozen=True, kw_only=True)
class Grid(Keywords):
    """Which frequencies: `frequencies` (Hz), or else `points` of them over `band` (two numbers)."""

    frequencies: Sequence[float] = ()
    band: Sequence[float] | None = None
    points: int = 61

    def over(self, band=None) -> np.ndarray:
        """Return the frequencies in ascending order; `band` (Hz): where none was given. Raises InputError."""
        band, frequencies = self.band or band, checked_frequencies(self.frequencies)
        if not len(frequencies) and declared("points", self.points, int) < 2:
            raise InputError(f"points: found {self.points}, expected at least 2 frequencies over the band")
        within("points", self.points, SAMPLES)
        within("band", band, FREQUENCY)
        return np.sort(frequencies) if len(frequencies) else np.linspace(*band, self.points)


@dataclass(frozen=True, kw_only=True)
class FineGrid(Grid):
    """Which frequencies, many by default."""

    points: int = 2001


@dataclass(frozen=True, kw_only=True)
class Solving(Keywords):
    """How full models are solved: in `groups` of ranks that share the frequencies, see frequency_response, and by what
    `factoring`."""

    groups: int | None = None
    factoring: Factoring | None = None

    def start(self):
        """Load the PETSc build that suits real matrices, where none is loaded yet."""
        startup.start(preferred="real", low_rank=self.factoring is not None and self.factoring.low_rank is not None)


@dataclass(frozen=True, kw_only=True)
class Files(Keywords):
    """Where to write: `output`, a .csv or HDF5 file, and `figure`, a .png, .svg or .pdf."""

    output: str | PathLike[str] | None = None
    figure: str | PathLike[str] | None = None

    def check(self, comm, reads, progress, needed: int = 0, over: str | None = None):
        """Refuse early what cannot be written: responses, or a Campbell diagram `over` a parameter. Collective."""
        if self.output is not None:
            check_response_name(self.output, foreign=over is None)
            kind = kind_of_responses(self.output) if over is None else kind_of_campbell(self.output, over)
            check_outputs({self.output: kind}, comm, reads, progress=progress, needed=needed)
        check_figure(self.figure, comm, reads, progress)
