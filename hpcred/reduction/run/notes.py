"""Collect the records of a reduction: columns, factors, and sentences for the user."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from ...linalg.solvers.base import FactorRecord
from ..result.record import ComponentRecord

WITHOUT_MASS = (
    "M is singular: directions that move no mass were left out of the basis, and with them the static deflection by "
    "loads on what has no mass; give it a little mass, or take it out by static condensation"
)


@dataclass(kw_only=True)
class Notes:
    """What is recorded of a run, and travels as one between ranks and from the run to its record.

    `needed`: the factors (mass and damping, as in FactorRecord) that a run without store has; `massless`: whether
    directions were left out since they move no mass; `incomplete`: whether a basis that holds all that M sees lacks
    part of the responses; `analyses`: symbolic ones.
    """

    components: list[ComponentRecord] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    needed: list[tuple[str, str]] = field(default_factory=list)
    factorisations: list[FactorRecord] = field(default_factory=list)
    analyses: int = 0
    massless: bool = False
    incomplete: bool = False

    def needs(self, mass: str, damping: str, again=False):
        """Note the factor that a part of the basis comes from, also if the store had the part; `again`: count it
        although the last part came from the same factor, which is gone."""
        if again or self.needed[-1:] != [(mass, damping)]:
            self.needed.append((mass, damping))

    def add(self, other: Notes, components: bool):
        """Add other notes, with or without their `components` of the basis."""
        if components:
            self.components += other.components
        self.remarks += other.remarks
        self.needed += other.needed
        self.factorisations += other.factorisations
        self.analyses += other.analyses
        self.massless |= other.massless
        self.incomplete |= other.incomplete

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user of the result has to know."""
        failed = [record.package_because for record in self.factorisations if record.gpu_failed]
        sentences = self.remarks + [f"MUMPS made factors, since {reason}" for reason in failed]
        return tuple(dict.fromkeys(sentences + [WITHOUT_MASS] * bool(self.massless)))

    @property
    def factorisations_saved(self) -> int:
        """How many factors were not made because of the store."""
        made = Counter((record.mass, record.damping) for record in self.factorisations)
        return (Counter(self.needed) - made).total()
