"""Count the files that an input file includes, so that a few which include each other many times come to an end."""

from pathlib import Path

from ..parallel.failures import InputError

MOST = 10_000  # files, each as often as it is included
DEEPEST = 100  # files above one
AGAIN = 2**26  # bytes, each as often as it is included, or
TIMES = 10  # times the bytes of the files, where that is more


class Included:
    """The files of one input file; `own`: what was found in a file, by its resolved name: each is read once, however
    often it is included. All ranks count alike."""

    def __init__(self, main: Path):
        self.main, self.own = main, {}
        self._seen, self._count, self._bytes, self._once = set(), 0, 0, 0

    def add(self, file: Path, above: tuple[Path, ...], refusal=InputError) -> Path:
        """Count a file below those that include it, `above`, all resolved; returns its resolved name.

        Raises `refusal` of a text where it includes itself, and InputError for more files, bytes or levels than any
        model has.
        """
        resolved = file.resolve()
        if resolved in above:
            raise refusal(f"found an include of {file}, which includes itself")
        size = file.stat().st_size if file.is_file() else 0
        self._count += 1
        self._bytes += size
        self._once += size * (resolved not in self._seen)
        self._seen.add(resolved)
        exceeded = next((excess for excess, beyond in (
            (f"more than {DEEPEST} files, one in the other", len(above) > DEEPEST),
            (f"more than {MOST} files, as often as they are included", self._count > MOST),
            (f"{self._bytes / 1e6:.0f} MB in files of {self._once / 1e6:.0f} MB",
             self._bytes > max(AGAIN, TIMES * self._once)),
        ) if beyond), None)  # fmt: skip
        if exceeded:
            raise InputError(f"{self.main}: found {exceeded}, at {file}; files include others again and again: give an "
                             "input file that includes each once")  # fmt: skip
        return resolved
