"""Structures of NLEVP, a collection of nonlinear eigenvalue problems, with inputs that this module chooses.

T. Betcke, N. J. Higham, V. Mehrmann, C. Schroeder and F. Tisseur, ACM Transactions on Mathematical Software 39 (2013).
NLEVP has no inputs, outputs or places of nodes. Its matrices come from a call such as
`c = nlevp('shaft'); K = c{1}; D = c{2}; M = c{3}; save('shaft.mat', 'M', 'D', 'K')`, with real(K) of foundation and
concrete, whose imaginary part is structural damping, and imag(D) of concrete.
"""

from __future__ import annotations

from functools import partial

import hpcred

from .published import Arrays, Published, unit_columns, variables

# Van Beeumen, Meerbergen and Michiels, SIAM Journal on Scientific Computing 35 (2013)
CORE = hpcred.laws.Fractional(low=3.504e5, high=3.062e9, time=8.230e-9, exponent=0.675)
WHERE = "github.com/ftisseur/nlevp"


def with_loads(path, rows, sign=1, circulatory=False) -> Arrays:
    """The matrices of a file, with unit forces on some rows; D and K times a sign, M as it is."""
    M, D, K = variables(path, "M", "D", "K")
    B = unit_columns(M.shape[0], rows)
    return Arrays(M=M, D=sign * D if D.nnz else None, K=sign * K, B=B, circulatory=circulatory)


def viscoelastic_beam(path) -> Arrays:
    """The sandwich beam K_e + g(s) K_v, moved across near its middle."""
    K, M, Kv = variables(path, "Ke", "M", "Kv")
    n = M.shape[0]
    return Arrays(M=M, D=None, K=K, B=unit_columns(n, [n // 2 + 2]), viscoelastic=(hpcred.Viscoelastic(Kv, CORE),))


_structure = partial(Published, source="NLEVP 4.1", licence="BSD-2-Clause", where=WHERE)
MODELS = (
    # Feriani, Perotti and Simoncini (2000); three forces on the last node. As stored, K and D are negative definite
    # beside a positive M, of a response K - omega^2 M + i omega D whose sign was turned.
    _structure(name="foundation", what="machine foundation of reinforced concrete on the ground, K(1 + 0.1 i)", n=3627,
               file="foundation_realpart.mat", loss_factor=0.1, band=(0.0, 60.0),
               read=partial(with_loads, rows=[3624, 3625, 3626], sign=-1)),
    # the same paper; forces on the first node. 997 rotations have no mass.
    _structure(name="concrete", what="concrete structure below a machine, K(1 + 0.04 i), M singular", n=2472,
               file="concrete.mat", loss_factor=0.04, band=(0.0, 20.0), read=partial(with_loads, rows=[0, 1, 2])),
    # a force at the damper, and one near the middle of the shaft. Its 201 rotations have no mass.
    _structure(name="shaft", what="shaft on bearings with one damper, M singular", n=400, file="shaft.mat",
               band=(0.0, 1000.0), read=partial(with_loads, rows=[19, 202])),
    _structure(name="sandwich", what="clamped sandwich beam with the static stiffness of its core", n=840,
               file="sandwich_840_elastic.mat", band=(0.0, 1000.0), read=partial(with_loads, rows=[422])),
    _structure(name="sandwich-viscoelastic", what="clamped sandwich beam, core of fractional law", n=840,
               file="sandwich_beam_840.mat", band=(0.0, 1000.0), read=viscoelastic_beam),
    # Graebner, Mehrmann, Quraishi, Schroeder and von Wagner (2016): already modal coordinates, and unstable (squeal)
    _structure(name="disk-brake", what="disk brake at 4 pi rad/s: D gyroscopic, K unsymmetric, unstable", n=100,
               file="disk_brake100_omega4pi.mat", band=(0.0, 0.3),
               read=partial(with_loads, rows=[0, 1], circulatory=True)),
    _structure(name="speaker-box", what="speaker box; refused, since some of its masses are negative", n=107,
               file="speaker_box.mat", band=(0.0, 1000.0), read=partial(with_loads, rows=[0])),
)  # fmt: skip
