"""Write a Superelement for Abaqus/Standard: the text of one linear user element with its matrices.

Of a symmetric matrix the upper half is given column by column, at most four numbers a line, each column on a new line
(Abaqus Keywords Reference, *MATRIX; Analysis User's Guide, user-defined elements). A number has at most 20 characters,
and one that stands alone a comma behind it (input syntax rules), as in the matrices that the program itself writes.
Modal coordinates are displacements 1 to 3 of further nodes. Damping is no part of *MATRIX: it stands as *MATRIX INPUT.
"""

import numpy as np

from .base import SuperelementWriter
from .superelement import fitted

ON_A_LINE, NODES_ON_A_LINE, WIDTH = 4, 15, 20


def _node(node, position):
    return f"{node}, " + ", ".join(_number(value) for value in position)


def _directions(count, modal_nodes, modal_count):
    """Directions of the first node, then each place in the list of nodes from which on they are others."""
    lines = ["1, 2, 3, 4, 5, 6"]
    whole, rest = divmod(modal_count, 3)
    if whole:
        lines.append(f"{count + 1}, 1, 2, 3")
    if rest:
        lines.append(f"{count + modal_nodes}, " + ", ".join(str(k + 1) for k in range(rest)))
    return lines


def _upper_half(matrix):
    for j in range(len(matrix)):
        for low in range(0, j + 1, ON_A_LINE):
            values = [_number(value) for value in matrix[low : min(low + ON_A_LINE, j + 1), j]]
            yield ", ".join(values) + "," * (len(values) == 1)


def _number(value):
    return fitted(value, WIDTH, "e")


def _listed(numbers):
    """Numbers on lines of which all but the last end in a comma."""
    rows = [numbers[k : k + NODES_ON_A_LINE] for k in range(0, len(numbers), NODES_ON_A_LINE)]
    return [", ".join(map(str, row)) + "," * (row is not rows[-1]) for row in rows]


def _entries(matrix, labels):
    """Node, direction, node, direction, value of the upper half."""
    for i, j in zip(*np.nonzero(np.triu(matrix)), strict=True):
        yield f"{labels[i, 0]}, {labels[i, 1]}, {labels[j, 0]}, {labels[j, 1]}, {_number(matrix[i, j])}"


class UserElement(SuperelementWriter):
    """User elements of Abaqus."""

    suffix = "_abaqus.inp"
    title, begin = "user element of Abaqus", "** superelement"
    nodes = r"(?m)^\*\* (?!modal coordinates$)(?P<name>.+)\n(?P<node>\d+), "

    def make(self, element, stem):
        # interface nodes keep their numbers, modal coordinates get nodes of their own
        labels = element.labels(directions=3)
        count = len(element.interfaces)
        modal = np.unique(labels[6 * count :, 0]).tolist()
        nodes = [interface.node for interface in element.interfaces] + modal
        number = element.interfaces[0].node
        lines = ["** superelement of interface nodes and modal coordinates", "*NODE"]
        for interface in element.interfaces:
            lines += [f"** {interface.name}", _node(interface.node, interface.position)]
        lines += ["** modal coordinates"] * bool(modal) + [_node(node, element.centre) for node in modal]
        # one linear user element with K and M
        lines += [f"*USER ELEMENT, TYPE=U{number % 9999 + 1}, NODES={len(nodes)}, LINEAR, COORDINATES=3"]
        lines += _directions(count, len(modal), element.modal_count)
        for kind, matrix in (("STIFFNESS", element.K), ("MASS", element.M)):
            lines += [f"*MATRIX, TYPE={kind}", *_upper_half(matrix)]
        lines += [f"*ELEMENT, TYPE=U{number % 9999 + 1}, ELSET=BODY_{number}", *_listed([number, *nodes])]
        lines += [f"*UEL PROPERTY, ELSET=BODY_{number}"]
        # a user element has no damping, so that comes as matrices of the same labels
        structural = element.loss_factor * element.K if element.loss_factor else None
        for quantity, name, matrix in (
            ("VISCOUS DAMPING", f"BODY_{number}_D", element.D),
            ("STRUCTURAL DAMPING", f"BODY_{number}_S", structural),
        ):
            if matrix is not None:
                lines += [f"*MATRIX INPUT, NAME={name}, TYPE=SYMMETRIC", *_entries(matrix, labels)]
                lines += [f"*MATRIX ASSEMBLE, {quantity}={name}"]
        return "\n".join(lines) + "\n", {}, [
            *element.remark_on_modal_points(modal),
            f"the body is element {number}, and no other element may have this number",
            *(["structural damping is that of *STEADY STATE DYNAMICS, DIRECT"] * bool(element.loss_factor)),
            *element.remarks,
        ]
