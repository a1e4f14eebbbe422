"""Write the shapes of a result as a universal file (UFF, .unv).

It has units (164), nodes (2411), elements (2412) and the shapes (55, displacements of normal modes).
"""

import re

from ..files.outputs import UFF
from ..files.system_errors import mapped
from ..parallel.petsc import MPI
from ..readers.nodes import uff
from .base import Writer

CODES = {"line": 21, "line3": 24, "triangle": 91, "triangle6": 92, "quad": 94, "quad8": 95, "tetra": 111,
         "tetra10": 118, "wedge": 112, "wedge15": 113, "hexahedron": 115, "hexahedron20": 116}  # fmt: skip
LINES = 2**16  # written at a time
SHAPE = re.compile(rb"(?m)^ {4}-1\r?\n {4}55\r?\n(.*?)\r?$")  # the name of a dataset 55
UNITS = """    -1
   164
         1  SI: Meter (newton)         2
  1.00000000000000000E+00  1.00000000000000000E+00  1.00000000000000000E+00
  2.73149999999999977E+02
    -1
"""


def _write_elements(file, shapes):
    number = 0
    if not any(kind in CODES for kind in shapes.cells):
        return
    file.write("    -1\n  2412\n")
    for kind, cells in shapes.cells.items():
        if kind not in CODES:
            continue
        for cell in shapes.nodes[cells[:, uff.ORDER.get(kind, slice(None))]]:
            number += 1
            file.write("".join(f"{entry:10d}" for entry in (number, CODES[kind], 1, 1, 7, len(cell))) + "\n")
            if kind in ("line", "line3"):
                file.write(f"{0:10d}{1:10d}{1:10d}\n")
            for low in range(0, len(cell), 8):
                file.write("".join(f"{node:10d}" for node in cell[low : low + 8]) + "\n")
    file.write("    -1\n")


class UffFile(Writer):
    """Shapes for programs of modal analysis: all columns as normal modes."""

    suffix, needs, kind = ".uff", "shapes", UFF

    def write(self, target, source):
        with source.shapes() as shapes, open(target, "w", encoding="utf-8", newline="\n") as file:
            nodes = shapes.nodes
            file.write(UNITS)
            file.write("    -1\n  2411\n")
            for low in range(0, len(nodes), LINES):
                rows = zip(nodes[low : low + LINES], shapes.points[low : low + LINES], strict=True)
                file.writelines(f"{node:10d}{0:10d}{0:10d}{11:10d}\n{x:25.16E}{y:25.16E}{z:25.16E}\n"
                                for node, (x, y, z) in rows)  # fmt: skip
            file.write("    -1\n")
            _write_elements(file, shapes)
            for k, (name, frequency) in enumerate(zip(shapes.names, shapes.frequencies, strict=True)):
                file.write(f"    -1\n    55\n{name}\nNONE\nNONE\nNONE\nNONE\n")
                # structural, normal mode, three translations, displacement, real, three numbers a node
                file.write("".join(f"{code:10d}" for code in (1, 2, 2, 8, 2, 3)) + "\n")
                file.write(f"{2:10d}{4:10d}{1:10d}{k + 1:10d}\n")
                file.write(f"{frequency:13.5E}{1.0:13.5E}{0.0:13.5E}{0.0:13.5E}\n")
                moved = shapes.displacement(k)
                for low in range(0, len(nodes), LINES):
                    rows = zip(nodes[low : low + LINES], moved[low : low + LINES], strict=True)
                    file.writelines(f"{node:10d}\n{x:13.5E}{y:13.5E}{z:13.5E}\n" for node, (x, y, z) in rows)
                file.write("    -1\n")
            return list(shapes.names)

    def describe(self, path):
        nodes, elements, *_ = uff.read(path, MPI.COMM_SELF)
        with mapped(path) as text:
            shapes = [match[1].decode(errors="replace").strip() for match in SHAPE.finditer(text)]
        return {
            "format": "universal file (UFF)",
            "nodes": len(nodes.label),
            "elements": {kind: len(cells) for kind, cells in elements.items()} or "none",
            "shapes": shapes,
        }
