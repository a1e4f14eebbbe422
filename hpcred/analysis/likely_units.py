"""Tell the units of a model from its mass, its size and the speed of waves in it, and warn of other ones."""

from __future__ import annotations

import operator

import numpy as np

from ..fe.dofs import SCALAR
from ..fe.elements import solid_volume
from ..linalg.csr import diagonal_of
from ..model.units import POUND, POUND_FORCE, SI, UNITS, Units, units_of
from ..parallel.lookup import sort_over_ranks
from ..parallel.petsc import MPI
from ..parallel.sums import joined

SPEEDS = (200.0, 3e4)  # m/s: waves in plastics to ceramics, with an order of magnitude for the estimate
DENSITIES = (50.0, 3e4)  # kg/m^3: mass over the volume of the surrounding box
FIRST = (0.1, 1e4)  # m/s: the first natural frequency times the diagonal of the surrounding box, wires to blocks
FAR = (10.0, 100.0, 100.0)  # beyond these ranges, where neither the estimates nor unusual materials can be the reason
HEAVY, STIFF = 2200.0, 2e9  # kg/m^3, Pa: what is denser (stone, metals) is stiffer, lead by a factor of 8
LIGHT = 300.0  # kg/m^3: foams, which explain anything
CLEARLY = 3.0  # times outside, where a mistake that is often made explains all of it
POINT_MASS = 30.0  # of the median of the diagonal of M: what is more belongs to no element
# densities in other units than those of K and of lengths: the units of these, how many times M is too large, in words
MISTAKES = (
    ("mm,t,s", 1e3, "a density in kg/mm^3 in place of t/mm^3"),
    ("inch,lbf,s", POUND_FORCE / POUND / 0.0254, "a density in lbm/inch^3 in place of lbf s^2/inch^4"),
    ("SI", 1e-3, "a density in g/cm^3 or t/m^3 in place of kg/m^3"),
)


def extent(model) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and largest coordinates (3,) of the nodes, those that are held included. Collective."""
    placed = model.dofs.position[model.dofs.direction != SCALAR]
    position = placed if model.held is None else np.concatenate([placed, model.held.position])
    low = np.min(model.comm.allgather(position.min(axis=0, initial=np.inf)), axis=0)
    return low, np.max(model.comm.allgather(position.max(axis=0, initial=-np.inf)), axis=0)


def likely_units(model, mass, size) -> str | None:
    """Return the only system of UNITS in which the body is of a usual material, or None where none or several are, or
    where a density in other units would explain the numbers as well. Collective.

    See fitting_units.
    """
    fitting = fitting_units(model, mass, size)
    mistaken = _mistakes(_numbers_of_material(model, mass, size, None))
    return fitting[0].name if len(fitting) == 1 and not mistaken else None


def fitting_units(model, mass, size, first=None, written=SI) -> list[Units]:
    """Return the systems of UNITS in which the body is of a usual material and of usual stiffness. Collective.

    `mass` of the body, `size` (3,) of its box, and its `first` natural frequency where known; `written`: the units in
    which the numbers were before they were converted. Cautious: bodies that fill little of their box, or whose
    stiffness is not that of elements between neighbouring nodes, fit no system.
    """
    numbers = _numbers_of_material(model, mass, size, first)
    return [units for units in UNITS if numbers and max(_beyond(numbers, units, written)) == 1]


def _numbers_of_material(model, mass, size, first):
    """Return the speed of waves, density, and speed of the first mode (or None), or None where they are not known.
    Collective."""
    volume = _volume_of_elements(model) or float(np.prod(size))
    speed = wave_speed(model)
    if not volume or not speed:
        return None
    return speed, mass * _share_of_elements(model) / volume, first and first * float(np.linalg.norm(size))


def _volume_of_elements(model) -> float | None:
    """Return the volume of solids, or None. Collective."""
    labels = [dofs for dofs in (model.dofs, model.held) if dofs is not None]
    label, first = np.unique(np.concatenate([dofs.node for dofs in labels]), return_index=True)
    position = np.concatenate([dofs.position for dofs in labels])[first]
    label, *places = sort_over_ranks(model.comm, label, list(position.T))
    once = np.diff(label, prepend=-1) > 0
    return solid_volume(model.comm, model.elements, label[once], np.stack(places, axis=1)[once])


def _beyond(numbers, units=SI, written=SI) -> list[float]:
    """Return how many times each of the numbers is outside of what is usual, where they are in these units, not as
    written."""
    L, M, T = np.divide(units.sizes, written.sizes)
    return _outside([value and value * factor for value, factor in
                     zip(numbers, (L / T, M / L**3, L / T), strict=True)])  # fmt: skip


def _outside(numbers) -> list[float]:
    """Return how many times the speed of waves, density, and speed of the first mode are outside of what is usual, and
    Young's modulus of the first two below that of any material so dense."""
    factors = [max(low / value, value / high, 1.0) for value, (low, high) in
               zip(numbers, (SPEEDS, DENSITIES, FIRST), strict=True) if value]  # fmt: skip
    speed, density, _ = numbers
    return [*factors, max(STIFF / (density * speed**2), 1.0) if density > HEAVY else 1.0]


