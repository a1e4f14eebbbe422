"""Write input files by which finite-element programs compute the stresses of the columns of a basis.

Each column is a step of a static analysis. All displacements of a step are prescribed, which any element of a program
takes, also one whose stresses do not follow from the displacements of its nodes alone. Those of ANSYS (CDREAD, D,
OUTRES) and Nastran (SOL 101, SPC1, SPCD) follow the manuals and were not run in the programs.
"""

import re
from abc import ABC, abstractmethod

from ..parallel.failures import InputError

SET = 90_000_000  # numbers of sets of loads and supports, above those of users
OWN_SET = "{set}"  # where a line has the number of the set of its column
# how bulk data, keywords and commands are found in original files
ANSYS_NODES = re.compile(r"(?im)^(NBLOCK|N,)")
CALCULIX_STEP = re.compile(r"(?im)^\*STEP\b")
CALCULIX_NODES = re.compile(r"(?im)^\*NODE\b(?!\s+(?:PRINT|FILE|OUTPUT))|^\*INCLUDE\b")
CALCULIX_NUMBERED = re.compile(r"(?m)^[ \t]*(\d+)[ \t]*,")  # lines that begin with the number of a node or element
CALCULIX_ALL = f"ALL{SET}"
NASTRAN_BEGIN = re.compile(r"(?im)^[ \t]*BEGIN[ \t]+BULK\b.*$")
NASTRAN_END = re.compile(r"(?im)^[ \t]*ENDDATA\b")
NASTRAN_GRID = re.compile(r"(?im)^(GRID\*?[ ,]|INCLUDE\b)")
NASTRAN_MPC = re.compile(r"(?im)^[ \t]*MPC[ \t]*=.*$")
ANSYS_SOLUTION = """/PREP7
CSYS,0
NROTAT,ALL
FINISH
/SOLU
ANTYPE,STATIC
DDELE,ALL,ALL
FDELE,ALL,ALL
SFEDELE,ALL,ALL,ALL
BFDELE,ALL,ALL
BFEDELE,ALL,ALL
ACEL,0,0,0
OUTRES,ALL,NONE
OUTRES,NSOL,LAST
OUTRES,STRS,LAST
"""


class Deck(ABC):
    """Base class of the input files of a program.

    `job`, `column`: names of the main file, and of the file of a column with `%d` for its number from 1. `line`: text
    of a line of the latter, a format of node and direction that gives one of the value; OWN_SET stands for 16 digits,
    SET and the number of the column. `directions`: what the program calls x, y, z, rx, ry, rz there. `supports`,
    `support`: name of a file of all dofs, held ones too, and the format of its lines, of direction and node; "" for
    none. `include`: how a line includes another file, whose name is its first group. `run`: what to run in the folder,
    and what it writes.
    """

    job = column = line = supports = support = run = ""
    include: re.Pattern | None = None
    directions: tuple = ()

    @abstractmethod
    def main(self, original: str, columns: list[str]) -> str:
        """Return the text of the main file, of the text of the original input file and the names of the files of the
        columns. Raises InputError for a text that is no such file."""


class AnsysDeck(Deck):
    """An archive (CDWRITE) as it is, and load steps behind it; nodes are turned to global axes, which the basis has."""

    job, column, line = "stress.inp", "column_%04d.inp", "D,%d,%s,%%.12e\n"
    directions = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
    run = "stress.inp in ANSYS; the answers are in file.rst"

    def main(self, original, columns):
        if not ANSYS_NODES.search(original):
            raise InputError("found no nodes (NBLOCK), expected an archive of ANSYS (CDWRITE,DB)")
        steps = "".join(f"/INPUT,{name.removesuffix('.inp')},inp\nSOLVE\n" for name in columns)
        return f"{original.rstrip()}\nFINISH\n{ANSYS_SOLUTION}{steps}FINISH\n"


class CalculixDeck(Deck):
    """Steps behind the model of an input file of CalculiX; numbers have at most 20 characters, which it reads."""

    job, column, line = "stress.inp", "column_%04d.inc", "%d,%s,%%.12e\n"
    include = re.compile(r"(?im)^\*INCLUDE[ \t]*,[ \t]*INPUT[ \t]*=[ \t]*([^\n,]+?)[ \t]*$\n?")
    directions = tuple(f"{number},{number}" for number in range(1, 7))
    run, sets, asked = "ccx stress; the answers are in stress.frd", "", "*NODE FILE\nU\n*EL FILE\nS\n"

    def main(self, original, columns):
        if not CALCULIX_NODES.search(original):
            raise InputError("found no keyword *NODE, expected an input file of CalculiX")
        step = CALCULIX_STEP.search(original)
        model = original[: step.start()] if step else original
        steps = (f"*STEP\n*STATIC\n1.,1.\n*BOUNDARY\n*INCLUDE,INPUT={name}\n{self.asked}*END STEP\n"
                 for name in columns)  # fmt: skip
        last = max(map(int, CALCULIX_NUMBERED.findall(model)), default=1)  # above which there is no node or element
        return f"{model.rstrip()}\n{self.sets.format(last=last)}{''.join(steps)}"


class CalculixPointsDeck(CalculixDeck):
    """The same, with stresses printed at integration points; in the sets CalculiX leaves out what does not exist."""

    run = "ccx stress; the answers are in stress.dat, to be read beside stress.inp"
    sets = f"*NSET,NSET={CALCULIX_ALL},GENERATE\n1,{{last}}\n*ELSET,ELSET={CALCULIX_ALL},GENERATE\n1,{{last}}\n"
    asked = f"*NODE PRINT,NSET={CALCULIX_ALL}\nU\n*EL PRINT,ELSET={CALCULIX_ALL},GLOBAL=YES\nS\n"


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
        begin, end = NASTRAN_BEGIN.search(original), NASTRAN_END.search(original)
        bulk = original[begin.end() if begin else 0 : end.start() if end else None].strip("\n")
        if not NASTRAN_GRID.search(bulk):
            raise InputError("found no GRID in the bulk data, expected an input file of Nastran")
        constraints = NASTRAN_MPC.findall(original[: begin.start()]) if begin else []
        lines = ["SOL 101", "CEND", "ECHO = NONE", "DISPLACEMENT(PUNCH) = ALL", "STRESS(PUNCH,CORNER) = ALL"]
        lines += [*(constraint.strip() for constraint in constraints), f"SPC = {SET}"]
        for number in range(1, len(columns) + 1):
            lines += [f"SUBCASE {number}", f"  LOAD = {SET + number}"]
        lines += ["BEGIN BULK", bulk, f"INCLUDE '{self.supports}'", *(f"INCLUDE '{name}'" for name in columns)]
        return "\n".join([*lines, "ENDDATA", ""])


DECKS = {"calculix": CalculixDeck, "calculix-dat": CalculixPointsDeck, "ansys": AnsysDeck, "nastran": NastranDeck}


def deck_called(word: str) -> Deck:
    """Return the Deck of a program. Raises InputError."""
    if word not in DECKS:
        raise InputError(f"deck: found '{word}', expected {' or '.join(DECKS)}")
    return DECKS[word]()
