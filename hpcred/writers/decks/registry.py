"""List the programs that compute stresses, by the words for --deck."""

from ...parallel.failures import InputError
from .base import Deck
from .calculix import CalculixDeck

DECKS = {"calculix": CalculixDeck}


def deck_called(word: str) -> Deck:
    """Return the Deck of a program. Raises InputError."""
    if word not in DECKS:
        raise InputError(f"deck: found '{word}', expected {' or '.join(DECKS)}")
    return DECKS[word]()
