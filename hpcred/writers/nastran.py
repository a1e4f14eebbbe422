"""Write a Superelement for Nastran and OptiStruct: DMIG cards, or matrices in OP4 with the cards beside.

Interface nodes are GRID, modal coordinates SPOINT cards. Numbers on cards have 16 columns, and of double precision a D
before the exponent: 10 to 13 digits. OP4 has all digits.
"""

import struct
from dataclasses import replace

import numpy as np

from ..files.outputs import OP4
from .base import SuperelementWriter
from .superelement import fitted

WIDTH = 16


def _ascending(element):
    """The same superelement with its rows in the order of the node numbers, as in the files of EXTSEOUT: matrices of
    OP4 carry no numbers, and a program that sorts the points of the EXTRN card finds the same rows."""
    order = np.argsort([node.node for node in element.interfaces])
    count = 6 * len(order)
    rows = np.concatenate([(6 * order[:, None] + np.arange(6)).ravel(), np.arange(count, element.size)])
    turned = {key: mat[np.ix_(rows, rows)] for key in "KMD" if (mat := getattr(element, key)) is not None}
    return replace(element, **turned, interfaces=tuple(element.interfaces[k] for k in order))


def _said(element, labels):
    yield from element.remark_on_modal_points(_modal_points(element, labels))
    if element.loss_factor:
        yield "structural damping (K42GG) is that of frequency responses; in time it needs PARAM,W4"


def _labels(element):
    labels = element.labels(directions=1)
    labels[6 * len(element.interfaces) :, 1] = 0
    return labels


def _modal_points(element, labels):
    return labels[6 * len(element.interfaces) :, 0].tolist()


def _matrices(element, name):
    """Matrices by name; that of structural damping is eta K."""
    matrices = {name.format("K"): element.K, name.format("M"): element.M}
    if element.D is not None:
        matrices[name.format("B")] = element.D
    if element.loss_factor:
        matrices[name.format("K4")] = element.loss_factor * element.K
    return matrices


def _points(element, labels):
    """Cards of the nodes and of the scalar points."""
    lines = []
    for node in element.interfaces:
        x, y, z = (number(value, "E") for value in node.position)
        lines += [f"$ {node.name}", f"GRID*   {node.node:16d}{0:16d}{x}{y}", f"*       {z}{0:16d}"]
    points = _modal_points(element, labels)
    return lines + _card("SPOINT", points, continued=False)


def _card(name, fields, continued=True):
    """Lines of whole numbers in fields of eight columns; cards of one kind may stand for a continued one."""
    rows = [fields[k : k + 8] for k in range(0, len(fields), 8)]
    heads = [name if not (k and continued) else "" for k in range(len(rows))]
    return [f"{head:8}" + "".join(f"{field:8d}" for field in row) for head, row in zip(heads, rows, strict=True)]


def _dmig(name, matrix, labels):
    """The cards of the upper half of a symmetric matrix; the diagonal is there even where it is zero."""
    lines = [f"DMIG    {name:8}{0:8d}{6:8d}{2:8d}{0:8d}{'':16}{len(matrix):8d}"]
    for j, (node, direction) in enumerate(labels.tolist()):
        lines.append(f"DMIG*   {name:16}{node:16d}{direction:16d}")
        for i in [*np.flatnonzero(matrix[:j, j]).tolist(), j]:
            lines.append(f"*       {labels[i, 0]:16d}{labels[i, 1]:16d}{number(matrix[i, j])}")
    return lines


def number(value: float, letter="D") -> str:
    """A number in sixteen columns with as many digits as fit beside the shortest exponent."""
    return f"{fitted(value, WIDTH, letter):>{WIDTH}}"


def _op4(name, matrix):
    """A symmetric matrix of double precision in OUTPUT4, little-endian, with whole columns."""
    size = len(matrix)

    def record(content):
        mark = struct.pack("<i", len(content))
        return mark + content + mark

    records = [record(struct.pack("<4i8s", size, size, 6, 2, f"{name:8}".encode()))]
    for j in range(size):
        rows = np.flatnonzero(matrix[:, j])
        if rows.size:
            values = matrix[rows[0] : rows[-1] + 1, j].astype("<f8")
            records.append(record(struct.pack("<3i", j + 1, rows[0] + 1, 2 * len(values)) + values.tobytes()))
    records.append(record(struct.pack("<3id", size + 1, 1, 2, 1.0)))
    return b"".join(records)


class DmigCards(SuperelementWriter):
    """DMIG cards."""

    suffix = ".pch"

    def make(self, element, stem):
        labels = _labels(element)
        matrices = _matrices(element, "{}AAX")
        lines = ["$ superelement; into the case control, above all SUBCASE:"]
        lines += [f"$   {name.removesuffix('AAX')}2GG = {name}" for name in matrices]
        lines += ["$ into the bulk data: INCLUDE this file", *_points(element, labels)]
        for name, matrix in matrices.items():
            lines += _dmig(name, matrix, labels)
        digits = "numbers have 10 to 13 digits; format 'nastran-op4' has all"
        return "\n".join(lines) + "\n", {}, [*_said(element, labels), digits, *element.remarks]


class ExternalOp4(SuperelementWriter):
    """Matrices in OP4 with cards beside them."""

    suffix, kind = "_external.op4", OP4
    title, begin = "cards of Nastran beside OP4 matrices", "$ external superelement"
    nodes = r"(?m)^\$ (?P<name>.+)\nGRID\* +(?P<node>\d+) "

    def make(self, element, stem):
        element = _ascending(element)
        labels = _labels(element)
        content = b"".join(_op4(name, matrix) for name, matrix in _matrices(element, "{}XX").items())
        pairs = [(interface.node, 123456) for interface in element.interfaces]
        pairs += [(node, 0) for node in _modal_points(element, labels)]
        lines = [f"$ external superelement with the matrices of {stem}.op4; behind BEGIN SUPER"]
        lines += [*_card("EXTRN", [value for pair in pairs for value in pair]), *_points(element, labels)]
        lines += _card("ASET", [value for pair in pairs for value in pair], continued=False)
        return content, {".pch": "\n".join(lines) + "\n"}, [*_said(element, labels), *element.remarks]