def _mistakes(numbers, written=SI) -> list[str]:
    """Return sentences on the MISTAKES that make a usual material of numbers that are clearly of none as written."""
    if not numbers or max(_outside(numbers)) < CLEARLY:
        return []
    sentences = []
    for name, times, words in MISTAKES:
        L, M, T = np.divide(units_of(name).sizes, written.sizes)
        speed, density, first = numbers
        faster = L / T * np.sqrt(times)
        right = speed * faster, density * M / L**3 / times, first and first * faster
        if right[1] > LIGHT and max(_outside(right)) == 1:
            sentences.append(f"{words} would explain it (K in {name}, M {times:.4g} times what it should be)")
    return sentences


def _share_of_elements(model) -> float:
    """Return the part of the mass that is no point mass, by the diagonal of M. Collective."""
    masses = diagonal_of(model.M)
    mine = masses[(model.dofs.direction < 3) & (masses > 0)]
    most = POINT_MASS * _median_of_ranks(model.comm, mine)
    usual, total = model.comm.allreduce(np.array([np.minimum(mine, most).sum(), mine.sum()]))
    return float(usual / total) if total else 1.0


def warnings_of_units(model, mass, first=None) -> list[str]:
    """Return a sentence where mass, size, stiffness and perhaps the `first` frequency (Hz) are those of other units.

    Of bodies that fill little of their box, such as frames of beams, the speed of waves alone. Collective.
    """
    low, high = extent(model)
    written = units_of(model.converted_from) if model.converted_from else SI
    # density and wave speed judged together, where both can be had
    numbers = _numbers_of_material(model, mass, high - low, first)
    mistakes = _mistakes(numbers, written)
    if numbers and not mistakes and all(map(operator.lt, _beyond(numbers)[: len(FAR)], FAR)):
        return []
    # units in which the numbers are those of a material
    fitting = fitting_units(model, mass, high - low, first, written)
    size = " x ".join(f"{value:.4g}" for value in high - low)
    known = f" and a first frequency of {first:.4g} Hz" if first else ""
    reason = f"a mass of {mass:.4g} kg in a box of {size} m{known} is of no usual material"
    if numbers:
        reason += f", with a density of {numbers[1]:.3g} kg/m^3 and waves at {numbers[0]:.2g} m/s"
    # with a mass that tells nothing, the waves alone
    if not fitting and not mistakes:
        speed = wave_speed(model)
        if not speed or SPEEDS[0] / FAR[0] <= speed <= SPEEDS[1] * FAR[0]:
            return []
        units_of_speed = [(units, units.length / units.time * written.time / written.length) for units in UNITS]
        fitting = [units for units, factor in units_of_speed if SPEEDS[0] <= speed * factor <= SPEEDS[1]]
        reason = f"waves that travel at {speed:.2g} m/s between neighbouring nodes are in no usual material"
    if any(np.allclose(units.sizes, written.sizes, rtol=1e-6, atol=0) for units in fitting):
        return []
    # each cause that is possible, with what to do
    causes = [f"{words}: correct it, and write the matrices again" for words in mistakes]
    if fitting:
        causes.append(
            f"the numbers look like {' or '.join(units.name for units in fitting)}, not {written.words}; convert with "
            f"--units {' or '.join(units.words for units in fitting)}"
        )
    return [f"{model.name}: {reason}: {'; or '.join(causes)}"] if causes else []


def wave_speed(model) -> float | None:
    """Return the speed of waves between neighbouring nodes, within an order of magnitude, or None. Collective.

    The mean distance of a node to the nearest one that K couples it with times the median of (K_ii / M_ii)^(1/2), of
    the stiffest direction, by 3: about what elements of first and second order have, also thin ones.
    """
    K, M = diagonal_of(model.K), diagonal_of(model.M)
    with np.errstate(over="ignore"):  # quotients of values that are refused elsewhere
        ratio = np.divide(K, M, out=np.zeros(len(K)), where=M > 0)
    direction, medians = model.dofs.direction, []
    for k in range(3):
        medians.append(_median_of_ranks(model.comm, ratio[(direction == k) & (ratio > 0)]))
    total, count = model.comm.allreduce(_distances(model), op=MPI.SUM)
    if not count or not max(medians):
        return None
    return float(total / count * np.sqrt(max(medians)) / 3)


def _median_of_ranks(comm, values) -> float:
    """Return the median of the medians of positive values on the ranks; 0 where there are none. Collective."""
    medians = joined(comm, [float(np.median(values))] if values.size else [])
    return float(np.median(medians)) if medians else 0.0


def _distances(model):
    """Return sum and number of the distances of the first nodes of this rank to the nearest other one that K couples.
    """
    first = model.first_row
    most = min(model.local_rows, 30_000)
    indptr, indices, values = model.K.getValuesCSR()
    indices, values = indices[: indptr[most]], values[: indptr[most]]
    rows = np.repeat(np.arange(most), np.diff(indptr[: most + 1]))
    columns = indices.astype(np.int64) - first
    near = (columns >= 0) & (columns < model.local_rows) & (values != 0)
    rows, columns = rows[near], columns[near]
    placed = model.dofs.direction != SCALAR
    rows, columns = (places[placed[rows] & placed[columns]] for places in (rows, columns))
    length = np.linalg.norm(model.dofs.position[rows] - model.dofs.position[columns], axis=1)
    rows, length = rows[length > 0], length[length > 0]
    starts = np.flatnonzero(np.diff(rows, prepend=-1))
    nearest = np.minimum.reduceat(length, starts) if len(starts) else length
    return np.array([nearest.sum(), len(nearest)])
