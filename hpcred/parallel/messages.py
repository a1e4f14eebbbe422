"""Give messages to the logger "hpcred"; where nobody listens to it, print on stderr what a terminal shows of them.

Who has given the logger, or the root logger, a handler decides by its level and format where messages go, and which:
INFO is progress, WARNING a doubt about numbers or input, CRITICAL the error by which a rank ends a job.
"""

import logging
import sys
from functools import partial

LOGGER = logging.getLogger("hpcred")


def printable(text: str) -> str:
    """A text in one line, with blanks for what a terminal would not show as a letter."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


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
        (show or partial(print, file=sys.stderr, flush=True))(printable(shown))
