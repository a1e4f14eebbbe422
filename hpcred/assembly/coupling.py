"""Couple the parts of a machine: one operator, from which rigid joints have eliminated coordinates; or receptances.

A joint has conditions g (one a direction), which are combinations of displacements of its two interfaces. Soft ones
(bushings, masses) add g^T z(s) g to the operator, by terms of the house: mass, damping, stiffness, laws. Rigid ones
hold g x = 0: with G of all of them, x = T y for an orthonormal basis of the null space of G, its columns scaled so that
coordinates of all units count alike. Receptances Y of uncoupled bodies couple as in frequency-based substructuring,

    H = Y - Y G_i W G_o Y,   W = (G_o Y G_i + Z^-1)^-1,   Z^-1 = 0 for rigid conditions.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from ..analysis.frequency_response import slices_of
from ..fe.dofs import SAME_PLACE
from ..linalg.eigensolver import congruent
from ..linalg.pencil import massless_last, modes_of, time_of
from ..model.interfaces.motion import rigid_rows
from ..model.laws.hysteretic import Hysteretic
from ..model.laws.tabulated import Tabulated
from ..model.operator import Law, Operator, Power, Term, in_coordinates
from ..model.parameters.definitions import Parameter, checked_values
from ..model.second_order_model import listed
from ..parallel.declared import nearest
from ..parallel.failures import InputError
from ..reduction.parametric.reduced import ParametricReducedModel, with_terms
from ..reduction.result.record import JointRecord
from ..reduction.result.reduced_model import ReducedModel
from .joints import GROUND, SIX, BushingJoint, PointMass, RigidJoint, matrix_of
from .parts import ROUND_OFF, UNDAMPED, Channels, Part, part_and_node

REDUNDANT = 1e-9  # of a condition, what is left of it beside those before
NOTHING = 1e-14  # of M + tau^2 K in scaled coordinates: motions that nothing resists
STILL = 1e-13  # of the largest squared frequency of coordinates with mass: rigid-body motion, but for round-off
FAINT = 1e-11  # of the same: modes below it have lost five digits of sixteen
MASSLESS = 1e-12  # of the largest mass, in coordinates that are scaled
FAR = 0.3  # of the smaller body: ends of a joint that are meant to lie together, or beside each other, are closer


@dataclass(frozen=True, eq=False, kw_only=True)
class Condition:
    """A direction of a joint: `rows` of the outputs and of the inputs of the parts that it holds, by name of the part;
    `laws`: value and law of each spring, damper and mass in it, none of a rigid one."""

    label: str
    rows: dict[str, tuple[np.ndarray, np.ndarray]]
    laws: tuple[tuple[float, Law], ...] = ()

    @property
    def rigid(self) -> bool:
        return not self.laws

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """Return z(s) (S,) of a soft one."""
        return sum(value * (law.coefficient(s) + law.static) for value, law in self.laws)


@dataclass(frozen=True, eq=False, kw_only=True)
class Machine:
    """Parts by name, the conditions of its joints, and its inputs and outputs: names, and rows (l, k) of the inputs
    and outputs of all parts. `far`: a sentence on each of the joints whose ends lie far apart."""

    parts: dict[str, Part]
    conditions: tuple[Condition, ...]
    parameters: tuple[Parameter, ...]
    inputs: Channels
    outputs: Channels
    joints: tuple[JointRecord, ...] = ()
    far: tuple[str, ...] = ()
    warnings: list[str] = field(default_factory=list)

    @property
    def reference(self) -> dict[str, float]:
        return checked_values(self.parameters, {})

    @property
    def exact(self) -> str:
        """Which bodies count as exact, in words that follow those on the error; "" where none does."""
        names = [f"'{name}'" for name, part in self.parts.items() if part.exact]
        return f", where {' and '.join(names)} count{'s' * (len(names) == 1)} as exact" if names else ""

    def as_measured(self) -> Machine:
        """Return the machine whose bodies have the damping that their errors were measured with."""
        known = [part.accuracy.loss_factor for part in self.parts.values() if part.accuracy is not None]
        loss_factor = max(known, default=0.0) or UNDAMPED
        return replace(self, parts={name: part.as_measured(loss_factor) for name, part in self.parts.items()})

    def conditions_of(self, side: int) -> np.ndarray:
        """Return G (c, k) on the outputs (side 0) or inputs (1) of all parts."""
        of = [(part.outputs, part.inputs)[side].names for part in self.parts.values()]
        names = list(zip(self.parts, of, strict=True))
        rows = [np.concatenate([condition.rows[name][side] if name in condition.rows else np.zeros(len(own))
                                for name, own in names]) for condition in self.conditions]  # fmt: skip
        return np.array(rows).reshape(-1, sum(map(len, of)))

    def coupled(self, s: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return L = I - Y G_i W G_o (S, r, r), R = I - G_i W G_o Y (S, p, p) and G_i W G_o (S, p, r) of uncoupled
        receptances Y (S, r, p) of all parts: H = L Y = Y R."""
        Go, Gi = self.conditions_of(0), self.conditions_of(1).T
        # rows of soft conditions times z: rigid ones have no z, and soft ones may have none at some frequency
        z = np.ones((len(s), len(Go)), dtype=complex)
        soft = np.array([not condition.rigid for condition in self.conditions], dtype=bool)
        for k in np.flatnonzero(soft):
            z[:, k] = self.conditions[k].impedance(s)
        between = z[:, :, None] * (Go @ Y @ Gi) + np.diag(soft.astype(float))
        K = Gi @ np.linalg.solve(between, z[:, :, None] * Go)
        return np.eye(Y.shape[1]) - Y @ K, np.eye(Y.shape[2]) - K @ Y, K

    def receptances(self, s: np.ndarray) -> np.ndarray:
        """Return Y(s) (S, r, p) of all parts, uncoupled."""
        return blocks([part.response(s, self.reference) for part in self.parts.values()])

    def response(self, s: np.ndarray) -> np.ndarray:
        """Return H(s) (S, r, p) of the machine at s (S,), by receptances."""
        largest = max(*self.outputs.matrix.shape, *self.inputs.matrix.shape, len(self.conditions))
        responses = []
        for chunk in slices_of(len(s), largest):
            Y = self.receptances(s[chunk])
            responses.append(self.outputs.matrix @ self.coupled(s[chunk], Y)[0] @ Y @ self.inputs.matrix.T)
        return np.concatenate(responses)

    def model(self, tau: float) -> tuple[ReducedModel, np.ndarray]:
        """Return the model of the machine in pseudo-modal coordinates, with parameters where bodies have some, and T
        (n, m) from them to the coordinates of all parts; `tau` (s): 1 / (2 pi f) of the frequencies that count. Raises
        InputError."""
        # the modes at the reference of what rigid conditions leave free
        with _after(self.far):
            T = self._resisted(self._free(tau), tau)
            squares, X, without = self._modes_seen(T, tau)
        if (squares < 0).any():
            raise InputError(f"the machine is unstable at rest: {(squares < 0).sum()} of its modes have a negative "
                             "stiffness, as of a body beyond buckling; give it more support")  # fmt: skip
        # all in these modes, whose mass and stiffness are diagonal but for what is skew
        T = T @ X
        constant, terms, added = self._without_rigid(T)
        masses = np.where(np.arange(len(squares)) < len(squares) - without, 1.0, 0.0)
        at = with_terms(constant, terms, self.reference)
        K = np.diag(np.where(masses > 0, squares, tau**-2)) + (at["K"] - at["K"].T) / 2
        machine = ReducedModel(
            operator=Operator.of(np.diag(masses), at["D"], K, added), B=at["B"], C=at["C"], Cv=at.get("Cv"),
            Ca=at.get("Ca"), frequencies=np.sqrt(squares) / (2 * np.pi), input_names=self.inputs.own,
            output_names=self.outputs.own,
        )  # fmt: skip
        if terms:
            machine = ParametricReducedModel.of(machine, parameters=self.parameters, constant=constant, terms=terms)
        return machine, T

    def _resisted(self, T, tau):
        """Return coordinates T without the motions that have neither mass nor stiffness, as those of a spring across
        its direction. Raises InputError where something acts on them."""
        at = with_terms(*self._without_rigid(T)[:2], self.reference)
        G = at["M"] + tau**2 * (at["K"] + at["K"].T) / 2
        size = np.sqrt(np.where((own := np.abs(np.diag(G))) > 0, own, 1.0))
        shares, X = np.linalg.eigh((G + G.T) / 2 / np.outer(size, size))
        X /= size[:, None]
        nothing = np.abs(shares) < NOTHING
        rows = {"inputs": at["B"].T, "outputs": at["C"], "dampers": at["D"]}
        acted = [kind for kind, matrix in rows.items()
                 if (np.abs(matrix @ X[:, nothing]) > ROUND_OFF * (np.abs(matrix) @ np.abs(X[:, nothing]))).any()]
        if acted:
            raise InputError(f"the machine has {nothing.sum()} motions with neither mass nor stiffness, to which "
                             f"{acted[0]} belong; join them, or leave these out of `{acted[0]}`")  # fmt: skip
        return T @ X[:, ~nothing] if nothing.any() else T

    def _modes(self, T, tau):
        """Return what `_modes` does of the machine at the reference, in coordinates T."""
        at = with_terms(*self._without_rigid(T)[:2], self.reference)
        return _modes(at["K"], at["M"], tau)

    def _modes_seen(self, T, tau):
        """Return the same. Raises InputError for springs and masses beside which round-off leaves few digits of modes:
        of more than if these conditions were of the size of the bodies, whatever the band is."""
        own = min(time_of(part.model.K, part.model.M) for part in self.parts.values())
        rows = self._rows() * self._scale(own)
        at = np.array([1j / own])
        shares = np.array([
            0.0 if condition.rigid else own**2 * abs(condition.impedance(at)[0]) * (row @ row)
            for condition, row in zip(self.conditions, rows, strict=True)
        ])  # fmt: skip
        if not (shares > 1).any():
            return self._modes(T, tau)
        lighter = tuple(
            replace(condition, laws=tuple((value / max(share, 1.0), law) for value, law in condition.laws))
            for condition, share in zip(self.conditions, shares, strict=True)
        )  # fmt: skip
        others = replace(self, conditions=lighter)._modes(T, tau)
        try:
            modes = self._modes(T, tau)
            hidden = max(_below(modes, bound) - _below(others, bound) for bound in (STILL, FAINT))
        except np.linalg.LinAlgError:  # matrices of which nothing but these conditions is left
            hidden = len(others[0])
        if hidden > 0:
            worst = int(shares.argmax())
            raise InputError(f"{self.conditions[worst].label}: is {shares[worst]:.0e} times as stiff or heavy as the "
                             "bodies, whose motions round-off would hide; take a rigid joint, or check units (N/m, kg)")
        return modes

    def _without_rigid(self, T):
        """Return matrices of all parts with the springs, dampers and masses between them, terms and added terms, in
        coordinates y, x = T y."""
        constant, terms, added = {}, [], []
        parts = list(self.parts.values())
        # rows of T, and columns of inputs and outputs, of each part
        sizes = np.array([(part.size, len(part.inputs.names), len(part.outputs.names)) for part in parts])
        own = (np.split(matrix, ends, axis=1) for matrix, ends in zip(
            (T.T, self.inputs.matrix, self.outputs.matrix), sizes.cumsum(axis=0)[:-1].T, strict=True))  # fmt: skip
        for part, rows, inputs, outputs in zip(parts, *own, strict=True):

            def moved(of, matrix, X=rows.T, inputs=inputs, outputs=outputs):
                if of in "MDK":
                    return congruent(matrix, X)
                matrix = in_coordinates(of, matrix, X)
                return matrix @ inputs.T if of == "B" else outputs @ matrix

            for key, matrix in part.constant.items():
                constant[key] = constant.get(key, 0.0) + moved(key, matrix)
            terms += [replace(term, matrix=moved(term.of, term.matrix))
                      for term in getattr(part.model, "terms", ())]  # fmt: skip
            added += [replace(term, matrix=moved("K", term.matrix), name=f"{part.name}: {term.name}")
                      for term in part.model.added]  # fmt: skip
            if eta := float(part.model.loss_factor):
                added.append(Term(moved("K", part.model.K), Hysteretic((1.0,), (eta,)),
                                  f"{part.name}: structural damping"))  # fmt: skip
        # what soft conditions add: powers of s to M, D and K, laws to terms of their own
        for condition, row in zip(self.conditions, self._rows() @ T, strict=True):
            for value, law in condition.laws:
                pattern = value * np.outer(row, row)
                if isinstance(law, Power):
                    constant["KDM"[law.order]] = constant["KDM"[law.order]] + pattern
                    continue
                constant["K"] = constant["K"] + law.static * pattern
                added.append(Term(pattern, law, condition.label))
        constant = {key: matrix for key, matrix in constant.items() if key in "MDKBC" or matrix.any()}
        return constant, tuple(terms), tuple(_together(added))

    def _rows(self) -> np.ndarray:
        """Return the conditions (c, n) in the coordinates of all parts. Raises InputError."""
        parts = self.parts.values()
        C, B = (block_diag(*(getattr(part.model, key) for part in parts)) for key in "CB")
        rows, forces = self.conditions_of(0) @ C, self.conditions_of(1) @ B.T
        apart = np.abs(rows - forces).max(axis=1, initial=0.0) > ROUND_OFF * np.abs(rows).max(axis=1, initial=0.0)
        if apart.any():
            raise InputError(f"{self.conditions[int(apart.argmax())].label}: forces act on the body otherwise than its "
                             "displacements are measured; reduce one-sided, with interfaces among inputs and outputs")
        return rows

    def _scale(self, tau) -> np.ndarray:
        """Return the coordinates (n,) of all parts at which mass and stiffness at 1 / tau are one."""
        size = np.concatenate([np.diag(part.model.M) + tau**2 * np.abs(np.diag(part.model.K))
                               for part in self.parts.values()])  # fmt: skip
        return 1 / np.sqrt(np.where(size > 0, size, 1.0))

    def _free(self, tau) -> np.ndarray:
        """Return an orthonormal basis T (n, k), of scaled coordinates, of what rigid conditions leave free. Raises
        InputError for conditions that others hold already."""
        rigid = [k for k, condition in enumerate(self.conditions) if condition.rigid]
        scale = self._scale(tau)
        G = (self._rows() * scale)[rigid]
        return scale[:, None] * _unheld(G, [self.conditions[k].label for k in rigid])


