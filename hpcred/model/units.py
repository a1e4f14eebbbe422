"""Convert models from other systems of units to SI, and read the names of such systems."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..fe.dofs import ABSOLUTE, DIRECTIONS, OWN, QUANTITIES, SCALAR, Dofs, named_quantity, target_of
from ..linalg.blocks import dense_matrix
from ..parallel.failures import InputError
from .loads.kinds import LoadColumn
from .outputs.cuts import cut_output_of
from .outputs.rates import Rates
from .outputs.stresses import stress_output_of
from .second_order_model import SecondOrderModel

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 0.0254, "in": 0.0254, "ft": 0.3048}
POUND = 0.45359237  # kg
POUND_FORCE = POUND * 9.80665  # N
MASSES = {"kg": 1.0, "g": 1e-3, "mg": 1e-6, "t": 1e3, "lbm": POUND, "slug": POUND_FORCE / 0.3048}
FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "MN": 1e6, "lbf": POUND_FORCE, "kgf": 9.80665}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


@dataclass(frozen=True)
class Units:
    """A consistent system of units.

    Parameters
    ----------
    name : str
        Such as "mm, t, s (N, MPa)".
    length, mass, time : float
        The units of length in m, of mass in kg, and of time in s.
    """

    name: str
    length: float
    mass: float
    time: float

    @property
    def sizes(self) -> tuple[float, float, float]:
        """The units of length, mass and time."""
        return self.length, self.mass, self.time

    @property
    def energy(self) -> float:
        """The unit of energy in J."""
        return self.mass * (self.length / self.time) ** 2

    @property
    def words(self) -> str:
        """The name as users write it: mm,t,s."""
        if self.name == SI.name:
            return "SI"
        return self.name.partition(" (")[0].replace(" s^2/inch", "").replace(" ", "")


SI = Units("m, kg, s", 1.0, 1.0, 1.0)
UNITS = (
    SI,
    Units("mm, t, s (N, MPa)", 1e-3, 1e3, 1.0),
    Units("mm, kg, ms (kN, GPa)", 1e-3, 1.0, 1e-3),
    Units("mm, kg, s (mN, kPa)", 1e-3, 1.0, 1.0),
    Units("mm, g, ms (N, MPa)", 1e-3, 1e-3, 1e-3),
    Units("inch, lbf s^2/inch, s (lbf, psi)", 0.0254, POUND_FORCE / 0.0254, 1.0),
)


def units_of(text: str) -> Units:
    """Return the system of units that a text names.

    Parameters
    ----------
    text : str
        SI, or a length, a mass or a force, and a time, such as mm,t,s or inch-lbf-s. A force and a length determine
        the unit of mass.

    Raises
    ------
    InputError
        For other words.

    Examples
    --------
    >>> hpcred.model.units_of("mm,t,s").mass
    1000.0
    """
    if text.strip().upper() == "SI":
        return SI
    known = next((units for units in UNITS if units.name == text), None)
    if known is not None:
        return known
    words = re.split(r"[\s,-]+", text.strip())
    by_quantity = [[word for word in words if word in table] for table in (LENGTHS, TIMES, MASSES, FORCES)]
    length, time, mass, force = by_quantity
    if len(words) != 3 or len(length) != 1 or len(time) != 1 or len(mass + force) != 1:
        raise InputError(
            f"units: found '{text}', expected SI, or three words such as mm,t,s: a length ({', '.join(LENGTHS)}), a "
            f"mass ({', '.join(MASSES)}) or a force ({', '.join(FORCES)}), and a time ({', '.join(TIMES)})"
        )
    L, T = LENGTHS[length[0]], TIMES[time[0]]
    kilograms = MASSES[mass[0]] if mass else FORCES[force[0]] * T**2 / L
    return Units(f"{length[0]}, {(mass + force)[0]}, {time[0]}", L, kilograms, T)


def rotational(direction: np.ndarray) -> np.ndarray:
    """Return which of these directions (indices of DIRECTIONS) are rotations."""
    return ((direction >= 3) & (direction < SCALAR)) | (direction >= OWN + 3)


def unit_of_output(name: str) -> str:
    """Return the SI unit of an output by its name, "" where it does not tell."""
    if (cut := cut_output_of(name)) is not None:
        return "N" if cut.component[0] == "f" else "N m"
    if stress_output_of(name) is not None:
        return "Pa"
    quantity, place = named_quantity(name.removeprefix(ABSOLUTE))
    turns = _turns(place)
    return "" if turns is None else ("m", "rad")[turns] + ("", "/s", "/s^2")[QUANTITIES.index(quantity)]


def unit_of_input(name: str, loads: Iterable[LoadColumn] = ()) -> str:
    """Return the SI unit of an input by its name, "" where there is none; `loads`: those of the model, among which are
    the motions of bases."""
    known = next((load for load in loads if load.name == name and load.kind != "given"), None)
    turns = _turns(name)
    if known is not None:
        return ("m", "rad")[turns] + ("/s^2", "/s", "")[known.integrated] if known.is_motion else ""
    return "" if turns is None else ("N", "N m")[turns]


def _turns(name) -> int | None:
    """Return whether a name such as 20:rz is that of a rotation; None of one that is no direction of a node."""
    target = target_of(name)
    direction = DIRECTIONS.index(target[1]) if isinstance(target, tuple) else SCALAR
    return None if direction == SCALAR else int(rotational(np.array(direction)))


def unit_of_response(output: str, given: str, loads: Iterable[LoadColumn] = ()) -> str:
    """Return the SI unit of a response, such as rad/N, from the names of its output and input, see unit_of_input; ""
    where one of them does not tell."""
    unit, load = unit_of_output(output), unit_of_input(given, loads)
    unit, load = (f"({text})" if set(text) & marks else text for text, marks in ((unit, {" "}), (load, {" ", "/"})))
    return unit and load and f"{unit}/{load}"


def in_si(model: SecondOrderModel, units: Units) -> SecondOrderModel:
    """Return a model in SI, from one in other units. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        It is not changed.
    units : Units
        The units of its numbers.

    Raises
    ------
    InputError
        For a model without nodes, unless the unit of length is m, and for one that has interface nodes or loads
        already.

    Notes
    -----
    With q = S^-1 q_SI, where S is the unit of length for translations and 1 for rotations, and the units of energy E
    and time T: M_SI = E T^2 S^-1 M S^-1, K_SI = E S^-1 K S^-1, D_SI = E T S^-1 D S^-1. Inputs on translations are
    forces, others are moments; outputs are displacements and angles. Unit columns therefore stay unit columns. Scalar
    dofs are not converted.
    """
    if model.dofs is None and units.length != 1:
        raise InputError(
            f"units: {model.name} has no nodes, so that translations cannot be told from rotations; give --nodes (and "
            "--dofs)"
        )
    if model.interfaces:
        raise InputError(f"units: {model.name} has interface nodes already; convert it before they are made")
    if model.loads:
        raise InputError(f"units: {model.name} has loads already, which are in SI; convert it before they are made")
    # translations have the unit of length, rotations have none
    moved = _translations(model)
    scale = np.where(moved, units.length, 1.0)
    # each entry by what its row and column are
    operator = model.operator.map(lambda mat: mat.copy())
    for key, mat in operator.matrices.items():
        scale_to_si(model, units, key, mat)
    dense = [None if mat is None else dense_matrix(model.K, _columns(model, mat, names, moved, scale, units, rates))
             for mat, names, rates in ((model.B, model.input_names, Rates()),
                                       (model.Ct, model.own_output_names, model.rates))]  # fmt: skip
    # materials, places, and names of the units that were
    properties = model.properties
    if properties is not None:
        stress, density = units.energy / units.length**3, units.mass / units.length**3
        properties = replace(
            properties, materials=tuple(material.in_units(stress, density) for material in properties.materials)
        )
    dofs, held = (rows and Dofs(rows.node, rows.direction, rows.position * units.length)
                  for rows in (model.dofs, model.held))  # fmt: skip
    return model.with_fields(
        operator=operator, B=dense[0], Ct=dense[1], dofs=dofs, held=held,
        converted_from=units.name, properties=properties,
        rates=model.rates.in_time(units.time),
    )  # fmt: skip


def scale_to_si(model, units: Units, key: str, mat):
    """Convert a matrix M, D or K (`key`) with the rows of a model from other units. Collective."""
    inverse = model.K.createVecLeft()
    inverse.setArray(1 / np.where(_translations(model), units.length, 1.0))
    mat.diagonalScale(inverse, inverse)
    mat.scale(units.energy * units.time ** "KDM".index(key[0]))  # K_v as K


def _translations(model) -> np.ndarray:
    """Return which rows of this rank are translations; all are where nothing is known of them."""
    direction = np.zeros(model.local_rows, int) if model.dofs is None else model.dofs.direction
    return ~rotational(direction) & (direction != SCALAR)


def _columns(model, mat, names, moved, scale, units, rates):
    """Return the rows of this rank of B, or of the measured columns C^T, in SI."""
    local = mat.getDenseArray().real.copy()
    of_forces = np.array(model.comm.allgather((local[moved] != 0).any(axis=0))).any(axis=0)
    rows = rates.rows_of_columns(len(of_forces))
    translates = np.zeros(len(names), bool)
    np.logical_or.at(translates, rows, of_forces)
    factors = np.where(translates, units.length, 1.0)
    factors[[stress_output_of(name) is not None for name in names]] = units.energy / units.length**3
    for component, unit in (("f", units.energy / units.length), ("m", units.energy)):
        cuts = [cut_output_of(name) for name in names]
        factors[[cut is not None and cut.component[0] == component for cut in cuts]] = unit
    return local / scale[:, None] * factors[rows]
