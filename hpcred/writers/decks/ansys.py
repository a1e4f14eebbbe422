"""Write input files of ANSYS by which it computes the stresses of the columns of a basis.

They follow the manuals (CDREAD, D, OUTRES) and were not run in the program.
"""

import re

from ...parallel.failures import InputError
from .base import Deck

BLOCK = re.compile(r"(?im)^(NBLOCK|N,)")
HEAD = """/PREP7
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


class AnsysDeck(Deck):
    """An archive (CDWRITE) as it is, and load steps behind it; nodes are turned to global axes, which the basis has."""

    job, column, line = "stress.inp", "column_%04d.inp", "D,%d,%s,%%.12e\n"
    directions = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
    run = "stress.inp in ANSYS; the answers are in file.rst"

    def main(self, original, columns):
        if not BLOCK.search(original):
            raise InputError("found no nodes (NBLOCK), expected an archive of ANSYS (CDWRITE,DB)")
        steps = "".join(f"/INPUT,{name.removesuffix('.inp')},inp\nSOLVE\n" for name in columns)
        return f"{original.rstrip()}\nFINISH\n{HEAD}{steps}FINISH\n"
