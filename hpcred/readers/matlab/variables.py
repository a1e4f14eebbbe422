"""List the variables of MATLAB files of all versions, by name, shape and position."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Variable:
    """A matrix of numbers: its `name` with the structs and cells it is in (nas.kaa.k0, parts(2).K, c{1}), its `shape`,
    whether it is `sparse` (then with `nonzeros`, where known) and `complex`, and the `place` that its reader needs."""

    name: str
    shape: tuple[int, ...]
    sparse: bool = False
    nonzeros: int | None = None
    complex: bool = False
    place: object = None

    def in_words(self) -> str:
        """Return such as "54 x 54 sparse, 606 entries"."""
        size = " x ".join(str(number) for number in self.shape)
        entries = f", {self.nonzeros} entries" if self.nonzeros is not None else ""
        return f"{size} {'sparse' if self.sparse else 'dense'}{entries}{', complex' if self.complex else ''}"
