"""Limit the numbers of inputs and outputs by the memory of their columns and responses, before the computation."""

from __future__ import annotations

from ..parallel.failures import InputError
from ..parallel.memory import MB, available_mb

BLOCKS = 4  # as large as B that are there at once
LITTLE_MB = 64  # which is always there
FREQUENCIES = 350  # at which a search has all responses at once


def require_room(model, frequencies: int = FREQUENCIES):
    """Raise InputError where the columns of B, or the responses of all pairs of inputs and outputs at so many
    frequencies, take more memory than there is. Collective."""
    inputs, outputs = len(model.input_names), len(model.output_names)
    rows = max(model.comm.allgather(model.local_rows))
    columns, pairs = BLOCKS * 8 * rows * inputs / MB, 16 * frequencies * inputs * outputs / MB
    if columns + pairs > LITTLE_MB and columns + pairs > (there := available_mb(model.comm)):
        raise InputError(
            f"{model.name}: found {inputs} inputs and {outputs} outputs: columns take {columns:.0f} MB of a rank, "
            f"their {inputs * outputs} responses at {frequencies} frequencies {pairs:.0f} MB, and {there:.0f} MB "
            "are free; name fewer, such as those of interface nodes"
        )