def _unheld(G, labels) -> np.ndarray:
    """Return an orthonormal basis (n, n - c) of what conditions G (c, n) leave free. Raises InputError for those that
    others hold already."""
    lengths = np.linalg.norm(G, axis=1)
    Q, R = np.linalg.qr((G / np.maximum(lengths, 1e-300)[:, None]).T, mode="complete")
    left = np.zeros(len(G))
    left[: min(R.shape)] = np.abs(np.diag(R))
    held = [labels[k] for k in np.flatnonzero((left < REDUNDANT) | (lengths == 0))]
    if held:
        raise InputError(
            f"{held[0]}: is held by other rigid joints already, or cannot move ({len(held)} of {len(G)} rigid "
            "directions: the loop is overdetermined); leave these directions out, or take a bushing"
        )
    return Q[:, len(G) :]


def blocks(matrices) -> np.ndarray:
    """Return block diagonal matrices (S, r, p) of those of all parts."""
    return np.array([block_diag(*each) for each in zip(*matrices, strict=True)])


def _modes(K, M, tau):
    """Return omega^2 (m,), ascending, X (m, m), and how many of the last coordinates have no mass."""
    if np.linalg.eigvalsh((M + M.T) / 2).min(initial=1.0) > MASSLESS * np.abs(M).max(initial=0.0):
        squares, X = modes_of(K, (M + M.T) / 2)
        without, largest = 0, squares.max(initial=0.0)
    else:
        squares, X, without = massless_last(K, M, tau)
        largest = max(squares[: len(squares) - without].max(initial=0.0), tau**-2)
    return np.where(np.abs(squares) < STILL * largest, 0.0, squares), X, without


