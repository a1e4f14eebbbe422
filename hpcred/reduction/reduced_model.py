"""The reduced model: small numpy arrays, the same on all ranks, and what they came from."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class ReducedModel:
    """M x'' + D x' + K x = B u, y = C x with m coordinates, p inputs, r outputs; SI units.

    M, D, K (m, m), B (m, p), C (r, m); `frequencies` (m,): eigenfrequencies and pseudo-frequencies in Hz (52).
    `loss_factor`: eta of structural damping, for frequency responses only. `provenance`: what made it.
    `columns`: the basis V as a distributed block (n, m), zero at the dofs that the frame holds, when the reduction
    was run here, and `left_columns` W of a two-sided projection; None after reading a file. close() frees them.
    """

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    B: np.ndarray
    C: np.ndarray
    frequencies: np.ndarray
    loss_factor: float = 0.0
    input_names: list = field(default_factory=list)
    output_names: list = field(default_factory=list)
    provenance: dict = field(default_factory=dict)
    columns: object = None
    left_columns: object = None

    @property
    def size(self) -> int:
        return len(self.M)

    def transfer_function(self, s: complex) -> np.ndarray:
        """H(s) = C (s^2 M + s D + (1 + i eta) K)^-1 B (r, p), (25, 41)."""
        dynamic = s * s * self.M + s * self.D + (1 + 1j * self.loss_factor) * self.K
        return self.C @ np.linalg.solve(dynamic, self.B.astype(complex))

    def poles(self) -> np.ndarray:
        """The 2m roots of det(s^2 M + s D + K) in rad/s, by imaginary part."""
        size = self.size
        inverse = np.linalg.inv(self.M)
        state = np.block([[np.zeros((size, size)), np.eye(size)], [-inverse @ self.K, -inverse @ self.D]])
        roots = np.linalg.eigvals(state)
        return roots[np.argsort(roots.imag)]

    def unstable_poles(self) -> np.ndarray:
        """Poles in the right half-plane, beyond round-off."""
        roots = self.poles()
        return roots[roots.real > 1e-9 * np.abs(roots).max(initial=0.0)]

    def close(self):
        """Free the basis. Collective."""
        for block in (self.columns, self.left_columns):
            if block is not None:
                block.destroy()
        self.columns = self.left_columns = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
