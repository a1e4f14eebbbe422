"""Write input files of Nastran by which it computes the stresses of the columns of a basis.

They follow the Quick Reference Guide (SOL 101, SPC1, SPCD) and were not run in the program.
"""

import re

from ...parallel.failures import InputError
from .base import OWN_SET, SET, Deck

BEGIN = re.compile(r"(?im)^[ \t]*BEGIN[ \t]+BULK\b.*$")
END = re.compile(r"(?im)^[ \t]*ENDDATA\b")
GRID = re.compile(r"(?im)^(GRID\*?[ ,]|INCLUDE\b)")
MPC = re.compile(r"(?im)^[ \t]*MPC[ \t]*=.*$")


class NastranDeck(Deck):
    """A subcase a column: all dofs are held (SPC1) and moved (SPCD), in large fields of ten digits.

    Displacement systems (CD) of nodes must be the basic one.
    """

    job, column, supports = "stress.bdf", "column_%04d.bdf", "supports.bdf"
    line = f"SPCD*   {OWN_SET}%16d%16d%%16.9E\n*\n"
    support, directions = f"SPC1,{SET},%d,%d\n", tuple(range(1, 7))
    include = re.compile(r"(?im)^[ \t]*INCLUDE[ \t]*('[^']+'|\"[^\"]+\"|[^'\"\n$ \t]+)[ \t]*(?:\$.*)?$\n?")
    run = "stress.bdf in Nastran; the answers are in its punch file (.pch)"

    def main(self, original, columns):
        begin, end = BEGIN.search(original), END.search(original)
        bulk = original[begin.end() if begin else 0 : end.start() if end else None].strip("\n")
        if not GRID.search(bulk):
            raise InputError("found no GRID in the bulk data, expected an input file of Nastran")
        constraints = MPC.findall(original[: begin.start()]) if begin else []
        lines = ["SOL 101", "CEND", "ECHO = NONE", "DISPLACEMENT(PUNCH) = ALL", "STRESS(PUNCH,CORNER) = ALL"]
        lines += [*(item.strip() for item in constraints), f"SPC = {SET}"]
        for number in range(1, len(columns) + 1):
            lines += [f"SUBCASE {number}", f"  LOAD = {SET + number}"]
        lines += ["BEGIN BULK", bulk, f"INCLUDE '{self.supports}'", *(f"INCLUDE '{name}'" for name in columns)]
        return "\n".join([*lines, "ENDDATA", ""])
