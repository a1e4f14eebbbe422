"""Read the loads of a step of an Abaqus or CalculiX input file: *Cload, *Dload and *Dsload.

Of distributed loads, pressures on faces of solids (P1 to P6, P on a *Surface), GRAV and CENTRIF on the whole body are
read. Loads that are given several times in a step add up, as in both programs. Any other load, and any keyword of a
step of which it is not known that it is none, is refused by its line.
"""

import re
from pathlib import Path

import numpy as np

from ...fe.elements import SHELLS, abaqus_kind
from ...fe.shape_functions import corner_kind
from ...files.text import LARGEST_LABEL, pieces, warnings_of_end, without_comments
from ...parallel.declared import nearest
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import sort_over_ranks
from ..deck_loads import DeckLoads, faces_at, find_elements, place_of_face
from ..nodes.table import GROUP
from . import input_file

LOADS = ("cload", "dload", "dsload")
FACES = {  # corners of the faces P1, P2, ...
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "pyramid": ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
    "wedge": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    "hexahedron": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}  # fmt: skip
PARAMETERS = {"op", "amplitude"}  # of a load, that are understood
NO_LOADS = {  # keywords of a step
    "step", "endstep", "static", "dynamic", "frequency", "buckle", "complexfrequency", "steadystatedynamics",
    "modaldynamic", "modaldamping", "visco", "nodefile", "nodeprint", "nodeoutput", "elfile", "elprint",
    "elementoutput", "output", "contactfile", "contactprint", "contactoutput", "energyfile", "energyprint",
    "energyoutput", "sectionfile", "sectionprint", "faceprint", "preprint", "print", "restart", "monitor", "fileformat",
    "modalfile", "controls", "solvercontrols", "timepoints", "filter", "diagnostics", "matrixgenerate", "matrixoutput",
    "substructuregenerate", "substructurematrixoutput", "retainednodaldofs", "nset", "elset", "surface", "amplitude",
    "include", "heading", "boundary",
}  # fmt: skip
QUOTED = re.compile(r'("?)([^"]*)\1')
BLANKS = " \t\r\v\f"
WHOLE = ("GRAV", "CENTRIF")  # loads of the whole body
WITHOUT_MASS = ("SPRING", "DASHPOT", "GAP", "CONN", "DCOUP", "ITS")  # elements of unknown kinds


def read_loads(path, step: int, comm, *, calculix: bool = False) -> DeckLoads:
    """Return the loads of a step, counted from 1, of an input file of Abaqus or of `calculix`. Collective. Raises
    InputError."""
    path = Path(path)
    mesh = input_file.read(path, comm, calculix=calculix, surfaces=True)
    with agreed(comm):
        sections = _of_step(path, mesh.sections, step)
        if "transform" in [section.keyword for section in mesh.sections]:
            raise InputError(f"{path}: found *Transform, which turns the directions of *Cload; give loads in x, y, z")
    reading = _Reading(path, comm, mesh)
    for section in sections:
        getattr(reading, f"read_{section.keyword}")(section)
    reading.check_whole_body()
    for file in sorted({section.path for section in sections} - {path}):
        reading.found.remarks += warnings_of_end(file)
    if any("amplitude" in section.parameters for section in sections):
        reading.found.remarks.append("it has the reference values of its loads; their *Amplitude is not applied")
    return reading.found


