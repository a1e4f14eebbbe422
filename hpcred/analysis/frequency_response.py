"""Compute frequency responses H(i 2 pi f): densely for reduced and tiny models, else by a factorisation a frequency."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..linalg.blocks import as_pairs, create_block, from_dense, inner, multiply, times, unfold
from ..linalg.free_motions import check_free_motions
from ..linalg.refinement import REFINE_ABOVE
from ..linalg.solvers.base import MOVES_FREELY, SingularMatrix
from ..linalg.solvers.complex import ComplexSolver
from ..linalg.solvers.settings import Factoring
from ..linalg.solvers.shifted import ShiftedSolver
from ..model.damping import Damping, ModalDamping, caughey_terms, damping_or_given, loss_factor_of
from ..model.definiteness import check_definite
from ..model.frames import Frame, apply_frame
from ..model.input_output_counts import require_room
from ..model.scales import in_usual_units, unscaled
from ..model.second_order_model import SecondOrderModel, require_inputs, require_model
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError, Owned, agreed
from ..parallel.petsc import MPI, PETSc
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, within
from ..reduction.checks import check_series, require_no_series
from ..reduction.components.groups import Group
from ..reduction.result.reduced_model import ReducedModel, require_finite
from ..reduction.small.error_estimate import at_poles

SMALL = 10_000  # dofs up to which every rank takes its own share of the frequencies
TINY = 150  # dofs up to which full matrices take less time than the calls of a sparse solver
DRAWN = 801  # equally spaced frequencies of a curve; more around its resonances
NEAR = np.sinh(0.8 * np.arange(-6, 7))  # distances of those from a resonance, in half-widths of its peak
SHARPEST = 1e-4  # damping ratio as which a smaller one is drawn: undamped peaks have no end
TOGETHER = 2**20  # bytes of the matrices that are solved in one call, which stay in the cache


@spelled
def frequency_response(
    model: SecondOrderModel | ReducedModel, frequencies: ArrayLike, frame: Frame | None = None,
    damping: Damping | None = None, *, factoring: Factoring | None = None, progress: Progress | None = None,
    groups: int | None = None,
) -> np.ndarray:  # fmt: skip
    """Return the frequency response H(i omega) = C A(i omega)^-1 B. Collective.

    Parameters
    ----------
    model : SecondOrderModel or ReducedModel
        A reduced model has the frame and damping of its reduction.
    frequencies : array_like, shape (N,)
        Hz, each at least 0.
    frame : Frame, optional
        Reference frame of a free body; by default none. In the Buckens frame the response is that of the elastic part,
        of the body whose displacements are M-orthogonal to its rigid-body modes.
    damping : Damping, optional
        By default the damping matrix of the model, if it has one.
    factoring : Factoring, optional
        How to factor, and in how much memory.
    groups : int, optional
        Groups of ranks that solve for different frequencies at the same time, each with its own copy of the matrices
        and the factor; by default as many as ranks for small models and one for others.

    Returns
    -------
    ndarray, complex, shape (N, r, p)
        m/N for displacements under forces; the same on all ranks.

    Raises
    ------
    InputError
        At an undamped pole, for modal damping of a full model, which only a reduced model has, and for a Caughey series
        of more than two terms beside added terms, or beside forces and outputs on dofs without mass.

    Notes
    -----
    One factorization per frequency; equation (25) of Lehner and Eberhard (2006).
    """
    frequencies = checked_frequencies(frequencies)
    # of a reduced model
    if isinstance(model, ReducedModel):
        if frame is not None or damping is not None:
            raise InputError("frame, damping: a reduced model has those that it was reduced with; leave them out")
        require_finite(model)
        return _reduced(model, frequencies)
    # of a full model: what has a response, and how many ranks share a frequency
    require_model(model)
    progress = progress or Progress(model.comm)
    declared("factoring", factoring, Factoring | None)
    damping = damping_or_given(model, damping)
    if isinstance(damping, ModalDamping):
        raise InputError("damping: modal ratios belong to a reduced model; the full model has no such response")
    require_no_series(model, damping)
    groups = declared("groups", groups, int | None) or (model.comm.size if model.size <= SMALL else 1)
    if not 1 <= groups <= model.comm.size:
        raise InputError(f"groups: found {groups}, expected 1 to {model.comm.size}, the number of ranks")
    check_definite(model)
    require_inputs(model)
    check_series(model, damping)
    require_room(model, len(frequencies))
    with in_usual_units(model) as (usual, inputs, outputs):
        # frequencies by all ranks together, or each by one of the groups
        framed = apply_frame(usual, frame, damping)
        check_free_motions(framed.model, framed.rigid, factoring)
        if groups == 1:
            with progress.stage("full model", f"{len(frequencies)} frequencies"):
                response = _full(framed, frequencies, factoring, progress)
        else:
            with progress.stage("full model", f"{len(frequencies)} frequencies in {groups} groups"):
                response = _in_groups(framed, frequencies, factoring, progress, groups)
    return model.rates.at(2j * np.pi * frequencies, unscaled(response, inputs * outputs))


def response_and_drive(
    model, frequencies, frame=None, damping=None, *, measured=False, **keywords
) -> tuple[np.ndarray, np.ndarray]:
    """Return H (F, r, p) of a SecondOrderModel, and the responses (F, p) of its inputs where they act; see
    frequency_response. `measured`: H without the factors s and s^2 of velocities and accelerations. Collective."""
    if model.Ct is None:
        response = frequency_response(model, frequencies, frame, damping, **keywords)
        return response, np.einsum("fpp->fp", response)
    both = np.hstack([mat.getDenseArray().real for mat in (model.Ct, model.B)])
    with_drive = model.with_output_columns(both, tuple(map(str, range(both.shape[1]))))
    response = frequency_response(with_drive, frequencies, frame, damping, **keywords)
    response, drive = np.split(response, [model.Ct.getSize()[1]], axis=1)
    applied = model.rates.responses if measured else model.rates.at
    return applied(2j * np.pi * np.asarray(frequencies), response), np.einsum("fpp->fp", drive)


def checked_frequencies(frequencies) -> np.ndarray:
    """Return frequencies (F,) in Hz, of a list or a single number. Raises InputError where one is negative or not
    finite."""
    if isinstance(frequencies, (int, float)) or getattr(frequencies, "ndim", None) == 0:
        frequencies = [frequencies]
    values = np.array(declared("frequencies", frequencies, tuple[float, ...]))
    within("frequencies", values.tolist(), FREQUENCY)
    return values


def resonances_of(reduced: ReducedModel) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (k,) in Hz where the response of a ReducedModel may peak, and their damping ratios (k,)."""
    frequencies, ratios = at_poles(reduced.poles())
    return frequencies, ratios + reduced.loss_factor / 2


