"""Compute the response of a result to random, harmonic and shock loads of a table, into a .csv and a figure."""

from __future__ import annotations

import csv

import numpy as np

from ..analysis.frequency_response import resonances_of
from ..analysis.random_loads import harmonic_response, random_response
from ..analysis.shock import damping_ratio, require_size, shock_spectrum, time_response
from ..files.hdf5 import written_by_one
from ..files.outputs import CSV_OF_RESPONSES, check_outputs
from ..files.result_file import result_at
from ..files.together import together
from ..model.units import unit_of_output
from ..parallel.declared import flattened
from ..parallel.failures import InputError, agreed
from ..parallel.ranges import require_band
from ..readers.drive_table import read_drive_table, unit_of_density, units_of_inputs
from ..report.figures import driven_figure, kind_of_figure
from .keywords import At, Drive, Name, Numbers
from .pair_figures import check_figure
from .workflow import workflow

AT_REST = 1e-2  # of an amplitude that has died away
FAR_BELOW = 1e-2  # of the lowest oscillator: resonances below are as rigid-body motions to it
SPECTRUM = np.geomspace(10.0, 2000.0, 93)  # Hz, twelve an octave
TITLES = {"psd": "one-sided densities", "harmonic": "harmonic response", "srs": "shock response spectra, maximax"}


@workflow
@flattened
def driven_response(
    result, *, drive: Drive, band: Numbers = None, output: Name = None, figure: Name = None, at: At = None, comm=None,
    progress=None,
) -> dict:  # fmt: skip
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
    figure : str or PathLike, optional
        A .png, .svg or .pdf.
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
    # what does not go together, and what cannot be written, is refused before anything is computed
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
    check_figure(figure, comm, [result, table], progress)
    # curves (name, unit, values (F,)) over frequencies (F,), and a row for each
    taken = result_at(result, at, comm)
    with agreed(comm):
        loads = read_drive_table(table, taken.reduced, "time" if kind == "srs" else kind)
        if kind == "psd":
            modes = None if drive.stress is None else taken.stress_modes(drive.stress)
            f, curves, rows = _random(taken.reduced, loads, band, modes)
        elif kind == "harmonic":
            f, curves, rows = _harmonic(taken.reduced, loads)
        else:
            f, curves, rows = _shock(taken.reduced, loads, SPECTRUM if band is None else
                                     np.geomspace(*band, len(SPECTRUM)), drive.q)  # fmt: skip
    warnings = []
    accuracy = None if taken.reduced.record is None else taken.reduced.record.accuracy
    highest = loads.over[-1] if band is None else band[1]
    if kind != "srs" and accuracy is not None and highest > accuracy.band[1] * (1 + 1e-9):
        warnings.append(f"{table if band is None else 'the band'} reaches to {highest:g} Hz, and the accuracy of "
                        f"{result} is known to {accuracy.band[1]:g} Hz")  # fmt: skip
    with together(comm):
        if output is not None:
            written_by_one(output, comm, _write, f, curves)
        if figure is not None:
            written_by_one(figure, comm, driven_figure, f, curves, f"{result}: {TITLES[kind]}", kind_of_figure(figure))
    return {"result": str(result), "kind": kind, "rows": rows, "warnings": warnings, "output": output and str(output),
            "figure": figure and str(figure)}  # fmt: skip


def _random(reduced, loads, band, modes):
    response = random_response(reduced, loads.over, loads.values, band=band, orders=loads.orders, stress=modes)
    units = [unit_of_output(name) or "1" for name in reduced.output_names]
    units += ["Pa"] * (len(response.names) - len(units))  # of stresses
    rows = [{"output": name, "RMS": rms, "unit": unit}
            for name, rms, unit in zip(response.names, response.rms, units, strict=True)]  # fmt: skip
    curves = zip(response.names, map(unit_of_density, units), response.psd.T, strict=True)
    return response.frequencies, list(curves), rows


def _harmonic(reduced, loads):
    response = harmonic_response(reduced, loads.over, loads.values, orders=loads.orders)
    curves = [(name, unit_of_output(name) or "1", values)
              for name, values in zip(reduced.output_names, response.T, strict=True)]  # fmt: skip
    most = np.abs(response).argmax(axis=0)
    rows = [{"output": name, "amplitude": abs(values[k]), "unit": unit, "f (Hz)": loads.over[k]}
            for (name, unit, values), k in zip(curves, most, strict=True)]  # fmt: skip
    return loads.over, curves, rows


def _shock(reduced, loads, spectrum, q):
    t = _instants(reduced, loads.over, spectrum, q)
    inputs = loads.at(t)
    # accelerations of bases that move, and outputs that are accelerations
    histories = list(zip(reduced.input_names, units_of_inputs(reduced), inputs.T, strict=True))
    histories = [history for history in histories if history[2].any()]
    histories += [(name, unit_of_output(name), values)
                  for name, values in zip(reduced.output_names, time_response(reduced, t, inputs).T, strict=True)]
    curves, rows = [], []
    for name, unit, values in histories:
        if unit.endswith("/s^2"):
            curves.append((f"{name} SRS", unit, shock_spectrum(t, values, spectrum, q=q).maximax))
            rows.append({"of": name, "largest": np.abs(values).max(), "largest of SRS": curves[-1][2].max(),
                         "unit": unit})  # fmt: skip
    return spectrum, curves, rows


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
    require_size(reduced, count, step)
    return over[0] + step * np.arange(int(count))


def _write(path, f, curves):
    """Write a .csv with a column for each curve, and one of the phase where it is complex."""
    columns = {"f_hz": f}
    for name, unit, values in curves:
        columns[f"{name} [{unit}]"] = np.abs(values)
        if np.iscomplexobj(values):
            columns[f"{name} phase [deg]"] = np.angle(values, deg=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())
