"""Refuse models that cannot be reduced, and warn of others that look wrong."""

from __future__ import annotations

import numpy as np

from ..linalg.csr import diagonal_of
from ..model.damping import ModalDamping, caughey_terms
from ..model.definiteness import check_definite, warnings_of_definiteness
from ..model.frames import Buckens, refuse_unsymmetric
from ..model.interfaces import warnings_of_interfaces
from ..model.rigid_body_modes import exchange_of_matrices, misfit_of_nodes, remark_on_digits, warnings_of_nodes
from ..model.rows_alone import warnings_of_rows_alone
from ..model.second_order_model import SAY_SO, SYMMETRIC_TO, require_inputs
from ..model.solids import Solids
from ..model.stress_outputs import stress_output_of
from ..model.support import support_of
from ..parallel.failures import InputError
from ..parallel.petsc import MPI

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


def require_no_series(model, damping):
    """Refuse a Caughey series of more than two terms beside added terms."""
    if model.added and caughey_terms(damping) is not None:
        raise InputError(
            f"damping: {model.name} has {model.added.plural}, beside which a Caughey series of more than two terms is "
            "not computed; take 'rayleigh', 'given' or 'modal'"
        )


def warnings_of(model, frame, constant=None) -> tuple[str, ...]:
    """Return warnings of the model; those that the frame depends on are refusals. `constant`: the constant part of a
    model with parameters, whose nodes fit if they fit K without terms that resist or push rigid-body motions."""
    signs = (*warnings_of_definiteness(model), *warnings_of_rows_alone(model))
    if model.dofs is None:
        return signs
    exchanged = exchange_of_matrices(model)
    of_nodes = (exchanged,) if exchanged else tuple(warnings_of_nodes(model))  # all else follows from it
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
    of_loads = (note for item in model.loads for note in item.notes)
    nodes = sorted({item.node for name in model.output_names if (item := stress_output_of(name))})
    of_stresses = Solids(model, nodes).warnings() if nodes and model.properties is not None else ()
    return (*signs, *of_nodes, *warnings_of_interfaces(model), *of_loads, *of_stresses)


def warnings_of_band(model, band) -> tuple[str, ...]:
    """Return a band that ends far above all that the mesh follows, as one in other units does. Collective."""
    stiffness, mass = diagonal_of(model.K), diagonal_of(model.M)
    ratios = stiffness[mass > 0] / mass[mass > 0]
    highest = np.sqrt(max(model.comm.allreduce(ratios.max(initial=0.0), op=MPI.MAX), 0.0)) / 2 / np.pi
    if not 0 < BEYOND * highest < band[1]:
        return ()
    return (
        f"band: it ends at {band[1]:g} Hz, while single nodes of {model.name} vibrate at {highest:.2g} Hz at "
        "most, which no mesh follows; is the band in Hz, and are M and K in the units of one system?",
    )
