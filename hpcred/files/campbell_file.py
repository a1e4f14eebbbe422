"""Read and write files of Campbell diagrams, as HDF5 or .csv.

HDF5, with V values of a parameter and k modes (attributes: format "hpcred-campbell", version 1, parameter, unit,
highest in Hz):
values (V); poles (V, k), complex, in rad/s, and orbits (V, k), -1 to 1: NaN where a mode is not, or this is not known
orders (o); critical_speeds/order, mode, value, frequency, damping_ratio, whirl (c)
full/value, poles, residual (f): of the full model, a line a pole
stability (2): the first value where a pole is unstable, and its frequency in Hz, or empty
record: JSON with warnings, and what made it
The .csv has one line a value: parameter, its value in rpm where it is in rad/s, and of each mode the frequency in
Hz, the damping ratio and the orbit (f_1_hz, damping_1, orbit_1, ...).
"""

from dataclasses import fields

import numpy as np

from ..analysis.campbell_diagram import Campbell, CriticalSpeed, FullPoles
from .checked import Array
from .hdf5 import reading, texts, writing, written_by_one
from .outputs import OtherKind, hdf5_kind
from .text import write_table

FORMAT, VERSION = "hpcred-campbell", 1
CRITICAL = tuple(item.name for item in fields(CriticalSpeed))
SCHEMA = {
    "values": Array("real", ("v",), needed=True), "poles": Array("complex", ("v", "k"), needed=True),
    "orbits": Array("real", ("v", "k"), needed=True), "orders": Array("real", ("o",), needed=True),
    "critical_speeds/mode": Array("integer", ("c",)), "critical_speeds/whirl": Array("text", ("c",)),
    **{f"critical_speeds/{key}": Array("real", ("c",)) for key in CRITICAL if key not in ("mode", "whirl")},
    "full/value": Array("real", ("f",)), "full/poles": Array("complex", ("f",)), "full/residual": Array("real", ("f",)),
    "stability": Array("real", ("?",), needed=True), "record": Array("text", (), needed=True),
}  # fmt: skip


def kind_of_campbell(path, parameter: str) -> str | OtherKind:
    """Return what a file of a Campbell diagram with this name will be, see outputs.kind_of."""
    if not str(path).endswith(".csv"):
        return hdf5_kind(FORMAT)
    start = f"{parameter},".encode()
    return OtherKind(".csv file of a Campbell diagram",
                lambda begin: begin.startswith(start) and b"f_1_hz" in begin.splitlines()[0])  # fmt: skip


def write_campbell(path, diagram: Campbell, comm, record: dict | None = None) -> None:
    """Write a Campbell diagram as a .csv, or else as HDF5, whole or not at all. Collective.

    Parameters
    ----------
    path : str or PathLike
    diagram : Campbell
    comm : MPI communicator
    record : dict, optional
        What made it.

    Raises
    ------
    InputError, ComputationError
        If the file cannot be written.
    """
    if str(path).endswith(".csv"):
        written_by_one(path, comm, _write_csv, diagram)
        return
    with writing(path, comm, FORMAT, VERSION) as file:
        for key in ("parameter", "unit", "highest"):
            file.attribute(key, getattr(diagram, key))
        file.several({key: getattr(diagram, key) for key in ("values", "poles", "orbits")}, gaps=True)
        file.small("orders", np.array(diagram.orders, dtype=float))
        for key in CRITICAL if diagram.critical_speeds else ():
            file.small(f"critical_speeds/{key}", [getattr(entry, key) for entry in diagram.critical_speeds])
        if diagram.full:
            sizes = [len(entry.poles) for entry in diagram.full]
            file.small("full/value", np.repeat([entry.value for entry in diagram.full], sizes))
            file.small("full/poles", np.concatenate([entry.poles for entry in diagram.full]))
            file.small("full/residual", np.repeat([entry.residual for entry in diagram.full], sizes))
        limit = () if diagram.stability_limit is None else (diagram.stability_limit, diagram.unstable_frequency)
        file.small("stability", np.array(limit, dtype=float))
        file.small("record", {"warnings": list(diagram.warnings)} | (record or {}))


def _write_csv(path, diagram):
    columns = {diagram.parameter: diagram.values}
    if diagram.unit == "rad/s":
        columns["rpm"] = diagram.values * 30 / np.pi
    for k in range(diagram.poles.shape[1]):
        columns |= {f"f_{k + 1}_hz": diagram.frequencies[:, k], f"damping_{k + 1}": diagram.damping_ratios[:, k],
                    f"orbit_{k + 1}": diagram.orbits[:, k]}  # fmt: skip
    write_table(path, columns, 16)


def read_campbell(path) -> Campbell:
    """Read an HDF5 file of a Campbell diagram, on this rank.

    Parameters
    ----------
    path : str or PathLike

    Raises
    ------
    InputError
        For other files, and damaged ones.
    """
    with reading(path, FORMAT, VERSION, SCHEMA) as file:
        critical = ()
        if "critical_speeds" in file:
            columns = [texts(file[f"critical_speeds/{key}"]) if key == "whirl"
                       else file[f"critical_speeds/{key}"][...].tolist() for key in CRITICAL]  # fmt: skip
            critical = tuple(CriticalSpeed(**dict(zip(CRITICAL, row, strict=True)))
                             for row in zip(*columns, strict=True))  # fmt: skip
        full = ()
        if "full" in file:
            at, poles, residuals = (file[f"full/{key}"][...] for key in ("value", "poles", "residual"))
            full = tuple(FullPoles(value=value, poles=poles[at == value], residual=float(residuals[at == value].max()))
                         for value in np.unique(at).tolist())  # fmt: skip
        limit = [*file["stability"][...].tolist(), None, None][:2]
        return Campbell(
            parameter=file.attribute("parameter", str), unit=file.attribute("unit", str),
            highest=file.attribute("highest", float), orders=tuple(file["orders"][...].tolist()),
            **{key: file[key][...] for key in ("values", "poles", "orbits")}, critical_speeds=critical, full=full,
            stability_limit=limit[0], unstable_frequency=limit[1],
            warnings=tuple(file.table("record").get("warnings", ())),
        )  # fmt: skip