def frequencies_to_draw(band, resonances, tabulated=()) -> np.ndarray:
    """Return frequencies (F,) over a band (Hz) between which a curve is drawn without losing a peak, and the
    `tabulated` ones.

    `resonances`: frequencies (k,) and damping ratios (k,). Above 0 Hz, where free bodies have no response.
    """
    (low, high), (at, ratios) = band, resonances
    damped = ratios > SHARPEST
    near = at[:, None] * (1 + np.maximum(ratios, SHARPEST)[:, None] * NEAR)
    near = near[damped[:, None] | (NEAR != 0)]
    drawn = np.concatenate([np.linspace(low or high / DRAWN, high, DRAWN), near])
    return np.union1d(drawn[(drawn > 0) & (drawn >= low) & (drawn <= high)], tabulated)


def _in_groups(framed, frequencies, factoring, progress, groups):
    """Solve with the frequencies shared among groups of ranks."""
    comm = framed.model.comm
    with Owned(comm) as owned:
        group = owned.owns(Group(framed, groups))
        with agreed(comm), Owned(group.comm):
            own = _full(group.framed, frequencies[group.number :: groups], factoring, progress)
        shares = comm.allgather((group.number, own) if group.leads else (None, None))
    response = np.zeros((len(frequencies), *own.shape[1:]), dtype=complex)
    for owner, values in shares:
        if owner is not None:
            response[owner::groups] = values
    return response


