"""Make names of files and of columns of names that users chose, each of them once."""

import os

LONGEST = 160  # bytes of a name that is made here; the rest of 255 is for endings and temporary names


class FileNames:
    """Names of the files of one folder, of letters, digits, dots, hyphens and underscores. A name that there is
    already, also in small letters, gets a number."""

    def __init__(self):
        self._taken: set[str] = set()

    def of(self, name: str) -> str:
        """Return a name of a file for a name."""
        plain = "".join(letter if letter.isalnum() or letter in ".-_" else "_" for letter in name.replace(":", ""))
        plain = plain.encode()[:LONGEST].decode(errors="ignore")
        return self._once(plain, str.lower)

    def of_column(self, name: str) -> str:
        """Return a name of a column, which any name is unless it is there already."""
        return self._once(name, str)

    def _once(self, name, alike):
        number, unique = 1, name
        while alike(unique) in self._taken:
            number, unique = number + 1, f"{name}_{number + 1}"
        self._taken.add(alike(unique))
        return unique


def in_text(path) -> str:
    """Return the name of a file as a text that UTF-8 has: of other bytes their numbers, such as \\\\xff."""
    return os.fsencode(path).decode(errors="backslashreplace")
