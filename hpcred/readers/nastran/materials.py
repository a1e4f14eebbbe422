"""Give solids of Nastran their materials: CTETRA, CHEXA, CPENTA name a PSOLID, which names a MAT1."""

from __future__ import annotations

import numpy as np

from ...fe.materials import MATERIAL, TYPE, ElementProperties, Material, material_of

SAME = 1e-2  # relative difference of G and E / (2 (1 + NU)) that rounding explains


def properties_of(comm, cards, names, tables: dict, mass_unit: float) -> ElementProperties | None:
    """Return the properties of elements, None where there are none; `cards` with PSOLID and the materials.

    `tables` (elements, 3) by kind: number of the element, place of its type in `names`, and number of its property,
    which its material replaces here. `mass_unit`: what densities are multiplied by. Collective.
    """
    if not tables:
        return None
    materials = {}
    for card in cards:
        if card.name.startswith("MAT") and card.name[3:].isdigit():
            materials.setdefault(card.whole(0, "the number of a material"), _material(card, mass_unit))
    for card in cards:
        number = card.text(0)
        if card.name == "MATS1" and number.isdigit() and (item := materials.get(int(number))):
            materials[int(number)] = Material(name=item.name, density=item.density, expansion=item.expansion,
                                              reason="found MATS1")  # fmt: skip
    order = {number: place for place, number in enumerate(materials)}
    of_property = {}
    for card in cards:
        if card.name == "PSOLID":
            place = order.get(card.whole(1, "the number of a material", 0), -1)
            of_property.setdefault(card.whole(0, "the number of a property"), place)
    known = np.array(sorted(of_property), np.int64)
    places = np.array([*(of_property[number] for number in known.tolist()), -1])
    for table in tables.values():
        at = np.searchsorted(known, table[:, MATERIAL])
        there = np.append(known, -1)[at] == table[:, MATERIAL]
        table[:, MATERIAL] = places[np.where(there, at, -1)]
    used = [np.any(comm.allgather(_used(tables, column, size)), axis=0)
            for column, size in ((TYPE, len(names)), (MATERIAL, len(materials)))]  # fmt: skip
    for column, kept in zip((TYPE, MATERIAL), used, strict=True):
        renumbered = np.append(np.cumsum(kept) - 1, -1)
        for table in tables.values():
            table[:, column] = renumbered[table[:, column]]
    types, kept = ([item for item, there in zip(items, mask, strict=True) if there]
                   for items, mask in zip((names, materials.values()), used, strict=True))  # fmt: skip
    return ElementProperties("Nastran", tuple(types), tuple(kept), tables)


def _used(tables, column, size):
    """Return which places (size,) stand in a column of the tables."""
    found = np.zeros(size, bool)
    for table in tables.values():
        found[table[table[:, column] >= 0, column]] = True
    return found


def _material(card, mass_unit) -> Material:
    """Return the material of a card, without constants where it is no MAT1."""
    name = f"{card.name} {card.text(0)}"
    if card.name != "MAT1":
        return Material(name=name, reason=f"found {card.name}")
    young, shear, poisson, density, expansion = (
        card.real(k, what) if card.text(k) else None for k, what in (
            (1, "Young's modulus"), (2, "the shear modulus"), (3, "Poisson's ratio"), (4, "a density"),
            (5, "a coefficient of expansion")))  # fmt: skip
    rest = {"density": None if density is None else density * mass_unit, "expansion": expansion}
    if young and shear and poisson is None:
        poisson = young / (2 * shear) - 1
    elif shear and poisson is not None and not young:
        young = 2 * (1 + poisson) * shear
    elif young and shear and abs(2 * (1 + poisson) * shear / young - 1) > SAME:
        return material_of(name, **rest, reason=f"found E {young:g}, G {shear:g} and NU {poisson:g}, which do not fit")
    if not young or poisson is None:
        return material_of(name, **rest, reason="found a MAT1 without two of E, G and NU")
    return material_of(name, young=young, poisson=poisson, **rest)
