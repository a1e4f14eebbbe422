"""Draw a figure of every pair of output and input, with the responses of several models and their relative error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..files.hdf5 import written_by_one
from ..files.names import FileNames
from ..files.outputs import PICTURES, check_outputs
from ..parallel.failures import InputError, agreed
from ..report.figures import FIGURES, kind_of_figure, new_figure, pair_figure

ZERO = 1e-12  # of the largest response, below which one is round-off


def check_figure(path, comm, reads, progress=None, endings=FIGURES):
    """Refuse early what cannot be drawn or written; None is no figure. Collective. Raises InputError."""
    if path is not None:
        check_outputs({path: PICTURES[f".{kind_of_figure(path, endings)}"]}, comm, reads, progress=progress)
        check_drawing(comm)


def check_drawing(comm):
    """Refuse early where there is no matplotlib. Collective. Raises InputError."""
    with agreed(comm):
        new_figure()


def figures_of_pairs(path, outputs, inputs, responses, comm, pairs, loads=()) -> list[str]:
    """Draw the responses of `outputs` (r) to `inputs` (p), by name, of `pairs` of their places. Collective.

    `responses`: (label, frequencies (F,) in Hz, complex (F, r, p)), the reduced one first; where a second one is at
    some of its frequencies, the difference of the two relative to the second is drawn too. A single pair is
    drawn as `path`, several under names with the pair in them. `loads`: see unit_of_response. Returns the names of the
    files.
    """
    path, written, names = Path(path), [], FileNames()
    alone = len(pairs) == 1
    for i, j in pairs:
        name = f"{outputs[i]}-{inputs[j]}"
        target = path if alone else path.with_name(f"{path.stem}_{names.of(name)}{path.suffix}")
        curves = [(label, f, values[:, i, j]) for label, f, values in responses]
        written_by_one(target, comm, pair_figure, curves, outputs[i], inputs[j], _errors(*curves), loads,
                       kind_of_figure(target))  # fmt: skip
        written.append(str(target))
    return written


def pairs_by_name(wanted, outputs, inputs, where) -> list[tuple[int, int]]:
    """Return output and input (from 0) of pairs named output/input, such as 20:z/1:x. Raises InputError for others;
    `where` names the result."""
    known = {f"{output}/{input_}": (i, j) for i, output in enumerate(outputs) for j, input_ in enumerate(inputs)}
    for name in wanted:
        if name not in known:
            first = next(iter(known))
            raise InputError(f"pairs: found '{name}', expected output/input of {where}, such as {first}")
    return [known[name] for name in wanted]


def pairs_to_show(H, outputs, inputs, most=None) -> list[tuple[int, int]]:
    """Return output and input (from 0) of the `most` largest responses of H (F, r, p), or of all, in their order:
    without those that are zero to round-off, and of a symmetric H with one of the two that are equal."""
    size = np.abs(H).max(axis=0)
    reciprocal = tuple(inputs) == tuple(outputs) and np.allclose(
        H, H.transpose(0, 2, 1), rtol=1e-6, atol=1e-6 * size.max()
    )
    pairs = [(i, j) for i in range(len(outputs)) for j in range(len(inputs))
             if size[i, j] > ZERO * size.max() and (i <= j or not reciprocal)]  # fmt: skip
    largest = set(sorted(pairs, key=lambda pair: -size[pair])[:most])
    return [pair for pair in pairs if pair in largest]


def _errors(reduced, full=None):
    """Return the relative error of curves (label, frequencies, values) at the frequencies of the full model, if there
    is one."""
    if full is None:
        return []
    _, frequencies, values = full
    size = np.abs(values)
    difference = np.abs(reduced[2][np.searchsorted(reduced[1], frequencies)] - values)
    error = np.divide(difference, size, out=np.full(len(size), np.nan), where=size > 0)
    return [("of this pair, measured", frequencies, error)]