def _below(modes, bound) -> int:
    """Return how many modes that `_modes` found have squared frequencies below a share of the largest one, or no mass.
    """
    squares, _, without = modes
    squares = np.abs(squares[: len(squares) - without])
    return int((squares < bound * squares.max(initial=0.0)).sum()) + without


def _together(added):
    """Return added terms, those of one law and joint as one."""
    groups = {}
    for term in added:
        key = (term.name.rpartition(":")[0], term.law)
        before = groups.get(key)
        groups[key] = term if before is None else replace(before, matrix=before.matrix + term.matrix, name=key[0])
    return groups.values()


def machine_of(parts: list[Part], joints, masses=(), inputs=None, outputs=None, tables=None) -> Machine:
    """Return the machine of parts, joints and masses; `tables`: by number of the joint from 0, (laws by direction) of
    those with a table. Raises InputError that names the joint."""
    by_name: dict[str, Part] = {}
    for part in parts:
        if part.name in by_name:
            raise InputError(f"body.name: found '{part.name}' twice, expected a name of its own for every body")
        by_name[part.name] = part
    of_joints = [_conditions(by_name, joint, f"joint[{k}]", (tables or {}).get(k, {}))
                 for k, joint in enumerate(joints)]  # fmt: skip
    conditions = sum(of_joints, [])
    for k, mass in enumerate(masses):
        conditions += _of_mass(by_name, mass, f"mass[{k}]")
    known, far = _distances(by_name, joints)
    machine = Machine(parts=by_name, conditions=tuple(conditions), parameters=_parameters(parts),
                      inputs=_chosen(parts, "inputs", inputs), outputs=_chosen(parts, "outputs", outputs),
                      joints=known, far=far, warnings=[*far, *(text for part in parts for text in part.warnings)],
                      )  # fmt: skip
    rigid = [k for k, condition in enumerate(conditions) if condition.rigid]
    with _after(far):
        _unheld(machine.conditions_of(0)[rigid], [conditions[k].label for k in rigid])
    machine.warnings.extend(_twice(joints, of_joints, masses))
    loose = [part.name for part in parts if len(parts) > 1 and not any(part.name in each.rows for each in conditions)]
    if loose:
        machine.warnings.append(f"body '{loose[0]}' has no joint: it moves by itself")
    return machine


