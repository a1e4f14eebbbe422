"""Write a Body as the .fem file of MBDyn's modal joint ("FEM file format" of its input manual).

Groups 1 to 10 are header, node labels, initial modal displacements and velocities, coordinates x, y, z, mode shapes,
modal mass and stiffness; 12 is mass, centre of mass and inertia about it; 13 the damping; 14 to 18 are the couplings
between large motion and modes, which MBDyn calls invariants 3, 4, 8, 5 and 9. Group 11, from which MBDyn would compute
them by lumped masses at all nodes, is not there. Coordinates count from the origin of the body frame.
"""

import re
from dataclasses import dataclass
from textwrap import wrap

import numpy as np

from ..body.body import check_moving, inputs_without_node, maker, remarks
from ..files.outputs import MBDYN
from .base import Writer
from .round_off import without_round_off
from .surface_file import surface_as_obj

A_LINE = 6  # numbers; older versions of MBDyn skip groups that they do not know, if the lines are short
REMARK = 100  # characters a line: MBDyn takes a line that is longer than its buffer for the end of the file


def _groups(body) -> dict:
    """Title and values, in the order in which MBDyn reads them, by the number of the record group."""
    reduced, frame, nodes = body.reduced, body.floating_frame, body.nodes
    places = np.array([shape.position - frame.origin for shape in nodes])
    centre = frame.mc / frame.mass
    about_centre = frame.J - frame.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    # -integral of skew(R) skew(Phi_j) dm (row, j, column); integral of skew(Phi_j) skew(Phi_k) dm (row, j, k, column)
    linear = frame.Gr.reshape(3, reduced.size, 3) / 2
    trace = np.einsum("aakj->jk", frame.S)
    quadratic = frame.S.transpose(0, 3, 2, 1) - np.einsum("rc,jk->rjkc", np.eye(3), trace)
    return {
        2: ("FINITE ELEMENT NODE LIST", np.array([shape.name or str(shape.node) for shape in nodes])),
        3: ("INITIAL MODAL DISPLACEMENTS", np.zeros(reduced.size)),
        4: ("INITIAL MODAL VELOCITIES", np.zeros(reduced.size)),
        5: ("NODAL X COORDINATES", places[:, 0]),
        6: ("NODAL Y COORDINATES", places[:, 1]),
        7: ("NODAL Z COORDINATES", places[:, 2]),
        8: ("MODE SHAPES", np.array([np.concatenate([shape.phi, shape.psi]) for shape in nodes])),
        9: ("MODAL MASS MATRIX", without_round_off(reduced.M)),
        10: ("MODAL STIFFNESS MATRIX", without_round_off(reduced.K)),
        12: ("RIGID BODY INERTIA", np.concatenate([[frame.mass], centre, about_centre.ravel()])),
        13: ("MODAL DAMPING MATRIX", without_round_off(reduced.D)),
        14: ("INVARIANT 3", frame.Ct.T),
        15: ("INVARIANT 4", frame.Cr.T),
        16: ("INVARIANT 8", linear),
        17: ("INVARIANT 5", frame.Cr1.transpose(2, 1, 0)),
        18: ("INVARIANT 9", quadratic),
    }


def _numbers(values) -> list[str]:
    """Numbers or labels in their order, a few a line."""
    words = [value if values.dtype.kind == "U" else f"{value: .16e}" for value in values.ravel()]
    return [" ".join(words[low : low + A_LINE]) for low in range(0, len(words), A_LINE)]


@dataclass(frozen=True, kw_only=True)
class MbdynOptions:
    """`surface`: whether the surface is written beside the file, see surface_file."""

    surface: bool = False


class MbdynFile(Writer):
    """Modal joints of MBDyn."""

    suffix, needs, kind, options = ".fem", "body", MBDYN, MbdynOptions

    def write(self, target, source):
        body = source.body
        if source.options.surface:
            source.beside[".obj"] = surface_as_obj(body)
        check_moving(body, "a .fem file for MBDyn")
        reduced, count = body.reduced, body.reduced.size
        lines = [
            *wrap("; ".join([maker(reduced), *remarks(body)]), REMARK, initial_indent="** ", subsequent_indent="** "),
            "** RECORD GROUP 1, HEADER",
            "**   REVISION,  NODE,  NORMAL, ATTACHMENT, CONSTRAINT, REJECTED MODES.",
            f"REV0 {len(body.nodes)} {count} 0 0 0",
        ]
        for number, (title, values) in _groups(body).items():
            lines += ["**", f"** RECORD GROUP {number}, {title}"]
            if number == 8:
                for k in range(count):
                    lines += [f"**    NORMAL MODE SHAPE # {k + 1}", *_numbers(values[..., k])]
            else:
                lines += _numbers(values)
        lines += ["**", "** END OF FILE", ""]
        with open(target, "w", encoding="utf-8") as file:  # labels are compared byte by byte
            file.write("\n".join(lines))
        return [*remarks(body), *inputs_without_node(body)]

    def describe(self, path):
        with open(path, encoding="latin-1") as file:
            groups = re.split(r"(?m)^\*\* RECORD GROUP (\d+),", file.read())
        words = {number: [line for line in text.splitlines()[1:] if not line.startswith("**")]
                 for number, text in zip(groups[1::2], groups[2::2], strict=True)}  # fmt: skip
        return {
            "format": ".fem file of MBDyn's modal joint",
            "coordinates": int(words["1"][0].split()[2]),
            "interface_nodes": " ".join(words["2"]).split(),
            "mass": float(words["12"][0].split()[0]),  # in units that the file does not say
        }
