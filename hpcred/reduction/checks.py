"""Refuse models that cannot be reduced, and warn of others that look wrong."""

from __future__ import annotations

import math

import numpy as np

from ..fe.solids import Solids
from ..linalg.csr import diagonal_of
from ..model.damping import ModalDamping, caughey_terms
from ..model.definiteness import check_definite, warnings_of_definiteness
from ..model.frames import Buckens, refuse_unsymmetric
from ..model.interfaces.motion import members
from ..model.interfaces.nodes import warnings_of_interfaces
from ..model.order_of_matrices import questions_on_order
from ..model.outputs.stresses import stress_output_of
from ..model.rigid_body.modes import misfit_of_nodes, remark_on_digits, warnings_of_nodes
from ..model.rigid_body.rows_alone import warnings_of_rows_alone
from ..model.rigid_body.support import support_of
from ..model.second_order_model import SAY_SO, SYMMETRIC_TO, require_inputs
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from ..parallel.sums import anywhere

LEAST_DIGITS = 4  # of a number that is seen to be 2 pi times a round one: one in 200 is so by accident
FAR = 3.0  # times the frequency at which a wave is as long as a bearing is wide
BEYOND = 10.0  # times the highest frequency of a single node: a mesh has modes up to about five times that


def check_model(model):
    """Refuse a model that cannot be reduced: an unsymmetric M, or K unless it is declared so, one of the other sign, no
    inputs."""
    check_symmetric(model, declared=True)
    check_definite(model)
    require_inputs(model)


def check_symmetric(model, declared=False):
    """Refuse an unsymmetric M, and an unsymmetric K, unless K may be so where it is `declared`."""
    hint = f"; {SAY_SO}"
    if model.may_be_unsymmetric("K"):
        hint = "; its unsymmetric forces make modes complex, which hpcred.damped_modes finds"
    for key in ("M", "K"):
        if not model.is_symmetric(key) and not (declared and model.may_be_unsymmetric(key)):
            raise InputError(
                f"{model.name}: matrix {key} is not symmetric: max |a_ij - a_ji| / |a_ij| = "
                f"{model.symmetry_defects[key]:.1e}, expected round-off (below {SYMMETRIC_TO:g})"
                + (hint if key == "K" else "")
            )


def check_unsymmetric(model, damping):
    """Refuse what does not go with an unsymmetric K: added terms, and damping by eigenfrequencies."""
    if model.is_symmetric("K"):
        return
    if model.added:
        raise InputError(f"{model.name}: found {model.added.plural} beside an unsymmetric K, which no reduction has; "
                         "leave one of them out")  # fmt: skip
    require_no_frequencies(model, damping)


def require_no_frequencies(model, damping):
    """Refuse damping by eigenfrequencies, which an unsymmetric K does not have."""
    if isinstance(damping, ModalDamping) or caughey_terms(damping) is not None:
        raise InputError(
            f"damping: found '{damping.kind}', which is made from eigenfrequencies, and the unsymmetric K of "
            f"{model.name} has none; take 'rayleigh' or 'given'"
        )


def check_added(model, damping):
    """Refuse what does not go with added terms: a long Caughey series, and matrices with which a law that has no states
    may be unstable, which its poles do not show."""
    if not model.added:
        return
    require_no_series(model, damping)
    without = [term for term in model.added if term.law.elements is None]
    if without and (not model.symmetric or warnings_of_definiteness(model)):
        raise InputError(
            f"{model.name}: the law of {without[0].name} is {without[0].law.nature}, and M, D and K are not all "
            "symmetric and positive semidefinite, so that stability is not known; take a law of kind 'maxwell'"
        )


def check_series(model, damping):
    """Refuse forces and outputs on dofs without mass beside a Caughey series of more than two terms. Collective."""
    terms = caughey_terms(damping)
    if terms is None:
        return
    without = diagonal_of(model.M) == 0
    columns = [mat.getDenseArray()[without] for mat in (model.B, model.Ct) if mat is not None]
    if anywhere(model.comm, [column.any() for column in columns]):
        raise InputError(
            f"damping.kind: found 'caughey' with {len(terms)} terms and forces or outputs on dofs without mass of "
            f"{model.name}, where M (M^-1 K)^k has no value; take two terms (Rayleigh), modal ratios or a loss factor, "
            "or give these dofs some mass"
        )


def require_no_series(model, damping):
    """Refuse a Caughey series of more than two terms beside added terms."""
    if model.added and caughey_terms(damping) is not None:
        raise InputError(
            f"damping: {model.name} has {model.added.plural}, beside which a Caughey series of more than two terms is "
            "not computed; take 'rayleigh', 'given' or 'modal'"
        )


def doubts_of_matrices(model, exchanged: str | None) -> tuple[str, ...]:
    """Return what looks wrong of M, D and K: an indefinite one, another order, and other units; `exchanged`: what
    exchange_of_matrices says. Collective."""
    return tuple(warnings_of_definiteness(model) + ([exchanged] if exchanged else questions_on_order(model)))