@contextmanager
def _after(far):
    """Say first which joints have ends far apart, where a machine is refused: that may be why."""
    try:
        yield
    except InputError as error:
        raise InputError("; ".join([*far, str(error)])) from error


def _distances(parts, joints) -> tuple[tuple[JointRecord, ...], tuple[str, ...]]:
    """Return the joints with the distances of their ends, and a sentence on each where it is large beside a body."""
    known, far = [], []
    for k, joint in enumerate(joints):
        ends = [part_and_node(parts, name, f"joint[{k}]") for name in joint.bodies if name != GROUND]
        places = np.array([part.places[node] for part, node in ends])
        apart = None
        if len(ends) == 2 and np.isfinite(places).all():
            apart = float(np.linalg.norm(places[0] - places[1]))
            apart = apart if apart > SAME_PLACE * np.abs(places).max() else 0.0
        known.append(JointRecord(key=f"joint[{k}]", kind=joint.kind, ends=joint.bodies, apart=apart))
        size = min([part.extent for part, _ in ends if part.extent], default=np.inf)
        if apart is not None and apart > FAR * size:
            far.append(f"joint[{k}]: {joint.bodies[0]} and {joint.bodies[1]} are {apart:.3g} m apart, and one of the "
                       f"bodies is about {size:.3g} m large: a rigid lever joins them; if that is not meant, check "
                       "position (m) and turn of the bodies")  # fmt: skip
    return tuple(known), tuple(far)


