"""The blocks of one expansion point on their way from its solver to the basis."""

from dataclasses import dataclass, field

from ..linalg.basis import Basis


@dataclass
class PointBlocks:
    """Orthonormal `vectors` of a point, and its blocks: (label, columns offered, first vector, end)."""

    vectors: Basis
    parts: list[tuple[str, int, int, int]] = field(default_factory=list)

    def add(self, label, columns) -> int:
        """Note that the vectors since the last call are a block; returns the first of them."""
        start = self.parts[-1][3] if self.parts else 0
        self.parts.append((label, columns, start, self.vectors.size))
        return start

    def join(self, basis, run):
        """Add the vectors to the basis, block by block, and free them. Collective."""
        join(self.parts, self.vectors.columns_between, basis, run)
        self.vectors.close()


def join(parts, columns_between, basis, run):
    """Add blocks to the basis and note what each brought; `columns_between(start, stop)` gives their vectors."""
    for label, columns, start, stop in parts:
        with run.progress.stage("orthogonalise"):
            found = basis.extend(columns_between(start, stop))
        run.note(label, columns, found)
