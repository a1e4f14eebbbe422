"""Compute the load vector of a rise in temperature: the integral of B^T E alpha T over solids of known materials."""

from __future__ import annotations

import numpy as np

from ...fe.element_rows import element_rows
from ...fe.element_rules import rule_of
from ...fe.elements import FACES
from ...fe.materials import MATERIAL, TYPE
from ...fe.shape_functions import SOLIDS, integration_points, shape_functions
from ...fe.solids import NO_TABLE
from ...fe.strain_matrices import strain_matrices
from ...parallel.failures import InputError, agreed
from .on_faces import NodalForces

AT_ONCE = 2**12  # elements whose matrices are held at a time


def thermal_forces(model, where: str, temperature) -> NodalForces:
    """Return the forces on nodes of a rise in temperature; temperature(nodes) gives it in K at nodes (k,), and may be
    collective. Collective. Raises InputError for other elements than solids with rules and materials."""
    _require_solids(model, where)
    forces = []
    for kind, rows in element_rows(model).items():
        nodes, place = np.unique(rows.nodes, return_inverse=True)
        rise = temperature(nodes)[place.reshape(rows.nodes.shape)]
        with agreed(model.comm):
            if not rows.placed.all():
                lost = rows.nodes[~rows.placed][np.isnan(rows.position[~rows.placed]).any(axis=2)][0]
                raise InputError(f"{where}: node {lost} of the solids of {model.name} has no row, since it follows "
                                 "another one; a temperature needs all nodes")  # fmt: skip
            table = model.properties.table.get(kind, NO_TABLE)
            for type_, material in np.unique(table[:, [TYPE, MATERIAL]], axis=0).tolist():
                mine = np.flatnonzero((table[:, TYPE] == type_) & (table[:, MATERIAL] == material))
                rule, item_of = _rule(model, where, kind, type_), _material(model, where, material)
                for low in range(0, len(mine), AT_ONCE):
                    some = mine[low : low + AT_ONCE]
                    forces.append(_forces(kind, rule, item_of, rows.nodes[some], rows.position[some], rise[some]))
    return NodalForces.joined(forces)


def _forces(kind, rule, material, nodes, position, rise):
    B, volumes = strain_matrices(kind, rule, position)
    points = integration_points(kind, "reduced" if rule.strain == "mean" else rule.scheme)[0]
    at_points = rise @ shape_functions(kind, points)[0].T
    pressure = material.young * material.expansion / (1 - 2 * material.poisson)  # of a rise by 1 K that is held back
    forces = pressure * np.einsum("egia,eg->ea", B[:, :, :3], volumes * at_points)
    return NodalForces.of_elements(nodes, forces, position)


def _require_solids(model, where):
    kinds = set().union(*model.comm.allgather({kind for kind, elements in model.elements.items() if len(elements)}))
    other = sorted(kind for kind in kinds if kind not in SOLIDS)
    if other or not kinds & set(FACES):
        raise InputError(
            f"{where}: found {', '.join(other) or 'no elements'} in {model.name}, expected solids only, whose load by "
            "temperature is known; take that of the finite-element program as a vector (kind = 'given')"
        )
    if model.properties is None:
        raise InputError(
            f"{where}: the types and materials of the elements of {model.name} are not known; convert it from its "
            "input file, or give a material in Python (with_material)"
        )


def _rule(model, where, kind, type_):
    name = model.properties.types[type_]
    rule = rule_of(model.properties.program, name, kind)
    if rule is None:
        raise InputError(
            f"{where}: found elements {name} of {model.properties.program} ({kind}), whose strains are not those of "
            "the displacements of their nodes alone; take the load of that program as a vector (kind = 'given')"
        )
    return rule


def _material(model, where, place):
    material = model.properties.materials[place] if place >= 0 else None
    if material is None or not material.isotropic or material.expansion is None:
        what = "no material" if material is None else f"the material '{material.name}'"
        lacks = "" if material is None or not material.isotropic else " without a coefficient of thermal expansion"
        why = f" ({material.reason})" if material is not None and material.reason else ""
        raise InputError(
            f"{where}: found {what}{lacks}{why}, expected Young's modulus, Poisson's ratio and a coefficient of "
            "thermal expansion; give them in Python (with_material)"
        )
    return material
