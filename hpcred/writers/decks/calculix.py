"""Write input files of CalculiX by which it computes the stresses of the columns of a basis."""

import re

from ...parallel.failures import InputError
from .base import SET, Deck

STEP = re.compile(r"(?im)^\*STEP\b")
NODE = re.compile(r"(?im)^\*NODE\b(?!\s+(?:PRINT|FILE|OUTPUT))|^\*INCLUDE\b")

NUMBERED = re.compile(r"(?m)^[ \t]*(\d+)[ \t]*,")  # lines that begin with the number of a node or element
ALL = f"ALL{SET}"


class CalculixDeck(Deck):
    """Steps behind the model of an input file of CalculiX; numbers have at most 20 characters, which it reads."""

    job, column, line = "stress.inp", "column_%04d.inc", "%d,%s,%%.12e\n"
    include = re.compile(r"(?im)^\*INCLUDE[ \t]*,[ \t]*INPUT[ \t]*=[ \t]*([^\n,]+?)[ \t]*$\n?")
    directions = tuple(f"{number},{number}" for number in range(1, 7))
    run, sets, asked = "ccx stress; the answers are in stress.frd", "", "*NODE FILE\nU\n*EL FILE\nS\n"

    def main(self, original, columns):
        if not NODE.search(original):
            raise InputError("found no keyword *NODE, expected an input file of CalculiX")
        step = STEP.search(original)
        model = original[: step.start()] if step else original
        steps = (
            f"*STEP\n*STATIC\n1.,1.\n*BOUNDARY\n*INCLUDE,INPUT={name}\n{self.asked}*END STEP\n"
            for name in columns
        )
        last = max(map(int, NUMBERED.findall(model)), default=1)  # above which there is no node or element
        return f"{model.rstrip()}\n{self.sets.format(last=last)}{''.join(steps)}"


class CalculixPointsDeck(CalculixDeck):
    """The same, with stresses printed at integration points; in the sets CalculiX leaves out what does not exist."""

    run = "ccx stress; the answers are in stress.dat, to be read beside stress.inp"
    sets = f"*NSET,NSET={ALL},GENERATE\n1,{{last}}\n*ELSET,ELSET={ALL},GENERATE\n1,{{last}}\n"
    asked = f"*NODE PRINT,NSET={ALL}\nU\n*EL PRINT,ELSET={ALL},GLOBAL=YES\nS\n"
