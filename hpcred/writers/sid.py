"""Read and write SID files, "standard input data" of a flexible body (O. Wallrapp, 1993; SIMPACK, NEWEUL and others).

Text, one item a line, `key = value`, numbers as Fortran doubles with 11 decimals. An object has an order (0: constant,
1: also linear in q), a shape and a structure (0 zero, 1 diagonal, 2 symmetric, 3 full, 4 identity); m0(i, j) is its
constant part, m1(i, k, j) the coefficient of q_k in row i, column j.

A Body becomes a file with mass, inertia and couplings (mdCM, J, Ct, Cr, Me, Gr, Ge, Oe), K (Ke), D (De) and its nodes.
The file has no inputs and outputs but nodes, and no loss factor.
"""

import re
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..body.body import Body, check_moving, inputs_without_node, maker, remarks
from ..fe.dofs import DIRECTIONS
from ..files.outputs import SID
from ..files.system_errors import open_input
from ..files.text import shown
from ..model.rotation import skew
from ..parallel.failures import InputError
from .base import Writer
from .round_off import without_round_off
from .surface_file import surface_as_obj

OBJECTS = ("mdCM", "J", "Ct", "Cr", "Me", "Gr", "Ge", "Oe", "ksigma", "Ke", "De")
OF_NODE = ("origin", "phi", "psi", "AP")
HEADER = ("order", "nrow", "ncol", "nq", "nqn", "structure")
# rows and columns of the objects, n the number of elastic coordinates
SHAPES = {
    "mdCM": "3 1", "J": "6 1", "Ct": "n 3", "Cr": "n 3", "Me": "n n", "Gr": "3 3n", "Ge": "n 3n", "Oe": "n 6",
    "ksigma": "n 1", "Ke": "n n", "De": "n n", "origin": "3 1", "phi": "3 n", "psi": "3 n", "AP": "3 3",
}  # fmt: skip
GE_ORDERS = {
    "component": "columns of Ge by component, (c-1) n + k, as in PY_SID",
    "coordinate": "columns of Ge by coordinate, 3 (k-1) + c, as in EMBSlib and FEMBeam",
}
ENTRY = re.compile(r"(m[01])\(([ ]*\d+[ ]*(?:,[ ]*\d+[ ]*){1,2})\)")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
BLANKS = " \t\r"  # str.strip takes more away, which stands in letters of UTF-8
CONTROL = re.compile(r"[^\t\r\n\x20-\x7e\x80-\xff]")


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


def write_sid(path, body: Body | Sid, *, ge_order: str = "component") -> list[str]:
    """Write a Body, or a Sid as it is; call it on one rank.

    Parameters
    ----------
    path : str or PathLike
    body : Body or Sid
    ge_order : {"component", "coordinate"}
        The columns of Ge of a Body (see SidOptions).

    Returns
    -------
    list of str
        Remarks on what is not in the file.

    Raises
    ------
    InputError
        For a body with structural damping, rigid-body motions, or without mass in some direction.
    """
    sid, notes = (body, []) if isinstance(body, Sid) else build_sid(body, ge_order)
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


def _object_lines(name, taylor, indent):
    rows, columns = taylor.m0.shape
    values = (taylor.order, rows, columns, taylor.nq, taylor.nqn, taylor.structure)
    lines = [" " * indent + name] + [_line(26, key, f"{value:5d}") for key, value in zip(HEADER, values, strict=True)]
    if taylor.structure not in (0, 4):
        for i, j in np.argwhere(taylor.m0 != 0):
            lines.append(_line(26, f"m0( {i + 1}, {j + 1})" + 13 * " ", _number(taylor.m0[i, j])))
    if taylor.m1 is not None:
        # column by column, as the reference files have it
        for j, i, k in np.argwhere(taylor.m1.transpose(2, 0, 1) != 0):
            lines.append(_line(26, f"m1( {i + 1}, {k + 1}, {j + 1})" + 10 * " ", _number(taylor.m1[i, k, j])))
    return [*lines, f"{' ' * indent}end {name}"]


