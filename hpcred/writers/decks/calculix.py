"""Write input files of CalculiX by which it computes the stresses of the columns of a basis."""

import re

from ...parallel.failures import InputError
from .base import Deck

STEP = re.compile(r"(?im)^\*STEP\b")
NODE = re.compile(r"(?im)^\*NODE\b(?!\s+(?:PRINT|FILE|OUTPUT))|^\*INCLUDE\b")


class CalculixDeck(Deck):
    """Steps behind the model of an input file of CalculiX; numbers have at most 20 characters, which it reads."""

    job, column, line = "stress.inp", "column_%04d.inc", "{node},{direction},{direction},{value:.12e}\n"
    include = re.compile(r"(?im)^\*INCLUDE[ \t]*,[ \t]*INPUT[ \t]*=[ \t]*([^\n,]+?)[ \t]*$\n?")
    directions = tuple(range(1, 7))
    run = "ccx stress; the answers are in stress.frd"

    def main(self, original, columns):
        if not NODE.search(original):
            raise InputError("found no keyword *NODE, expected an input file of CalculiX")
        step = STEP.search(original)
        model = original[: step.start()] if step else original
        steps = (
            f"*STEP\n*STATIC\n1.,1.\n*BOUNDARY\n*INCLUDE,INPUT={name}\n*NODE FILE\nU\n*EL FILE\nS\n*END STEP\n"
            for name in columns
        )
        return f"{model.rstrip()}\n{''.join(steps)}"
