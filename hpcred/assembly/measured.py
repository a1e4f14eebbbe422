"""Take measured responses as a body of a machine, by dynamic stiffness: there are no coordinates, only receptances."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..fe.dofs import node_of
from ..parallel.failures import InputError
from .joints import MachineBody, matrix_of
from .parts import Part, _channels, new_names, renamed

BEYOND = 1e-9  # of the last line, by which round-off goes beyond it


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredPart(Part):
    """A part known by receptances H (F, r, p) at `lines` (F,) in Hz, linear between them."""

    lines: np.ndarray
    H: np.ndarray = field(repr=False)

    def response(self, s: np.ndarray, values) -> np.ndarray:
        """Return H (S, r, p) at s = 2 pi i f (S,). Raises InputError outside of the lines."""
        f = np.imag(s) / (2 * np.pi)
        low, high = self.lines[[0, -1]]
        outside = (f < low - BEYOND * high) | (f > high + BEYOND * high)
        if outside.any():
            raise InputError(f"body '{self.name}': was measured from {low:g} to {high:g} Hz, not at {f[outside][0]:g} "
                             "Hz; take a narrower band")  # fmt: skip
        k = np.clip(np.searchsorted(self.lines, f) - 1, 0, max(len(self.lines) - 2, 0))
        if len(self.lines) == 1:
            return np.repeat(self.H, len(f), axis=0)
        part = ((f - self.lines[k]) / (self.lines[k + 1] - self.lines[k]))[:, None, None]
        return (1 - part) * self.H[k] + part * self.H[k + 1]


def measured_part(body: MachineBody, frf) -> MeasuredPart:
    """Return a measured body, of files.response_file.Responses of displacements. Raises InputError."""
    turn, where = matrix_of(body.turn), f"body '{body.name}'"
    known = {node: number for node, (number, _) in (frf.places or {}).items()}
    for node in map(node_of, (*frf.input_names, *frf.output_names)):
        if node is not None:
            known.setdefault(str(node), node if isinstance(node, int) else 0)  # 0: of no number
    numbers = new_names(body, known, where)
    inputs, outputs = ([renamed(name, numbers) for name in names] for names in (frf.input_names, frf.output_names))
    nodes = {str(node_of(name)) for name in inputs if node_of(name) is not None}
    if not nodes:
        raise InputError(f"body '{body.name}': has no interfaces or nodes among its inputs "
                         f"({', '.join(frf.input_names[:3])}), expected names such as 20:z or foot:z")  # fmt: skip
    at = {numbers.get(name, name): place for name, (_, place) in (frf.places or {}).items()}
    places = {node: turn @ at[node] + body.position if node in at else np.full(3, np.nan) for node in nodes}
    return MeasuredPart(
        name=body.name, model=None, inputs=_channels(body.name, inputs, turn), places=places, turn=turn,
        outputs=_channels(body.name, outputs, turn), lines=frf.frequencies, H=frf.response,
    )  # fmt: skip