def measured_response(reduced, frequencies, rates) -> np.ndarray:
    """Return the response (F, r, p) of a ReducedModel without the factors s and s^2 of velocities and accelerations,
    which the `rates` of the full model tell. Collective."""
    return _reduced(reduced, frequencies, lambda s: reduced.measured_response(s, rates))


def _reduced(reduced, frequencies, response_at=None, comm=MPI.COMM_WORLD):
    """Solve with the frequencies shared among the ranks."""
    response_at = response_at or reduced.transfer_function
    mine = frequencies[comm.rank :: comm.size]
    with agreed(comm):
        try:
            mine = [response_at(2j * np.pi * mine[chunk]) for chunk in slices_of(len(mine), reduced.size)]
        except np.linalg.LinAlgError as error:
            place = "0 Hz, where rigid-body motions have" if not frequencies.all() else "a pole of the model, which has"
            raise InputError(f"frequencies: found {place} no response; leave it out") from error
    response = np.zeros((len(frequencies), len(reduced.C), reduced.B.shape[1]), dtype=complex)
    for rank, chunk in enumerate(comm.allgather(mine)):
        if chunk:
            response[rank :: comm.size] = np.concatenate(chunk)
    return response


def above_rest(frequencies: np.ndarray, response_at) -> tuple[np.ndarray, list[str]]:
    """Return frequencies (F,) in Hz without 0 Hz where `response_at(s)` has no response there, as of a machine that
    moves freely, and a sentence on it; all where there are no others."""
    others = frequencies[frequencies > 0]
    if len(others) in (0, len(frequencies)):
        return frequencies, []
    try:
        response_at(np.zeros(1, dtype=complex))
    except np.linalg.LinAlgError:
        return others, ["0 Hz is left out: rigid-body motions have no response there"]
    return frequencies, []


