"""Reduce all published models that are here: verdicts, coordinates, errors at fresh frequencies, seconds.

    python benchmarks/published.py [NAME ...] [--data FOLDER]

Where CalculiX is installed, FEDEM's knuckle stands beside CalculiX's own frequencies and beside Craig-Bampton with the
component modes of FEDEM's options; where a file has Hankel singular values, those of the reduced model are compared.
Writes published.json into the current folder.
"""

import argparse
import shutil
import sys
import time

import numpy as np
from common import finish
from models import MODELS, knuckle, slicot
from models.published import find

import hpcred

FRESH = 6  # random frequencies of the check, beside those near resonances
LOSS_FACTOR = 0.002  # with which hpcred measures undamped models
MODES = 5  # elastic ones of the knuckle


def reduced(made, model):
    """The reduction to a tolerance, its row, and the frequencies of its check."""
    start = time.process_time(), time.perf_counter()
    rom = made.reduce(model)
    seconds, wall = time.process_time() - start[0], time.perf_counter() - start[1]
    check = hpcred.check_reduced(rom, model, FRESH, seed=1)
    low, high = made.band
    row = {"model": made.name, "basis": f"tolerance {made.tolerance:g}", "dofs": model.size,
           "inputs": len(model.input_names), "band (Hz)": f"{low:g} to {high:g}", "coordinates": rom.size,
           "verdict": "reached" if rom.record.accuracy.reached else rom.record.accuracy.sentence,
           "largest error": max(check.measured), "processor s": seconds, "wall s": wall}  # fmt: skip
    return rom, row, check.frequencies


def craig_bampton(made, model, frequencies, count):
    """The same by component modes, so many with fixed interfaces; measured at the same frequencies."""
    settings = {"frame": hpcred.Buckens(), "damping": hpcred.Structural(LOSS_FACTOR)}
    with knuckle.with_interfaces(model) as jointed:
        start = time.process_time()
        rom = hpcred.reduce(jointed, hpcred.CraigBampton(count=count), **settings)
        seconds = time.process_time() - start
        full = hpcred.frequency_response(jointed, frequencies, **settings)
    error = hpcred.relative_error(full, rom.frequency_response(frequencies)).max()
    return rom, {"model": made.name, "basis": f"Craig-Bampton, {count} modes", "dofs": model.size,
                 "coordinates": rom.size, "largest error": float(error), "processor s": seconds}  # fmt: skip


def measured(made, folder):
    """The rows of a model."""
    path = made.path(folder)
    with made.model(folder=folder) as model:
        rom, row, frequencies = reduced(made, model)
        if made in slicot.MODELS:
            row |= hankel(path, rom)
        if made not in knuckle.MODELS:
            return [row]
        rows, own = [row], knuckle.frequencies(path, MODES + 6)[6:]
        row["frequencies"] = beside(own, rom)
        for count in (knuckle.fedem_modes(path), 3 * knuckle.fedem_modes(path)):
            other, theirs = craig_bampton(made, model, frequencies, count)
            rows.append(theirs | {"frequencies": beside(own, other)})
        return rows


def beside(own, rom):
    """The largest relative difference of the lowest frequencies from those of CalculiX."""
    return float(np.abs(rom.frequencies[:MODES] / own - 1).max())


def hankel(path, rom):
    """The largest difference of Hankel singular values from the published ones, beside the largest."""
    published = slicot.published_hankel_values(path)
    found = slicot.hankel_values(rom.M, rom.D, rom.K, rom.B, rom.C, rom.Cv)
    return {"Hankel values": float(np.abs(found - published[: len(found)]).max() / published[0])}


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="by default all whose files are here")
    parser.add_argument("--data", metavar="FOLDER", help="folder of the files; by default the shared data")
    given = parser.parse_args(arguments)
    without = set() if shutil.which("ccx") else {"knuckle"}
    here = [name for name, made in MODELS.items() if name not in without and find(made.file, given.data)]
    rows = []
    for name in given.names or here:
        try:
            rows += measured(MODELS[name], given.data)
        except hpcred.InputError as error:
            rows.append({"model": name, "verdict": f"refused: {error}"})
    if not rows:
        sys.exit("found no published models; HPCRED_SHARED_DATA names their folder (benchmarks/models)")
    finish("published", rows)


if __name__ == "__main__":
    main()
