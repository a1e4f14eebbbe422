"""A body in SI enters; the same body in other units leaves, for programs that compute in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.dofs import DIRECTIONS, target_of
from ..model.units import Units, rotational
from ..parallel.failures import InputError
from .body import Body


def in_units(body: Body, units: Units) -> Body:
    """The body in other units; frequencies stay in Hz. Raises InputError.

    The coordinates are scaled by g, q_SI = g q: pseudo-modal ones so that V^T M V = I stays, g = length mass^(1/2), and
    displacements and angles of interface nodes by their own units. Inputs are forces or moments, outputs displacements
    or angles, by their names. With G = diag(g), K = G K_SI G / energy, M = G M_SI G / (mass length^2), and so on.
    """
    reduced, quantities = body.reduced, body.floating_frame
    L, M = units.length, units.mass
    inertia, moment = M * L**2, M * L
    g = np.full(reduced.size, L * np.sqrt(M))
    g[: 6 * len(reduced.interfaces)] = np.tile([L, L, L, 1.0, 1.0, 1.0], len(reduced.interfaces))
    both = np.outer(g, g)
    force = [1.0 if turn else 1 / L for turn in _rotations(reduced.input_names)]
    displacement = [1.0 if turn else 1 / L for turn in _rotations(reduced.output_names)]
    return Body(
        replace(
            reduced, M=both * reduced.M / inertia, D=both * reduced.D * units.time / inertia,
            K=both * reduced.K / units.energy, B=g[:, None] * reduced.B * force,
            C=np.array(displacement)[:, None] * reduced.C * g,
            interfaces=tuple(replace(item, position=tuple(np.array(item.position) / L)) for item in reduced.interfaces),
        ),
        replace(
            quantities, masses=quantities.masses / M, mc=quantities.mc / moment, J=quantities.J / inertia,
            Ct=g[:, None] * quantities.Ct / moment, Cr=g[:, None] * quantities.Cr / inertia,
            N=g[:, None, None] * quantities.N / inertia, S=both * quantities.S / inertia,
            Me=both * quantities.Me / inertia, origin=quantities.origin / L,
        ),
        [replace(shape, position=shape.position / L, phi=shape.phi * g / L, psi=shape.psi * g) for shape in body.nodes],
        body.surface and replace(body.surface, points=body.surface.points / L, phi=body.surface.phi * g / L),
    )  # fmt: skip


def _rotations(names) -> list[bool]:
    """Whether each input or output is a moment or an angle."""
    targets = [target_of(name) for name in names]
    lost = [name for name, target in zip(names, targets, strict=True) if not isinstance(target, tuple)]
    if lost:
        raise InputError(
            f"units: {', '.join(lost)} may be a force or a moment; name inputs and outputs by node and direction, or "
            "export in SI"
        )
    return [bool(rotational(np.array(DIRECTIONS.index(direction)))) for _, direction in targets]