def _twice(joints, of_joints, masses) -> list[str]:
    """Return a remark on bushings that act between the same ends in the same directions, and on masses at one place."""
    places: dict = {}
    for k, joint in enumerate(joints):
        if isinstance(joint, BushingJoint):
            for condition in of_joints[k]:
                places.setdefault((frozenset(joint.bodies), condition.label.rpartition(":")[2]), []).append(k)
    doubled = {tuple(numbers): joints[numbers[0]].bodies for numbers in places.values() if len(numbers) > 1}
    told = [f"{len(numbers)} bushings between {ends[0]} and {ends[1]} ({', '.join(f'joint[{k}]' for k in numbers)}): "
            "what they have in the same directions adds up" for numbers, ends in doubled.items()]  # fmt: skip
    at: dict = {}
    for k, mass in enumerate(masses):
        at.setdefault(mass.at, []).append(k)
    return told + [f"{len(numbers)} masses at {name} ({', '.join(f'mass[{k}]' for k in numbers)}): they add up"
                   for name, numbers in at.items() if len(numbers) > 1]  # fmt: skip


def _conditions(parts, joint, key, laws_of_table) -> list[Condition]:
    """Return the conditions of a joint, at the place of its first interface."""
    ends = [part_and_node(parts, name, key) for name in joint.bodies if name != GROUND]
    known = [part.places[node] for part, node in ends if np.isfinite(part.places[node]).all()]
    place, axes = known[0] if known else np.full(3, np.nan), np.kron(np.eye(2), matrix_of(joint.turn).T)
    conditions = []
    for d, name in enumerate(SIX):
        laws: tuple[tuple[float, Law], ...] = ()
        if isinstance(joint, RigidJoint):
            if name not in joint.directions:
                continue
        else:
            laws = _laws(joint, d) + tuple((1.0, law) for law in [laws_of_table.get(name)] if law)
            if not laws:
                continue
        rows: dict[str, tuple] = {}
        for sign, (part, node) in zip((1.0, -1.0), ends, strict=False):
            # displacement at the place of the joint: u + theta x arm
            arm = place - part.places[node]
            arm = np.where(np.abs(arm) > SAME_PLACE * np.abs(place).max(), arm, 0.0)  # nor where it is not known
            weights = sign * axes[d] @ rigid_rows(np.arange(6), np.tile(arm, (6, 1)))
            before = rows.get(part.name, (0.0, 0.0))
            rows[part.name] = tuple(map(np.add, before, part.functional(node, weights, key)))
        conditions.append(Condition(label=f"{key} between {joint.bodies[0]} and {joint.bodies[1]}:{name}", rows=rows,
                                    laws=laws))  # fmt: skip
    return conditions


