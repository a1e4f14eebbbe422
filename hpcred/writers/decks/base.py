"""Define what input files for stresses are: a step of a static analysis for each column of a basis.

All displacements of a step are prescribed, which any element of a program takes, also one whose stresses do not follow
from the displacements of its nodes alone.
"""

import re
from abc import ABC, abstractmethod

SET = 90_000_000  # numbers of sets of loads and supports, above those of users
OWN_SET = "{set}"  # where a line has the number of the set of its column


class Deck(ABC):
    """Base class of the input files of a program.

    Attributes
    ----------
    job, column : str
        Names of the main file, and of the file of a column with `%d` for its number from 1.
    line : str
        Text of a line of the file of a column, a format of node and direction that gives one of the value; OWN_SET
        stands for 16 digits, SET and the number of the column.
    directions : tuple
        What the program calls x, y, z, rx, ry, rz in such a line.
    supports, support : str
        Name of a file of all dofs, held ones too, and the format of its lines, of direction and node; "" for none.
    include : re.Pattern or None
        How a line includes another file, whose name is its first group.
    run : str
        What to run in the folder, and what it writes.
    """

    job = column = line = supports = support = run = ""
    include: re.Pattern | None = None
    directions: tuple = ()

    @abstractmethod
    def main(self, original: str, columns: list[str]) -> str:
        """Return the text of the main file, of the text of the original input file and the names of the files of the
        columns. Raises InputError for a text that is no such file."""
