"""Several result files of one model enter; their errors and pseudo-modes beside each other, and the model's, leave."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.linalg

from ..analysis.error import error_integral, relative_error
from ..analysis.frequency_response import frequency_response
from ..formats.hdf5 import atomic_output
from ..formats.locks import locks_given_back
from ..formats.outputs import CSV_OF_RESPONSES, PICTURES, check_outputs
from ..formats.result_file import read_basis, read_result
from ..linalg.blocks import apply, create_block, inner
from ..linalg.factorisation import Factoring
from ..model.damping import NoDamping
from ..parallel import startup
from ..parallel.failures import InputError, Owned, agreed
from ..parallel.progress import Progress
from ..reduction.interface_coordinates import elastic_part
from ..reduction.modes import Modes
from ..reduction.pseudo_modal import worst_pair
from ..reduction.reduce import reduce
from ..report.figures import error_figure
from .evaluate import SAME, band_of, factoring_of, frequencies_over, model_of_record

SAME_MODE = 1e-6  # relative difference of the frequencies of repeated modes


@locks_given_back()
def compare_results(
    results, full, *, frequencies=(), band=None, points: int = 61, modes: int = 10, output=None, figure=None,
    groups: int | None = None, factoring: Factoring | None = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Results of one model (names of files) against the model file `full`, which is solved once. Collective.

    They must have the same inputs, outputs, frame and damping. The other keywords are those of evaluate_result.
    `rows`: for each result its coordinates, size, largest eps (55), Q (57), and the worst pair of output and input
    (see analysis.error.worst_pair). `modes`: the lowest modes of the model (so many) and, for each result, the
    relative error of the frequency of its pseudo-mode with the largest modal assurance criterion,

        MAC = (phi^T M psi)^2 / (phi^T M phi psi^T M psi),

    which is given too where the file has its basis; for repeated modes it is the sum over them. `output`: a .csv of eps
    over the frequencies; `figure`: its picture. Raises InputError.
    """
    comm = comm or startup.start_mpi()
    results = [str(path) for path in results]
    labels = _labels(results)
    reduced = [elastic_part(read_result(path, comm).reduced) for path in results]
    _check_alike(results, reduced)
    first = reduced[0].record
    grid = frequencies_over(frequencies, band or band_of(reduced[0]), points)
    written = {output: CSV_OF_RESPONSES}
    if figure is not None:
        written |= {Path(figure).with_suffix(suffix): PICTURES[suffix] for suffix in (".png", ".svg")}
    check_outputs(written, comm, [*results, full], progress=progress)
    factoring = factoring or factoring_of(first)
    damped = not isinstance(first.damping, NoDamping)
    startup.start(preferred="complex" if damped else "real", low_rank=factoring.low_rank is not None)
    with model_of_record(full, first, results[0], comm) as model:
        known = frequency_response(
            model, grid, first.frame, first.damping, factoring=factoring, progress=progress, groups=groups
        )
        shapes = _modes(model, first, modes, results, reduced, factoring, progress)
    rows, curves = [], []
    for label, item in zip(labels, reduced, strict=True):
        found = frequency_response(item, grid)
        eps = relative_error(known, found)
        i, j, error = worst_pair(known, found)
        curves.append((label, eps))
        rows.append({
            "result": label, "coordinates": item.record.coordinates, "size": item.size,
            "largest eps": float(eps.max()), "Q": error_integral(grid, eps),
            "worst pair": f"{item.output_names[i]} / {item.input_names[j]}", "its error": error,
        })  # fmt: skip
    report = {"full": str(full), "frequencies_hz": grid.tolist(), "rows": rows, "modes": shapes,
              "eps": {label: eps.tolist() for label, eps in curves}}  # fmt: skip
    if output is not None:
        with atomic_output(output, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                table = np.array([grid, *(eps for _, eps in curves)]).T
                head = ",".join(["f_hz", *(f"eps_{label}" for label in labels)])
                np.savetxt(temporary, table, "%.10e", ",", header=head, comments="")
    if figure is not None:
        with agreed(comm):
            if comm.rank == 0:
                error_figure(Path(figure).with_suffix(""), grid, curves, first.model)
    return report


def _labels(results):
    """Short names of the files, each once."""
    names = [Path(path).stem for path in results]
    return names if len(set(names)) == len(names) else results


def _check_alike(results, reduced):
    """Refuse results that do not answer the same question."""
    if len(set(results)) < len(results) or len(results) < 2:
        raise InputError(f"results: found {', '.join(results)}, expected two or more, each once")
    for path, item in zip(results, reduced, strict=True):
        if item.record is None:
            raise InputError(f"{path}: has no record of its reduction, which a comparison needs; reduce again")
    first = reduced[0].record
    for path, item in zip(results[1:], reduced[1:], strict=True):
        record = item.record
        for key in ("inputs", "outputs", "frame", "damping", "size"):
            mine, other = getattr(first, key), getattr(record, key)
            if mine != other:
                raise InputError(
                    f"{path}: its {key} are {other}, but those of {results[0]} are {mine}; compare results of one "
                    "model with the same loads and frame"
                )
        for key, expected in first.signature.items():
            values = np.array(record.signature.get(key, ()))
            scale = np.abs(expected).max(initial=0.0)
            if values.shape != np.shape(expected) or np.abs(values - expected).max(initial=0.0) > SAME * scale:
                raise InputError(f"{path}: was reduced from another model than {results[0]} (its {key} differs)")


def _modes(model, record, count, results, reduced, factoring, progress):
    """Rows of the lowest modes of the model and what each result has for them. Collective."""
    rigid = record.rigid_body_modes
    count = min(count, model.size - rigid)
    labels = _labels(results)
    with reduce(model, [Modes(count=count)], record.frame, factoring=factoring, progress=progress) as reference:
        rows = [{"mode": i + 1, "f (Hz)": float(f)} for i, f in enumerate(reference.frequencies)]
        with Owned(model.comm) as owned:
            momentum = owned.owns(create_block(model.M, len(rows)))
            apply(model.M, reference.columns, momentum)
            for path, label, item in zip(results, labels, reduced, strict=True):
                basis = None if item.record.projection == "two_sided" else read_basis(path, model)
                share = None
                if basis is not None:
                    whole = read_result(path, model.comm).reduced
                    X = scipy.linalg.eigh(whole.K, whole.M)[1][:, whole.size - item.size :]
                    share = (inner(momentum, owned.owns(basis)) @ X) ** 2
                for cluster in _clusters(reference.frequencies):
                    best, value = _nearest(reference.frequencies[cluster], item.frequencies,
                                           None if share is None else share[cluster])  # fmt: skip
                    for i, j in zip(cluster, best, strict=True):
                        rows[i][f"{label} error"] = float(item.frequencies[j] / reference.frequencies[i] - 1)
                        if share is not None:
                            rows[i][f"{label} MAC"] = float(value[j])
    return rows


def _clusters(frequencies):
    """The places of equal frequencies, whose modes may be mixed in any way."""
    new = np.flatnonzero(np.diff(frequencies) > SAME_MODE * frequencies[1:]) + 1
    return np.split(np.arange(len(frequencies)), new)


def _nearest(frequencies, own, share):
    """The pseudo-mode (of frequencies `own`) for each of the equal modes, and the MAC of all with these modes.

    `share` (modes, pseudo-modes): MAC with each; without it the nearest frequencies count.
    """
    if share is None:
        return np.sort(np.argsort(np.abs(own - frequencies[0]), kind="stable")[: len(frequencies)]), None
    value = share.sum(axis=0)
    return np.sort(np.argsort(-value, kind="stable")[: len(frequencies)]), value