def slices_of(count: int, size: int) -> list[slice]:
    """Return slices of `count` frequencies, of which each is solved in one call, for matrices (size, size)."""
    step = max(TOGETHER // (16 * size * size), 1)
    return [slice(first, first + step) for first in range(0, count, step)]


def _full(framed, frequencies, factoring, progress):
    model = framed.model
    with Owned(model.comm) as owned:
        loads = from_dense(model.B)
        sensors = from_dense(model.B if model.Ct is None else model.Ct)
        response = np.zeros((len(frequencies), sensors.getSizes()[1], loads.getSizes()[1]), dtype=complex)
        solvers = owned.owns(_Solvers(framed, factoring))

        def step(done):
            progress.step("frequencies of the full model", done, len(frequencies))

        step(0)
        left = _by_full_matrices(solvers, frequencies, response, step)
        for done, i in enumerate(left, len(frequencies) - len(left) + 1):
            frequency = frequencies[i]
            try:
                response[i] = solvers.response(2 * np.pi * frequency, loads, sensors)
            except SingularMatrix as error:
                away = "leave it out or add damping" if frequency else f"leave it out, or: {MOVES_FREELY}"
                raise InputError(
                    f"frequency {frequency:.10g} Hz is a pole of the full model (relative distance of its "
                    f"square {error.distance:.1e}); {away}"
                ) from error
            step(done)
    return response


def _by_full_matrices(solvers, frequencies, response, step) -> np.ndarray:
    """Fill in the response of a tiny damped model that one rank has; returns the numbers of the frequencies left.

    What is left is for the sparse solvers to solve, or to refuse: 0 Hz, and where the residual is not small.
    """
    model, left = solvers.model, np.ones(len(frequencies), dtype=bool)
    if model.size > TINY or model.comm.size > 1 or not solvers.damped or solvers.terms or solvers.rigid is not None:
        return np.flatnonzero(left)
    operator, B = model.operator.map(_full_matrix), _full_matrix(model.B)
    C = B.T if model.Ct is None else _full_matrix(model.Ct).T
    for chunk in slices_of(len(frequencies), model.size):
        omega = 2 * np.pi * frequencies[chunk]
        A = operator.at(1j * omega) + 1j * solvers.loss * operator["K"]
        try:
            X = np.linalg.solve(A, np.broadcast_to(B.astype(complex), (len(A), *B.shape)))
        except np.linalg.LinAlgError:
            continue
        residual = np.linalg.norm(A @ X - B, axis=1)
        response[chunk] = C @ X
        small = (residual <= REFINE_ABOVE * np.linalg.norm(B, axis=0)).all(axis=1)  # NaN is not
        left[chunk] = (frequencies[chunk] == 0) | ~small
        step(np.count_nonzero(~left))
    return np.flatnonzero(left)


def _full_matrix(mat):
    """Return a matrix that one rank has as a numpy array; model matrices are real in both builds."""
    full = mat.convert("dense", PETSc.Mat())  # whose memory the array shares
    return full.getDenseArray().real.copy()


class _Solvers:
    """The arithmetic that a damping model needs: real without damping and at rest, complex otherwise."""

    def __init__(self, framed, factoring):
        self.model, self.rigid, self.factoring = framed.model, framed.rigid, factoring
        self.terms = caughey_terms(framed.damping)
        self.loss = loss_factor_of(framed.damping)
        self.damped = bool(self.model.D is not None or self.terms is not None or self.loss > 0 or self.model.added)
        self._shifted = self._complex = None

    def close(self):
        for solver in (self._shifted, self._complex):
            if solver is not None:
                solver.close()

    def response(self, omega, loads, sensors):
        """Return C A(i omega)^-1 B (r, p)."""
        solve = self._damped if omega and self.damped else self._undamped
        return solve(omega, loads, sensors)

    def _undamped(self, omega, loads, sensors):
        if self._complex is not None:
            self._complex.release()
        if self._shifted is None:
            self._shifted = ShiftedSolver(self.model, self.rigid, prefix="response_", factoring=self.factoring)
        self._shifted.factor(-(omega**2))
        solution = create_block(self.model.K, loads.getSizes()[1])
        self._shifted.solve(loads, solution)
        return inner(sensors, solution) / (1 + 1j * self.loss)

    def _damped(self, omega, loads, sensors):
        if self._shifted is not None:
            self._shifted.release()
        if self._complex is None:
            self._complex = ComplexSolver(self.model, self.rigid, prefix="response_", factoring=self.factoring)
        right = as_pairs(loads, self.model.K)
        solution = create_block(self.model.K, right.getSizes()[1])
        if self.terms is None:
            s = 1j * omega
            self._complex.factor_at(s, 1 + 1j * self.loss)
            self._complex.solve(right, solution)
        else:
            solve_caughey(self._complex, 1j * omega, self.terms, right, solution)
        gram = inner(sensors, solution)
        return gram[:, 0::2] + 1j * gram[:, 1::2]


def solve_caughey(solver, s, terms, right, solution):
    """Set solution = A(s)^-1 right with D = M sum_k a_k (M^-1 K)^k (39); pairs of columns.

    A(s) = M p(M^-1 K) with p(z) = s^2 + z + s sum_k a_k z^k; with its roots z_i and leading coefficient c,
    A^-1 = 1/c (K - z_d M)^-1 M ... (K - z_2 M)^-1 M (K - z_1 M)^-1: sparse solves only.
    """
    polynomial = s * np.array(terms, dtype=complex)
    polynomial[0] += s * s
    polynomial[1] += 1.0
    polynomial = np.trim_zeros(polynomial, "b")
    load = right
    for root in np.roots(polynomial[::-1]):
        solver.factor(-root)
        solver.solve(load, solution)
        load = None  # its memory is for the next one
        load = times(solver.model.M, solution)
    columns = solution.getSizes()[1] // 2
    multiply(solution, unfold(np.eye(columns) / polynomial[-1]))
