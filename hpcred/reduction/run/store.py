"""Define stores, which keep columns from one reduction to the next, and their entries."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np


@dataclass
class Entry:
    """What a store keeps under one key: columns as a block in `widths` columns each, facts (plain types), and small
    arrays, the same on all ranks. `block` is None where there are no columns."""

    facts: dict
    widths: tuple[int, ...] = ()
    block: object = None
    arrays: dict[str, np.ndarray] = field(default_factory=dict)


@runtime_checkable
class Store(Protocol):
    """Where columns are kept from one reduction to the next (files.point_store has one in a folder).

    Both methods are collective over the ranks of `model`, whose rows the columns have. They fail for no reason that
    lies in files: `say` gets a sentence for the user instead.
    """

    def load(self, model, key: dict, say, most: int | None = None) -> Entry | None:
        """Return the entry of a key, with its first `most` widths; None if there is no valid one."""

    def save(self, model, key: dict, entry: Entry, say):
        """Keep an entry, in place of what is there."""
