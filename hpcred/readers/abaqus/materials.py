"""Read materials of Abaqus and CalculiX input files, and give them to elements by *Solid Section.

*Elastic, *Density and *Expansion of isotropic materials are read; a material with more than these has no constants and
a reason. Constants that depend on temperature count with their first line.
"""

from ...fe.materials import MATERIAL, ElementProperties, Material, material_of
from ...files.text_numbers import number_in, parse, with_e
from ...parallel.lookup import look_up
from ..parts import used_properties

# what a material may have beside, in models with small strains without plasticity
HARMLESS = {"elastic", "density", "expansion", "damping", "conductivity", "specificheat", "latentheat", "electrical"}
NOT_LINEAR = {
    "plastic", "hyperelastic", "hyperfoam", "creep", "viscoelastic", "viscous", "usermaterial", "depvar", "cyclic",
    "cyclichardening", "deformationplasticity", "druckerprager", "capplasticity", "castironplasticity", "mohrcoulomb",
    "crushablefoam", "clayplasticity", "mullinseffect", "lowdensityfoam", "hypoelastic", "porouselastic", "concrete",
    "superelastic", "fabric", "fluid", "gasketbehavior", "gasketelasticity", "hysteresis", "potential", "swelling",
    "brittlecracking", "concretedamagedplasticity", "damageinitiation", "eos", "nocompression", "notension",
}  # fmt: skip


def materials_of(sections, data_lines) -> tuple[list[Material], list[str]]:
    """Return the materials of the keywords of a file, and sentences on what was left out. `data_lines` gives those of a
    keyword, as lists of fields."""
    materials, remarks, inside = {}, [], False
    for section in sections:
        if section.keyword == "material":
            name, inside = section.parameters.get("name", ""), True
            materials[name.lower()] = name, {}, []
        elif inside and section.keyword in HARMLESS | NOT_LINEAR:
            _add(section, *materials[name.lower()], remarks, data_lines)
        else:
            inside = False
    return [_material(name, known, reasons) for name, known, reasons in materials.values()], remarks


def _add(section, name, known, reasons, remarks, data_lines):
    """Put what a keyword says of a material into `known`, or why it is not isotropic and linear into `reasons`."""
    keyword, kind = section.keyword, section.parameters.get("type", "iso").lower()
    if keyword in NOT_LINEAR:
        reasons.append(f"found *{keyword.capitalize()}")
        return
    keys = {"elastic": ("young", "poisson"), "density": ("density",), "expansion": ("expansion",)}.get(keyword, ())
    if not keys:
        return
    if not kind.startswith("iso"):
        if keyword == "elastic":
            reasons.append(f"found *Elastic, type={kind.upper()}")
        return
    lines = data_lines(section)
    fields = lines[0] if lines else []
    values = [number_of(field) if field else 0.0 for field in fields[: len(keys)]]
    if len(values) < len(keys) or None in values:
        if keyword == "elastic":
            reasons.append(f"found *Elastic with '{', '.join(fields)}', expected Young's modulus and Poisson's ratio")
        return
    known |= dict(zip(keys, values, strict=True))
    if len(lines) > 1:
        remarks.append(
            f"{section.path}: *{keyword.capitalize()} of the material '{name}' has {len(lines)} lines, such as for "
            "several temperatures; the first one counts"
        )


def number_of(field: str) -> float | None:
    """Return the finite number of a field of a data line, None where there is something else."""
    return number_in(field, lambda text: parse(with_e(text)))


def _material(name, known, reasons) -> Material:
    """Return a material of what is known of it."""
    if not reasons and "young" not in known:
        reasons = ["found no *Elastic"]
    if reasons:
        rest = {key: value for key, value in known.items() if key not in ("young", "poisson")}
        return material_of(name, **rest, reason="; ".join(reasons))
    return material_of(name, **known)


def properties_of(comm, program, blocks, materials, types, tables, keys, members) -> ElementProperties:
    """Return the properties of elements, from the Blocks of *Solid Section. Collective.

    `types`: names of the types; `tables` (elements, 3) and `keys` (elements,) by kind, whose materials are set here;
    `members`: keys of the elements of this rank by the names of the sets of sections, in small letters.
    """
    materials = list(materials)
    places = {material.name.lower(): place for place, material in enumerate(materials)}
    for block in blocks:
        values = block.section.parameters
        name = values.get("material", "")
        if "composite" in values:
            place, name = None, f"composite of {values.get('elset', '')}"
            reason = "found *Solid Section with COMPOSITE"
        else:
            place, reason = places.get(name.lower()), "found no *Material of this name"
        if place is None:
            place = places[name.lower()] = len(materials)
            materials.append(Material(name=name, reason=reason))
        elset = next((name for name in names_of(block) if name in members), None)
        if elset is not None:
            for kind, table in tables.items():
                table[look_up(comm, members[elset], [], keys[kind])[0], MATERIAL] = place
    return used_properties(comm, program, types, materials, tables)


def names_of(block) -> list[str]:
    """Return the ways to write the set of a *Solid Section in full, in small letters."""
    elset = block.section.parameters.get("elset", "").lower()
    return [block.prefix.lower() + elset, elset]
