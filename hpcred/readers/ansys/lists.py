"""Read ANSYS' lists of nodes and rows: nodes, HBMAT's mapping, and node numbers in the order of the rows.

Lists of nodes are those of NLIST (with headings on each page), NWRITE (without trailing zeros) and Workbench (a heading
in any language, tabs, decimal points or commas). A .mapping file has lines of equation, node and name of the dof. A
vector of nodes comes from *VEC,...,BACK and *EXPORT,...,MMF.
"""

import re

import numpy as np

from ...files.system_errors import damaged_file
from ...files.text import Piece, end_to_end, first_bytes, pieces, read_lines, shown
from ...files.text_numbers import labels, padded, ragged, whole
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import repeated_key
from ..entries import label_name, label_of
from ..nodes.table import finite

DOFS = (b"UX", b"UY", b"UZ", b"ROTX", b"ROTY", b"ROTZ")
MAPPING = re.compile(rb"^\s*Matrix Eqn\s+Node\s+DOF\s*$", re.MULTILINE)
MAPPING_LINE = re.compile(rb"(?m)^[ \t]*Matrix Eqn[ \t]+Node[ \t]+DOF[ \t]*\r?$")
NO_ROW = re.compile(rb"(?m)^(?![ \t]*\d+[ \t]+\d+[ \t]+(?:" + rb"|".join(DOFS) + rb")[ \t]*\r?$)[^\n]*[^\s][^\n]*$")
NAME = re.compile(rb"\b(" + rb"|".join(DOFS) + rb")\b")
CREATOR = b"% Creator: ANSYS"
VECTOR = re.compile(rb"^%%matrixmarket +matrix +array +integer +general[ \t]*\r?\n", re.IGNORECASE)
# what stands between the lines of NLIST: headings of each page and of the output
HEADING = re.compile(
    rb"(?m)^1[ \t]*\r?$|^[ \t]*(?:LIST ALL |SORT TABLE |NODE[ \t]+X[ \t]+Y[ \t]+Z\b|\*{3,}|/|VERSION|RELEASE|"
    rb"CURRENT JOBNAME|NSYS|DSYS)[^\n]*"
)
NLIST = re.compile(rb"(?m)^[ \t]*(?:LIST ALL SELECTED NODES|NODE[ \t]+X[ \t]+Y[ \t]+Z\b)")
NUMBER = rb"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?"
WORKBENCH = re.compile(rb"^[^\d\s%#/*!,;][^\t\r\n]*\t[^\r\n]*\r?\n[ ]*\d+\t[ ]*" + NUMBER + rb"\t")
# of NWRITE: Fortran's G20.13, 13 digits, perhaps with an exponent; a sign may touch what is in front
GENERAL = rb"(?: +-?|-)(?=\d+\.)[\d.]{14,15}(?:[ED][+-]\d{2,3})?(?=[ \-\r\n])"
NWRITE = re.compile(rb"^(?: *\d+(?:" + GENERAL + rb"){0,6} *\r?\n){2}")
TOUCHING = re.compile(rb"(?<=[0-9])-")
COMMA = re.compile(rb"(?<=[0-9]),")


def begins_nodes(start: bytes) -> bool:
    """Test whether a text that starts so is a list of nodes with headings, or without trailing zeros."""
    return bool(NLIST.search(start[:2000]) or WORKBENCH.match(start) or NWRITE.match(start))


def begins_mapping(start: bytes) -> bool:
    """Test whether a text that starts so is HBMAT's mapping."""
    return bool(MAPPING.match(start.split(b"\n", 1)[0]))


def begins_vector(start: bytes) -> bool:
    """Test whether a text that starts so is a vector of whole numbers of *EXPORT,...,MMF."""
    return bool(VECTOR.match(start)) and CREATOR in start


