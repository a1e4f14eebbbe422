"""Write the state-space matrices of a ReducedModel by name, as .mat or .npz; SI units, rad/s.

With x = [q; q'], u the forces of the inputs and y the outputs:

    x' = A x + B u,  y = C x + D u                A (2m, 2m), B (2m, p), C (r, 2m), D (r, p): zero but for accelerations
    y_d' = C_velocity x                           C_velocity (d, 2m): the velocities of the d outputs without q', q''
    E x' = EA x + EB u                            the descriptor form, without the inverse of M: E = diag(I, M)
    mass q'' + damping q' + stiffness q = input_matrix u
    y = output_matrix q + velocity_matrix q' + acceleration_matrix q'' + feedthrough_matrix u, the last three where
        they are not zero

input_names, output_names; velocity_names of the rows of C_velocity; comment. Viscoelastic parts of Maxwell's law have
states w, x = [q; q'; w], and in the second-order form, whose mass is singular, coordinates (q, w): see
reduction.result.maxwell_states. Coordinates without mass, of dofs without mass, stay in the second-order form. In A, B,
C, D and E, EA, EB what follows forces at once is in D, and what dampers hold is a state of first order: see
reduction.result.massless. There is no place for structural damping and for fractional laws.

Of a model with parameters, unless values were chosen, these are at their reference values, and the arrays of
writers.arrays for parameters make up mass, damping, stiffness, input_matrix, output_matrix (M, D, K, B, C) at others.
"""

from dataclasses import replace

import numpy as np

from ..body.body import check_viscous, instability, maker
from ..files.outputs import MATLAB, ZIP
from ..reduction.result.massless import first_order, static_coordinates
from ..reduction.result.maxwell_states import maxwell_states, with_maxwell_states
from ..reduction.result.reduced_model import ReducedModel, require_finite
from .arrays import arrays_of_parameters, save_mat, save_npz, words_on_damping
from .base import Writer


def state_space(reduced: ReducedModel) -> dict:
    """Return the matrices of first and of second order by name.

    Parameters
    ----------
    reduced : ReducedModel

    Returns
    -------
    dict of ndarray

    Raises
    ------
    InputError
        For structural damping and fractional laws.
    """
    require_finite(reduced)
    # coordinates without mass and Maxwell elements have states of another number
    if static_coordinates(reduced):
        return _with_massless(reduced)
    if reduced.added:
        return _with_maxwell_states(reduced)
    check_viscous(reduced, "a state space")
    M, D, K, B, C, size = reduced.M, reduced.D, reduced.K, reduced.B, reduced.C, reduced.size
    _, Cv, Ca = reduced.output_parts
    # accelerations are M^-1 (B u - K q - D v), so outputs of them have feedthrough
    by_mass = np.linalg.solve(M.T, Ca.T).T
    zero, one = np.zeros((size, size)), np.eye(size)
    still, displaces = np.zeros((size, B.shape[1])), reduced.displaces
    direct = 0.0 if reduced.feedthrough is None else reduced.feedthrough
    return {
        "A": np.block([[zero, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]]),
        "B": np.concatenate([still, np.linalg.solve(M, B)]),
        "C": np.concatenate([C - by_mass @ K, Cv - by_mass @ D], axis=1),
        "D": by_mass @ B + direct,
        "C_velocity": np.concatenate([np.zeros_like(C), C], axis=1)[displaces],
        "E": np.block([[one, zero], [zero, M]]),
        "EA": np.block([[zero, one], [-K, -D]]),
        "EB": np.concatenate([still, B]),
        **_second_order(reduced, reduced, displaces),
    }


