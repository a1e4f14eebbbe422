"""Read and write files of frequency responses, as HDF5 or .csv.

HDF5, with F frequencies, r outputs and p inputs (attributes: format "hpcred-response", version 1):
frequencies (F) in Hz, ascending; input_names (p), output_names (r), such as 20:z
response (F, r, p), complex: of a full model, from `hpcred response`
reduced (F, r, p), full (F, r, p), complex: of a reduced model, and of its full model by factorising, from `evaluate`
drive (F, p): beside `full`, its responses where the inputs act
eps (F): relative error, estimated beside `response`, measured beside `full`
record: JSON with what is known of the error, and what made it
The .csv has one line a frequency: f_hz, then for every pair of an output and an input, such as 20:z/1:x, its
real and imaginary part (re_20:z/1:x, im_20:z/1:x) or magnitude and phase in degrees (abs_..., deg_...); last eps.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..fe.dofs import node_of
from ..model.second_order_model import listed
from ..parallel.failures import ComputationError, InputError, agreed
from .checked import Array
from .frf_file import write_frf
from .hdf5 import reading, texts, writing, written_by_one
from .names import FileNames
from .outputs import CSV_OF_RESPONSES, UFF, ZIP, hdf5_kind
from .text import write_table

FORMAT, VERSION = "hpcred-response", 1
RESPONSES = ("response", "reduced", "full")
FOREIGN = {".unv": UFF, ".uff": UFF, ".npz": ZIP}
ARRAYS = (*RESPONSES, "drive", "eps")
SCHEMA = {
    "frequencies": Array("real", ("f",), needed=True), "eps": Array("real", ("f",)),
    "input_names": Array("text", ("p",), needed=True), "output_names": Array("text", ("r",), needed=True),
    **{key: Array("complex", ("f", "r", "p")) for key in RESPONSES}, "drive": Array("complex", ("f", "p")),
    "record": Array("text", (), needed=True),
}  # fmt: skip


@dataclass(eq=False, kw_only=True)
class Responses:
    """What a file of responses contains; None for what is not there.

    Attributes
    ----------
    frequencies : ndarray, shape (F,)
        Hz, ascending.
    input_names, output_names : tuple of str
        Of the p inputs and r outputs, such as 20:z.
    response : ndarray, complex, shape (F, r, p), or None
        Of a full model, from `hpcred response`.
    reduced, full : ndarray, complex, shape (F, r, p), or None
        Of a reduced model, and of its full model, from `hpcred evaluate`.
    drive : ndarray, complex, shape (F, p), or None
        Beside `full`, its responses where the inputs act.
    eps : ndarray, shape (F,), or None
        The relative error, estimated beside `response`, measured beside `full`.
    record : dict
        What is known of the error, and what made it.
    places : dict or None
        Number and position (3,) in m of nodes by name, for files of other programs.
    """

    frequencies: np.ndarray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    response: np.ndarray | None = None
    reduced: np.ndarray | None = None
    full: np.ndarray | None = None
    drive: np.ndarray | None = None
    eps: np.ndarray | None = None
    record: dict = field(default_factory=dict)
    places: dict[str, tuple[int, np.ndarray]] | None = None

    @property
    def pairs(self) -> list[tuple[str, int, int]]:
        """Name, output and input of every pair."""
        return [(f"{output}/{input_}", i, j) for i, output in enumerate(self.output_names)
                for j, input_ in enumerate(self.input_names)]  # fmt: skip

    def of_forces(self) -> Responses:
        """Return those to forces, as other programs take all inputs, without those to accelerations of bases, which are
        `moves` of the record. Raises InputError where nothing is left."""
        moves = self.record.get("moves", ())
        kept = [j for j, name in enumerate(self.input_names) if name not in moves]
        if not kept:
            raise InputError(f"found no input but {listed(moves)}, accelerations of bases, where forces are expected; "
                             "take .csv or .h5")  # fmt: skip
        curves = {key: array[..., kept] for key in (*RESPONSES, "drive") if (array := getattr(self, key)) is not None}
        return replace(self, input_names=tuple(self.input_names[j] for j in kept), **curves)


def check_response_name(path, foreign=True):
    """Raise InputError unless the name ends as one of the formats; `foreign`: also as those of other programs."""
    *endings, last = (".csv", ".h5", ".hdf5", *(FOREIGN if foreign else ()))
    if not str(path).endswith((*endings, last)):
        raise InputError(f"output {path}: expected a name that ends in {', '.join(endings)} or {last}")


def lost_channels(path, responses) -> list[str]:
    """Return a warning of inputs and outputs that a file with this name will not have."""
    if not str(path).endswith(tuple(FOREIGN)):
        return []
    moves = responses.record.get("moves", ())
    told = [f"{path} leaves out {listed(moves)}, accelerations of bases, since its inputs are forces"] if moves else []
    lost = [name for name in dict.fromkeys((*responses.output_names, *responses.input_names))
            if name not in moves and node_of(name) is None]  # fmt: skip
    if lost and not str(path).endswith(".npz"):
        told.append(f"{path} leaves out {listed(lost)}, which belong to no node; .npz has them")
    return told


def kind_of_responses(path) -> str:
    """What a file of responses with this name will be, see outputs.kind_of."""
    kinds = {".csv": CSV_OF_RESPONSES, **FOREIGN}
    return next((kind for ending, kind in kinds.items() if str(path).endswith(ending)), hdf5_kind(FORMAT))


def write_responses(path, responses: Responses, comm, polar=False) -> None:
    """Write responses as a .csv, or else as HDF5, whole or not at all. Collective.

    Parameters
    ----------
    path : str or PathLike
    responses : Responses
    comm : MPI communicator
    polar : bool
        Magnitude and phase in place of real and imaginary parts in a .csv.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with agreed(comm):
        _require_numbers(path, responses)
    if str(path).endswith(".csv"):
        written_by_one(path, comm, _write_csv, responses, polar)
        return
    if str(path).endswith(tuple(FOREIGN)):
        with agreed(comm):
            known = responses.of_forces()
        H = next(array for key in RESPONSES if (array := getattr(known, key)) is not None)
        written_by_one(path, comm, write_frf, known, H, str(path).endswith(".npz"))
        return
    with writing(path, comm, FORMAT, VERSION) as file:
        file.several({"frequencies": responses.frequencies, "input_names": list(responses.input_names),
                      "output_names": list(responses.output_names), "record": responses.record,
                      **{key: getattr(responses, key) for key in ARRAYS}})  # fmt: skip


