"""Take a reduced body as a part of a machine: free, with rigid-body motions, turned and moved, its inputs and outputs
in the axes of the machine.

Results in pseudo-modal coordinates of a free body (Buckens frame) get the six rigid-body coordinates about the origin
of the body frame, whose mass matrix is that of the floating frame at rest (13); results in interface coordinates have
them already, and bodies without frame are supported.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..fe.dofs import DIRECTIONS, QUANTITIES, named_quantity, node_of, quantity_name
from ..model.interfaces.motion import rigid_rows
from ..model.loads.kinds import motions_of
from ..model.outputs.rates import combined, orders_of
from ..model.parameters.definitions import Parameter
from ..model.second_order_model import listed
from ..parallel.declared import nearest
from ..parallel.failures import InputError
from ..reduction.interface_coordinates import elastic_part
from ..reduction.parametric.reduced import ParametricReducedModel
from ..reduction.result.accuracy import Accuracy
from ..reduction.result.measure import Measure
from ..reduction.result.reduced_model import ReducedModel, as_measured, require_finite
from .joints import GROUND, SIX, MachineBody, matrix_of

ROUND_OFF = 1e-9  # of direction cosines, and of C - B^T
FASTEST = 1e5  # m/s: lengths times frequencies are below the speed of waves, 1.8e4 at most
UNDAMPED = 2e-3  # loss factor of bodies without damping where errors are measured
BEYOND = 1e-9  # of the last line of a measured body, by which round-off goes beyond it
UNFELT = 1e100  # scales that measures give to inputs and outputs without response


@dataclass(frozen=True, eq=False, kw_only=True)
class Channels:
    """The inputs or outputs (k) of a body by `names`, and those in axes of the machine (l) that are made of them:
    `own` by name, rows `matrix` (l, k)."""

    names: tuple[str, ...]
    own: tuple[str, ...]
    matrix: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """A body in the machine. SI units, `turn` (3, 3) from its axes to those of the machine, `shift` (3,) of its origin;
    `labels` of its nodes by number.

    `model`: in axes of the body, with rigid-body motions, at all values of its parameters. `inputs`, `outputs`: see
    Channels. `places` of its nodes by label, in the machine. `elastic`: the model that its `accuracy` speaks of; None
    where there is none, or the result counts as `exact`. `rigid_motions` (6, k) about `origin` in its axes: the
    first k coordinates, which were put before those of the result. `extent`: how large it is about (m), 0 where that
    is not known.
    """

    name: str
    model: ReducedModel
    inputs: Channels
    outputs: Channels
    places: dict[str, np.ndarray]
    turn: np.ndarray
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    labels: dict[int, str] = field(default_factory=dict)
    elastic: ReducedModel | None = None
    accuracy: Accuracy | None = None
    rigid_motions: np.ndarray = field(default_factory=lambda: np.zeros((6, 0)))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    warnings: tuple[str, ...] = ()
    exact: bool = False
    extent: float = 0.0

    @property
    def size(self) -> int:
        return self.model.size

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return getattr(self.model, "parameters", ())

    @property
    def constant(self) -> dict[str, np.ndarray]:
        """M, D, K (n, n), B (n, p), C, Cv, Ca (r, n) without the terms of parameters."""
        if isinstance(self.model, ParametricReducedModel):
            return self.model.constant
        return {key: matrix for key in (*"MDKBC", "Cv", "Ca") if (matrix := getattr(self.model, key)) is not None}

    def functional(self, node: str, weights: np.ndarray, key: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows (k,) of outputs and of inputs that are weights (6,) . (u, theta) of a node, in axes of the
        machine. Raises InputError where the body has no such direction."""
        own, rows = (weights.reshape(2, 3) @ self.turn).ravel(), []
        for names in (self.outputs.names, self.inputs.names):
            rows.append(np.zeros(len(names)))
            for d in np.flatnonzero(np.abs(own) > ROUND_OFF):
                if f"{node}:{SIX[d]}" not in names:
                    there = [channel.rpartition(":")[2] for channel in names if channel.rpartition(":")[0] == node]
                    raise InputError(
                        f"{key}: '{self.name}.{node}' has no direction {SIX[d]} (axes of the body) among its inputs "
                        f"and outputs, it has {', '.join(there) or 'none'}; reduce the body with all directions of the "
                        "interface, or leave the direction out"
                    )
                rows[-1][names.index(f"{node}:{SIX[d]}")] = own[d]
        return rows[0], rows[1]

    def response(self, s: np.ndarray, values) -> np.ndarray:
        """Return H(s) (S, r, p) of the free body at s (S,), in its own axes."""
        return self.model.transfer_function(s, **{p.name: values[p.name] for p in self.parameters})

    @property
    def eps(self) -> float:
        """The error that the body is known to have."""
        return 0.0 if self.exact else self.accuracy.largest + self.accuracy.noise

    def scales(self, s: np.ndarray, f: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h (S, r) and g (S, p) at s (S,), |E_ji| <= h_j g_i, over frequencies f (S,) within `reach` (Hz).

        The errors of directions are those of the record, and at no frequency more than its curve: with symmetric
        matrices |E_ji| is at most the error of either direction, and so at most their geometric mean.
        """
        if self.exact:
            return np.zeros((len(s), len(self.outputs.names))), np.zeros((len(s), len(self.inputs.names)))
        outputs, states = self.elastic.output_parts, self.elastic.states(s)
        orders = orders_of(outputs)
        measure: Measure = self.accuracy.measure
        scales = measure.scales(combined(outputs, s, orders) @ states, np.einsum("ip,sip->sp", self.elastic.B, states))
        h, g = (np.where(values < UNFELT, values, 0.0) for values in scales)
        # errors by direction, with what the uncompressed model lacks and with round-off
        known = {direction.output: direction.largest for direction in self.accuracy.directions}
        rest = max(self.accuracy.largest - max(known.values(), default=0.0), 0.0) + self.accuracy.noise
        own = np.array([known.get(name, self.accuracy.largest) + rest for name in self.elastic.output_names])
        names = self.elastic.output_names
        symmetric = all(np.array_equal(term.matrix, term.matrix.T) for term in self.elastic.operator)
        other = np.array([own[names.index(name)] if symmetric and name in names else self.eps
                          for name in self.elastic.input_names])  # fmt: skip
        curve = self._curve(f, reach)[:, None]
        h = h * np.sqrt(np.minimum(own, curve)) * np.abs(s)[:, None] ** np.maximum(orders, 0)
        return h, g * np.sqrt(np.minimum(other, curve))

    def _curve(self, f, reach) -> np.ndarray:
        """Return the largest error (S,) of the record at the frequencies within `reach` of f, and those around."""
        lines, eps = np.array(self.accuracy.frequencies), np.array(self.accuracy.eps)
        low = np.maximum(np.searchsorted(lines, f - reach, side="right") - 1, 0)
        high = np.minimum(np.searchsorted(lines, f + reach), len(lines) - 1)
        return np.array([eps[i : j + 1].max() for i, j in zip(low, high, strict=True)]) + self.accuracy.noise

    def as_measured(self, loss_factor: float = UNDAMPED) -> Part:
        """Return the body at the reference, with the damping that its error was measured with; an exact one without
        damping with `loss_factor`, that of the others."""
        if self.accuracy is not None:
            return replace(self, model=as_measured(_base(self.model), self.accuracy))
        damped = self.model.D.any() or self.model.loss_factor or self.model.added
        return replace(self, model=replace(_base(self.model), loss_factor=loss_factor)) if not damped else self


def _base(reduced: ReducedModel) -> ReducedModel:
    """Return the model at the reference values."""
    return reduced.base if isinstance(reduced, ParametricReducedModel) else reduced


def part_of(body: MachineBody, result: Any) -> Part:
    """Return a body of the machine, of a result as files.result_file.Result or anything with its `reduced`,
    `floating_frame` and `nodes`. Raises InputError."""
    where, reduced = f"body '{body.name}'", result.reduced
    require_finite(reduced)
    if reduced.feedthrough is not None or (reduced.record is not None and motions_of(reduced.record.loads)):
        raise InputError(f"{where}: moves relative to a base of its own; reduce it without [[base]]")
    # where its nodes are, and what they are called
    names, labels, numbers = _names(body, result, where)
    inputs, outputs = ([renamed(channel, names) for channel in channels]
                       for channels in (reduced.input_names, reduced.output_names))  # fmt: skip
    places = {label: np.array(place) for label, place in numbers.items()}
    if not any(node in places for node in map(_label, inputs)):
        raise InputError(f"{where}: has no interfaces or nodes among its inputs ({listed(reduced.input_names)}), which "
                         "joints and axes need; reduce a model with node coordinates and [[interface]]")  # fmt: skip
    warnings = [] if units_of(reduced) else _doubtful_units(reduced, places, where)
    # rigid-body motions, put before the coordinates of a free body whose frame has taken them out
    motions, origin = _free_motions(reduced, result.floating_frame, where)
    model = replace(reduced, record=None, columns=None, left_columns=None, model=None)
    if motions.shape[1]:
        if any(term.of in "MB" for term in getattr(reduced, "terms", ())) or reduced.resultants is None:
            raise InputError(f"{where}: its mass or loads depend on parameters, and its rigid-body motions are those "
                             "of the reference; reduce with coordinates = 'interface'")  # fmt: skip
        rows = [_moved(name, places, origin, where) for name in outputs]
        model = _with_motions(model, motions, result.floating_frame, rows, origin)
    if isinstance(reduced, ParametricReducedModel):
        kinds = [f"damping of kind '{reduced.record.damping.kind}'"] if reduced.damping_follows else []
        if reduced.loss_factor and any(term.of == "K" for term in reduced.terms):
            kinds.append("structural damping")
        warnings += [f"{where}: {kind} is that of the reference values at all values of the parameters in the machine"
                     for kind in kinds]  # fmt: skip
    # axes of the machine, and what is known of its error
    turn = matrix_of(body.turn)
    accuracy = None if reduced.record is None or body.exact else reduced.record.accuracy
    elastic = None
    if accuracy is not None:
        elastic = elastic_part(as_measured(_base(reduced), accuracy))
    return Part(
        name=body.name, model=model,
        inputs=_channels(body.name, inputs, turn), outputs=_channels(body.name, outputs, turn),
        places={node: turn @ place + body.position for node, place in places.items()}, turn=turn,
        shift=np.array(body.position), labels=labels, elastic=elastic,
        accuracy=accuracy, rigid_motions=motions, origin=origin, warnings=tuple(warnings), exact=body.exact,
        extent=_extent(places, result.floating_frame),
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredPart(Part):
    """A part without coordinates, known by receptances H (F, r, p) at `lines` (F,) in Hz, linear between them."""

    lines: np.ndarray
    H: np.ndarray = field(repr=False)

    def response(self, s: np.ndarray, values) -> np.ndarray:
        """Return H (S, r, p) at s = 2 pi i f (S,). Raises InputError outside of the lines."""
        f = np.imag(s) / (2 * np.pi)
        low, high = self.lines[[0, -1]]
        outside = (f < low - BEYOND * high) | (f > high + BEYOND * high)
        if outside.any():
            raise InputError(f"body '{self.name}': was measured from {low:g} to {high:g} Hz, not at {f[outside][0]:g} "
                             "Hz; take a narrower band")  # fmt: skip
        k = np.clip(np.searchsorted(self.lines, f) - 1, 0, max(len(self.lines) - 2, 0))
        if len(self.lines) == 1:
            return np.repeat(self.H, len(f), axis=0)
        weight = ((f - self.lines[k]) / (self.lines[k + 1] - self.lines[k]))[:, None, None]
        return (1 - weight) * self.H[k] + weight * self.H[k + 1]


def measured_part(body: MachineBody, frf) -> MeasuredPart:
    """Return a measured body, of files.response_file.Responses of displacements. Raises InputError."""
    turn, where = matrix_of(body.turn), f"body '{body.name}'"
    known = {node: number for node, (number, _) in (frf.places or {}).items()}
    for node in map(node_of, (*frf.input_names, *frf.output_names)):
        if node is not None:
            known.setdefault(str(node), node if isinstance(node, int) else 0)  # 0: of no number
    numbers = new_names(body, known, where)
    inputs, outputs = ([renamed(name, numbers) for name in names] for names in (frf.input_names, frf.output_names))
    nodes = {str(node_of(name)) for name in inputs if node_of(name) is not None}
    if not nodes:
        raise InputError(f"body '{body.name}': has no interfaces or nodes among its inputs "
                         f"({', '.join(frf.input_names[:3])}), expected names such as 20:z or foot:z")  # fmt: skip
    at = {numbers.get(name, name): place for name, (_, place) in (frf.places or {}).items()}
    places = {node: turn @ at[node] + body.position if node in at else np.full(3, np.nan) for node in nodes}
    return MeasuredPart(
        name=body.name, model=None, inputs=_channels(body.name, inputs, turn), places=places, turn=turn,
        outputs=_channels(body.name, outputs, turn), lines=frf.frequencies, H=frf.response, extent=_extent(at),
    )  # fmt: skip


def _extent(places, frame=None) -> float:
    """Return the diagonal (m) of a box around nodes, or of a uniform body of the inertia of a floating frame."""
    points = np.array(list(places.values())).reshape(-1, 3)
    nodes = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    if frame is None or not frame.mass > 0:
        return nodes
    spread = np.trace(frame.J) / (2 * frame.mass) - (frame.mc / frame.mass) @ (frame.mc / frame.mass)
    return max(nodes, float(np.sqrt(12 * spread)) if spread > 0 else 0.0)  # not where M knows no inertia


def units_of(reduced) -> str:
    """Return from which units a model was converted, "" where nothing is known of them."""
    return "" if reduced.record is None else reduced.record.units


def _doubtful_units(reduced, places, where) -> list[str]:
    """Return a warning where lengths and frequencies are those of no material: of a model that was not in SI."""
    points = np.array(list(places.values()))
    length = np.linalg.norm(points[:, None] - points[None], axis=2).max(initial=0.0)
    elastic = reduced.frequencies[reduced.frequencies > 0]
    if len(elastic) and elastic.min() * length > FASTEST:
        return [f"{where}: interfaces {length:g} m apart in a body of {elastic.min():.4g} Hz are those of no material; "
                "if its model is not in SI, convert it with --units, such as mm,t,s"]  # fmt: skip
    return []


def _names(body, result, where):
    """Return new labels of nodes by those of the result and by number, and the places of all labels in axes of the
    body."""
    record = result.reduced.record
    nodes = [(shape.label, shape.node, shape.position) for shape in result.nodes]
    nodes += [(end.name, end.node, end.position) for end in result.reduced.interfaces]
    nodes += [] if record is None else [(end.name, end.node, end.position) for end in record.interface_nodes]
    names = new_names(body, {label: number for label, number, _ in nodes}, where)
    return (names, {number: names.get(label, label) for label, number, _ in nodes},
            {names.get(label, label): place for label, _, place in nodes})  # fmt: skip


def new_names(body, nodes: dict[str, int], where) -> dict[str, str]:
    """Return the names that a body gives to nodes, by their labels until now; `nodes`: all numbers by label. Raises
    InputError."""
    labels = {number: label for label, number in nodes.items()}
    for name, number in body.nodes.items():
        if number not in labels:
            raise InputError(f"{where}: nodes: found the number {number} for '{name}', which is no node of its inputs "
                             f"and outputs; they are {listed([str(known) for known in labels if known])}")  # fmt: skip
    names = {labels[number]: name for name, number in body.nodes.items()}
    for name in body.nodes:
        if [names.get(label, label) for label in nodes].count(name) > 1:
            raise InputError(f"{where}: nodes: found the name '{name}', which another node has; take one of its own")
    return names


def _label(name) -> str:
    """Return the node of an input or output as a text, "" for none."""
    node = node_of(name)
    return "" if node is None else str(node)


def renamed(name, names) -> str:
    quantity, place = named_quantity(name)
    node, colon, direction = place.rpartition(":")
    return quantity_name(quantity, f"{names.get(node, node)}{colon}{direction}")


def _free_motions(reduced, frame, where) -> tuple[np.ndarray, np.ndarray]:
    """Return the rigid-body motions (6, k), and their origin (3,), that a result leaves to its frame."""
    record = reduced.record
    kind = "none" if record is None else record.frame.kind
    if kind == "none" or reduced.interfaces:
        return np.zeros((6, 0)), np.zeros(3)
    advice = "reduce with coordinates = 'interface'"
    if kind != "buckens":
        raise InputError(f"{where}: the {kind} frame does not tell which rigid-body motions are free; reduce in the "
                         "Buckens frame, or a supported body with frame none")  # fmt: skip
    if frame is None:
        raise InputError(f"{where}: the result has no floating-frame quantities, by which its rigid-body motions are "
                         f"known; {advice}")  # fmt: skip
    if record.damping.kind == "given" or not np.array_equal(reduced.K, reduced.K.T):
        raise InputError(f"{where}: how its damping matrix or its unsymmetric K acts on rigid-body motions is not in "
                         f"the result; {advice}")  # fmt: skip
    still = frame.masses <= 0
    gone = [*still, still[1] | still[2], still[2] | still[0], still[0] | still[1]]
    motions = np.eye(6)[:, ~np.array(gone)]
    if motions.shape[1] != record.rigid_body_modes:
        raise InputError(f"{where}: {record.rigid_body_modes} of its rigid-body motions are free, the others are held "
                         f"in the model; {advice}")  # fmt: skip
    return motions, frame.origin


def _moved(name, places, origin, where) -> tuple[int, np.ndarray]:
    """Return the order of the time derivative that an output is, and how rigid-body motions (6,) move it, about the
    origin."""
    quantity, place = named_quantity(name)
    node = node_of(name)
    if node is None:
        if name.startswith(("stress ", "cut ")):
            return 0, np.zeros(6)  # which rigid-body motions leave at rest
        raise InputError(f"{where}: how rigid-body motions move the output '{name}' is not known; reduce with "
                         "coordinates = 'interface', or leave it out")  # fmt: skip
    d, arm = DIRECTIONS.index(place.rpartition(":")[2]), places[str(node)] - origin
    return QUANTITIES.index(quantity), rigid_rows(np.array([d]), arm[None])[0]


def _with_motions(reduced, motions, frame, rows, origin) -> ReducedModel:
    """Return the model with the rigid-body motions before the other coordinates."""
    k, m = motions.shape[1], reduced.size
    mass = np.nan_to_num(frame.mass_matrix(np.zeros(m)))
    T = np.block([[motions, np.zeros((6, m))], [np.zeros((m, k)), np.eye(m)]])
    # loads act on rigid-body motions by their resultants about the origin of the frame
    force, moment = reduced.resultants[:, :3], reduced.resultants[:, 3:]
    loads = np.hstack([force, moment - np.cross(origin, force)])
    elastic = reduced.in_coordinates(np.eye(m, k + m, k))

    def moved(matrices):
        changed = {"M": T.T @ mass @ T, "B": np.vstack([motions.T @ loads.T, matrices["B"][k:]])}
        for order, key in enumerate(("C", "Cv", "Ca")):
            if matrices.get(key) is not None:
                rigid = np.array([row if order == own else np.zeros(6) for own, row in rows])
                changed[key] = np.hstack([rigid @ motions, matrices[key][:, k:]])
        return changed

    base = _base(elastic)
    base = replace(base, **moved({key: getattr(base, key) for key in ("B", "C", "Cv", "Ca")}))
    if not isinstance(elastic, ParametricReducedModel):
        return base
    constant = elastic.constant | moved(elastic.constant)
    return ParametricReducedModel.of(base, parameters=elastic.parameters, constant=constant, terms=elastic.terms)


def _channels(body, names, turn) -> Channels:
    """Return inputs or outputs with their names and rows in axes of the machine.

    Displacements of a node, and rotations, are turned; where the body has not all that a direction of the machine is
    made of, the channel stays as it is, "of the body" in its name.
    """
    own, rows, done = [], [], set()
    turned = np.where(np.abs(turn) > ROUND_OFF, turn, 0.0)
    for j, name in enumerate(names):
        quantity, place = named_quantity(name)
        node, _, direction = place.rpartition(":")
        if _label(name) == "":
            own.append(f"{body}.{name}")
            rows.append(np.eye(len(names))[j])
            continue
        first = 0 if DIRECTIONS.index(direction) < 3 else 3
        if (quantity, node, first) in done:
            continue
        done.add((quantity, node, first))
        places = [quantity_name(quantity, f"{node}:{item}") for item in SIX[first : first + 3]]
        of_body = np.array([[float(item == other) for other in names] for item in places])
        there = of_body.any(axis=1)
        made = (there | (turned == 0)).all(axis=1)
        left = there & (np.linalg.norm(turned[made], axis=0) < 1 - ROUND_OFF)
        own += [f"{quantity_name(quantity, f'{body}.{node}')}:{SIX[first + d]}" for d in np.flatnonzero(made)]
        own += [f"{body}.{places[e]} of the body" for e in np.flatnonzero(left)]
        rows += [*(turned @ of_body)[made], *of_body[left]]
    return Channels(names=tuple(names), own=tuple(own), matrix=np.array(rows).reshape(-1, len(names)))


def part_and_node(parts: dict[str, Part], name: str, key: str) -> tuple[Part, str]:
    """Return the part and the node that "bed.guide" names. Raises InputError, with the name that was meant."""
    body, _, node = name.partition(".")
    if body == GROUND:
        raise InputError(f"{key}: found '{name}': the ground has no interfaces; joints call it \"{GROUND}\" alone")
    if body not in parts:
        raise InputError(f"{key}: '{name}': there is no body '{body}'{nearest(body, [*parts, GROUND])}; there are "
                         f"{', '.join(parts)}")  # fmt: skip
    part = parts[body]
    known = [label for label in part.places if any(own.rpartition(":")[0] == label for own in part.inputs.names)]
    if node not in known and node in part.places:
        raise InputError(f"{key}: '{name}': body '{body}' has the interface '{node}', but no inputs there, by which "
                         f"joints act; reduce it with inputs = outputs = [..., \"{node}\"], in Python "
                         f"model.with_inputs([..., \"{node}\"])")  # fmt: skip
    if node not in known:
        raise InputError(f"{key}: '{name}': body '{body}' has no interface '{node}'{nearest(node, known)}; it has "
                         f"{', '.join(known) or 'none'}")  # fmt: skip
    return part, node