def read_sid(path) -> Sid:
    """Read a file of standard input data back.

    Parameters
    ----------
    path : str or PathLike

    Raises
    ------
    InputError
        That names the line.
    """
    with open_input(path, "r", encoding="latin-1", newline="\n") as file:
        text = file.read()
    if CONTROL.search(text):
        raise InputError(f"{path}: found a character that is no text; the file is damaged")
    reader = _Lines(path, text.split("\n"))
    # the first line has the numbers that the rest is checked against
    head, _, comment = reader.next().partition(":")
    if not re.fullmatch(r"\s*\d{1,9}\s+\d{1,9}\s*", head):
        raise reader.unexpected("the numbers of nodes and of modes")
    nodes, modes = map(int, head.split())
    # refmod: mass, and the names of the coordinates
    reader.expect("part")
    reader.expect("new modal")
    reader.expect("refmod")
    mass = reader.value("mass")
    if reader.count("nelastq") != modes:
        raise reader.unexpected(f"nelastq = {modes} as in the first line")
    coordinates = [reader.text(f"ielastq ({k})") for k in range(1, modes + 1)]
    reader.expect("end refmod")
    # frame: each node with its objects
    reader.expect("frame")
    read = []
    while reader.peek().startswith("new node"):
        node = SidNode(reader.count("new node"), rframe=reader.text("rframe"))
        node.objects = {name: _read_object(reader, name, modes) for name in OF_NODE}
        reader.expect("end node")
        read.append(node)
    if len(read) != nodes:
        raise reader.unexpected(f"{nodes} nodes as in the first line")
    reader.expect("end frame")
    # the objects of the body, and nothing behind them
    objects = {name: _read_object(reader, name, modes) for name in OBJECTS}
    reader.expect("end modal")
    reader.expect("end part")
    if reader.peek():
        reader.next()
        raise reader.unexpected("nothing behind 'end part'")
    return Sid(mass, coordinates, read, objects, comment)


def _read_object(reader, name, modes):
    reader.expect(name)
    order, rows, columns, nq, nqn, structure = (reader.count(key) for key in HEADER)
    shape = tuple(int(word.replace("n", "") or 1) * (modes if "n" in word else 1) for word in SHAPES[name].split())
    if (rows, columns, nq) != (*shape, modes) or order > 1 or structure > 4:
        raise reader.unexpected(
            f"{name} of order 0 or 1, {shape[0]} rows, {shape[1]} columns, {modes} coordinates, structure 0 to 4"
        )
    m0 = np.eye(rows, columns) if structure == 4 else np.zeros((rows, columns))
    m1 = np.zeros((rows, nq, columns)) if order else None
    seen = set()
    while not reader.peek().startswith("end"):
        entry = ENTRY.fullmatch(reader.key())
        value = reader.value(reader.key())
        index = tuple(int(number) - 1 for number in entry[2].split(",")) if entry else ()
        target = {"m0": m0 if structure not in (0, 4) else None, "m1": m1}.get(entry[1]) if entry else None
        if (target is None or len(index) != target.ndim or index in seen
                or any(not 0 <= i < n for i, n in zip(index, target.shape, strict=True))):  # fmt: skip
            raise reader.unexpected(f"an entry of {name} with {rows} rows and {columns} columns, each once")
        target[index] = value
        seen.add(index)
        if structure == 2 and target is m0:
            target[index[::-1]] = value
            seen.add(index[::-1])
    reader.expect(f"end {name}")
    return SidObject(m0, m1, nq, nqn, structure)


class _Lines:
    """The lines of a file one after the other."""

    def __init__(self, path, lines):
        self._path, self._lines, self._at = path, lines, 0

    def peek(self):
        while self._at < len(self._lines) and not self._lines[self._at].strip(BLANKS):
            self._at += 1
        return self._lines[self._at].strip(BLANKS) if self._at < len(self._lines) else ""

    def next(self):
        line = self.peek()
        self._at += 1
        return line

    def expect(self, words):
        line = self.next().rstrip("=" + BLANKS).strip(BLANKS)
        if line != words:
            raise self.unexpected(f"'{words}'")

    def text(self, key):
        head, equals, value = self.next().partition("=")
        if not equals or re.sub(r"\( *", "(", head.strip(BLANKS)) != re.sub(r"\( *", "(", key):
            raise self.unexpected(f"'{key} = ...'")
        return value.strip(BLANKS)

    def value(self, key):
        text = self.text(key)
        value = float(text.upper().replace("D", "E")) if NUMBER.fullmatch(text) else np.inf
        if not np.isfinite(value):
            raise self.unexpected(f"a number behind '{key} ='")
        return value

    def count(self, key):
        text = self.text(key)
        if not (text.isdigit() and text.isascii() and len(text) < 10):
            raise self.unexpected(f"a whole number behind '{key} ='")
        return int(text)

    def key(self):
        return self.peek().partition("=")[0].strip(BLANKS)

    def unexpected(self, expected):
        line = self._lines[self._at - 1] if 0 < self._at <= len(self._lines) else "the end"
        found = shown(line.encode("latin-1"), 60)
        return InputError(f"{self._path}, line {self._at}: found '{found}', expected {expected}")