def _laws(joint: BushingJoint, d: int) -> tuple:
    """Return values and laws of a direction of a bushing."""
    k, c = ((*values, *[0.0] * 6)[d] for values in (joint.stiffness, joint.damping))
    terms = ((k, Power(0)),) * bool(k) + ((c, Power(1)),) * bool(c)
    if joint.law is not None and k:
        # `stiffness` is the static one, whatever the law has at rest
        terms += ((k, joint.law), (-k * joint.law.static, Power(0))) if joint.law.static else ((k, joint.law),)
    return terms


def _of_mass(parts, mass: PointMass, key) -> list[Condition]:
    part, node = part_and_node(parts, mass.at, key)
    conditions = []
    for d, value in enumerate((mass.mass,) * 3 + mass.inertia):
        if value:
            rows = {part.name: part.functional(node, np.eye(6)[d], key)}
            conditions.append(Condition(label=f"{key} at {mass.at}:{SIX[d]}", rows=rows, laws=((value, Power(2)),)))
    return conditions


def _parameters(parts) -> tuple[Parameter, ...]:
    """Return the parameters of all bodies, those of one name as one. Raises InputError where they differ."""
    parameters: dict[str, Parameter] = {}
    for part in parts:
        for parameter in part.parameters:
            if parameters.setdefault(parameter.name, parameter) != parameter:
                raise InputError(f"body '{part.name}': parameter '{parameter.name}': has another range, reference or "
                                 "unit than that of another body; a parameter of a name is one of the machine"
                                 )  # fmt: skip
    return tuple(parameters.values())