def read_nodes(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return node numbers, coordinates (share, 3) and angles (share, 3) in degrees. Collective. Raises InputError."""

    def decode(piece):
        text = HEADING.sub(b"", piece.text) if listed else piece.text
        # Workbench heads its columns, and writes decimal commas in some countries
        if headed and piece.start in (0, 3):
            text = b"\n" + text.split(b"\n", 1)[-1]
        if headed and b"," in text:
            if b"." in text:
                raise InputError(f"{path}: found commas and points in its numbers, expected one of them")
            text = COMMA.sub(b".", text)
        # NWRITE leaves no blank before a minus, and leaves out angles that are zero
        if written:
            text = TOUCHING.sub(b" -", text)
        plain = Piece(piece.path, text, piece.start)
        values, counts, lines = ragged(plain, commas=False, expected="node, x, y, z")
        piece.require(counts <= 7, lines, "a node, three coordinates and at most three angles")
        if not written:
            piece.require((counts == 4) | (counts == 7), lines, "node, x, y, z, and perhaps three angles")
        table = padded(values, counts, 7)
        finite(piece, table[:, 1:], lines)
        return labels(piece, table[:, 0], lines), table[:, 1:4], table[:, 4:]

    with agreed(comm):
        # the three forms are told by their first lines
        start = first_bytes(path)
        headed, listed, written = WORKBENCH.match(start), NLIST.search(start), NWRITE.match(start)
        label, position, angles = end_to_end(pieces(path, comm), decode)
    if not comm.allreduce(len(label)):
        raise InputError(f"{path}: found no nodes, expected lines of node, x, y, z")
    return label, position, angles


def read_mapping(path, comm) -> tuple[np.ndarray, np.ndarray]:
    """Return labels of the lines of a .mapping file, and the row (from 0) of each. Collective."""

    def decode(piece):
        text = MAPPING_LINE.sub(b"", piece.text)
        if other := NO_ROW.search(text):
            line = text[: other.start()].count(b"\n")
            raise piece.refusal(line, "equation, node and one of UX, UY, UZ, ROTX, ROTY, ROTZ")
        text = NAME.sub(lambda match: b"%d" % (DOFS.index(match[0]) + 1), text)
        values, _, lines = ragged(Piece(piece.path, text, piece.start), False, "equation, node, dof")
        table = values.reshape(-1, 3)
        row = whole(piece, table[:, 0], lines, "the equation", 1) - 1
        return label_of(labels(piece, table[:, 1], lines), table[:, 2].astype(np.int64) - 1), row

    with agreed(comm):
        label, row = end_to_end(pieces(path, comm), decode)
    total = comm.allreduce(len(row))
    twice, again = repeated_key(comm, label), repeated_key(comm, row)
    if twice is not None or again is not None or (total and max(comm.allgather(row.max(initial=-1))) != total - 1):
        wrong = f"two rows of {label_name(twice)}" if twice is not None else "equations not numbered 1, 2, 3, ..."
        raise damaged_file(path, f"{wrong}")
    return label, row


def read_vector(path, comm, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and rows (from 0) of node numbers in the order of `size` rows, 3 or 6 a node. Collective."""
    with agreed(comm):
        # the header has the number of nodes, from which that of the rows of each node follows
        start = first_bytes(path)
        lines = start.split(b"\n")
        head = next((k for k, line in enumerate(lines) if not line.startswith(b"%")), 0)
        words = lines[head].split()
        if len(words) != 2 or words[1] != b"1" or not words[0].isdigit():
            raise InputError(f"{path}: found the size line '{shown(lines[head])}', expected nodes and 1")
        announced = int(words[0])
        per_node = size // announced if announced and size % announced == 0 else 0
        if per_node not in (3, 6):
            raise InputError(
                f"{path}: found {announced} nodes for {size} rows, expected 3 or 6 rows a node, none of them held; "
                "give the rows by the mapping of HBMAT"
            )
        begin = sum(len(line) + 1 for line in lines[: head + 1])

    def decode(piece):
        values, counts, at = ragged(piece, False, "a node number")
        piece.require(counts == 1, at, "one node number a line")
        return (labels(piece, values, at),)

    # one node a line, in the order of the rows
    node, place = read_lines(path, comm, decode, begin)
    total, twice = comm.allreduce(len(node)), repeated_key(comm, node)
    if total != announced or twice is not None:
        wrong = f"{total} nodes, but {announced} in its header" if twice is None else f"the node {twice} twice"
        raise damaged_file(path, f"{wrong}")
    direction = np.tile(np.arange(per_node), len(node))
    return label_of(np.repeat(node, per_node), direction), np.repeat(place * per_node, per_node) + direction
