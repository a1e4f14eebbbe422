"""Hold the blocks of one expansion point, and add them to a basis."""

from dataclasses import dataclass, field
from typing import NamedTuple

from ...linalg.basis import Basis


class Part(NamedTuple):
    """A block: columns offered for it, its vectors `start` .. `stop` - 1, and whether they came from a store."""

    label: str
    columns: int
    start: int
    stop: int
    from_store: bool


@dataclass
class PointBlocks:
    """Orthonormal `vectors` of a point, and its blocks."""

    vectors: Basis
    parts: list[Part] = field(default_factory=list)

    def join(self, basis, run):
        """Add the vectors to the basis, block by block. Collective."""
        join(self.parts, self.vectors.columns_between, basis, run, self.vectors.mass_images_between)


def join(parts, columns_between, basis, run, mass_images_between=lambda start, stop: None):
    """Add blocks to the basis and note what each brought.

    `columns_between(start, stop)` gives their vectors, `mass_images_between` M times these, or None where not known.
    """
    for part in parts:
        with run.progress.stage("orthogonalise"):
            place = part.start, part.stop
            extension = basis.extend(columns_between(*place), mass_images_between(*place))
        run.note(part.label, part.columns, extension, minor=True, from_store=part.from_store)