def _chosen(parts, side, wanted) -> Channels:
    """Return the inputs or outputs of the machine; `wanted`: names, or interfaces for all of their directions, None
    for all. Raises InputError."""
    own = [name for part in parts for name in getattr(part, side).own]
    names = [f"{part.name}.{name}" for part in parts for name in getattr(part, side).names]
    matrix = block_diag(*(getattr(part, side).matrix for part in parts))
    chosen = own if wanted is None else []
    for word in wanted or ():
        there = [name for name in own if word in (name, name.rpartition(":")[0])]
        if not there:
            raise InputError(f"{side}: found '{word}'{nearest(word, own)}, expected some of {listed(own)}")
        chosen += [name for name in there if name not in chosen]
    return Channels(names=tuple(names), own=tuple(chosen), matrix=matrix[[own.index(name) for name in chosen]])


def laws_of_table(header, rows, joint: BushingJoint, band, key) -> dict[str, Tabulated]:
    """Return the laws by direction of a table with a header and rows (k, columns), at the value `at` of its parameter;
    `band` (Hz) must lie inside. Raises InputError."""
    # columns by name: a frequency, real and imaginary parts, and at most one parameter
    known = {f"{c}_{name}" for c in ("re", "im") for name in SIX}
    names = [name for name in header if name not in known | {"f_hz"}]
    if "f_hz" not in header or len(names) > 1 or set(names) != set(joint.at) or not known & set(header):
        raise InputError(f"{key}: found the columns {', '.join(header)}, expected f_hz, re_x, im_x and so on to im_rz, "
                         f"and one for each parameter in `at` ({', '.join(joint.at) or 'none'}), at most one")
    columns, count = dict(zip(header, np.transpose(rows), strict=True)), len(rows)
    at, parameter = (joint.at[names[0]], columns[names[0]]) if names else (0.0, np.zeros(count))
    # the same frequencies at each value of the parameter, over the whole band
    order, there = np.lexsort((columns["f_hz"], parameter)), np.unique(parameter)
    if not count or not (np.abs(rows) <= 1e30).all():
        raise InputError(f"{key}: found no lines, or numbers that are not finite or above 1e30")
    f = columns["f_hz"][order][: count // len(there)]
    if (np.diff(f) <= 0).any() or not np.array_equal(columns["f_hz"][order], np.tile(f, len(there))):
        raise InputError(f"{key}: found frequencies twice, or other ones at other values of the parameter, expected "
                         "each once")  # fmt: skip
    if f[0] < 0:
        raise InputError(f"{key}: found {f[0]:g} Hz, expected frequencies of at least 0")
    if f[0] > band[0] or f[-1] < band[1]:
        raise InputError(f"{key}: has {f[0]:g} to {f[-1]:g} Hz, which ends inside of the band {band[0]:g} to "
                         f"{band[1]:g} Hz; measure it over the band, or take a narrower one")  # fmt: skip
    if not there[0] <= at <= there[-1]:
        raise InputError(f"{key}: at: found {names[0]} = {at:g}, expected {there[0]:g} to {there[-1]:g}, the range of "
                         "the table")  # fmt: skip
    # one law a direction, interpolated linearly between values of the parameter
    laws = {}
    for name in SIX:
        if {f"re_{name}", f"im_{name}"} & set(header):
            g = sum(unit * columns.get(f"{c}_{name}", np.zeros(count)) for c, unit in (("re", 1.0), ("im", 1j)))
            g = np.array([np.interp(at, there, column) for column in g[order].reshape(len(there), -1).T])
            laws[name] = Tabulated(tuple(f.tolist()), tuple(g.real.tolist()), tuple(g.imag.tolist()))
    return laws


def warnings_of_table(laws: dict[str, Tabulated], key) -> list[str]:
    """Return a sentence on laws of a table whose imaginary parts are negative."""
    low = {name: min(law.imaginary) for name, law in laws.items() if min(law.imaginary) < 0}
    return [f"{key}: im_{name} comes down to {value:.3g}: such a joint gives energy in place of taking it; with "
            "exp(-i omega t) the sign is the other one" for name, value in low.items()]  # fmt: skip
