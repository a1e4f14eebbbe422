"""Read a substructure that is written as a linear user element: its matrices, and the node and dof of each row.

Abaqus writes it by *SUBSTRUCTURE MATRIX OUTPUT, CalculiX by *SUBSTRUCTURE GENERATE (stiffness only), hpcred by its
export. Below *USER ELEMENT stand the dofs of the first node, and then each place in the list of nodes from which on
there are others. The list is a comment (** ELEMENT NODES) or the line of *ELEMENT; CalculiX lists a node once for each
dof. A matrix has its upper triangle column by column, all of it with UNSYMM (Abaqus Keywords Reference, *MATRIX).
Viscous damping may also stand beside the element, as *MATRIX INPUT of its dofs, one triangle with TYPE=SYMMETRIC. The
files are small, and are read by rank 0.
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...fe.dofs import SCALAR
from ...files.text import first_bytes, open_unpacked, shown
from ...files.text_numbers import parse, with_e
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ..base import Reader
from ..entries import LabelledEntries, label_of
from ..parts import Parts
from . import input_file

START = re.compile(rb"(?mi)^[ \t]*\*[ \t]*USER ELEMENT[^\n]*\bLINEAR\b")
KEYWORD = re.compile(r"(?m)^[ \t]*\*(?!\*)[^\n]*\n?")
LISTED = re.compile(r"(?mi)^\*\*[ \t]*ELEMENT NODES[ \t]*\n((?:\*\*[ \t]*\d[\d, \t]*(?:\n|$))+)")
MODAL = re.compile(r"(?mi)^\*\*[ \t]*modal coordinates[ \t]*\n(?:[ \t]*\d[^\n]*\n?)*")  # of our own export
KEYS = {"STIFFNESS": "K", "MASS": "M", "VISCOUSDAMPING": "D", "DAMPING": "D"}
OF_CALCULIX = "GENERATION OF SUBSTRUCTURE"


def begins(start: bytes) -> bool:
    """Test whether a text that starts so has a linear user element."""
    return START.search(start) is not None


def read(path, comm) -> Parts:
    """Return the matrices of a user element, with the nodes of the file or of the input file beside it. Collective.

    Raises InputError.
    """
    path = Path(path)
    content = decided(comm, _content, path)
    node, matrices = content.node, content.matrices
    # nodes with a place are those of the substructure; others are internal to it, as of its modes
    with agreed(comm):
        file = path if content.has_nodes else _input_beside(path)
    mesh = None if file is None else input_file.read(file, comm, calculix=content.of_calculix)
    parts = Parts(dict.fromkeys(matrices), dict.fromkeys(matrices, str(path)))
    parts.warnings += content.remarks * (comm.rank == 0)
    placed = np.unique(node)
    if mesh is not None:
        there = ~np.isin(mesh.nodes.label, content.modal)
        parts.nodes = type(mesh.nodes).as_given(comm, mesh.nodes.label[there], mesh.nodes.position[there])
        parts.sets = mesh.sets
        parts.warnings += [f"nodes are those of {file}"] * (comm.rank == 0)
        placed = np.concatenate(comm.allgather(parts.nodes.label))
    modal = ~np.isin(node, placed)
    scalars = label_of(node.max() + np.cumsum(modal), np.full(len(node), SCALAR))
    label = np.where(modal, scalars, label_of(node, content.dof - 1))
    for key, matrix in matrices.items():
        # rows of zeros are rows: of a spring in one direction, other directions too
        there = (matrix != 0) | np.eye(len(matrix), dtype=bool)
        i, j = np.nonzero(there) if comm.rank == 0 else (np.zeros(0, np.int64),) * 2
        parts.matrices[key] = LabelledEntries(label[i], label[j], matrix[i, j])
    return parts


class _Content(NamedTuple):
    """Node and dof of each row, matrices by key, and remarks; whether CalculiX wrote the file; whether it has nodes,
    and `modal` those that our export gives to modal coordinates, which are no places."""

    node: np.ndarray
    dof: np.ndarray
    matrices: dict[str, np.ndarray]
    remarks: list[str]
    of_calculix: bool
    has_nodes: bool
    modal: list[int]


def _content(path) -> _Content:
    """Return what a file has. Raises InputError."""
    with open_unpacked(path) as file:
        text = file.read().decode("latin-1").replace("\r\n", "\n")
    blocks = _blocks(text)
    elements = [block for block in blocks if block[0] == "USERELEMENT"]
    if len(elements) != 1:
        raise InputError(f"{path}: found {len(elements)} user elements, expected one, of one substructure; matrices "
                         "element by element are no superelement")  # fmt: skip
    # which node and dof each row is
    params, body = elements[0][1:]
    nodes = _nodes(path, text, blocks, params)
    node, dof = _rows(path, nodes, body)
    labels = np.stack([node, dof], axis=1)
    if len(np.unique(labels, axis=0)) < len(labels):
        twice, counts = np.unique(labels, axis=0, return_counts=True)
        raise InputError(f"{path}: found node {twice[counts > 1][0, 0]}, dof {twice[counts > 1][0, 1]} in two rows, "
                         "expected one row each")  # fmt: skip
    # the matrices that a model has
    matrices, remarks = {}, []
    for keyword, params, body in blocks:
        if keyword != "MATRIX":
            continue
        kind = params.get("TYPE", "").replace(" ", "")
        if kind not in KEYS:
            remarks.append(f"{path}: a matrix of type {params.get('TYPE', 'none')} was not read")
            continue
        if KEYS[kind] in matrices:
            raise InputError(f"{path}: found two matrices of type {params['TYPE']}, expected one")
        matrices[KEYS[kind]] = _matrix(path, params["TYPE"], body, len(node), "UNSYMM" in elements[0][1])
    inputs = {params.get("NAME", ""): (params, body) for keyword, params, body in blocks if keyword == "MATRIXINPUT"}
    assembled = [pair for keyword, params, _ in blocks if keyword == "MATRIXASSEMBLE" for pair in params.items()]
    for kind, name in assembled:
        if kind != "VISCOUS DAMPING" or "D" in matrices or name not in inputs:
            remarks.append(f"{path}: *MATRIX ASSEMBLE, {kind}={name} was not read")
        else:
            matrices["D"] = _beside(path, name, *inputs[name], labels)
    remarks += [f"{path}: *MATRIX INPUT, NAME={name} was not read, as no *MATRIX ASSEMBLE has it"
                for name in sorted(inputs.keys() - {name for _, name in assembled})]  # fmt: skip
    if "K" not in matrices:
        raise InputError(f"{path}: found no *MATRIX, TYPE=STIFFNESS, expected one; ask for STIFFNESS=YES in "
                         "*SUBSTRUCTURE MATRIX OUTPUT")  # fmt: skip
    if "M" not in matrices:
        remarks.append(f"{path}: found no mass matrix: the substructure is a spring between its nodes, without mass")
        matrices["M"] = np.zeros_like(matrices["K"])
    # what else the file tells of its nodes
    modal = MODAL.search(text)
    modal = [int(line.split(",")[0]) for line in modal[0].splitlines()[1:]] if modal else []
    has_nodes = any(keyword == "NODE" for keyword, *_ in blocks)
    return _Content(node, dof, matrices, remarks, OF_CALCULIX in text, has_nodes, modal)


def _blocks(text):
    """Return keyword, parameters and data of each keyword."""
    blocks, starts = [], list(KEYWORD.finditer(text))
    for match, after in zip(starts, [*starts[1:], None], strict=True):
        keyword, *parameters = match[0].strip().lstrip("* \t").upper().rstrip(",").split(",")
        params = {key.strip(): value.strip() for key, _, value in (pair.partition("=") for pair in parameters)}
        body = text[match.end() : after.start() if after else len(text)]
        blocks.append((keyword.replace(" ", ""), params, re.sub(r"(?m)^[ \t]*\*\*[^\n]*\n?", "", body)))
    return blocks


def _nodes(path, text, blocks, params) -> np.ndarray:
    """Return the list of nodes (k,) of the element."""
    listed = LISTED.search(text)
    if listed:
        nodes = [int(word) for word in re.findall(r"\d+", listed[1])]
    else:
        lines = [body for keyword, _, body in blocks if keyword == "ELEMENT"]
        nodes = [int(word) for word in re.findall(r"\d+", lines[0])][1:] if lines else []
    if str(len(nodes)) != params.get("NODES"):
        raise InputError(f"{path}: found {len(nodes)} nodes of the user element, expected NODES={params.get('NODES')} "
                         "in a comment ** ELEMENT NODES or below *ELEMENT")  # fmt: skip
    return np.array(nodes, np.int64)


def _rows(path, nodes, body):
    """Return node and dof of each row, from the lines below *USER ELEMENT."""
    lines = [line for line in body.splitlines() if line.strip()]
    try:
        numbers = [[int(word) for word in line.split(",") if word.strip()] for line in lines]
        first, *changes = numbers
        starts, dofs = [1, *(line[0] for line in changes)], [first, *(line[1:] for line in changes)]
        directions = [d for group in dofs for d in group]
        if sorted(set(starts)) != starts or starts[-1] > len(nodes) or not set(directions) <= set(range(1, 7)):
            raise ValueError
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: found the lines '{shown(' / '.join(lines).encode('latin-1'))}' below *USER ELEMENT, "
                         "expected the dofs (1 to 6) of the first node, and then places in the list of nodes with the "
                         "dofs from there on") from error  # fmt: skip
    # a place holds until the next one, and an empty line of dofs for nodes without any
    which = np.searchsorted(starts, np.arange(1, len(nodes) + 1), side="right") - 1
    pairs = [(node, d) for node, k in zip(nodes.tolist(), which, strict=True) for d in dofs[k]]
    return np.array(pairs, np.int64).reshape(-1, 2).T


def _matrix(path, kind, body, size, unsymmetric) -> np.ndarray:
    """Return a matrix (size, size)."""
    values = _values(path, kind, body)
    expected = size**2 if unsymmetric else size * (size + 1) // 2
    if len(values) != expected:
        raise InputError(f"{path}: found {len(values)} numbers of {kind}, expected {expected} for {size} rows; the "
                         "file is cut off or damaged")  # fmt: skip
    if unsymmetric:
        return values.reshape(size, size).T
    matrix = np.zeros((size, size))
    matrix.T[np.tril_indices(size)] = values  # the upper triangle, column by column
    return matrix + np.triu(matrix, 1).T


def _beside(path, name, params, body, labels) -> np.ndarray:
    """Return the matrix (size, size) of the lines of node, dof, node, dof, value below *MATRIX INPUT."""
    table, size = _values(path, name, body), len(labels)
    if len(table) % 5 or not len(table):
        raise InputError(f"{path}: found {len(table)} numbers of *MATRIX INPUT, NAME={name}, expected lines of node, "
                         "dof, node, dof, value; the file is cut off or damaged")  # fmt: skip
    table = table.reshape(-1, 5)
    fits = (table[:, :4].reshape(-1, 2, 1, 2) == labels).all(axis=3)
    if not fits.any(axis=2).all():
        raise InputError(f"{path}: found a row or column of *MATRIX INPUT, NAME={name} that the user element has not")
    row, column = fits.argmax(axis=2).T
    matrix = np.zeros((size, size))
    np.add.at(matrix, (row, column), table[:, 4])
    if params.get("TYPE", "SYMMETRIC") == "UNSYMMETRIC":
        return matrix
    return matrix + matrix.T - np.diag(np.diag(matrix))


def _values(path, kind, body) -> np.ndarray:
    """Return the numbers of lines."""
    values = parse(with_e(body.replace(",", " ").encode("latin-1")))
    if values is None:
        raise InputError(f"{path}: {kind}: found something else than numbers below it; the file is damaged")
    return values


def _input_beside(path):
    """Return the input file of the run, of the same name or the only one in the folder; None where there is none."""
    others = [file for file in sorted(path.parent.glob("*.inp")) if file != path and not begins(first_bytes(file))]
    same = [file for file in others if file.stem == path.stem]
    fitting = same or others
    if len(fitting) > 1:
        raise InputError(f"{path}: found several input files beside it ({', '.join(file.name for file in fitting)}), "
                         f"expected one, or {path.stem}.inp with its nodes")  # fmt: skip
    return fitting[0] if fitting else None


class UserElement(Reader):
    """A substructure as a linear user element."""

    name, told_by = "a substructure of Abaqus or CalculiX as a user element", "*USER ELEMENT with LINEAR"
    companions = "x.inp with the nodes, or the only .inp beside it"
    begins, read_model = staticmethod(begins), staticmethod(read)
