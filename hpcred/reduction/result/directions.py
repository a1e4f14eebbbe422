"""Tabulate the accuracy of each output by itself, by the measure of directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .measure import IDLE, TINY, Directions


@dataclass(frozen=True, kw_only=True)
class Direction:
    """The accuracy of an output: its response to an `input` in SI units at the lowest frequency of the band (`static`),
    the error of that (`static_error`); and the `largest` error of its responses over the band, its place (`frequency`,
    Hz) and input (`worst_input`). The `input` acts where the output measures, at the drive point, or else has the
    largest response."""

    output: str
    input: str
    static: float
    static_error: float
    largest: float
    frequency: float
    worst_input: str


def directions_table(by: Directions, frequencies, errors, worst, first, outputs, inputs) -> tuple[Direction, ...]:
    """Return the accuracy of each of the `outputs` under the `inputs` (names), the least accurate output first.

    `errors` (S, r): of the outputs by the measure at frequencies (S,) in Hz, under the inputs `worst` (S, r); `first`:
    errors and responses at the first of these, both (r, p).
    """
    errors, table = np.where(np.isnan(errors), np.inf, errors), []
    (static, H), g = first, np.sqrt(np.maximum(by.inputs, TINY))
    for j, k in enumerate(errors.argmax(axis=0)):
        i = by.drive[j] if by.drive[j] >= 0 else int((np.abs(H[j]) / g).argmax())
        table.append(Direction(
            output=outputs[j], input=inputs[i], static=float(abs(H[j, i])), static_error=float(min(static[j, i], IDLE)),
            largest=float(min(errors[k, j], IDLE)), frequency=float(frequencies[k]), worst_input=inputs[worst[k, j]],
        ))  # fmt: skip
    return tuple(sorted(table, key=lambda direction: -direction.largest))


def worst_of_directions(directions) -> str:
    """Return the least accurate output and its error as text; "" where nothing is known."""
    return "".join(f"{worst.output}: {worst.largest:.2g} at {worst.frequency:.6g} Hz" for worst in directions[:1])


def rows_of_directions(directions, band) -> list[dict]:
    """Return rows of a table, the least accurate output first; `band` (Hz)."""
    at = "0 Hz" if band[0] == 0 else f"{band[0]:.6g} Hz"
    rows = []
    for direction in directions:
        row = {"direction": direction.output, f"|H| at {at}": direction.static, "error there": direction.static_error,
               "largest error": direction.largest, "at (Hz)": direction.frequency}  # fmt: skip
        if any(other.input != other.output for other in directions):
            row["input"] = direction.input
        if any(other.worst_input != other.input for other in directions):
            row["worst under"] = direction.worst_input
        rows.append(row)
    return rows
