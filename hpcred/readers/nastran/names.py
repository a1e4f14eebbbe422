"""Decide by their names which matrices of a Nastran file are K, M and D."""

from dataclasses import dataclass

from ...parallel.failures import InputError

# sets of dofs by what follows K, M or B in a name, the best one first: with all constraints, and free supports in it
PREFERRED = (("AA", "A"), ("XX", None), ("FF", "F"), ("LL", "L"), ("NN", "N"), ("GG", "G"), ("JJ", "G"))
WORDS = {"STIF": ("MASS", "DAMP"), "STIFF": ("MASS", "DAMP"), "STIFFNES": ("MASS", "DAMPING")}
STRUCTURAL = "K4"


@dataclass(frozen=True)
class Choice:
    """Places, in the list of names, of K, M and perhaps D by key; `letter` of the set of dofs, None if not known."""

    places: dict[str, int]
    letter: str | None


def pairs(names: list[str]) -> list[Choice]:
    """Return all pairs of stiffness and mass with names that fit, the best first; of equal names the first counts."""
    choices = []
    for name in dict.fromkeys(names):
        if name in WORDS:
            mass, damping, rest = *WORDS[name], ""
        elif name.startswith("K") and not name.startswith(STRUCTURAL):
            rest = name[1:]
            mass, damping = f"M{rest}", f"B{rest}"
            damping = next((name for name in (damping, f"{damping}1", f"D{rest}") if name in names), damping)
        else:
            continue
        if mass not in names:
            continue
        rank, letter = _set_of(rest)
        places = {"K": names.index(name), "M": names.index(mass)}
        if damping in names:
            places["D"] = names.index(damping)
        choices.append((rank, Choice(places, letter)))
    return [choice for _, choice in sorted(choices, key=lambda ranked: ranked[0])]


def _set_of(rest):
    """Return how good a set is, and its letter; K2GG counts as KGG, and so does KDGG, the differential stiffness."""
    rest = rest.lstrip("2D")
    for rank, (start, letter) in enumerate(PREFERRED):
        if rest.startswith(start):
            return rank, letter
    return len(PREFERRED), None


def named(path, names: list[str], variables: dict[str, str]) -> dict[str, int]:
    """Return places of the matrices that a user named by key; KAA:2 is the second of that name. Raises InputError."""
    chosen = {}
    for key, wanted in variables.items():
        name, _, which = wanted.upper().partition(":")
        places = [k for k, other in enumerate(names) if other == name]
        if not places or not (which or "1").isdecimal() or not 0 < int(which or 1) <= len(places):
            raise InputError(f"{path}: found the matrices {', '.join(names)}, but none that is {key} = {wanted}")
        if not which and len(places) > 1:
            raise InputError(
                f"{path}: found {len(places)} matrices {name}; say which: --variables {key}={name}:1 to "
                f"{name}:{len(places)}"
            )
        chosen[key] = places[int(which or 1) - 1]
    return chosen


def letter_of(name: str) -> str | None:
    """Return the set of dofs that the name of a matrix says, or None."""
    return _set_of(name[1:])[1]


def none_found(path, names) -> InputError:
    """Return the error for a file without a pair of stiffness and mass."""
    return InputError(
        f"{path}: found the matrices {', '.join(names) or 'none'}, expected a stiffness and a mass matrix of one set "
        "such as KAA and MAA, or KGG and MGG; name others by --variables K=...,M=..."
    )


def single(path, matrices: list, key: str, variables: dict[str, str] | None):
    """Return the one matrix that a file is read for: K, M, D, B, C, Cv or Ca. Raises InputError."""
    names = [one.name for one in matrices]
    if variables and key in variables:
        return matrices[named(path, names, {key: variables[key]})[key]]
    if len(names) == 1:
        return matrices[0]
    for choice in pairs(names):
        if key in choice.places:
            return matrices[choice.places[key]]
    starts = {"K": ("K", "STIF"), "M": ("M",), "D": ("B", "D")}.get(key, (key.upper(),))
    fitting = [one for one in matrices if one.name.startswith(starts) and not one.name.startswith(STRUCTURAL)]
    if len(fitting) == 1:
        return fitting[0]
    raise InputError(f"{path}: found the matrices {', '.join(names)}; say which is {key} by --variables {key}=NAME")
