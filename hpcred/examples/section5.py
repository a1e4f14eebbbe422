"""Reproduce Section 5 of the paper on the built-in linkage: the models of Tables 1 and 2, and their errors."""

from dataclasses import dataclass

import numpy as np

from ..analysis.error import error_integral, relative_error
from ..analysis.frequency_response import frequency_response
from ..body.body import body_of
from ..model.frames import Buckens
from ..parallel.failures import agreed
from ..reduction.components.krylov import Krylov, StaticCorrection
from ..reduction.components.modes import Modes
from ..reduction.components.second_order_krylov import SecondOrderKrylov
from ..reduction.reduce import reduce
from ..simulation.joints import Joint
from ..simulation.loads import SineForce
from ..simulation.simulation import Simulation, simulate
from .linkage import BAND, DAMPING, FRAME, LOAD, SUPPORTS

FREQUENCIES = np.linspace(0.1, BAND[1], 3001)
ROUND_OFF = 1e-13  # deflation tolerance: all 14 vectors of row 1, the last of which are close to dependent


@dataclass(frozen=True)
class Row:
    """A row of a table: how the paper calls it, what it says of Q, and the basis."""

    number: int
    method: str
    modes: str
    points: str
    paper_q: float | None
    basis: tuple


def _modes(first, last):
    return Modes(index=tuple(range(first, last + 1)))


TABLE_1 = (
    Row(1, "Krylov", "", "10 Hz (1), 150 Hz (5), 240 Hz (3), 300 Hz (1)", 2.69e-9,
        (Krylov(10.0, 1), Krylov(150.0, 5), Krylov(240.0, 3), Krylov(300.0, 1))),
    Row(2, "second-order Krylov", "", "10 Hz (0), 150 Hz (2), 240 Hz (1), 300 Hz (0)", 4.67e-9,
        tuple(SecondOrderKrylov(f, order=j) for f, j in ((10.0, 0), (150.0, 2), (240.0, 1), (300.0, 0)))),
    Row(3, "modal + frm", "1-13", "0 Hz (0)", 1.44e-2, (_modes(1, 13), StaticCorrection())),
    Row(4, "modal", "1-14", "", 11.95, (_modes(1, 14),)),
)  # fmt: skip
TABLE_2 = (
    Row(1, "Krylov", "", "80 Hz (1), 260 Hz (0)", 4.01e-4, (Krylov(80.0, 1), Krylov(260.0, 0))),
    Row(2, "modal + second-order Krylov", "7-13", "150 Hz (0)", 1.20e-3,
        (_modes(7, 13), SecondOrderKrylov(150.0))),
    Row(3, "modal + frm", "7-20", "10 Hz (0)", 1.08e-3, (_modes(7, 20), Krylov(10.0))),
    Row(4, "modal", "7-27", "", 1.57, (_modes(7, 27),)),
)  # fmt: skip


AUTOMATIC = Row(0, "automatic, eps <= 1e-4", "", "chosen", None, ())


@dataclass(frozen=True)
class Setting:
    """A reference frame with its inputs, and the table and figure of the paper that belong to it."""

    table: int
    figure: int
    title: str
    frame: object
    inputs: tuple
    rows: tuple


SISO = Setting(1, 3, "SISO: chord frame, force at node 20", FRAME, (LOAD,), TABLE_1)
MIMO = Setting(2, 4, "MIMO: Buckens frame, seven inputs and outputs", Buckens(), (*SUPPORTS, LOAD), TABLE_2)


def compare(model, setting: Setting, numbers=None, progress=None, keep=None):
    """Reduce the linkage for the rows (all, or those with `numbers`), and compare with its full response. Collective.

    Returns a list of dicts with row, size, Q, eps_max and eps (frequencies). `keep(row, reduced, loaded)` is called
    with each reduced model before it is freed, and the model with the inputs of the setting.
    """
    results = []
    with model.with_inputs(setting.inputs) as loaded:
        full = frequency_response(loaded, FREQUENCIES, setting.frame, DAMPING)
        for row in setting.rows:
            if numbers is not None and row.number not in numbers:
                continue
            with _reduced(loaded, row, setting, progress) as reduced:
                errors = relative_error(full, frequency_response(reduced, FREQUENCIES), "paper")
                if keep is not None:
                    keep(row, reduced, loaded)
                measures = {"Q": error_integral(FREQUENCIES, errors), "eps_max": float(errors.max()), "eps": errors}
                results.append({"row": row, "size": reduced.size, **measures})
    return results


def _reduced(model, row, setting, progress=None):
    if row is AUTOMATIC:
        return reduce(model, (), setting.frame, DAMPING, tolerance=1e-4, band=BAND, progress=progress)
    return reduce(model, row.basis, setting.frame, DAMPING, deflation_tolerance=ROUND_OFF, progress=progress)


SIMULATION = Simulation(
    end=1.0, steps=1000,
    force=(SineForce(LOAD[0], (0.0, 0.0, -1000.0), 1.0),),
    constraint=(Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",))),
)  # fmt: skip
REFERENCE = Row(0, "all elastic modes", "7-120", "", 0.0, (_modes(7, 120),))


def time_response(model, progress=None):
    """Simulate Figure 5: the free linkage held at its supports and loaded, with all elastic modes and for Table 2.

    The ranks share the simulations. Returns (Row, Motion) pairs, the reference first. Collective.
    """
    comm, rows = model.comm, (REFERENCE, *MIMO.rows)
    motions = {}
    bodies = []
    with model.with_inputs(MIMO.inputs) as loaded:
        for row in rows:
            with _reduced(loaded, row, MIMO) as reduced:
                bodies.append(body_of(loaded, reduced, SIMULATION.nodes))
    with agreed(comm):
        for k in range(comm.rank, len(rows), comm.size):
            motions[k] = simulate(bodies[k], SIMULATION, progress)
    motions = {k: motion for of_rank in comm.allgather(motions) for k, motion in of_rank.items()}
    return [(row, motions[k]) for k, row in enumerate(rows)]


def deviations(motions):
    """Return largest |u_y - reference| of the loaded node in m for every reduced model."""
    curves = [lateral(motion) for _, motion in motions]
    return [float(np.abs(curve - curves[0]).max()) for curve in curves[1:]]


def lateral(motion):
    """Return u_y (nt,) of the loaded node in m."""
    return motion.node_displacement[:, motion.nodes.index(LOAD[0]), 1]


def table(results):
    """Return columns and rows of a table with the paper's figures beside ours."""
    columns = ["row", "method", "modes", "points (order)", "size", "Q of the paper", "Q", "largest eps"]
    rows = [
        [r["row"].number, r["row"].method, r["row"].modes, r["row"].points, r["size"],
         "" if r["row"].paper_q is None else r["row"].paper_q, r["Q"],
         r["eps_max"]]
        for r in results
    ]  # fmt: skip
    return columns, rows