def warnings_of(model, frame, exchanged: str | None, constant=None) -> tuple[str, ...]:
    """Return warnings of the model beside those of its matrices; those that the frame depends on are refusals.
    `exchanged`: what exchange_of_matrices says. `constant`: the constant part of a model with parameters, whose nodes
    fit if they fit K without terms that resist or push rigid-body motions. Collective."""
    of_rows = tuple(warnings_of_rows_alone(model))
    if model.dofs is None:
        return of_rows
    if exchanged and isinstance(frame, Buckens):
        raise InputError(exchanged)
    of_nodes = () if exchanged else tuple(warnings_of_nodes(model))  # all else follows from it
    if of_nodes and constant is not None and (misfit := misfit_of_nodes(model)) and not misfit_of_nodes(constant):
        of_nodes = tuple(sentence for sentence in of_nodes if sentence != misfit)
    if of_nodes and isinstance(frame, Buckens):
        refuse_unsymmetric(model)  # which pushes rigid-body motions
        raise InputError(of_nodes[0])
    support = support_of(model) if isinstance(frame, Buckens) else None
    if support and (few := remark_on_digits(support)):
        of_nodes += (f"{model.name}: {few}",)
    if support and (soft := support.softness):
        of_nodes += (
            f"frame: {model.name} counts as free, but K resists translations by up to {soft:.1e} of the stiffness of a "
            "row: soft springs to the ground, which the Buckens frame leaves out, have to be put into the multibody "
            "model",
        )
    of_loads = (note for load in model.loads for note in load.notes)
    nodes = sorted({stress.node for name in model.output_names if (stress := stress_output_of(name))})
    of_stresses = Solids(model, nodes).warnings() if nodes and model.properties is not None else ()
    return (*of_rows, *of_nodes, *warnings_of_interfaces(model), *of_loads, *of_stresses)


def warnings_of_band(model, band) -> tuple[str, ...]:
    """Return what looks wrong of a band: one in rad/s, one far above what the bearings transmit, and one above all that
    the mesh follows. Collective."""
    sentences = (_in_radians(band[1]), _beyond_bearings(model, band[1]), _beyond_mesh(model, band[1]))
    return tuple(sentence for sentence in sentences if sentence)


def _in_radians(upper) -> str | None:
    """Return a sentence where the end of a band is a round number times 2 pi, to the digits that it has."""
    digits = len(f"{upper:.10e}".partition("e")[0].replace(".", "").rstrip("0"))
    if digits < LEAST_DIGITS:
        return None
    unit = 10.0 ** (math.floor(math.log10(upper)) + 1 - digits)
    round_number = float(f"{upper / (2 * np.pi):.{min(digits - LEAST_DIGITS, 2)}e}")
    if abs(upper - 2 * np.pi * round_number) > unit:
        return None
    return (
        f"band: it ends at {upper:.10g} Hz, which is 2 pi times {round_number:g}; a band is in Hz: where rad/s were "
        f"meant, it ends at {round_number:g}"
    )


def _beyond_bearings(model, upper) -> str | None:
    """Return a sentence where shear waves at the end of a band are far shorter than all interfaces are wide."""
    materials = model.properties.materials if model.properties is not None else ()
    speeds = [(material.young / (2 * (1 + material.poisson) * material.density)) ** 0.5 for material in materials
              if None not in (material.young, material.poisson, material.density) and material.density > 0]  # fmt: skip
    interfaces = [interface for interface in model.interfaces if interface.definition]
    if not speeds or not interfaces:
        return None
    wide = []
    for interface in interfaces:
        away = model.dofs.position[members(model, interface.definition)] - interface.position
        wide.append(2 * model.comm.allreduce(np.sqrt((away**2).sum(axis=1)).max(initial=0.0), op=MPI.MAX))
    transmitted = max(speeds) / min(wide) if min(wide) > 0 else np.inf
    if upper <= FAR * transmitted:
        return None
    return (
        f"band: it ends at {upper:g} Hz, where waves of shear are shorter than the smallest bearing, which is "
        f"{min(wide):.3g} m wide: they hardly pass a bearing above {transmitted:.2g} Hz; is the band in Hz?"
    )


def _beyond_mesh(model, upper) -> str | None:
    """Return a sentence where a band ends far above all that the mesh follows, as one in other units does."""
    stiffness, mass = diagonal_of(model.K), diagonal_of(model.M)
    ratios = stiffness[mass > 0] / mass[mass > 0]
    highest = np.sqrt(max(model.comm.allreduce(ratios.max(initial=0.0), op=MPI.MAX), 0.0)) / 2 / np.pi
    if not 0 < BEYOND * highest < upper:
        return None
    return (
        f"band: it ends at {upper:g} Hz, while single nodes of {model.name} vibrate at {highest:.2g} Hz at "
        "most, which no mesh follows; is the band in Hz, and are M and K in the units of one system?"
    )
