"""Say at which points, and with which strains, finite-element programs integrate their solids, by type of element.

Elements whose strains are not those of the displacements of their nodes alone have no rule: those with incompatible
modes, enhanced strains or bubble functions, hybrid elements, shells and beams.
"""

from typing import NamedTuple

from .shape_functions import SOLIDS


class Rule(NamedTuple):
    """Integration `scheme`, full or reduced, and the strain at its points: "of the point", "mean" for the gradients
    averaged over the element (uniform strain), "mean volume" for the dilatation averaged over it (B-bar)."""

    scheme: str = "full"
    strain: str = "of the point"


FULL, REDUCED = Rule(), Rule("reduced")
UNIFORM, B_BAR = Rule("reduced", "mean"), Rule("full", "mean volume")
CALCULIX = {
    "C3D4": {"tetra": FULL}, "C3D10": {"tetra10": FULL}, "C3D6": {"wedge": FULL}, "C3D15": {"wedge15": FULL},
    "C3D8": {"hexahedron": FULL}, "C3D8R": {"hexahedron": UNIFORM}, "C3D20": {"hexahedron20": FULL},
    "C3D20R": {"hexahedron20": REDUCED},
}  # fmt: skip
RULES = {
    "hpcred": {kind: {kind: FULL} for kind in SOLIDS},
    "CalculiX": CALCULIX,
    "Abaqus": CALCULIX | {"C3D8": {"hexahedron": B_BAR}},
    # MSC and NX give CHEXA and CPENTA without nodes on their edges bubble functions
    "Nastran": {"CTETRA": {"tetra": FULL, "tetra10": FULL}, "CHEXA": {"hexahedron20": REDUCED},
                "CPENTA": {"wedge15": FULL}},
    "ANSYS": {
        "SOLID185": {"hexahedron": B_BAR, "tetra": FULL}, "SOLID185 KEYOPT(2)=1": {"hexahedron": REDUCED},
        "SOLID186": {"hexahedron20": REDUCED}, "SOLID186 KEYOPT(2)=1": {"hexahedron20": FULL},
        "SOLID187": {"tetra10": FULL}, "SOLID92": {"tetra10": FULL}, "SOLID95": {"hexahedron20": REDUCED},
    },
}  # fmt: skip


def rule_of(program: str, type_: str, kind: str) -> Rule | None:
    """Return the rule of an element type of a program, None where it has none."""
    return RULES.get(program, {}).get(type_, {}).get(kind)