def _second_order(reduced, whole, moved, words=()) -> dict:
    """Return the second-order form of `whole`, `reduced` perhaps with further coordinates, and all names; `moved` (r,):
    which outputs have velocities; `words`: remarks."""
    outputs = {"velocity_matrix": whole.Cv, "acceleration_matrix": whole.Ca, "feedthrough_matrix": whole.feedthrough}
    names = [f"velocity of {name}" for name, shown in zip(reduced.output_names, moved, strict=True) if shown]
    return {
        "mass": whole.M, "damping": whole.D, "stiffness": whole.K, "input_matrix": whole.B, "output_matrix": whole.C,
        **{key: matrix for key, matrix in outputs.items() if matrix is not None},
        "input_names": np.array(reduced.input_names, dtype=str),
        "output_names": np.array(reduced.output_names, dtype=str),
        "velocity_names": np.array(names, dtype=str),
        "comment": np.array("; ".join([maker(reduced), *instability(reduced), *words])),
    }  # fmt: skip


def _with_massless(reduced) -> dict:
    """The matrices of a model with coordinates without mass, whose second-order form keeps them."""
    check_viscous(reduced, "a state space")
    whole = with_maxwell_states(reduced)[0] if reduced.added else reduced
    matrices = first_order(whole)
    elastic = reduced.M.any(axis=0)
    # rates of what follows forces at once are none of the states
    moved = reduced.displaces & ~(np.abs(reduced.C[:, ~elastic]) > 0).any(axis=1)
    if whole.feedthrough is not None:
        matrices["D"] = matrices["D"] + whole.feedthrough
    return matrices | {
        "C_velocity": matrices["C"][moved] @ matrices["A"],
        **_second_order(reduced, whole, moved, words_on_massless(reduced)),
    }


def words_on_massless(reduced) -> list[str]:
    """Return a remark on coordinates without mass, if there are any."""
    count = static_coordinates(reduced)
    return [f"{count} coordinates without mass are feedthrough and states of first order; the rates of outputs that "
            "they move are left out"] * bool(count)  # fmt: skip


def _with_maxwell_states(reduced) -> dict:
    """The matrices of a model with added terms."""
    states = maxwell_states(reduced.added)
    free = {"columns": None, "left_columns": None, "model": None}
    elastic = state_space(replace(reduced, operator=reduced.operator.quadratic, **free))
    A = states.state_matrix(np.linalg.inv(reduced.M), reduced.D, reduced.K)
    E = np.eye(len(A))
    E[: 2 * reduced.size, : 2 * reduced.size] = elastic["E"]
    mass, damping, stiffness = states.second_order(reduced.M, reduced.D, reduced.K)

    longer = {key: np.pad(elastic[key], [(0, states.size), (0, 0)]) for key in ("B", "EB", "input_matrix")}
    for key in ("C_velocity", "output_matrix", "velocity_matrix", "acceleration_matrix"):
        if key in elastic:
            longer[key] = np.pad(elastic[key], [(0, 0), (0, states.size)])
    C, Cv, Ca = reduced.output_parts
    outputs = np.hstack([C, Cv, np.zeros((len(C), states.size))]) + Ca @ A[reduced.size : 2 * reduced.size]
    return elastic | longer | {
        "A": A, "E": E, "EA": E @ A, "C": outputs, "mass": mass, "damping": damping, "stiffness": stiffness,
        "comment": np.array("; ".join([maker(reduced), *instability(reduced), *words_on_states(reduced)])),
    }  # fmt: skip


def words_on_states(reduced) -> list[str]:
    """Return a remark on the states of added terms, if there are any."""
    if not reduced.added:
        return []
    count = maxwell_states(reduced.added).size
    return [f"the last {count} states are those of Maxwell elements ({reduced.added.names})"]


class StateSpaceMat(Writer):
    """State spaces for MATLAB."""

    suffix, needs, kind, keeps_parameters = "_statespace.mat", "reduced", MATLAB, True
    save = staticmethod(save_mat)

    def write(self, target, source):
        reduced, parametric = source.reduced, source.parametric
        if parametric is not None and parametric.added:
            parametric, _ = with_maxwell_states(parametric)
        self.save(target, state_space(reduced) | arrays_of_parameters(parametric))
        words = words_on_massless(reduced) or words_on_states(reduced)
        return [*instability(reduced), *words, *words_on_damping(source.parametric)]


class StateSpaceNpz(StateSpaceMat):
    """State spaces for NumPy."""

    suffix, kind, save = "_statespace.npz", ZIP, staticmethod(save_npz)
