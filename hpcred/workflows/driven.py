"""Compute the response of a result to random, harmonic and shock loads of a table, into a .csv."""

from __future__ import annotations

import csv

import numpy as np

from ..analysis.frequency_response import resonances_of
from ..analysis.random_loads import harmonic_response, random_response
from ..analysis.shock import damping_ratio, shock_spectrum, time_response
from ..files.drive_table import quantity_of_input, read_drive_table, unit_of_density
from ..files.hdf5 import atomic_output
from ..files.outputs import CSV_OF_RESPONSES, check_outputs
from ..files.result_file import result_at
from ..model.outputs.cuts import cut_output_of
from ..model.outputs.stresses import stress_output_of
from ..parallel.declared import flattened
from ..parallel.failures import InputError, agreed
from ..parallel.ranges import require_band
from .keywords import At, Drive, Name, Numbers
from .workflow import workflow

AT_REST = 1e-2  # of an amplitude that has died away
FAR_BELOW = 1e-2  # of the lowest oscillator: resonances below are as rigid-body motions to it
MOST = 100_000_000  # numbers of the states of a response over time
SPECTRUM = np.geomspace(10.0, 2000.0, 93)  # Hz, twelve an octave


@workflow
@flattened
def driven_response(
    result, *, drive: Drive, band: Numbers = None, output: Name = None, at: At = None, comm=None, progress=None
) -> dict:
    """Return the response of a result to what drives it: see docs/driven.md. Collective.

    Parameters
    ----------
    result : str or PathLike
        A result.h5.
    psd, harmonic, srs : str or PathLike, optional
        One table, as the page "What drives a body" has it: densities, amplitudes, or accelerations over time.
    q : float, optional
        Of the oscillators of shock spectra, by default 10.
    stress : sequence of int, optional
        Nodes whose stresses are outputs under random loads.
    band : sequence of 2 floats, optional
        Hz, of random loads, by default that of the table, or of shock spectra, by default 10 to 2000.
    output : str or PathLike, optional
        A .csv.
    at : dict of float, optional
        Values of the parameters by name.

    Returns
    -------
    dict
        Rows of a table; `rows` with the RMS, amplitude or largest value of each output.

    Raises
    ------
    InputError
        For tables that do not fit the result.
    """
    if drive.table is None:
        raise InputError("response: found none of psd, harmonic and srs, expected one of them")
    kind, table = drive.table
    if kind == "harmonic" and band is not None:
        raise InputError("--band: belongs to --psd or --srs; harmonic loads act at the frequencies of their table")
    require_band("band", band)
    if kind == "srs" and band is not None and band[0] <= 0:
        raise InputError(f"--band: found {band[0]:g} Hz, expected frequencies of oscillators above 0 Hz")
    if output is not None:
        if not str(output).endswith(".csv"):
            raise InputError(f"output {output}: expected a name that ends in .csv")
        check_outputs({output: CSV_OF_RESPONSES}, comm, [result, table], progress=progress)
    taken = result_at(result, at, comm)
    reduced = taken.reduced
    with agreed(comm):
        loads = read_drive_table(table, reduced, "time" if kind == "srs" else kind)
        columns, rows = {}, []
        if kind == "psd":
            modes = None if drive.stress is None else taken.stress_modes(drive.stress)
            found = random_response(reduced, loads.over, loads.values, band=band, orders=loads.orders, stress=modes)
            columns["f_hz"] = found.frequencies
            for name, density, rms in zip(found.names, found.psd.T, found.rms, strict=True):
                unit = unit_of_output(name)
                columns[f"{name} [{unit_of_density(unit)}]"] = density
                rows.append({"output": name, "RMS": rms, "unit": unit})
        elif kind == "harmonic":
            found = harmonic_response(reduced, loads.over, loads.values, orders=loads.orders)
            columns["f_hz"] = loads.over
            for name, values in zip(reduced.output_names, found.T, strict=True):
                unit, most = unit_of_output(name), int(np.abs(values).argmax())
                columns[f"{name} [{unit}]"], columns[f"{name} phase [deg]"] = np.abs(values), np.angle(values, deg=True)
                rows.append({"output": name, "amplitude": abs(values[most]), "unit": unit, "f (Hz)": loads.over[most]})
        else:
            spectrum = SPECTRUM if band is None else np.geomspace(*band, len(SPECTRUM))
            t = _instants(reduced, loads.over, spectrum, drive.q)
            inputs = np.column_stack([np.interp(t, loads.over, column, right=0.0) for column in loads.values.T])
            moved = [j for j in np.flatnonzero(inputs.any(axis=0))
                     if quantity_of_input(reduced, reduced.input_names[j]) == "an acceleration"]  # fmt: skip
            histories = {reduced.input_names[j]: inputs[:, j] for j in moved}
            responses = zip(reduced.output_names, time_response(reduced, t, inputs).T, strict=True)
            histories |= {name: y for name, y in responses if unit_of_output(name) == "m/s^2"}
            columns["f_hz"] = spectrum
            for name, history in histories.items():
                columns[f"{name} SRS [m/s^2]"] = shock_spectrum(t, history, spectrum, q=drive.q).maximax
                rows.append({"of": name, "largest (m/s^2)": np.abs(history).max(),
                             "largest of SRS (m/s^2)": columns[f"{name} SRS [m/s^2]"].max()})  # fmt: skip
    warnings = []
    accuracy = None if reduced.record is None else reduced.record.accuracy
    highest = loads.over[-1] if band is None else band[1]
    if kind != "srs" and accuracy is not None and highest > accuracy.band[1] * (1 + 1e-9):
        warnings.append(f"{table if band is None else 'the band'} reaches to {highest:g} Hz, and the accuracy of "
                        f"{result} is known to {accuracy.band[1]:g} Hz")  # fmt: skip
    if output is not None:
        with atomic_output(output, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                with open(temporary, "w", newline="", encoding="utf-8") as file:
                    writer = csv.writer(file, lineterminator="\n")
                    writer.writerow(columns)
                    writer.writerows(np.column_stack(list(columns.values())).tolist())
    return {"result": str(result), "kind": kind, "rows": rows, "warnings": warnings, "output": output and str(output)}


def _instants(reduced, over, spectrum, q) -> np.ndarray:
    """Return instants (n,) in equal steps over the times of a table, and on until the body has come to rest, or
    oscillators that ring with it have reached their largest acceleration. Raises InputError for too many."""
    at, ratios = resonances_of(reduced)
    at, ratios = at[at > FAR_BELOW * spectrum[0]], ratios[at > FAR_BELOW * spectrum[0]]
    after = 0.0
    if len(at):
        decay = 2 * np.pi * max((at * ratios).min(), spectrum[0] * damping_ratio(q))
        after = np.log(1 / AT_REST) / decay + 1 / at.min()
    step = min(np.diff(over).min(), 1 / (32 * spectrum[-1]))
    with np.errstate(over="ignore"):
        count = np.ceil((over[-1] - over[0] + after) / step) + 2
    if 2 * reduced.size * count > MOST:
        raise InputError(f"t [s]: {count:.3g} equal steps of {step:.3g} s are needed, expected at most "
                         f"{MOST // (2 * reduced.size)}; leave out instants that follow each other more closely than "
                         "others, or begin the band higher")  # fmt: skip
    return over[0] + step * np.arange(int(count))


def unit_of_output(name: str) -> str:
    """Return the SI unit of an output by its name, 1 where it is not known."""
    if (cut := cut_output_of(name)) is not None:
        return "N" if cut.component[0] == "f" else "N m"
    node, _, last = name.rpartition(":")
    if stress_output_of(name) is not None or last in ("xx", "yy", "zz", "xy", "yz", "zx", "mises"):
        return "Pa"
    if last not in ("x", "y", "z", "rx", "ry", "rz") or not node:
        return "1"
    rate = "/s^2" if "acceleration " in node else "/s" if "velocity " in node else ""
    return ("rad" if last.startswith("r") else "m") + rate
