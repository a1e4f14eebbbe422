"""Give messages to the logger "hpcred"; where nobody listens to it, print on stderr what a terminal shows of them.

Who has given the logger, or the root logger, a handler decides by its level and format where messages go, and which:
INFO is progress, WARNING a doubt about numbers or input, CRITICAL the error by which a rank ends a job.
"""

import logging
import shutil
import sys
import textwrap
from functools import partial

LOGGER = logging.getLogger("hpcred")


def printable(text: str) -> str:
    """A text in one line, with blanks for what a terminal would not show as a letter."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def folded(text: str) -> str:
    """A text in lines that fit the terminal, or COLUMNS, parted between words only. As it is where there is no width,
    as in a pipe or a file, where a sentence is a line to search for."""
    columns = shutil.get_terminal_size((0, 0)).columns
    if not columns:
        return text
    how = {"subsequent_indent": "  ", "break_long_words": False, "break_on_hyphens": False}
    return "\n".join(textwrap.fill(line, columns, **how) for line in text.split("\n"))


def routed() -> bool:
    """Whether a handler takes the messages of this rank; then nothing is printed."""
    return LOGGER.hasHandlers()


def message(level: int, text: str, shown: str | None = None, show=None) -> None:
    """Log one line; without a handler `show(shown)`, by default a line on stderr, unless a level silences the logger.

    The level of the root logger, which hides INFO by default, counts for handlers only.
    """
    if routed():
        LOGGER.log(level, printable(text))
    elif shown is not None and level >= LOGGER.level and level > LOGGER.manager.disable and not LOGGER.disabled:
        (show or partial(print, file=sys.stderr, flush=True))(folded(printable(shown)))
