"""Convert a body, or its coordinates, from SI to other units, for programs that compute in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fe.dofs import DIRECTIONS, named_quantity, target_of
from ..model.loads.kinds import motions_of
from ..model.outputs.cuts import cut_output_of
from ..model.outputs.stresses import stress_output_of
from ..model.units import Units, rotational
from ..parallel.failures import InputError
from .body import Body, Prestress
from .geometric_stiffness import GeometricStiffness, unit_of_state


def in_units(body: Body, units: Units) -> Body:
    """Return the body in other units; frequencies stay in Hz. Raises InputError.

    The coordinates and matrices are those of sizes_of and fields_in. Inputs are forces or moments, outputs
    displacements or angles and their rates, stresses or forces of cuts, by their names; of loads the inputs are
    factors, the outputs work.
    """
    reduced, quantities, prestress = body.reduced, body.floating_frame, body.prestress
    L, M = units.length, units.mass
    inertia, moment = M * L**2, M * L
    # of each coordinate; M, D, K scale on both sides
    g = sizes_of(reduced, units)
    both = np.outer(g, g)
    force, measured = (np.array([_over_energy(kind, units) for kind in _kinds(reduced, names)])
                           for names in (reduced.input_names, reduced.output_names))  # fmt: skip
    # inputs and outputs by what they are: forces, moments, displacements, rotations
    unit = np.repeat([units.energy / L, units.energy], 3)
    resultants = reduced.resultants
    if resultants is not None:
        resultants = resultants * (force * units.energy)[:, None] / unit
    added = reduced.added.map((both * units.time**2 / inertia).__mul__)
    added = added.with_laws(lambda law: law.in_units(units.time))
    return Body(
        replace(
            reduced, **fields_in(reduced, units), operator=added, B=g[:, None] * reduced.B * force,
            **{key: matrix if matrix is None else measured[:, None] * matrix * g
               for key, matrix in (("C", reduced.C), ("Cv", reduced.Cv), ("Ca", reduced.Ca))}, resultants=resultants,
        ),
        replace(
            quantities, masses=quantities.masses / M, mc=quantities.mc / moment, J=quantities.J / inertia,
            Ct=g[:, None] * quantities.Ct / moment, Cr=g[:, None] * quantities.Cr / inertia,
            N=g[:, None, None] * quantities.N / inertia, S=both * quantities.S / inertia,
            Me=both * quantities.Me / inertia, origin=quantities.origin / L,
        ),
        [replace(shape, position=shape.position / L, phi=shape.phi * g / L, psi=shape.psi * g) for shape in body.nodes],
        body.surface and replace(body.surface, points=body.surface.points / L, phi=body.surface.phi * g / L),
        body.geometric_stiffness and _stiffness_in(body.geometric_stiffness, both * units.time**2 / inertia, units),
        body.stress and replace(body.stress, stress=body.stress.stress * g[:, None, None] * L**3 / units.energy),
        prestress and Prestress(g * prestress.forces / units.energy, both * prestress.softening / units.energy,
                               prestress.load),
    )  # fmt: skip


def _stiffness_in(stiffness, factor, units: Units) -> GeometricStiffness:
    """Return a geometric stiffness in other units; `factor` (m, m) is that of K."""
    unit = np.array([unit_of_state(state, units) for state in stiffness.states])[:, None, None]
    return replace(stiffness, matrices=unit * factor * stiffness.matrices, origin=stiffness.origin / units.length)


def sizes_of(reduced, units: Units) -> np.ndarray:
    """Return the sizes g (m,) of the coordinates, q_SI = g q, of anything with `size` and `interfaces`.

    Pseudo-modal ones such that V^T M V = I stays, g = length mass^(1/2); displacements and angles of interface nodes
    have their own units.
    """
    g = np.full(reduced.size, units.length * np.sqrt(units.mass))
    g[: 6 * len(reduced.interfaces)] = np.tile([*[units.length] * 3, 1.0, 1.0, 1.0], len(reduced.interfaces))
    return g


def fields_in(reduced, units: Units) -> dict:
    """Return M, D (or None), K and interfaces by name in other units, of anything that has them.

    With G = diag(g), K = G K_SI G / energy, D = G D_SI G time / (mass length^2), M = G M_SI G / (mass length^2).
    """
    g = sizes_of(reduced, units)
    both = np.outer(g, g) / (units.mass * units.length**2)
    return {
        "M": both * reduced.M,
        "D": None if reduced.D is None else both * units.time * reduced.D,
        "K": both * units.time**2 * reduced.K,
        "interfaces": tuple(replace(interface, position=tuple(np.array(interface.position) / units.length))
                            for interface in reduced.interfaces),
    }  # fmt: skip


def _over_energy(kind: str, units: Units) -> float:
    """Return the unit of an input over that of energy, and so of 1 over that of its output; or 1 over the unit of an
    output that is a force, a moment or a stress of the body."""
    E, L = units.energy, units.length
    return {"force": 1 / L, "moment": 1.0, "load": 1 / E, "fx": L / E, "mx": 1 / E, "xx": L**3 / E}[kind]


def _kinds(reduced, names) -> list[str]:
    """Return "force", "moment" or "load" of inputs or outputs, "fx" or "mx" of a cut, "xx" of a stress, by names.
    Raises InputError for others."""
    loads = {} if reduced.record is None else {load.name for load in reduced.record.loads if load.kind != "given"}
    own = {name: "mx" if cut.component.startswith("m") else "fx" for name in names if (cut := cut_output_of(name))}
    if moves := reduced.record is not None and motions_of(reduced.record.loads):
        raise InputError(f"units: {moves[0]} is an acceleration, not a force; export in SI")
    own |= {name: "xx" for name in names if stress_output_of(name)} | dict.fromkeys(loads, "load")
    targets = {name: target_of(named_quantity(name)[1]) for name in names if name not in own}
    lost = [name for name, target in targets.items() if not isinstance(target, tuple)]
    if lost:
        raise InputError(
            f"units: {', '.join(lost)} may be a force or a moment; name inputs and outputs by node and direction, or "
            "export in SI"
        )
    turn = {name: bool(rotational(np.array(DIRECTIONS.index(target[1])))) for name, target in targets.items()}
    return [own.get(name) or ("moment" if turn[name] else "force") for name in names]
