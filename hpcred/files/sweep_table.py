"""Write the table of a sweep as .csv, .json or HDF5.

HDF5 (attributes: format "hpcred-sweep", version 1), with k runs: columns/<name> (k), numbers (not a number where there
is none) or texts; curves/<run>/frequencies (F) in Hz and curves/<run>/eps (F), where they are known.
The .csv has one line a run, empty where there is nothing; the .json the same rows, null where there is nothing.
"""

import csv
import json
import os

import numpy as np

from ..parallel.failures import InputError
from .hdf5 import atomic_output, writing
from .outputs import JSON, check_outputs, hdf5_kind

FORMAT, VERSION = "hpcred-sweep", 1
ENDINGS = (".csv", ".json", ".h5", ".hdf5")


def check_table_name(path, comm):
    """Raise InputError unless the name ends as one of the formats and the table may be written there. Collective."""
    if not str(path).endswith(ENDINGS):
        raise InputError(f"output {path}: expected a name that ends in {', '.join(ENDINGS)}")
    kinds = {".csv": ".csv table of run", ".json": JSON}
    check_outputs({path: kinds.get(os.path.splitext(path)[1], hdf5_kind(FORMAT))}, comm)


def write_sweep_table(path, rows: list[dict], curves: dict, comm):
    """Write rows with the same keys, and `curves` {run: (frequencies, eps)}. On one rank. Raises InputError."""
    if str(path).endswith((".h5", ".hdf5")):
        with writing(path, comm, FORMAT, VERSION) as file:
            for key in rows[0]:
                file.small(f"columns/{key}", _column([row[key] for row in rows]), gaps=True)
            for name, (frequencies, eps) in curves.items():
                file.small(f"curves/{name}/frequencies", np.asarray(frequencies, dtype=float))
                file.small(f"curves/{name}/eps", np.asarray(eps, dtype=float), gaps=True)
        return
    with atomic_output(path, comm) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        if str(path).endswith(".json"):
            json.dump(rows, file, indent=1)
            file.write("\n")
        else:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def _column(values):
    if all(value is None or isinstance(value, (int, float)) for value in values):
        return np.array([np.nan if value is None else float(value) for value in values])
    return ["" if value is None else str(value) for value in values]