def _require_numbers(path, responses):
    """Raise ComputationError for numbers that are not finite, as HDF5 files do, and InputError for one frequency where
    there have to be more."""
    for key in RESPONSES:
        values = getattr(responses, key)
        if values is not None and not np.isfinite(values).all():
            bad, size = np.count_nonzero(~np.isfinite(values)), np.size(values)
            raise ComputationError(f"{path}: {key} has {bad} of {size} numbers that are not finite, and is not written")
    if FOREIGN.get(Path(path).suffix) == UFF and len(responses.frequencies) < 2:
        raise InputError(f"output {path}: found one frequency, of which pyuff writes no universal file; expected more, "
                         "or a name that ends in .npz")  # fmt: skip


def _write_csv(path, responses, polar):
    keys = [key for key in RESPONSES if getattr(responses, key) is not None]
    columns, once = {"f_hz": responses.frequencies}, FileNames()
    for key in keys:
        values = getattr(responses, key)
        tail = "" if len(keys) == 1 else f"_{key}"
        for name, i, j in responses.pairs:
            name, H = once.of_column(f"{name}{tail}"), values[:, i, j]
            if polar:
                columns |= {f"abs_{name}": np.abs(H), f"deg_{name}": np.angle(H, deg=True)}
            else:
                columns |= {f"re_{name}": H.real, f"im_{name}": H.imag}
    if responses.eps is not None:
        columns["eps"] = responses.eps
    head = io.StringIO()
    csv.writer(head, lineterminator="").writerow(columns)  # names of a user may have commas
    write_table(path, columns, 16, head.getvalue())


def read_responses(path) -> Responses:
    """Read an HDF5 file of responses, on this rank.

    Parameters
    ----------
    path : str or PathLike

    Raises
    ------
    InputError
        For a file that has none, or is damaged.
    """
    with reading(path, FORMAT, VERSION, SCHEMA) as file:
        return Responses(
            frequencies=file["frequencies"][...], record=file.table("record"),
            input_names=tuple(texts(file["input_names"])), output_names=tuple(texts(file["output_names"])),
            **{key: file[key][...] for key in ARRAYS if key in file},
        )  # fmt: skip
