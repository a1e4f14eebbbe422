"""List the programs that compute stresses, by the words for --deck."""

from ...parallel.failures import InputError
from .ansys import AnsysDeck
from .base import Deck
from .calculix import CalculixDeck, CalculixPointsDeck
from .nastran import NastranDeck

DECKS = {"calculix": CalculixDeck, "calculix-dat": CalculixPointsDeck, "ansys": AnsysDeck, "nastran": NastranDeck}


def deck_called(word: str) -> Deck:
    """Return the Deck of a program. Raises InputError."""
    if word not in DECKS:
        raise InputError(f"deck: found '{word}', expected {' or '.join(DECKS)}")
    return DECKS[word]()
