"""Describe the materials and types of elements, as far as stresses and loads of solids need them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..parallel.failures import InputError

NUMBER, TYPE, MATERIAL = range(3)  # columns of the tables of elements


@dataclass(frozen=True, kw_only=True)
class Material:
    """A material, isotropic and linear where Young's modulus and Poisson's ratio are known.

    Parameters
    ----------
    name : str
        Name in the input file.
    young : float, optional
        Young's modulus in Pa.
    poisson : float, optional
        Poisson's ratio, above -1 and below 0.5.
    density : float, optional
        kg/m^3.
    expansion : float, optional
        Coefficient of thermal expansion in 1/K.
    reason : str, optional
        Why `young` and `poisson` are not known.

    Raises
    ------
    InputError
        For values out of range.
    """

    name: str
    young: float | None = None
    poisson: float | None = None
    density: float | None = None
    expansion: float | None = None
    reason: str = ""

    def __post_init__(self):
        for key, low, high, expected in (
            ("young", 0.0, np.inf, "a positive modulus in Pa"),
            ("poisson", -1.0, 0.5, "more than -1 and less than 0.5"),
            ("density", -1e-300, np.inf, "at least 0 kg/m^3"),
            ("expansion", -np.inf, np.inf, "a finite number in 1/K"),
        ):
            value = getattr(self, key)
            if value is not None and not low < value < high:
                raise InputError(f"material '{self.name}': {key}: found {value:g}, expected {expected}")

    @property
    def isotropic(self) -> bool:
        """Whether Young's modulus and Poisson's ratio are known."""
        return self.young is not None and self.poisson is not None

    def in_units(self, stress: float, density: float) -> Material:
        """Return the material in SI, from one in units of `stress` Pa and `density` kg/m^3."""
        young, dense = (None if value is None else value * unit
                        for value, unit in ((self.young, stress), (self.density, density)))  # fmt: skip
        return replace(self, young=young, density=dense)


def material_of(name: str, **constants) -> Material:
    """Return a material of a file; one whose constants are out of range has none, and the reason."""
    try:
        return Material(name=name, **constants)
    except InputError as error:
        return Material(name=name, reason=str(error).partition(": ")[2])


@dataclass(frozen=True)
class ElementProperties:
    """Numbers, types and materials of elements, beside `SecondOrderModel.elements`.

    Attributes
    ----------
    program : str
        "Abaqus", "CalculiX", "Nastran", "ANSYS" or "hpcred": elements of one name differ between programs.
    types : tuple of str
        Names of the element types, the same on all ranks: C3D8R, CTETRA, SOLID185; of hpcred those of the kinds.
    materials : tuple of Material
        The same on all ranks.
    table : dict of str to ndarray of int, shape (elements of this rank, 3)
        By kind of element, in the order of `elements`: number of the element, place of its type in `types`, and of its
        material in `materials`, -1 for none.
    """

    program: str
    types: tuple[str, ...]
    materials: tuple[Material, ...]
    table: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def of_one(cls, comm, elements: dict, material: Material) -> ElementProperties:
        """Return the properties of plain `elements`, node numbers (elements, nodes) by kind, of one `material`,
        numbered from 1 in each kind. Collective."""
        table = {}
        for place, (kind, nodes) in enumerate(elements.items()):
            number = (comm.exscan(len(nodes)) or 0) + np.arange(1, len(nodes) + 1)
            table[kind] = np.stack([number, np.full(len(nodes), place), np.zeros(len(nodes), int)], axis=1)
        return cls("hpcred", tuple(elements), (material,), table)

    def with_material(self, material: Material) -> ElementProperties:
        """Return the same elements, all of one `material`."""
        table = {kind: rows.copy() for kind, rows in self.table.items()}
        for rows in table.values():
            rows[:, MATERIAL] = 0
        return replace(self, materials=(material,), table=table)


def properties_in_words(properties: ElementProperties, comm, units: bool = True) -> dict[str, dict]:
    """Return how many elements have each type, and the constants of the materials in words. `units`: whether they are
    in SI. Collective."""
    counts = np.zeros(len(properties.types), int)
    for table in properties.table.values():
        counts += np.bincount(table[:, TYPE], minlength=len(counts))
    words = {"element_types": dict(zip(properties.types, comm.allreduce(counts).tolist(), strict=True))}
    if properties.materials:
        words["materials"] = {material.name: _in_words(material, units) for material in properties.materials}
    return words


def _in_words(material, units):
    """Return the constants of a material in a line."""
    constants = [f"{text} = {value:g}{unit if units else ''}" for text, value, unit in (
        ("E", material.young, " Pa"), ("nu", material.poisson, ""), ("density", material.density, " kg/m^3"),
        ("expansion", material.expansion, " 1/K")) if value is not None]  # fmt: skip
    if not material.isotropic:
        constants.append(f"not isotropic and linear: {material.reason}")
    return ", ".join(constants)


def check_properties(properties: ElementProperties | None, elements: dict | None, name: str):
    """Raise InputError unless the properties belong to the elements."""
    if properties is None:
        return
    for kind, nodes in (elements or {}).items():
        table = properties.table.get(kind)
        if table is None or table.shape != (len(nodes), 3):
            what = "none" if table is None else f"an array {table.shape}"
            raise InputError(f"{name}: element properties: found {what} of {kind}, expected ({len(nodes)}, 3)")
        for column, names, low in ((TYPE, properties.types, 0), (MATERIAL, properties.materials, -1)):
            if len(table) and not low <= table[:, column].min() <= table[:, column].max() < len(names):
                raise InputError(
                    f"{name}: element properties: found the {('type', 'material')[column - 1]} "
                    f"{table[:, column].max()} of {kind}, expected less than {len(names)}"
                )
