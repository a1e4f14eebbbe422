"""Compute outputs from measured columns and their rates: y = sum_k P_k (d/dt)^k (c^T q) + F u, k = 0, 1, 2.

The columns c (n, k) are what moments are matched of. A pure output is a multiple of one column, differentiated 0, 1 or
2 times; a mixed one, such as c^T q + d^T q', has a column for each of its parts. Everything is small, NumPy and local.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...fe.dofs import QUANTITIES, named_quantity, quantity_name, target_of
from ...parallel.failures import InputError

KEY = "derivatives"  # of the digest of rates in records
MIXED = -1  # order of an output that has parts of several orders


@dataclass(frozen=True, eq=False)
class Rates:
    """Outputs (r) of measured columns (k): `parts` (3, r, k), the factors P_0, P_1, P_2 of the columns, their first
    and their second derivatives; None where the outputs are the columns, which is false. `direct`: F (r, p), what
    outputs have of the inputs themselves, None without."""

    parts: np.ndarray | None = None
    direct: np.ndarray | None = None

    def __bool__(self) -> bool:
        return self.parts is not None

    @property
    def orders(self) -> np.ndarray | None:
        """The order (r,) of each output, or MIXED, as of those with a direct part; 0 of an output that is zero. None
        where the outputs are the columns."""
        if not self or self.direct is None:
            return orders_of(self.parts) if self else None
        return np.where(self.direct.any(axis=1), MIXED, orders_of(self.parts))

    @property
    def are_columns(self) -> bool:
        """Whether outputs, as `measured` has them, are the columns one by one."""
        if not self:
            return True
        same = self.parts.shape[1] == self.parts.shape[2] and MIXED not in self.orders
        return same and np.array_equal(self.parts.sum(axis=0), np.eye(self.parts.shape[1]))

    def count(self, columns: int) -> int:
        """Return the number of outputs of so many columns."""
        return self.parts.shape[1] if self else columns

    def at(self, s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return (P_0 + s P_1 + s^2 P_2) rows + F (S, r, p) at s (S,): H of the responses (S, k, p) of the columns."""
        return self._with_direct(combined(self.parts, s) @ rows) if self else rows

    def _with_direct(self, H: np.ndarray) -> np.ndarray:
        return H if self.direct is None else H + self.direct

    def responses(self, s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the same without the factor s^k of pure outputs."""
        return self._with_direct(self.measured(s, rows))

    def measured(self, s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return what errors are measured of: no direct part, and no factor s^k of pure outputs, whose relative error
        it does not change: it is that of the displacement, also at 0 Hz."""
        return self.measured_at(s) @ rows if self else rows

    def measured_at(self, s: np.ndarray) -> np.ndarray:
        """Return the factors (S, r, k) of `measured`."""
        return combined(self.parts, s, self.orders)

    def with_factors(self, s: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Return responses (S, r, p) with the factors s^k of pure outputs, which `measured` leaves out."""
        return np.asarray(s)[:, None, None] ** np.maximum(self.orders, 0)[:, None] * H if self else H

    def transposed(self, s: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return what belongs to outputs (S, m, r), as `measured` has them, of what belongs to columns (S, m, k)."""
        return columns @ self.measured_at(s).transpose(0, 2, 1) if self else columns

    def static(self, columns: np.ndarray) -> np.ndarray:
        """Return the columns (n, r) that pure outputs differentiate, of columns (n, k); zero for mixed outputs."""
        if not self:
            return columns
        return columns @ np.where((self.orders == MIXED)[:, None], 0.0, self.parts.sum(axis=0)).T

    def rows_of_columns(self, count: int) -> np.ndarray:
        """Return the output (k,) that has each of `count` columns, as `packed_parts` makes them."""
        return self.parts.any(axis=0).argmax(axis=0) if self else np.arange(count)

    def in_time(self, unit: float) -> Rates:
        """Return the outputs in seconds, from another unit of time. An output of several orders has the unit of its
        lowest: of y = c^T q + d^T q' a displacement, d is a time."""
        if not self:
            return self
        lowest = self.parts.any(axis=2).argmax(axis=0)
        powers = np.maximum(np.arange(len(self.parts))[:, None] - lowest, 0)
        return replace(self, parts=self.parts * (float(unit) ** powers)[:, :, None])

    def of_inputs(self, before, after) -> Rates:
        """Return the outputs of other inputs, by the names of those before and after; new ones have no direct part."""
        if self.direct is None:
            return self
        places = {name: j for j, name in enumerate(before)}
        none = np.zeros(len(self.direct))
        direct = [self.direct[:, places[name]] if name in places else none for name in after]
        return replace(self, direct=np.column_stack(direct) if np.any(direct) else None)

    def outputs_of_only(self, columns) -> list[int]:
        """Return the outputs that have no part of other columns than these."""
        if not self:
            return list(columns)
        others = np.setdiff1d(np.arange(self.parts.shape[2]), columns)
        return np.flatnonzero(~self.parts[:, :, others].any(axis=(0, 2))).tolist()

    def of(self, columns: np.ndarray) -> dict[str, np.ndarray]:
        """Return C, and where there are rates Cv and Ca (r, m), of measured rows (k, m) by name."""
        return dict(zip(("C", "Cv", "Ca"), self.parts @ columns, strict=True)) if self else {"C": columns}


def orders_of(parts: np.ndarray) -> np.ndarray:
    """Return the order (r,) of each row of C, C_v and C_a (3, r, m), or MIXED; 0 of a row that is zero."""
    there = np.asarray(parts).any(axis=2)
    return np.where(there.sum(axis=0) > 1, MIXED, there.argmax(axis=0))


def combined(parts: np.ndarray, s: np.ndarray, orders: np.ndarray | None = None) -> np.ndarray:
    """Return C + s C_v + s^2 C_a (..., r, m) at s (...); with `orders` (r,) without the factor s^k of pure outputs."""
    powers = np.asarray(s)[..., None, None] ** np.arange(len(parts))  # (..., 1, 3)
    powers = np.broadcast_to(powers, (*np.shape(s), parts.shape[1], len(parts)))
    if orders is not None:
        powers = np.where((orders == MIXED)[:, None], powers, 1.0)
    return np.einsum("...rd,drm->...rm", powers, parts)


def packed_parts(parts: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, Rates]:
    """Return measured columns (rows, k), and the outputs of them, from the rows (3, r, rows) of C, Cv and Ca on this
    rank; `there` (3, r): which of them are not zero on all ranks.

    The first r columns are those of the lowest order of each output, the others follow them.
    """
    r = parts.shape[1]
    first = there.argmax(axis=0)
    rows, orders = np.nonzero((there & (np.arange(len(parts))[:, None] > first)).T)  # those of higher orders
    columns = np.concatenate([parts[first, np.arange(r)], parts[orders, rows]])
    factors = np.zeros((len(parts), r, len(columns)))
    factors[first, np.arange(r), np.arange(r)] = 1.0
    factors[orders, rows, np.arange(r, len(columns))] = 1.0
    return columns.T, Rates(factors)


def check_names(names, there: np.ndarray, what: str):
    """Raise InputError for names of displacements, velocities or accelerations of outputs that are something else.

    `there` (3, r): which rows of C, Cv and Ca are not zero.
    """
    for name, row in zip(names, there.T, strict=True):
        quantity, place = named_quantity(name)
        quantities = [word for word, is_there in zip(QUANTITIES, row, strict=True) if is_there]
        if quantities and quantities != [quantity] and target_of(place) is not None:
            better = f"'{quantity_name(quantities[0], place)}', or by " if len(quantities) == 1 else "by "
            raise InputError(
                f"{what}: found '{name}', the name of a {quantity}, for a row of {' and '.join(quantities)}; name it "
                f"{better}a word of your own"
            )