def _of_step(path, sections, step):
    """Return the sections of loads of a step. Raises InputError for others that are not known to be none."""
    # loads of the step, and of steps before it, which may go on
    number, chosen, before, open_step = 0, [], {}, None
    for section in sections:
        if section.keyword == "step":
            # a step without an end may lack loads
            if open_step is not None and number <= step:
                break
            number += 1
            open_step = section
        elif section.keyword == "endstep":
            open_step = None
        elif number != step and section.keyword in LOADS:
            if 0 < number < step:
                before[section.keyword] = section
        elif number == step and section.keyword in LOADS:
            _check(section)
            chosen.append(section)
        elif number == step and section.keyword not in NO_LOADS:
            raise section.refusal(
                f"found *{section.keyword.capitalize()} in step {step}, which is not read; expected *Cload, *Dload or "
                "*Dsload: take it out if it is no load"
            )
        elif number == step and section.keyword == "boundary":
            _check_boundary(section)
    if open_step is not None and number <= step:
        raise open_step.refusal(
            f"found no *End Step of step {number}, expected one behind its last line; the file is cut off, or loads "
            "are missing"
        )
    if number < step:
        raise InputError(f"{path}: found {number} steps, expected a step {step}, whose loads are wanted")
    if not chosen:
        raise InputError(f"{path}: found no loads in step {step}, expected *Cload, *Dload or *Dsload")
    # loads go on from step to step, but for a kind that the step gives anew
    fresh = {section.keyword for section in chosen if section.parameters.get("op", "").lower() == "new"}
    fresh |= {"dload", "dsload"} if fresh & {"dload", "dsload"} else set()
    for keyword, section in before.items():
        if keyword not in fresh:
            raise section.refusal(
                f"found loads of *{keyword.capitalize()} that go on in step {step}, whose loads are wanted; give that "
                "step op=new and all of its loads, or write it into a file of its own"
            )
    return chosen


def _check(section):
    unknown = sorted(set(section.parameters) - PARAMETERS)
    if unknown:
        raise section.refusal(
            f"found *{section.keyword.capitalize()} with the parameter {unknown[0]}, which is not read; expected a "
            "constant load that does not follow rotations"
        )
    if (op := section.parameters.get("op", "mod").lower()) not in ("mod", "new"):
        raise section.refusal(f"found op={op}, expected new or mod")


def _check_boundary(section):
    for fields in input_file.data_lines(section):
        value = input_file.number_of(fields[3]) if len(fields) > 3 and fields[3] else 0.0
        if value is None or value:
            raise section.refusal("found a displacement that is prescribed, which is no load; take it out of the step")


