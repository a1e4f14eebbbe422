"""Keep what is known of a model together with its source, so that a weaker source never serves a stronger claim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Kind = Literal["exact factor", "approximate factor", "Krylov", "declared", "estimated"]


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a value comes from. `accuracy`: the relative one of an approximate factor, 0 for others."""

    kind: Kind = "exact factor"
    accuracy: float = 0.0

    def serves(self, claim: Source) -> bool:
        """Test whether a value from here is as strong as one from the source `claim`."""
        kinds = get_args(Kind)  # the strongest first
        return (kinds.index(self.kind), self.accuracy) <= (kinds.index(claim.kind), claim.accuracy)

    @property
    def in_words(self) -> str:
        """The source as text."""
        return f"{self.kind}, {self.accuracy:g}" if self.accuracy else self.kind


EXACT = Source()


@dataclass(frozen=True, kw_only=True)
class ModeCount:
    """How many modes lie below a frequency (Hz), and what told so."""

    modes: int
    below: float
    source: Source = EXACT

    @property
    def in_words(self) -> str:
        """The count as text."""
        return f"{self.modes} modes below {self.below:.6g} Hz ({self.source.in_words})"
