"""Find classes by their addresses: hpcred's own in a table, those of other installed packages by entry points.

An address is "module:Class". Our own classes are asked first, in the order of their table, then those of others, by
name and package. A module is imported when its class is asked for, and the entry points are looked up when none of our
own fits. A class of another package that cannot be loaded is left out, and `broken` has a sentence on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points

from .failures import ComputationError, HpcredError, InputError, reason_of

OWN = "hpcred"


@dataclass(frozen=True)
class Registered:
    """A registered class: its name, its address, and the package that brings it."""

    name: str
    address: str
    package: str = OWN


def found_at(address: str):
    """Return what is at an address in hpcred."""
    return EntryPoint("", f"{OWN}.{address}", "").load()


class Registry:
    """The classes that derive from that at `base`: `own` addresses by name, and those of a `group` of entry points.

    Instances get the `package` of their entry, and its name where the class has none. Use it on one rank, and send the
    entry that was chosen to the others.
    """

    def __init__(self, base: str, group: str, own: dict[str, str]):
        self._base, self._group, self._loaded, self._failed = base, group, {}, {}
        self.own = tuple(Registered(name, f"{OWN}.{address}") for name, address in own.items())

    @cached_property
    def others(self) -> tuple[Registered, ...]:
        """The entries of other packages."""
        entries = {Registered(entry.name, entry.value, getattr(entry.dist, "name", "unknown"))
                   for entry in entry_points(group=self._group)}  # fmt: skip
        return tuple(sorted(entries, key=astuple))

    @property
    def broken(self) -> list[str]:
        """A sentence on each class of another package that failed so far."""
        return list(self._failed.values())

    def entries(self) -> Iterator[Registered]:
        """All entries, our own first."""
        yield from self.own
        yield from self.others

    def load(self, entry: Registered):
        """Return the instance of an entry. Raises InputError where another package has no such class."""
        if entry not in self._loaded:
            try:
                class_, base = EntryPoint("", entry.address, "").load(), found_at(self._base)
                if not (isinstance(class_, type) and issubclass(class_, base)):
                    raise TypeError(f"found {class_!r}, expected a class derived from hpcred.{base.__name__}")
                instance = class_()
            except (Exception, SystemExit) as error:  # whatever the import of a module raises
                if entry.package == OWN:
                    raise
                self._failed[entry] = (
                    f"the package {entry.package} has a {self._group[7:-1]} '{entry.name}' that cannot be "
                    f"used ({type(error).__name__}: {error}); update or remove the package"
                )
                raise InputError(self._failed[entry]) from error
            instance.package, instance.name = entry.package, instance.name or entry.name
            self._loaded[entry] = instance
        return self._loaded[entry]

    def fitting(self, fits: Callable[..., bool], entries=None) -> Iterator[Registered]:
        """Yield the entries whose instances fit, of all or of some; what fails in another package does not fit."""
        for entry in self.entries() if entries is None else entries:
            try:
                fit = entry not in self._failed and fits(self.load(entry))
            except Exception as error:
                if entry.package == OWN:
                    raise
                if entry not in self._failed:
                    self._failed[entry] = str(_blame(self._loaded[entry], error))
                continue
            if fit:
                yield entry

    def first(self, fits: Callable[..., bool], entries=None) -> Registered | None:
        """Return the first entry whose instance fits, or None."""
        return next(self.fitting(fits, entries), None)

    def all(self) -> list:
        """Return the instances of all entries that can be loaded."""
        return [self._loaded[entry] for entry in self.fitting(lambda _: True)]


@contextmanager
def blamed(item):
    """Name the package of a registered class where its code fails; errors of hpcred and of the system pass."""
    try:
        yield
    except Exception as error:
        if item.package == OWN or isinstance(error, HpcredError | MemoryError) or reason_of(error):
            raise
        raise _blame(item, error) from error


def _blame(item, error):
    return ComputationError(
        f"'{item.name}' of the package {item.package} failed ({type(error).__name__}: {error}); tell its authors"
    )
