"""The SID file, "standard input data" of a flexible body (O. Wallrapp, 1993; read by SIMPACK, NEWEUL and others).

Text, one item a line, `key = value`, numbers as Fortran doubles with 11 decimals. An object has an order (0: constant,
1: also linear in q), a shape and a structure (0 zero, 1 diagonal, 2 symmetric, 3 full, 4 identity); m0(i, j) is its
constant part, m1(i, k, j) the coefficient of q_k in row i, column j.

A Body becomes a file with mass, inertia and couplings (mdCM, J, Ct, Cr, Me, Gr, Ge, Oe), K (Ke), D (De) and its nodes.
The file has no inputs and outputs but nodes, and no loss factor.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from ..multibody.body import Body, check_moving, inputs_without_node, maker, remarks
from ..parallel.failures import InputError

OBJECTS = ("mdCM", "J", "Ct", "Cr", "Me", "Gr", "Ge", "Oe", "ksigma", "Ke", "De")
OF_NODE = ("origin", "phi", "psi", "AP")
HEADER = ("order", "nrow", "ncol", "nq", "nqn", "structure")


@dataclass
class SidObject:
    """One matrix: m0 (nrow, ncol), and m1 (nrow, nq, ncol) if order is 1, else None."""

    m0: np.ndarray
    m1: np.ndarray | None = None
    nq: int = 0
    nqn: int = 0
    structure: int = 3

    @property
    def order(self) -> int:
        return 0 if self.m1 is None else 1


@dataclass
class SidNode:
    """A node where other bodies and forces may act: its number and objects (origin, phi, psi, AP)."""

    node: int
    objects: dict[str, SidObject] = field(default_factory=dict)
    rframe: str = "body ref"


@dataclass
class Sid:
    """A whole file. `coordinates`: a name for each elastic coordinate; `objects`: mdCM, J, ..., De by name."""

    mass: float
    coordinates: list[str]
    nodes: list[SidNode]
    objects: dict[str, SidObject]
    comment: str = ""


def begins(start: bytes) -> bool:
    """Whether a file that starts so is a SID file: two numbers and a comment, then the line "part"."""
    return re.match(rb"\s*\d+\s+\d+\s*:[^\n]*\n\s*part\s*\n", start) is not None


def write_sid(path, body: Body | Sid) -> list[str]:
    """Write a Body, or a Sid as it is; call it on one rank. Returns remarks on what is not in the file.

    Raises InputError for a body with structural damping, rigid-body motions, or without mass in some direction.
    """
    sid, notes = (body, []) if isinstance(body, Sid) else build_sid(body)
    lines = [f"{len(sid.nodes):5d}{len(sid.coordinates):4d}    :{sid.comment}", " part", _line(6, "new modal", "")]
    lines += [" " * 11 + "refmod", _line(16, "mass", _number(sid.mass))]
    lines.append(_line(16, "nelastq", f"{len(sid.coordinates):6d}"))
    for i, name in enumerate(sid.coordinates, 1):
        lines.append(_line(16, f"ielastq ({i:4d})", f" {name}"))
    lines += [" " * 11 + "end refmod", " " * 11 + "frame"]
    for node in sid.nodes:
        lines += [_line(16, "new node", f"    {node.node}"), _line(21, "rframe", f"    {node.rframe}")]
        for name in OF_NODE:
            lines += _object_lines(name, node.objects[name], 21)
        lines.append(" " * 16 + "end node")
    lines.append(" " * 11 + "end frame")
    for name in OBJECTS:
        lines += _object_lines(name, sid.objects[name], 11)
    lines += ["      end modal", " end part", ""]
    with open(path, "w", encoding="ascii", errors="replace") as file:
        file.write("\n".join(lines))
    return notes


def _line(indent, key, value):
    return f"{' ' * indent}{key}".ljust(48) + f"={value}"


def _number(value):
    return f"{value: .11E}".replace("E", "D")


def _object_lines(name, item, indent):
    rows, columns = item.m0.shape
    values = (item.order, rows, columns, item.nq, item.nqn, item.structure)
    lines = [" " * indent + name] + [_line(26, key, f"{value:5d}") for key, value in zip(HEADER, values, strict=True)]
    if item.structure not in (0, 4):
        for i, j in np.argwhere(item.m0 != 0):
            lines.append(_line(26, f"m0( {i + 1}, {j + 1})" + 13 * " ", _number(item.m0[i, j])))
    if item.m1 is not None:
        # column by column, as the reference files have it
        for j, i, k in np.argwhere(item.m1.transpose(2, 0, 1) != 0):
            lines.append(_line(26, f"m1( {i + 1}, {k + 1}, {j + 1})" + 10 * " ", _number(item.m1[i, k, j])))
    return [*lines, f"{' ' * indent}end {name}"]


def read_sid(path) -> Sid:
    """Read a file back. Raises InputError that names the line."""
    try:
        with open(path, encoding="latin-1") as file:
            text = file.read().splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    reader = _Lines(path, text)
    head, _, comment = reader.next().partition(":")
    try:
        nodes, modes = (int(word) for word in head.split())
    except ValueError as error:
        raise reader.unexpected("the numbers of nodes and of modes") from error
    reader.expect("part")
    reader.expect("new modal")
    reader.expect("refmod")
    mass = reader.value("mass")
    if reader.count("nelastq") != modes:
        raise reader.unexpected(f"nelastq = {modes} as in the first line")
    coordinates = [reader.text("ielastq") for _ in range(modes)]
    reader.expect("end refmod")
    reader.expect("frame")
    found = []
    while reader.peek().startswith("new node"):
        node = SidNode(reader.count("new node"), rframe=reader.text("rframe"))
        node.objects = {name: _read_object(reader, name) for name in OF_NODE}
        reader.expect("end node")
        found.append(node)
    if len(found) != nodes:
        raise reader.unexpected(f"{nodes} nodes as in the first line")
    reader.expect("end frame")
    objects = {name: _read_object(reader, name) for name in OBJECTS}
    reader.expect("end modal")
    reader.expect("end part")
    if reader.peek():
        reader.next()
        raise reader.unexpected("nothing behind 'end part'")
    return Sid(mass, coordinates, found, objects, comment)


def _read_object(reader, name):
    reader.expect(name)
    order, rows, columns, nq, nqn, structure = (reader.count(key) for key in HEADER)
    m0 = np.eye(rows, columns) if structure == 4 else np.zeros((rows, columns))
    m1 = np.zeros((rows, nq, columns)) if order else None
    while not reader.peek().startswith("end"):
        key, value = reader.item()
        index = tuple(int(number) - 1 for number in re.findall(r"\d+", key[2:]))
        target = {"m0": m0, "m1": m1}.get(key[:2])
        if target is None or len(index) != target.ndim or any(i >= n for i, n in zip(index, target.shape, strict=True)):
            raise reader.unexpected(f"an entry of {name} with {rows} rows and {columns} columns")
        target[index] = value
        if structure == 2 and key[:2] == "m0":
            target[index[::-1]] = value
    reader.expect(f"end {name}")
    return SidObject(m0, m1, nq, nqn, structure)


class _Lines:
    """The lines of a file one after the other."""

    def __init__(self, path, lines):
        self._path, self._lines, self._at = path, lines, 0

    def peek(self):
        while self._at < len(self._lines) and not self._lines[self._at].strip():
            self._at += 1
        return self._lines[self._at].strip() if self._at < len(self._lines) else ""

    def next(self):
        line = self.peek()
        self._at += 1
        return line

    def expect(self, words):
        found = self.next().rstrip("= ").strip()
        if found != words:
            raise self.unexpected(f"'{words}'")

    def text(self, key):
        head, equals, value = self.next().partition("=")
        if not equals or not head.strip().startswith(key):
            raise self.unexpected(f"'{key} = ...'")
        return value.strip()

    def value(self, key):
        text = self.text(key)
        try:
            return float(text.replace("D", "E").replace("d", "e"))
        except ValueError as error:
            raise self.unexpected(f"a number behind '{key} ='") from error

    def count(self, key):
        text = self.text(key)
        if not text.isdigit():
            raise self.unexpected(f"a whole number behind '{key} ='")
        return int(text)

    def item(self):
        key = self.peek().partition("=")[0].strip()
        return key, self.value(key)

    def unexpected(self, expected):
        line = self._lines[self._at - 1].strip() if 0 < self._at <= len(self._lines) else "the end"
        return InputError(f"{self._path}, line {self._at}: found '{line[:60]}', expected {expected}")


def build_sid(body: Body) -> tuple[Sid, list[str]]:
    """The file of a body, and remarks on what is not in it. Raises InputError as write_sid does."""
    check_moving(body, "a SID file")
    reduced, quantities = body.reduced, body.floating_frame
    notes = [*remarks(body), *inputs_without_node(body)]
    count = reduced.size
    skew = np.array([_skew(axis) for axis in np.eye(3)])
    nodes = []
    for shape in body.nodes:
        slopes = np.einsum("cij,ck->ikj", skew, shape.psi)  # m1(:, k, :) = skew(psi_k)
        objects = {
            "origin": SidObject((shape.position - quantities.origin)[:, None], shape.phi[:, :, None], count),
            "phi": _object(shape.phi, count),
            "psi": _object(shape.psi, count),
            "AP": SidObject(np.eye(3), slopes, count) if shape.psi.any() else SidObject(np.eye(3), None, count, 0, 4),
        }
        nodes.append(SidNode(int(shape.node), objects))
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    inertia = np.array([[quantities.J[a, b]] for a, b in pairs])
    slopes = np.array([quantities.dJ[:, a, b] for a, b in pairs])[:, :, None]
    objects = {
        "mdCM": SidObject(quantities.mc[:, None], quantities.Ct.T[:, :, None], count),
        "J": SidObject(inertia, slopes, count),
        "Ct": _object(quantities.Ct, count),
        "Cr": SidObject(quantities.Cr, quantities.Cr1, count),
        "Me": _object(quantities.Me, count),
        "Gr": _object(quantities.Gr, count),
        "Ge": _object(quantities.Ge, count),
        "Oe": SidObject(quantities.Oe, quantities.Oe1, count),
        "ksigma": SidObject(np.zeros((count, 1)), None, count, 0, 0),
        "Ke": _object(reduced.K, count),
        "De": _object(reduced.D, count),
    }
    names = [f"Eigen Mode {i:4d} : {f:12.3f} Hz" for i, f in enumerate(reduced.frequencies, 1)]
    comment = "; ".join([f"No. nodes, No. modes: {maker(body.reduced)}", *notes])
    return Sid(quantities.mass, names, nodes, objects, comment), notes


def _object(matrix, count):
    """A constant object with the structure that the matrix has; round-off beside a diagonal is left out."""
    square = matrix.shape[0] == matrix.shape[1]
    size = np.abs(matrix).max(initial=0.0)
    if size == 0:
        return SidObject(matrix, None, count, 0, 0)
    if square:
        diagonal = np.diag(np.diag(matrix))
        if np.abs(matrix - diagonal).max() <= 1e-12 * size:
            if np.abs(np.diag(matrix) - 1).max() <= 1e-11:
                return SidObject(np.eye(len(matrix)), None, count, 0, 4)
            return SidObject(diagonal, None, count, 0, 1)
    return SidObject(matrix, None, count, 0, 3)


def _skew(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
