"""Read materials and key options of elements in an ANSYS archive: MP, MPDATA, UIMP, TB, KEYOPT and ETBLOCK."""

from __future__ import annotations

from ...fe.materials import Material, material_of
from ...files.text_numbers import parse_fortran

CONSTANTS = {"EX": "young", "NUXY": "poisson", "PRXY": "poisson", "DENS": "density", "ALPX": "expansion"}
ORTHOTROPIC = {"EY", "EZ", "NUYZ", "NUXZ", "PRYZ", "PRXZ", "GXY", "GYZ", "GXZ"}
HARMLESS = ("SDAM", "DENS", "THER")  # tables that change no stiffness, by their first letters
OPTIONS = (2, 3, 6)  # of SOLID185 to 187: integration, layers, mixed formulation


def material_and_options(commands) -> tuple[dict[int, Material], dict[int, dict[int, str]], list[str]]:
    """Return materials by number, key options by number of the type, and sentences on tables of temperatures.

    `commands`: lines of words between commas, the first in capitals.
    """
    known, reasons, options, tables = {}, {}, {}, {}
    for name, *words in commands:
        if name.startswith("KEYO"):
            if len(words) > 2 and words[0].isdecimal() and words[1].isdecimal():
                options.setdefault(int(words[0]), {})[int(words[1])] = words[2]
            continue
        label, number, value, many = _constant(name, words + [""] * 8)
        if not number.isdecimal():
            continue
        found, reason = known.setdefault(int(number), {}), reasons.setdefault(int(number), [])
        if name == "TB":
            reason += [] if label[:4] in HARMLESS else [f"found TB,{label}"]
        elif label in ORTHOTROPIC:
            reason.append(f"found {label}")
        elif key := CONSTANTS.get(label):
            values = parse_fortran(value.encode()) if value else None
            if values is None or len(values) != 1:
                reason.append(f"found {label} '{value}', expected a number")
            elif not (many and key in found):
                found[key] = float(values[0])
            if many:
                tables.setdefault(int(number), set()).add(label)
    remarks = [f"{', '.join(sorted(labels))} of the material {number} have several temperatures; the first one counts"
               for number, labels in sorted(tables.items())]  # fmt: skip
    return {number: _material(number, found, reasons[number]) for number, found in known.items()}, options, remarks


def _constant(name, words) -> tuple[str, str, str, bool]:
    """Return the label of a constant, the number of the material, the value, and whether it is one of a table."""
    if name == "MPDATA":
        length, words = ("1", words) if not words[0].upper().startswith("R5") else (words[1], words[2:])
        label, number, place, value, second = words[:5]
        many = length not in ("", "1") or place not in ("", "1") or bool(second)
    elif name == "UIMP":
        number, label, _, _, value = words[:5]
        many = False
    else:  # MP, whose further values are coefficients of powers of the temperature, and TB
        label, number, value = words[:3]
        many = name == "MP" and any(words[3:7])
    return label.upper(), number, value, many


def _material(number, known, reasons) -> Material:
    """Return the material of a number from what is known of it; without Poisson's ratio ANSYS takes 0.3."""
    name = f"MAT {number}"
    if not reasons and "young" not in known:
        reasons = ["found no EX"]
    if reasons:
        rest = {key: value for key, value in known.items() if key not in ("young", "poisson")}
        return material_of(name, **rest, reason="; ".join(dict.fromkeys(reasons)))
    return material_of(name, **({"poisson": 0.3} | known))


def type_name(family: str, number: int, options: dict[int, str]) -> str:
    """Return the name of an element type, with its key options where they change its stresses: SOLID186 KEYOPT(2)=1."""
    given = [f"KEYOPT({key})={options[key]}" for key in OPTIONS if options.get(key, "0") not in ("", "0")]
    return " ".join([f"{family}{number}", *given])
