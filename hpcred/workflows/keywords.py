"""Hold the keywords that workflows share with each other and with the commands that call them: which frequencies, how
to compute, where to write. Their annotations have the options of the command line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Annotated, Any

import numpy as np

from ..analysis.campbell import POINTS
from ..analysis.frequency_response import checked_frequencies
from ..body.preload import Preload
from ..files.campbell_file import kind_of_campbell
from ..files.outputs import check_outputs
from ..files.response_file import check_response_name, kind_of_responses
from ..linalg.solvers.settings import Factoring
from ..model.damping import Damping
from ..model.frames import Frame
from ..parallel import startup
from ..parallel.declared import Keywords, Option, declared
from ..parallel.failures import InputError
from ..parallel.ranges import FREQUENCY, SAMPLES, within
from ..settings import texts
from .pair_figures import check_figure

Name = str | PathLike[str] | None  # of a file or folder
Numbers = Sequence[float] | None
Labels = Sequence[int | str] | None  # of nodes, interfaces and node sets
At = Annotated[
    dict[str, float] | None,
    Option("Values of parameters; default: the reference values.", "P=V,...", texts.parameters),
]
Band = Annotated[Numbers, Option("Hz; default: that of the job.", "LOW,HIGH", texts.band)]
FileUnits = Annotated[str, Option("Units of the files: SI; mm,t,s; mm-kg-ms; inch-lbf-s; ...")]
FullFile = Annotated[Name, Option("Compare with this full model.", "MODEL.h5")]
Load = Annotated[Preload | None, Option("Constant load: '{omega = [0, 0, 300]}' (rad/s).", "TABLE", texts.preload)]
Measured = Annotated[str | None, Option("What eps is: directions, or paper, the Frobenius norm (55).")]
Pairs = Annotated[Sequence[str], Option("Responses to show, such as 20:z/20:z,20:z/1:x.", "OUT/IN,...", texts.words)]
Points = Annotated[int, Option("Number of equally spaced frequencies in the band.")]
Variables = Annotated[dict[str, str] | None, Option("Names of matrices in a file.", "K=...,M=...", texts.names)]


@dataclass(frozen=True, kw_only=True)
class Grid(Keywords):
    """Which frequencies: `frequencies` (Hz), or else `points` of them over `band` (two numbers)."""

    frequencies: Annotated[Sequence[float], Option("Frequencies in Hz.", "F1,F2,...", texts.numbers)] = ()
    band: Band = None
    points: Points = 61

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

    band: Annotated[Numbers, Option("Hz.", "LOW,HIGH", texts.band)] = None
    points: Points = 2001


@dataclass(frozen=True, kw_only=True)
class Speeds(Keywords):
    """At which `values` of a parameter, or else at how many `points` of a `range`."""

    values: Sequence[float] = ()
    range: Annotated[Numbers, Option("Default: that of the parameter.", "LOW,HIGH", texts.interval)] = None
    points: Annotated[int, Option("Number of equally spaced values in the range.")] = POINTS


@dataclass(frozen=True, kw_only=True)
class Whirl(Keywords):
    """Which modes of a rotor, by the orbits of which nodes about which axis, and which multiples of its speed."""

    nodes: Annotated[
        Labels, Option("Nodes whose orbits tell the whirl: numbers, names, sets.", "N1,N2,...", texts.labels)
    ] = None
    axis: Annotated[
        str | Sequence[float] | None,
        Option("Of the rotation: x, y, z or three numbers; default: that of the job, or z.", None, texts.axis),
    ] = None
    orders: Annotated[Sequence[float], Option("Multiples of the speed.", "K1,K2,...", texts.numbers, "1")] = (1.0,)
    highest: Annotated[float | None, Option("Frequency up to which modes are shown.", "HZ")] = None


@dataclass(frozen=True, kw_only=True)
class Motion(Keywords):
    """Which instants and coordinates of a motion."""

    start: Annotated[float | None, Option("First instant in s.", "T", names=("--from",))] = None
    end: Annotated[float | None, Option("Last instant in s.", "T", names=("--to",))] = None
    every: Annotated[int, Option("Every N-th instant only.", "N")] = 1
    first: Annotated[int | None, Option("Exudyn: number of the first reduced coordinate in the system.", "N")] = None


@dataclass(frozen=True, kw_only=True)
class Recovered(Keywords):
    """What is recovered of which nodes."""

    nodes: Annotated[
        Labels, Option("Numbers, interfaces, node sets; default: all nodes.", "1,20,bearing,...", texts.labels)
    ] = None
    quantities: Annotated[
        Sequence[str],
        Option("displacement, velocity, acceleration.", "NAME,...", texts.words, "displacement"),
    ] = ("displacement",)
    inertial: Annotated[bool, Option("In inertial axes, with the frame's motion.", names=("--inertial",))] = False
    stress: Annotated[bool, Option("Stresses too, of a result with stress modes.", names=("--stress",))] = False
    single: Annotated[bool, Option("Single precision: half the bytes.", names=("--single",))] = False


@dataclass(frozen=True, kw_only=True)
class Shown(Keywords):
    """What a report shows."""

    pairs: Pairs = ()
    modes: Annotated[int, Option("Number of shapes to look at.")] = 10
    motion: Annotated[Name, Option("simulation.h5, ...: a picture of its largest stress.", "FILE")] = None


@dataclass(frozen=True, kw_only=True)
class Folders(Keywords):
    """Folders for figures and tables."""

    png: Annotated[Name, Option("Figures for papers, too.", "DIR")] = None
    svg: Annotated[Name, Option("Figures for papers, too.", "DIR")] = None
    csv: Annotated[Name, Option("The numbers as tables, too.", "DIR")] = None


@dataclass(frozen=True, kw_only=True)
class FreshPoints(Keywords):
    """At how many random frequencies estimates are compared with full solves; `seed` draws the same ones again."""

    check: Annotated[int, Option("Compare with full solves at N random frequencies.")] = 0
    seed: Annotated[int | None, Option("The fresh frequencies of an earlier --check.")] = None


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
class InputsAndOutputs(Keywords):
    """Dofs, such as 115 or (20, "z"), or a matrix file."""

    inputs: Annotated[Any, Option("Unit loads: 20:z,1:x or dof numbers 115,1", None, texts.targets)] = None
    outputs: Annotated[Any, Option("Outputs: 20:z,velocity 20:z,acceleration dof 115", None, texts.targets)] = None


@dataclass(frozen=True, kw_only=True)
class State(InputsAndOutputs):
    """How a full model is held, damped, loaded and observed, and at what values of its parameters."""

    frame: Annotated[
        Frame | None,
        Option("none, buckens, tangent:NODE or chord:N1,N2,N3[:AXES]; none or that of the job.", None, texts.frame),
    ] = None
    damping: Annotated[
        Damping | None,
        Option("none, given, rayleigh:ALPHA,BETA or loss:FACTOR; given by default where the model has a D.", None,
               texts.damping),
    ] = None  # fmt: skip
    preload: Load = None
    at: At = None


@dataclass(frozen=True, kw_only=True)
class Drive(Keywords):
    """What drives a result: one table of `psd`, `harmonic` or `srs`, the `q` of the oscillators of shock spectra, and
    nodes whose `stress` are outputs under random loads."""

    psd: Annotated[Name, Option("Of a result: random loads, densities.", "CSV")] = None
    harmonic: Annotated[Name, Option("Of a result: harmonic loads.", "CSV")] = None
    srs: Annotated[Name, Option("Of a result: shock spectra of a history.", "CSV")] = None
    q: Annotated[float | None, Option("Amplification of the oscillators of --srs; default 10.")] = None
    stress: Annotated[
        Sequence[int] | None, Option("With --psd: stresses at nodes.", "NODES", texts.whole_numbers)
    ] = None  # fmt: skip

    @property
    def table(self) -> tuple[str, str] | None:
        """The option of the one table that is given, and its name; None without any. Raises InputError."""
        tables = [(key, value) for key, value in vars(self).items() if key in ("psd", "harmonic", "srs") and value]
        if len(tables) > 1:
            raise InputError("response: found several of --psd, --harmonic and --srs, expected one of them")
        kind = tables[0][0] if tables else None
        for key, of in (("q", "srs"), ("stress", "psd")):
            if getattr(self, key) is not None and kind != of:
                raise InputError(f"--{key}: belongs to --{of}")
        return tables[0] if tables else None


@dataclass(frozen=True, kw_only=True)
class Files(Keywords):
    """Where to write: `output`, a .csv or HDF5 file, and `figure`, a .png, .svg or .pdf."""

    output: Annotated[Name, Option("A .csv or HDF5 file.", "FILE", names=("-o", "--output"))] = None
    figure: Annotated[Name, Option("A .png, .svg or .pdf.", "FILE")] = None

    def check(self, comm, reads, progress, needed: int = 0, over: str | None = None):
        """Refuse early what cannot be written: responses, or a Campbell diagram `over` a parameter. Collective."""
        if self.output is not None:
            check_response_name(self.output, foreign=over is None)
            kind = kind_of_responses(self.output) if over is None else kind_of_campbell(self.output, over)
            check_outputs({self.output: kind}, comm, reads, progress=progress, needed=needed)
        check_figure(self.figure, comm, reads, progress)


@dataclass(frozen=True, kw_only=True)
class ResponseFiles(Files):
    """Where to write responses, also in files of other programs."""

    output: Annotated[
        Name, Option("Write the responses: .csv, .h5, .unv, .npz.", "FILE", names=("-o", "--output"))
    ] = None  # fmt: skip