class _Reading:
    """Reads sections of loads of a mesh into `found`. Its methods are collective."""

    def __init__(self, path, comm, mesh):
        self.path, self.comm, self.mesh, self.found = path, comm, mesh, DeckLoads(nodes=mesh.nodes)
        groups = {key for keys in mesh.keys.values() for key in np.unique(keys // GROUP).tolist()}
        self.one_group = len(set().union(*comm.allgather(groups))) <= 1
        self.numbers = {kind: keys % GROUP for kind, keys in mesh.keys.items()}
        self.weighed = {}  # numbers of elements of this rank by acceleration or spin

    def read_cload(self, section):
        """Lines of node or node set, direction, value."""
        rows, named = self._lines(section, "a node or node set, direction 1 to 6, value", (3, 3))
        for target, (direction, value) in self._spread(rows, named, self._nodes_of, 2):
            wrong = (direction < 1) | (direction > 6) | (direction % 1 != 0)
            with agreed(self.comm):
                if wrong.any():
                    raise section.refusal(f"found the direction {direction[wrong][0]:g} of a force, expected 1 to 6")
            self.found.at_nodes(target, direction.astype(int) - 1, value)

    def read_dload(self, section):
        """Lines of element or element set, P1 to P6, value; or a set, GRAV or CENTRIF, value, and more."""
        rows, named = self._lines(section, "an element or element set, a label such as P1 or GRAV, numbers", (3, 9), 1)
        self._elements(section, rows, named)

    def read_dsload(self, section):
        """Lines of surface, P, value."""
        rows, named = self._lines(section, "a surface, P, value", (3, 3), 1)
        surfaces = self._surfaces()
        with agreed(self.comm):
            for name, label, _ in [*rows, *named]:
                if label != "P":
                    raise section.refusal(f"found the label {label} of *Dsload, expected P")
                if str(name).lower() not in surfaces:
                    raise section.refusal(f"found the surface '{name}', which no *Surface defines"
                                          f"{nearest(name, surfaces)}")  # fmt: skip
        lines = [(target, face, values) for name, _, values in named for target, face in surfaces[name.lower()]]
        mine = [(int(target), *load) for target, *load in lines if target.isdecimal()][self.comm.rank :: self.comm.size]
        self._elements(section, mine, [line for line in lines if not line[0].isdecimal()])

    def _lines(self, section, expected, width, labels=0):
        """Return target, label and values of the data lines: of this rank with a number as target, and all with names.

        Without `labels` the second field is a number and belongs to the values.
        """
        rows, named = [], []
        with agreed(self.comm):
            for piece in pieces(section.path, self.comm, section.start, section.stop):
                for number, line in enumerate(without_comments(piece.text).decode("latin-1").split("\n")):
                    fields = [field.strip(BLANKS) for field in line.split(",")]
                    while fields and not fields[-1]:
                        fields.pop()
                    if not fields:
                        continue
                    quoted = QUOTED.fullmatch(fields[0])
                    target, label = quoted[2] if quoted else "", (fields[1:2] or [""])[0].upper() if labels else ""
                    values = tuple(input_file.number_of(text) for text in fields[1 + labels :])
                    fits = width[0] <= len(fields) <= width[1] and None not in values
                    fits = fits and (target or (label in WHOLE and not fields[0]))
                    if not fits or (target.isdecimal() and not 1 <= int(target) <= LARGEST_LABEL):
                        raise piece.refusal(number, expected)
                    if target.isdecimal():
                        rows.append((int(target), label, values))
                    else:
                        named.append((target, label, values))
        return rows, sum(self.comm.allgather(named), [])

    def _spread(self, rows, named, members, width):
        """Yield numbers (k,) and values (width, k) of rows, then of each set that is named."""
        table = np.array([values for *_, values in rows]).reshape(len(rows), width)
        yield np.array([target for target, *_ in rows], np.int64), table.T
        for name, _, values in named:
            numbers = members(name)
            yield numbers, np.repeat(np.array(values)[:, None], len(numbers), axis=1)

    def _nodes_of(self, name):
        """Return this rank's part of a node set. Raises InputError."""
        by_lower = {key.lower(): key for key in self.mesh.sets}
        if name.lower() not in by_lower:
            raise InputError(f"{self.path}: found loads on the node set '{name}', which the file does not define"
                             f"{nearest(name, by_lower.values())}")  # fmt: skip
        return self.mesh.sets[by_lower[name.lower()]]

    def _elements_of(self, name):
        """Return this rank's part of the numbers of an element set, of all elements for "". Raises InputError."""
        if not name:
            return np.concatenate([np.zeros(0, np.int64), *self.numbers.values()])
        by_lower = {key.lower(): key for key in self.mesh.element_sets}
        if name.lower() not in by_lower:
            raise InputError(f"{self.path}: found loads on the element set '{name}', which the file does not define"
                             f"{nearest(name, by_lower.values())}")  # fmt: skip
        return self.mesh.element_sets[by_lower[name.lower()]] % GROUP

    def _elements(self, section, rows, named):
        """Read lines of element, label and values."""
        if not self.one_group:
            raise section.refusal("found loads on elements of several instances, expected an input file without parts")
        for label in sorted(set().union(*self.comm.allgather({label for _, label, _ in (*rows, *named)}))):
            mine = [row for row in rows if row[1] == label], [row for row in named if row[1] == label]
            if label[:1] == "P" and label[1:].isdecimal():
                with agreed(self.comm):
                    if any(len(values) != 1 for *_, values in (*mine[0], *mine[1])):
                        raise section.refusal(f"found several numbers behind {label}, expected a pressure")
                for numbers, (value,) in self._spread(*mine, self._elements_of, 1):
                    self._press(section, label, numbers, value)
            elif label in WHOLE:
                self._weigh(section, label, *mine)
            else:
                raise section.refusal(
                    f"found the label {label or 'without letters'}, which is not read; expected P1 to P6, GRAV or "
                    "CENTRIF; a pressure on shells is a [[load]] of kind 'pressure'"
                )

    def _press(self, section, label, numbers, value):
        """Put the pressure (k,) on the faces of the elements (k,)."""
        members = find_elements(self.comm, self.mesh.elements, self.numbers, numbers)
        there = np.zeros(len(numbers), bool)
        with agreed(self.comm):
            for kind, (place, nodes) in members.items():
                there[place] = True
                if not len(place):
                    continue
                corners = FACES.get(corner_kind(kind), ())
                if kind in SHELLS or int(label[1:]) > len(corners) or label == "P0":
                    raise section.refusal(f"found {label} on the element {numbers[place[0]]}, a {kind}, which has no "
                                          "such face")  # fmt: skip
                face = place_of_face(kind, corners[int(label[1:]) - 1])
                self.found.pressed.append((faces_at(kind, nodes, np.full(len(place), face)), value[place]))
            if not there.all():
                raise section.refusal(f"found {label} on the element {numbers[~there][0]}, of which the file has no "
                                      "solid")  # fmt: skip

    def _weigh(self, section, label, rows, named):
        """Add accelerations or spins, and remember on which elements."""
        all_rows = sum(self.comm.allgather(rows), [])
        for target, _, values in [*all_rows, *named]:
            with agreed(self.comm):
                if len(values) != (4 if label == "GRAV" else 7) or not np.any(values[-3:]):
                    expected = "g and a direction" if label == "GRAV" else "omega^2, a point and an axis"
                    raise section.refusal(f"found {len(values)} numbers behind {label}, expected {expected}")
            axis = np.array(values[-3:]) / np.linalg.norm(values[-3:])
            key = (label, *(values[0] * axis if label == "GRAV" else values))
            if key not in self.weighed:
                self.weighed[key] = section, []
                if label == "GRAV":
                    self.found.acceleration = self.found.acceleration + values[0] * axis
                else:
                    self.found.spins.append((values[0], np.array(values[1:4]), axis))
            if isinstance(target, str):
                self.weighed[key][1].append(self._elements_of(target))
            else:
                self.weighed[key][1].append(np.array([target][: self.comm.rank == 0], np.int64))

    def check_whole_body(self):
        """Refuse accelerations that do not act on each element once."""
        total = sum(self.mesh.counts.values())
        for key, (section, numbers) in self.weighed.items():
            every = sort_over_ranks(self.comm, np.concatenate([np.zeros(0, np.int64), *numbers]))[0]
            members = find_elements(self.comm, self.mesh.elements, self.numbers, np.unique(every))
            counts = [len(every), sum(len(place) for place, _ in members.values())]
            named, there = np.sum(self.comm.allgather(counts), axis=0)
            with agreed(self.comm):
                if (named, there) != (total, total):
                    raise section.refusal(
                        f"found {key[0]} on {there} of {total} elements (named {named} times), expected each once: the "
                        "mass matrix is that of the whole body"
                    )
                for other in self.mesh.sections:
                    name = other.parameters.get("type", "").upper()
                    if other.keyword == "element" and abaqus_kind(name) is None and not name.startswith(WITHOUT_MASS):
                        raise section.refusal(f"found {key[0]} and elements of type {name}, of which it is not known "
                                              "whether it acts on them; take kind = 'gravity'")  # fmt: skip

    def _surfaces(self):
        """Return element or element set and face (P1, ...) of the surfaces, by name in small letters."""
        surfaces = {}
        with agreed(self.comm):
            for section in self.mesh.sections:
                if section.keyword != "surface":
                    continue
                name, kind = section.parameters.get("name", ""), section.parameters.get("type", "element")
                lines = input_file.data_lines(section)
                if kind.lower() != "element" or any(len(line) < 2 or line[1][:1].upper() != "S" for line in lines):
                    continue  # of nodes, or without faces: refused where a load names it
                surfaces[name.lower()] = [(line[0].strip('"'), f"P{line[1][1:]}") for line in lines]
        return surfaces
