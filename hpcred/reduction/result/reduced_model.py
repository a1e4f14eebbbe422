"""Define the reduced model: small NumPy arrays, the same on all ranks, with the record of their reduction."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ...fe.dofs import ABSOLUTE, QUANTITIES
from ...linalg.pencil import LEAST_MASS, time_of
from ...model.interfaces.nodes import InterfaceNode
from ...model.loads.kinds import motions_of
from ...model.operator import NOTHING, Operator, Term, in_coordinates
from ...model.outputs.rates import Rates, combined
from ...model.second_order_model import SecondOrderModel, listed
from ...parallel.as_html import as_html
from ...parallel.failures import InputError, settle
from ...parallel.progress import counted
from .accuracy import Accuracy
from .massless import first_order, static_coordinates
from .maxwell_states import maxwell_states, with_maxwell_states
from .oscillating_poles import oscillating_poles
from .record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from scipy.signal import StateSpace

ROUND_OFF = 1e-13
SPREAD = 1e-12  # of the largest pole, by which round-off moves others
DOUBLE_ZERO = 1e-7  # of the largest pole: rigid-body motions have double zeros, which round-off spreads by its root


@dataclass(frozen=True, eq=False, init=False)
class ReducedModel:
    """M x'' + D x' + K x = B u, y = C x + C_v x' + C_a x'' + F u, m coordinates, p inputs, r outputs; SI units.

    It does not change: dataclasses.replace() returns others; another `operator` has other M, D, K or terms.

    Attributes
    ----------
    M, D, K : ndarray, shape (m, m)
        Terms of `operator`. M is singular where dofs have no mass: the last coordinates then are static deflections, or
        first-order states of dampers.
    B : ndarray, shape (m, p)
        Inputs.
    C, Cv, Ca : ndarray, shape (r, m)
        Outputs; Cv and Ca are None where they are zero.
    feedthrough : ndarray, shape (r, p), or None
        What outputs have of the inputs themselves, as absolute accelerations on a base that moves; None for nothing.
    operator : Operator
        All terms of A(s).
    frequencies : ndarray, shape (m,)
        Eigenfrequencies and pseudo-frequencies in Hz (52); without mass the least that counts as such.
    loss_factor : float
        eta of structural damping, for frequency responses only.
    viscoelastic : tuple
        Terms with matrices (m, m) that are added to K, the static stiffness.
    input_names, output_names : tuple of str
        Of the inputs and outputs.
    interfaces : tuple of InterfaceNode
        In interface coordinates, the nodes whose displacements x, y, z, rx, ry, rz are the first coordinates, six a
        node, in this order; empty in pseudo-modal ones.
    resultants : ndarray, shape (p, 6), or None
        Force and moment about the origin of each input at 1 on the whole body, in N and N m, which move its frame; None
        where the model has no nodes.
    record : Record or None
        What made it.
    columns, left_columns : block or None
        The basis V, distributed, (n, m), zero at the dofs that the frame holds, and W of a two-sided projection; None
        after reading a file. close() frees them.
    model : SecondOrderModel or None
        What was reduced; None after reading a file.
    """

    operator: Operator
    B: np.ndarray
    C: np.ndarray
    frequencies: np.ndarray
    loss_factor: float
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    interfaces: tuple[InterfaceNode, ...]
    resultants: np.ndarray | None
    record: Record | None
    columns: object
    left_columns: object
    model: SecondOrderModel | None
    Cv: np.ndarray | None
    Ca: np.ndarray | None
    feedthrough: np.ndarray | None

    def __init__(
        self, M: np.ndarray | None = None, D: np.ndarray | None = None, K: np.ndarray | None = None,
        B: np.ndarray | None = None, C: np.ndarray | None = None, frequencies: np.ndarray | None = None,
        loss_factor: float = 0.0, input_names: tuple[str, ...] = (), output_names: tuple[str, ...] = (),
        interfaces: tuple[InterfaceNode, ...] = (), resultants: np.ndarray | None = None, record: Record | None = None,
        columns: object = None, left_columns: object = None, model: SecondOrderModel | None = None,
        Cv: np.ndarray | None = None, Ca: np.ndarray | None = None, viscoelastic: Iterable[Term] | None = None, *,
        operator: Operator = NOTHING, feedthrough: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        known = dict(locals())
        added = operator.added if viscoelastic is None else viscoelastic
        known["operator"] = Operator.of(
            **{key: operator.get(key) if known[key] is None else known[key] for key in "MDK"}, added=added
        )
        for attribute in fields(ReducedModel):
            object.__setattr__(self, attribute.name, known[attribute.name])
        missing = [key for key in ("M", "D", "K") if key not in known["operator"].terms]
        missing += [key for key in ("B", "C", "frequencies") if known[key] is None]
        if missing:
            raise TypeError(f"ReducedModel: found no {', '.join(missing)}, expected M, D, K, B, C and frequencies")

    M = property(lambda self: self.operator["M"], doc="The mass matrix (m, m).")
    D = property(lambda self: self.operator["D"], doc="The damping matrix (m, m).")
    K = property(lambda self: self.operator["K"], doc="The stiffness matrix (m, m), at rest.")
    viscoelastic = property(lambda self: tuple(self.added), doc="The terms that are added to K.")

    @property
    def added(self) -> Operator:
        """The terms beside M, D and K."""
        return self.operator.added

    def in_coordinates(self, T: np.ndarray, **changed) -> ReducedModel:
        """Return the model in coordinates z (k,) with x = T z, T (m, k), and `changed` fields."""
        columns = {key: in_coordinates(key, matrix, T) for key in ("B", "C", "Cv", "Ca")
                   if (matrix := getattr(self, key)) is not None}  # fmt: skip
        return replace(self, operator=self.operator.projected(T), **columns | changed)

    @property
    def size(self) -> int:
        return len(self.M)

    @property
    def rigid_size(self) -> int:
        """How many coordinates belong to rigid-body motion: in interface coordinates of a free body those of its
        rigid-body modes, which the frame has taken out of pseudo-modal ones."""
        return self.record.rigid_body_modes if self.record is not None and self.interfaces else 0

    @property
    def size_in_words(self) -> str:
        """The number of coordinates, such as 26 coordinates (6 rigid-body, 20 elastic)."""
        rigid = self.rigid_size
        kinds = f" ({rigid} rigid-body, {self.size - rigid} elastic)" if rigid else ""
        return counted(self.size, "coordinate") + kinds

    def __str__(self):
        """Describe the model in a few lines; one that was reduced to a tolerance begins with its error."""
        record, first, last = self.record, [], []
        if record is not None:
            last = [f"warning: {text}" for text in record.warnings]
            if (accuracy := record.accuracy) is not None:
                first = [accuracy.sentence]
                last = [accuracy.least_accurate, accuracy.measured, *last]
                last = [text for text in last if text and text != f"warning: {accuracy.sentence}"]
        origin = f" for the {record.size} dofs of {record.model}" if record is not None else ""
        frame = f", frame {record.frame.kind}, damping {record.damping.kind}" if record is not None else ""
        return "\n  ".join([
            "\n".join([*first, f"reduced model: {self.size_in_words}{origin}"]),
            f"pseudo-frequencies {self.frequencies[0]:.6g} to {self.frequencies[-1]:.6g} Hz{frame}",
            f"inputs {listed(self.input_names)}; outputs {listed(self.output_names)}",
            *last,
        ])  # fmt: skip

    __repr__ = __str__

    def _repr_html_(self):
        """Return the verdict, where the error is known, and a table for notebooks."""
        record, accuracy = self.record, None if self.record is None else self.record.accuracy
        facts = {"full model": f"{record.model}, {record.size} dofs"} if record is not None else {}
        facts["pseudo-frequencies (Hz)"] = f"{self.frequencies[0]:.6g} to {self.frequencies[-1]:.6g}"
        if record is not None:
            facts |= {"units": f"SI, converted from {record.units}"} if record.units else {}
            facts |= {"frame": record.frame.kind, "damping": record.damping.kind}
        facts |= {"inputs": listed(self.input_names), "outputs": listed(self.output_names)}
        warnings = () if record is None else record.warnings
        notes = [f"warning: {text}" for text in warnings if accuracy is None or text != accuracy.sentence]
        known = "" if accuracy is None else accuracy._repr_html_()
        return known + as_html(f"reduced model: {self.size_in_words}", facts, notes=notes)

    def transfer_function(self, s: complex | np.ndarray) -> np.ndarray:
        """Return H(s) = (C + s C_v + s^2 C_a) A(s)^-1 B + F (r, p), (25, 41); (..., r, p) for an array (...) of s in
        1/s."""
        return combined(self.output_parts, s) @ self.states(s) + (0.0 if self.feedthrough is None else self.feedthrough)

    def measured_response(self, s: complex | np.ndarray, rates: Rates) -> np.ndarray:
        """Return H(s) without the factors s and s^2 of velocities and accelerations, whose relative error is that of
        the displacement; `rates`: those of the full model, by which they are known."""
        H = combined(self.output_parts, s, rates.orders) @ self.states(s)
        return H if self.feedthrough is None else H + self.feedthrough

    @property
    def output_parts(self) -> np.ndarray:
        """C, C_v and C_a (3, r, m), with zeros for None."""
        return np.stack([np.zeros_like(self.C) if rows is None else rows for rows in (self.C, self.Cv, self.Ca)])

    @property
    def displaces(self) -> np.ndarray:
        """Which outputs (r,) have no part that is a velocity or an acceleration."""
        return ~self.output_parts[1:].any(axis=(0, 2))

    def states(self, s: complex | np.ndarray) -> np.ndarray:
        """Return A(s)^-1 B (m, p), with 1 + i eta times K in A(s); (..., m, p) for an array (...) of s in 1/s."""
        dynamic = self.operator.at(s) + 1j * self.loss_factor * self.K
        loads = np.broadcast_to(self.B.astype(complex), (*dynamic.shape[:-2], *self.B.shape))
        return np.linalg.solve(dynamic, loads)

    def driven_by(self, quantity: str) -> ReducedModel:
        """Return the model with another motion of its bases as input, for exports and simulations elsewhere.

        Parameters
        ----------
        quantity : {"displacement", "velocity", "acceleration"}
            What the inputs of all bases are, in m or rad, m/s or rad/s, m/s^2 or rad/s^2.

        Returns
        -------
        ReducedModel
            Absolute accelerations become absolute displacements or velocities; outputs that would need derivatives of
            the input are left out. Beside forces it has twice as many coordinates.

        Raises
        ------
        InputError
            For a model without bases, with parameters, or without outputs that could stay.
        """
        return with_base_motion(self, quantity)

    def frequency_response(self, frequencies: ArrayLike) -> np.ndarray:
        """Return H(i omega) at `frequencies` in Hz, (F, r, p)."""
        import hpcred  # the public functions, which stand above

        return hpcred.frequency_response(self, frequencies)

    def save(self, path: str | PathLike[str], **more) -> None:
        """Write the result file `path` with all that multibody programs need; `more`: arguments of write_result.
        Collective."""
        import hpcred

        hpcred.write_result(path, self, self.model, **more)

    def export(self, path: str | PathLike[str], format: str | None = None, **more) -> dict[str, Any]:
        """Write a file for another program, by default the one that the ending of its name stands for: see
        export_result. Collective.

        Parameters
        ----------
        path : str or PathLike
            Such as "rod.SID_FEM".
        format : str, optional
            One of those of `hpcred export --format`.
        **more
            `nodes`, `units`, `modes`, `options`, `preload` of export_result; `stress` (stress_modes) and
            `geometric_stiffness` of write_result.

        Returns
        -------
        dict
            What was written.
        """
        import hpcred

        return hpcred.workflows.export_reduced(self, path, format, **more)

    def to_state_space(self) -> StateSpace:
        """Return the model as scipy.signal.StateSpace with states (q, q'), SI units.

        Raises
        ------
        InputError
            For structural damping, which has no meaning in time.
        """
        from scipy.signal import StateSpace

        import hpcred

        arrays = hpcred.state_space(self)
        return StateSpace(*(arrays[key] for key in "ABCD"))

    def to_pymor(self) -> Any:
        """Return the model as pymor.models.iosys.SecondOrderModel, on this rank alone; from_pymor is the way back.

        Of a parametric model the matrices that depend on parameters are pyMOR's linear combinations, with the same
        names of parameters; `rom.at(...).to_pymor()` is that of one set of values.

        Raises
        ------
        InputError
            If pyMOR is not installed or would take ranks away, or for structural damping; of parametric models also
            for accelerations and damping that follows the eigenfrequencies.
        """
        import hpcred

        from .to_pymor import pymor_model

        return pymor_model(self, hpcred.state_space)

    def plot(self, pairs: str | Sequence[str] | None = None, *, band: Sequence[float] | None = None) -> Figure:
        """Draw the frequency response, and its estimated error where that is known: see plot_response. Collective.

        Parameters
        ----------
        pairs : str or list of str, optional
            Responses such as "20:z/1:x", output and input; by default those of all drive points.
        band : (float, float), optional
            Hz; by default that of the reduction.
        """
        import hpcred  # the public functions, which stand above

        return hpcred.workflows.plot_response(self, pairs, band=band)

    def state_matrix(self) -> np.ndarray:
        """Return A (2m, 2m) of (x, x')' = A (x, x'); the states of added terms come last, for Maxwell's law.
        Coordinates without mass are eliminated, or have one state."""
        if static_coordinates(self):
            return first_order(with_maxwell_states(self)[0] if self.added else self)["A"]
        size, inverse = self.size, np.linalg.inv(self.M)
        if self.added:
            return maxwell_states(self.added).state_matrix(inverse, self.D, self.K)
        return np.block([[np.zeros((size, size)), np.eye(size)], [-inverse @ self.K, -inverse @ self.D]])

    def poles(self) -> np.ndarray:
        """Return the 2m roots of det A(s) in rad/s, by imaginary part, without structural damping.

        With added terms of Maxwell's law also those of their states; of other laws those that oscillate and are found,
        which is nearly all, as nothing counts them.
        """
        if any(term.law.elements is None for term in self.added):
            from scipy.linalg import eigh  # which most models do without

            # what has no mass, far above the frequencies that are asked for
            floor = np.where(self.M.any(axis=0), 0.0, LEAST_MASS * time_of(self.K, self.M) ** 2 * np.diag(self.K))
            eigenvalues, X = eigh(self.K, self.M + np.diag(floor))
            upper = oscillating_poles(eigenvalues, X.T @ self.D @ X, self.added.projected(X))
            return np.concatenate([upper.conj()[::-1], upper])
        roots = np.linalg.eigvals(self.state_matrix())
        return roots[np.argsort(roots.imag)]

    def unstable_poles(self) -> np.ndarray:
        """Return the poles in the right half-plane, beyond round-off; none where M, K and the symmetric part of D are
        semidefinite, since gyroscopic forces take no power."""
        matrices = self.operator.matrices | {"D": (self.D + self.D.T) / 2}
        if np.array_equal(self.K, self.K.T) and all(
            _semidefinite(matrix, np.abs(self.operator[key]).max(initial=0.0)) for key, matrix in matrices.items()
        ):
            return np.zeros(0, dtype=complex)
        roots = self.poles()
        size = np.abs(roots).max(initial=0.0)
        rigid = DOUBLE_ZERO * size if self.rigid_size else 0.0
        # round-off is one of the largest pole, which grows with the mesh: what the user cares for lies far below it
        return roots[(roots.real > 1e-9 * np.abs(roots) + SPREAD * size) & (np.abs(roots) > rigid)]

    def close(self) -> None:
        """Free the basis, and let go of the model. Collective."""
        for block in (self.columns, self.left_columns):
            if block is not None:
                block.destroy()
        if self.model is not None:
            self.model.close()
        for key in ("columns", "left_columns", "model"):
            object.__setattr__(self, key, None)

    def __enter__(self) -> ReducedModel:
        return self

    def __exit__(self, _, error, __):
        if error is not None and self.columns is not None:
            settle(self.columns.comm.tompi4py(), error)
        self.close()


def with_base_motion(reduced, quantity: str):
    """Return the model with other motions of its bases as inputs: see ReducedModel.driven_by.

    Where a model answers to the acceleration b'' of a base with y, it answers to b with y'': an output of a
    displacement becomes that of an acceleration of the same coordinates, and an absolute acceleration an absolute
    displacement. Forces beside a base keep their responses, by a second set of the same coordinates.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"quantity: found '{quantity}', expected one of {', '.join(QUANTITIES)}")
    moves = motions_of(reduced.record.loads) if reduced.record is not None else []
    if not moves:
        raise InputError("quantity: the model has no base that moves; reduce with [[base]] in the job")
    if hasattr(reduced, "parameters"):
        raise InputError("quantity: found a model with parameters, whose matrices these inputs change; choose their "
                         "values first")  # fmt: skip
    if any(load.integrated for load in reduced.record.loads):
        raise InputError("quantity: the inputs are no accelerations of bases any more; take the model from before")
    order = len(QUANTITIES) - 1 - QUANTITIES.index(quantity)
    if not order:
        return reduced
    # rows (3, r, m) of outputs to motions, and to forces; what would need derivatives of the motion is left out
    by_order, absolute = reduced.output_parts, np.array([name.startswith(ABSOLUTE) for name in reduced.output_names])
    of_motion = np.where(absolute[:, None], by_order, np.roll(by_order, order, axis=0))
    of_force = np.where(absolute[:, None], np.roll(by_order, -order, axis=0), by_order)
    kept = absolute | ~by_order[-order:].any(axis=(0, 2))
    if not kept.any():
        raise InputError(f"quantity: all outputs ({', '.join(reduced.output_names)}) would need derivatives of the "
                         f"{quantity} of the base; reduce with displacements as outputs")  # fmt: skip
    known = {
        "output_names": tuple(
            name.replace(f"{ABSOLUTE}{QUANTITIES[-1]}", f"{ABSOLUTE}{quantity}", 1)
            for name, there in zip(reduced.output_names, kept, strict=True) if there),
        "feedthrough": None if reduced.feedthrough is None else reduced.feedthrough[kept],
        "record": replace(reduced.record, loads=tuple(
            replace(load, integrated=order) if load.is_motion else load for load in reduced.record.loads)),
        "columns": None, "left_columns": None, "model": None,
    }  # fmt: skip
    B, forces = reduced.B, np.array([name not in moves for name in reduced.input_names])
    rows, frequencies, operator = of_motion[:, kept], reduced.frequencies, reduced.operator
    if forces.any():
        operator = operator.map(lambda matrix: block_diag(matrix, matrix))
        frequencies, rows = np.tile(frequencies, 2), np.concatenate([rows, of_force[:, kept]], axis=2)
        B = np.vstack([np.where(forces, 0.0, B), np.where(forces, B, 0.0)])
        known["interfaces"] = ()
    outputs = {key: part if key == "C" or part.any() else None
               for key, part in zip(("C", "Cv", "Ca"), rows, strict=True)}  # fmt: skip
    driven = replace(reduced, operator=operator, B=B, frequencies=frequencies, **outputs, **known)
    last = np.argsort(~driven.M.any(axis=0), kind="stable")  # coordinates without mass, which stand behind the others
    return driven.in_coordinates(np.eye(driven.size)[:, last], frequencies=frequencies[last])


def with_zero_D(reduced: ReducedModel) -> ReducedModel:
    """Return the reduced model with D = 0."""
    return replace(reduced, operator=Operator.of(reduced.M, np.zeros_like(reduced.D), reduced.K, reduced.added))


def as_measured(reduced: ReducedModel, accuracy: Accuracy) -> ReducedModel:
    """Return the reduced model with the damping that its accuracy was measured with; without its basis."""
    if not accuracy.loss_factor:
        return replace(reduced, columns=None, left_columns=None, model=None)
    whole = reduced if accuracy.beside_damping else with_zero_D(reduced)
    return replace(whole, loss_factor=accuracy.loss_factor, columns=None, left_columns=None, model=None)


def _semidefinite(matrix, size):
    """Test whether a matrix is symmetric without negative eigenvalues, up to round-off of entries of a size."""
    if not np.abs(matrix - matrix.T).max(initial=0.0) <= ROUND_OFF * size:
        return False
    return np.linalg.eigvalsh(matrix).min(initial=0.0) >= -ROUND_OFF * len(matrix) * size


def require_finite(reduced: ReducedModel):
    """Raise InputError for NaN and Inf in a reduced model, as one that was made by hand may have."""
    arrays = {key: getattr(reduced, key) for key in ("B", "C", "Cv", "Ca", "frequencies", "feedthrough")}
    for key, value in (reduced.operator.matrices | arrays).items():
        if value is None:
            continue
        numbers = np.asarray(value)
        wrong = numbers.size - np.count_nonzero(np.isfinite(numbers))
        if wrong:
            raise InputError(f"reduced model: {key} has {wrong} of {numbers.size} numbers that are NaN or Inf")