def build_sid(body: Body, ge_order: str = "component") -> tuple[Sid, list[str]]:
    """The file of a body, and remarks on what is not in it. Raises InputError as write_sid does."""
    check_moving(body, "a SID file")
    notes = [*remarks(replace(body, prestress=None)), *inputs_without_node(body)]
    if body.prestress is not None:
        notes.append("at a preload: Ke has its stress and ksigma its forces, so that q = 0 is the body under the "
                     "preload, which has to act on it")  # fmt: skip
    if body.geometric_stiffness is None:
        notes.append("no geometric stiffness: loads and rotations do not change the stiffness")
    body = body.stiffened()
    reduced, quantities, prestress = body.reduced, body.floating_frame, body.prestress
    count, Ge = reduced.size, quantities.Ge
    if ge_order == "coordinate":
        Ge = Ge.reshape(count, 3, count).transpose(0, 2, 1).reshape(count, -1)
    generators = np.array([skew(axis) for axis in np.eye(3)])
    # nodes: places and directions change with the shapes
    nodes = []
    for shape in body.nodes:
        slopes = np.einsum("cij,ck->ikj", generators, shape.psi)  # m1(:, k, :) = skew(psi_k)
        objects = {
            "origin": SidObject((shape.position - quantities.origin)[:, None], shape.phi[:, :, None], count),
            "phi": _object(shape.phi, count, shape.phi1),
            "psi": _object(shape.psi, count, shape.psi1),
            "AP": SidObject(np.eye(3), slopes, count) if shape.psi.any() else SidObject(np.eye(3), None, count, 0, 4),
        }
        nodes.append(SidNode(int(shape.node), objects))
    # the body: mass matrix, stiffness and damping
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    inertia = np.array([[quantities.J[a, b]] for a, b in pairs])
    slopes = np.array([quantities.dJ[:, a, b] for a, b in pairs])[:, :, None]
    objects = {
        "mdCM": SidObject(quantities.mc[:, None], quantities.Ct.T[:, :, None], count),
        "J": SidObject(inertia, slopes, count),
        "Ct": _object(quantities.Ct, count, quantities.Ct1),
        "Cr": SidObject(quantities.Cr, quantities.Cr1, count),
        "Me": _object(quantities.Me, count),
        "Gr": _object(quantities.Gr, count),
        "Ge": _object(Ge, count),
        "Oe": SidObject(quantities.Oe, quantities.Oe1, count),
        "ksigma": _object(np.zeros((count, 1)) if prestress is None else prestress.forces[:, None], count),
        "Ke": _object(reduced.K if prestress is None else reduced.K - prestress.softening, count),
        "De": _object(reduced.D, count),
    }
    # names of the coordinates
    names = [f"Eigen Mode {i:4d} : {f:12.3f} Hz" for i, f in enumerate(reduced.frequencies, 1)]
    if reduced.interfaces:
        own = [f"Node {node.node} : {name}" for node in reduced.interfaces for name in DIRECTIONS[:6]]
        names = own + [f"Modal coordinate {i:4d}" for i in range(1, count - len(own) + 1)]
    comment = "; ".join([f"No. nodes, No. modes: {maker(body.reduced)}", *notes, GE_ORDERS[ge_order]])
    return Sid(quantities.mass, names, nodes, objects, comment), notes


def _object(matrix, count, slopes=None):
    """An object with the structure that the matrix has; round-off beside a diagonal is left out. `slopes`: m1."""
    if slopes is not None and slopes.any():
        return SidObject(matrix, slopes, count)
    if not matrix.any():
        return SidObject(matrix, None, count, 0, 0)
    if matrix.shape[0] == matrix.shape[1]:
        matrix = without_round_off(matrix)
        diagonal = np.diag(np.diag(matrix))
        if (matrix == diagonal).all():
            return SidObject(matrix, None, count, 0, 4 if (np.diag(matrix) == 1).all() else 1)
    return SidObject(matrix, None, count, 0, 3)


@dataclass(frozen=True, kw_only=True)
class SidOptions:
    """`ge_order`: the order of the 3 n columns of Ge: component c of coordinate k is in column (c - 1) n + k
    ("component"), as in the files of PY_SID, or in column 3 (k - 1) + c ("coordinate"), as EMBSlib and FEMBeam read it.
    `surface`: whether the surface is written beside the file, see surface_file.
    """

    ge_order: Literal["component", "coordinate"] = "component"
    surface: bool = False


class SidFile(Writer):
    """SID files."""

    suffix, needs, kind, options = ".SID_FEM", "body", SID, SidOptions

    def write(self, target, source):
        if source.options.surface:
            source.beside[".obj"] = surface_as_obj(source.body)
        return write_sid(target, source.body, ge_order=source.options.ge_order)

    def describe(self, path):
        sid = read_sid(path)
        return {
            "format": "SID file of a flexible body",
            "mass": sid.mass,  # in units that the file does not say
            "coordinates": sid.coordinates,
            "interface_nodes": [node.node for node in sid.nodes],
            "inertia_xx_yy_zz_xy_xz_yz": sid.objects["J"].m0.ravel().tolist(),
            "damping": "none" if sid.objects["De"].structure == 0 else "given",
            "comment": sid.comment,
        }
