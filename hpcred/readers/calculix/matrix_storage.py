"""Read the model that CalculiX writes with *FREQUENCY, SOLVER=MATRIXSTORAGE, given one of its files.

beam.sti and beam.mas are K and M without the dofs of supports and of dependent nodes; beam.dof has node and direction
of each row; beam.inp beside them has nodes, elements, sets, supports (*Boundary) and rigid bodies. Without it, beam.frd
of another run has nodes and elements.
"""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...fe.dofs import SCALAR
from ...files.system_errors import damaged_file
from ...files.text import Piece, pieces, read_lines
from ...files.text_numbers import labels, numbers, padded, ragged, whole
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, repeated_key, sort_over_ranks
from ...parallel.petsc import MPI
from ..abaqus import input_file as abaqus_input
from ..base import Reader
from ..entries import STRIDE, label_name, label_of, node_and_direction
from ..nodes.table import NodeTable
from ..parts import Parts, hold_nodes_without_rows
from . import frd as calculix_frd
from . import matrices
from .matrices import read_triangle, require_last_line

DOF_LINES = re.compile(rb"(?:\d+\.\d\r?\n)*")
NAMED_LINE = re.compile(rb"(?m)^[ \t]*([A-Za-z_\"][^,\n]*),([^\n]*)")
EMPTY_FIELD = re.compile(rb",(?=[ \t]*(?:,|\r?$))", re.M)
SINGULAR_MASS = {"C3D20R"}
INCOMPATIBLE = ("C3D8I", "S4", "B31")  # S4 and B31 become C3D8I
EXPANDED = {  # what CalculiX makes of plane elements, whose rows have names that are not what they say
    "CPS": "solids with rows of their thickness",
    "CAX": "a sector of 2 degrees with 1/180 of the mass",
}
SEVERAL = "found {} for several rows, since CalculiX makes solids of beams and shells"
FLAT = ("triangle", "triangle6", "quad", "quad8", "line", "line3")
MOVED = {"submodel", "basemotion"}  # parameters of *Boundary that prescribe motions of other kinds
NO_NODES = np.zeros(0, np.int64)
SIDES = {"S1": -1, "SNEG": -1, "S2": 1, "SPOS": 1}
LEVELS = {"corner": (-1.0, 0.0, 1.0), "edge": (-1.0, 1.0), "linear": (-1.0, 1.0)}
CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4}
SUFFIXES = {"K": ".sti", "M": ".mas", "dofs": ".dof"}


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a .sti, .mas or .dof file."""
    return begins_dofs(start) or matrices.begins(start)


def begins_dofs(start: bytes) -> bool:
    """Test whether a text that starts so has lines of node.direction only."""
    cut = start.rfind(b"\n") + 1
    return cut > 0 and DOF_LINES.fullmatch(start[:cut]) is not None


def files_of(path) -> dict[str, str]:
    """Return K, M, dofs, and, where there are, input and results of the set of a file; also packed ones."""
    path = Path(path)
    stem = path.with_suffix("") if path.suffix == ".gz" else path
    files = {}
    for key, suffix in {**SUFFIXES, "input": ".inp", "results": ".frd"}.items():
        plain = stem.with_suffix(suffix)
        packed = [plain.with_name(plain.name + ".gz")] * (key != "results")
        there = [file for file in (plain, *packed) if file.is_file()]
        if there:
            files[key] = str(there[0])
    return files


def read_parts(path, comm) -> Parts:
    """Return K, M, row labels, nodes, elements, sets, held dofs of the files beside `path`. Collective."""
    with agreed(comm):
        # the three files of one run
        files = files_of(path)
        for key, suffix in SUFFIXES.items():
            if key not in files:
                hint = ", of a step *Frequency, SOLVER=MATRIXSTORAGE" if key == "M" else ""
                expected = Path(str(path).removesuffix(".gz")).with_suffix(suffix)
                raise InputError(f"{path}: found no {expected} beside it, expected one of CalculiX{hint}")
    triangles = {key: read_triangle(files[key], comm) for key in ("K", "M")}
    K, M = triangles["K"], triangles["M"]
    # K and M of one run have the same pattern
    if (K.size, K.places) != (M.size, M.places):
        raise InputError(
            f"{files['M']}: found {M.places[0]} entries of {M.size} rows, at other places than the {K.places[0]} "
            f"entries of {K.size} rows of {files['K']}; one of the files is damaged, or of another run"
        )
    # the rows, of which cyclic symmetry has two for each line
    label, row = read_dofs(files["dofs"], comm)
    count = comm.allreduce(len(label))
    if K.size == 2 * count:
        raise InputError(
            f"{files['K']}: found {K.size} rows for {count} lines of {files['dofs']}: with cyclic symmetry CalculiX "
            "writes real and imaginary parts of a nodal diameter; write the matrices of the whole body"
        )
    if K.size != count:
        raise InputError(f"{files['dofs']}: found {count} lines, expected one for each of the {K.size} rows")
    parts = Parts({key: triangles.pop(key).mirrored() for key in ("K", "M")}, {key: files[key] for key in ("K", "M")})
    del K, M
    # names come from the mesh beside the matrices; without it the matrices are read all the same
    try:
        name_rows(comm, parts, files, label, row)
    except Unnamed as reason:
        parts.warnings.append(
            f"{files['dofs']}: {reason}; the rows have no names, and inputs are named by the number of their row"
        )
    return parts


def read_dofs(path, comm) -> tuple[np.ndarray, np.ndarray]:
    """Return labels of the lines node.direction of this rank, and the row of each. Collective. Raises InputError."""

    def decode(piece):
        if not DOF_LINES.fullmatch(piece.text):
            lines = piece.text.split(b"\n")
            wrong = next(k for k, line in enumerate(lines) if not DOF_LINES.fullmatch(line + b"\n"))
            raise piece.refusal(wrong, "node.direction, such as 20.3")
        table, lines = numbers(Piece(path, piece.text.replace(b".", b" "), piece.start), 2)
        node = labels(piece, table[:, 0], lines)
        piece.require(table[:, 1] != 0, lines,
                      "a displacement (1 to 3); 0 is a temperature, which a mechanical model cannot have")  # fmt: skip
        return (label_of(node, whole(piece, table[:, 1], lines, "the direction (1 to 6)", 1, 6) - 1),)

    with agreed(comm):
        require_last_line(path)
    label, row = read_lines(path, comm, decode)
    return label, row


class Unnamed(Exception):
    """Why the rows cannot have names; raised on all ranks."""


def name_rows(comm, parts, files, label, row):
    """Fill in the mesh, row labels and held dofs from `files`, or raise Unnamed where they do not tell. Collective."""
    mesh = _mesh_of(comm, parts, files, label)
    # rows of no node, and those of nodes that CalculiX made of shells and beams
    inside = _inside_elements(comm, label, sum(mesh.counts.get(kind, 0) for kind in INCOMPATIBLE))
    last = comm.allreduce(int(mesh.nodes.label.max(initial=0)), op=MPI.MAX)  # of the input file
    label, mesh.nodes, (expanded, placed) = _with_expanded_nodes(comm, files["dofs"], label, mesh)
    if expanded:
        parts.warnings.append(
            f"{files['dofs']}: {expanded} nodes of shells and beams are several nodes of the solids that CalculiX "
            "makes of them; their rows are those of nodes with numbers above all others, "
            + ("below, in and above the middle surface" if placed else "at the place of the node of the input file, up "
               "to half of a thickness from where they are, since sections or ties do not tell these places")
        )
    # rotations of rigid bodies are displacements of nodes of their own
    turning = _turning(comm, files, mesh, label[~inside], last)
    label = with_rotations(label, turning)
    if count := comm.allreduce(int(np.count_nonzero(inside))):
        label, mesh.nodes = _as_scalars(comm, label, inside, mesh.nodes)
        parts.warnings.append(
            f"{files['dofs']}: {count} rows are the incompatible modes of elements of the type C3D8I, which "
            "belong to no node"
        )
    # the mesh, and what its boundary holds
    parts.nodes = mesh.nodes
    parts.take_mesh(mesh, mesh.remarks)
    parts.row_labels = label, row
    if "input" not in files:
        hold_nodes_without_rows(comm, parts, files["results"], files["dofs"])
        return
    parts.removed, inclined = held_by_boundary(comm, mesh, turning, label)
    if inclined:
        parts.warnings.append(
            f"{files['input']}: *Boundary holds {inclined} nodes along axes of their own (*Transform); these supports "
            "are in the matrices, without their part of the mass, and in no list of held dofs"
        )
    if any(kind in SINGULAR_MASS for kind in _element_types(mesh.sections)):
        parts.warnings.append(
            f"{files['M']}: elements of the type C3D20R have a singular mass matrix, by CalculiX' reduced integration"
        )


def _mesh_of(comm, parts, files, label):
    """Read the input file or results. Raises Unnamed where it does not say what the rows with these labels are."""
    if "input" not in files:
        twice = repeated_key(comm, label)
        if twice is not None:
            raise Unnamed(SEVERAL.format(label_name(twice)))
        _require_order(comm, files["dofs"], label)
        return _mesh_of_results(comm, parts, files, label)
    mesh = abaqus_input.read(files["input"], comm, calculix=True)
    with agreed(comm):
        _check_steps(files["input"], mesh.sections)
    for kind in sorted(_element_types(mesh.sections)):
        if kind[:3] in EXPANDED:
            raise Unnamed(f"elements of the type {kind} become {EXPANDED[kind[:3]]} in CalculiX")
    return mesh


def _with_expanded_nodes(comm, path, label, mesh):
    """Return labels and nodes, with those made of nodes of shells and beams; the number of these, and whether the
    places of what is made are known. Collective.

    The rows of such a node are those of several nodes of solids, one behind the other, which .dof names alike.
    """
    # rows of nodes of shells and beams; those of others are given once, in order
    flat = [nodes.ravel() for kind, nodes in mesh.elements.items() if kind in FLAT]
    flat = np.unique(sort_over_ranks(comm, np.concatenate([NO_NODES, *flat]))[0])
    node, direction = node_and_direction(label)
    mine, _ = look_up(comm, flat, [], node)
    twice = repeated_key(comm, label[~mine])
    if twice is not None:
        raise Unnamed(SEVERAL.format(label_name(twice)))
    _require_order(comm, path, label[~mine])
    if not comm.allreduce(int(mine.sum())):
        return label, mesh.nodes, (0, True)
    # a made node begins where the direction does not ascend; its number is above all others
    again = repeated_key(comm, label[mine])
    ends = comm.allgather(label[-1:].tolist())
    before = np.array([-1, *(end for of_rank in ends[: comm.rank] for end in of_rank)][-1:] + label.tolist())[:-1]
    first = mine & ((before // STRIDE != node) | (label <= before))  # rows with which a node of a solid begins
    behind = comm.allreduce(max(int(labels.max(initial=0)) for labels in (mesh.nodes.label, node)), op=MPI.MAX) + 1
    number = behind + (comm.exscan(int(first.sum())) or 0) + np.cumsum(first) - 1
    # places of the made nodes, through the thickness as far as it is known
    there, places = look_up(comm, mesh.nodes.label, list(mesh.nodes.position.T), node[first])
    if not all(comm.allgather(bool(there.all()))):
        raise Unnamed("nodes of shells and beams have no coordinates")
    off = _offsets(comm, mesh, node[first], number[first])
    if off is None and again is None:  # one node of each, for which its own name serves
        _require_order(comm, path, label)
        return label, mesh.nodes, (0, True)
    if off is None and not comm.allreduce(int((~mine).sum())):  # no row would have a place that is known
        raise Unnamed(SEVERAL.format(label_name(again)))
    label = label.copy()
    label[mine] = label_of(number[mine], direction[mine])
    made = number[first], np.array(places).T.reshape(-1, 3) + (0.0 if off is None else off), number[first]
    columns = zip((mesh.nodes.label, mesh.nodes.position, mesh.nodes.place), made, strict=True)
    count = comm.allreduce(len(np.unique(sort_over_ranks(comm, node[mine])[0])))
    return label, NodeTable(*map(np.concatenate, columns)), (count, off is not None)


def _offsets(comm, mesh, node, number) -> np.ndarray | None:
    """Return how far (k, 3) made nodes are from the node that they are made of; None where it is not known of all.

    A shell of second order becomes solids with three nodes at corners and two at edges, one of first order with two,
    along the mean normal. A *Tie takes the nodes of its first surface out, which is below (S1, SNEG) or above (S2,
    SPOS).
    `node` (k,), `number` (k,): those of this rank, ascending. Collective.
    """
    # one row for each node of each element: normal, thickness, and what tells how many nodes CalculiX made
    thickness, tied = _thickness(comm, mesh), _tied(comm, mesh)
    table = [np.zeros((0, 8))]
    kinds = [kind for kind in mesh.elements if kind in CORNERS]
    for kind in kinds:
        table.append(_of_elements(comm, mesh, kind, thickness[kind], tied[kind]))
    if any(len(beams) for beams in comm.allgather([kind for kind in mesh.elements if kind in ("line", "line3")])):
        return None
    # rows of one node meet: normals are added, the others must agree
    whole = np.concatenate(table)
    label, *columns = sort_over_ranks(comm, whole[:, 0].astype(np.int64), list(whole[:, 1:].T))
    label, start = np.unique(label, return_index=True)
    x, y, z, most, least, level, below, above = columns = [
        reduce.reduceat(column, start) if len(start) else column for reduce, column in zip(
            (np.add, np.add, np.add, np.maximum, np.minimum, np.maximum, np.maximum, np.maximum),
            [*columns[:4], columns[3], *columns[4:]], strict=True)]  # fmt: skip
    # each made node is the k-th of those of its node
    every, place, count = _counted(comm, node, number)
    there, values = look_up(comm, label, columns, every)
    normal = np.array(values[:3]).T
    size = np.linalg.norm(normal, axis=1)
    good = there & (values[3] == values[4]) & (values[3] > 0) & (size > 0)
    # its level through the thickness, by the number of levels that this kind of node has
    shift = np.zeros(len(every))
    for kind, levels in enumerate(LEVELS.values()):
        for low in (0, 1):
            for high in (0, 1):
                left = np.array(levels[low : len(levels) - high])
                mine = (values[5] == kind) & (values[6] == low) & (values[7] == high)
                good &= ~mine | (count == len(left))
                mine &= good
                shift[mine] = left[place[mine]]
    if not all(comm.allgather(bool(good.all()))):
        return None
    return (shift * values[3] / 2)[:, None] * normal / np.maximum(size, 1e-300)[:, None]


def _counted(comm, node, number):
    """Return the nodes, the place of each made node among those of its node, and how many these are, as given."""
    keys, made = sort_over_ranks(comm, node, [number])
    label, start, back, count = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    place = np.arange(len(keys)) - start[back]
    there, (place, count) = look_up(comm, made, [place, count[back]], number)
    return node, place, count


def _thickness(comm, mesh) -> dict:
    """Return the thickness of each shell of this rank by kind; 0 where a section does not tell a plain one."""
    of_elements = {kind: np.zeros(len(nodes)) for kind, nodes in mesh.elements.items()}
    for section in mesh.sections:
        if section.keyword != "shellsection":
            continue
        plain = set(section.parameters) <= {"elset", "material", "orientation"}
        lines = abaqus_input.data_lines(section) if plain else []
        value = (abaqus_input.number_of(lines[0][0]) if lines else None) or 0.0
        numbers = mesh.element_sets.get(section.parameters.get("elset", "").lower(), np.zeros(0, np.int64))
        for kind, thickness in of_elements.items():
            thickness[look_up(comm, numbers, [], mesh.keys[kind])[0]] = value
    return of_elements


def _tied(comm, mesh) -> dict:
    """Return by kind whether the nodes of each element of this rank (elements, 2) are tied below and above."""
    tied = {kind: np.zeros((len(nodes), 2), bool) for kind, nodes in mesh.elements.items()}
    surfaces, slaves = {}, []
    for section in mesh.sections:
        if section.keyword == "surface":
            surfaces[section.parameters.get("name", "").lower()] = abaqus_input.data_lines(section)
        elif section.keyword == "tie":
            slaves += [line[0].lower() for line in abaqus_input.data_lines(section)]
    # lines of the surfaces that are taken out: an element or a set of elements, and a side
    for words in sum((surfaces.get(slave, []) for slave in slaves), []):
        side = SIDES.get(words[1].upper()) if len(words) > 1 else None
        if side is None:
            continue
        name = words[0].lower()
        numbers = mesh.element_sets.get(name, np.zeros(0, np.int64))
        if name.isdecimal():
            numbers = np.array([int(name)][: comm.rank == 0], np.int64)
        for kind, flags in tied.items():
            flags[look_up(comm, numbers, [], mesh.keys[kind])[0], int(side > 0)] = True
    return tied


def _of_elements(comm, mesh, kind, thickness, tied) -> np.ndarray:
    """Return rows (k, 8) of node, normal, thickness, place in LEVELS, and whether tied below and above, of a kind."""
    nodes, corners = mesh.elements[kind], CORNERS[kind]
    _, places = look_up(comm, mesh.nodes.label, list(mesh.nodes.position.T), nodes.ravel())
    xyz = np.array(places).T.reshape(*nodes.shape, 3)
    first = xyz[:, 2] - xyz[:, 0]
    second = xyz[:, 3] - xyz[:, 1] if corners == 4 else xyz[:, 1] - xyz[:, 0]
    normal = np.cross(first, second) if corners == 4 else np.cross(second, first)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    linear = nodes.shape[1] == corners
    level = np.where(np.arange(nodes.shape[1]) < corners, 2 if linear else 0, 1)
    count = nodes.shape[1]
    return np.column_stack([
        nodes.ravel(), np.repeat(normal, count, axis=0), np.repeat(thickness, count), np.tile(level, len(nodes)),
        np.repeat(tied, count, axis=0),
    ])  # fmt: skip


def _mesh_of_results(comm, parts, files, label):
    """Return the mesh of results. Raises Unnamed where rows may be others than those of their nodes."""
    results = calculix_frd.read(files["results"], comm) if "results" in files else None
    if results is None:
        stem = Path(files["dofs"]).stem
        raise Unnamed(
            f"found no input file ({stem}.inp) beside it, which would give coordinates"
            + (f", and {files['results']} has no nodes" if "results" in files else f", nor results ({stem}.frd)")
        )
    flat = sorted(set(results.elements) & set(FLAT))
    if flat:
        raise Unnamed(f"elements of {files['results']} ({', '.join(flat)}) become solids in CalculiX")
    node, _ = node_and_direction(label)
    there, _ = look_up(comm, results.nodes.label, [], node)
    if other := sum(comm.allgather(np.unique(node[~there])[:1].tolist()), []):
        raise Unnamed(
            f"the node {min(other)} is not in {files['results']}, as those of rigid bodies and couplings, whose "
            "directions only the input file tells"
        )
    parts.warnings += results.notes(files["results"])
    parts.warnings.append(
        f"{files['results']}: nodes and elements are those of this file; supports and sets of nodes only the input "
        "file tells"
    )
    return abaqus_input.Mesh(results.nodes, results.elements, {}, [], {})


def _turning(comm, files, mesh, label, last):
    """Return the REF node by ROT node of rigid bodies; Unnamed where rows are of other nodes of CalculiX, which are
    numbered behind the `last` one of the input file."""
    turning, without = rigid_bodies(mesh.sections)
    node, _ = node_and_direction(label)
    there, _ = look_up(comm, mesh.nodes.label, [], node)
    made = sorted(set().union(*comm.allgather(set(np.unique(node[~there])[: len(without) + 1].tolist()))))
    if made and made[0] < last:  # those that CalculiX makes are numbered after all others
        raise InputError(
            f"{files['dofs']}: found rows of the node {made[0]}, which is not in {files['input']}; expected the input "
            "file of this run"
        )
    if len(made) == len(set(without)) == len(without):
        # CalculiX makes a ROT node for each *Rigid Body without one and each *Kinematic, with ascending numbers
        turning |= dict(zip(made, without, strict=True))
    elif made:
        raise Unnamed(
            f"the node {made[0]} is not in {files['input']}, since CalculiX made it (give *Rigid Body a REF NODE and a "
            "ROT NODE of the input file, and each *Coupling with *Kinematic a REF NODE of its own)"
        )
    return turning


def _inside_elements(comm, label, count):
    """Return which rows are incompatible modes of `count` elements: nine each, or none of all rows. Collective."""
    # CalculiX makes three nodes for each such element, behind all others, when the whole file is read
    node, _ = node_and_direction(label)
    inside = node > comm.allreduce(int(node.max(initial=0)), op=MPI.MAX) - 3 * count
    return inside if comm.allreduce(int(np.count_nonzero(inside))) == 9 * count else np.zeros(len(label), bool)


def _as_scalars(comm, label, inside, nodes):
    """Return labels in which rows `inside` of elements are scalars with own numbers, and nodes with these."""
    node, direction = node_and_direction(label[inside])
    number = 3 * node + direction
    first = comm.allreduce(int(number.min(initial=np.iinfo(np.int64).max)), op=MPI.MIN)
    behind = comm.allreduce(int(nodes.label.max(initial=0)), op=MPI.MAX) + 1
    number = behind + number - first
    label = label.copy()
    label[inside] = label_of(number, np.full(len(number), SCALAR))
    places = np.zeros((len(number), 3))
    columns = (nodes.label, number), (nodes.position, places), (nodes.place, number)
    return label, NodeTable(*map(np.concatenate, columns))


def _require_order(comm, path, label):
    """Raise InputError unless rows ascend by node and direction, as CalculiX numbers them."""
    ends = [pair for pair in comm.allgather((label[0], label[-1]) if len(label) else None) if pair]
    with agreed(comm):
        wrong = np.flatnonzero(np.diff(label) <= 0)
        if wrong.size:
            falling = label_name(label[wrong[0] + 1]), label_name(label[wrong[0]])
        else:
            falling = next(((label_name(b[0]), label_name(a[1])) for a, b in pairwise(ends) if b[0] <= a[1]), None)
        if falling:
            raise damaged_file(path, f"{falling[0]} below {falling[1]}, expected lines that ascend")


def _check_steps(path, sections):
    """Raise InputError unless the file has a step, and its end, of matrices in global directions."""
    keywords = [section.keyword for section in sections]
    if not 1 <= keywords.count("step") == keywords.count("endstep"):
        raise InputError(
            f"{path}: found {keywords.count('step')} *Step and {keywords.count('endstep')} *End Step, expected the "
            "step that wrote the matrices, and its end; the file is cut off or damaged"
        )
    for section in sections:
        if section.keyword == "frequency" and section.parameters.get("global", "").lower() == "no":
            raise section.refusal("found *Frequency with GLOBAL=NO, expected matrices in global directions")


def _element_types(sections):
    return {section.parameters.get("type", "").upper() for section in sections if section.keyword == "element"}


def rigid_bodies(sections) -> tuple[dict[int, int], list[int]]:
    """Return the REF node by ROT node, whose displacements are its rotations, and REF nodes without one, in order."""
    followers, without, coupled = {}, [], ""
    for section in sections:
        if section.keyword == "coupling":
            coupled = section.parameters.get("refnode", "")
        elif section.keyword == "kinematic" and coupled.isdecimal() and section.has_data():
            without.append(int(coupled))
        if section.keyword == "rigidbody":
            turned, reference = (section.parameters.get(key, "") for key in ("rotnode", "refnode"))
            if turned.isdecimal() and reference.isdecimal():
                followers[int(turned)] = int(reference)
            elif reference.isdecimal():
                without.append(int(reference))
    return followers, without


def with_rotations(label, turning: dict[int, int]):
    """Return labels in which 1 to 3 of a ROT node are 4 to 6 of its REF node."""
    node, direction = node_and_direction(label)
    turned = np.array(sorted(turning), np.int64)
    mine = np.isin(node, turned) & (direction < 3)
    reference = np.array([turning[key] for key in turned.tolist()], np.int64)
    label = label.copy()
    label[mine] = label_of(reference[np.searchsorted(turned, node[mine])], direction[mine] + 3)
    return label


def held_by_boundary(comm, mesh, turning, rows):
    """Return labels of dofs of *Boundary without row, and the number of nodes held along other axes. Collective."""
    sets = {name.lower(): nodes for name, nodes in mesh.sets.items()}
    with agreed(comm):
        labels, inclined = [NO_NODES], [NO_NODES]
        for section in mesh.sections:
            if section.keyword == "boundary" and not MOVED & set(section.parameters):
                labels += _supports(comm, section, sets)
            elif section.keyword == "transform":
                inclined.append(sets.get(section.parameters.get("nset", "").lower(), NO_NODES))
        label = with_rotations(np.unique(np.concatenate(labels)), turning)
    _, label = sort_over_ranks(comm, node_and_direction(label)[0], [label])  # all of a node on one rank
    label = np.unique(label)
    node, direction = node_and_direction(label)
    with_row, _ = look_up(comm, rows, [], label)
    there, _ = look_up(comm, mesh.nodes.label, [], node)
    local, _ = look_up(comm, np.unique(sort_over_ranks(comm, np.concatenate(inclined))[0]), [], node)
    # with axes of its own a node is held in global ones where all of them are; rotations have only rigid bodies
    _, place, count = np.unique(node, return_inverse=True, return_counts=True)
    turned = (direction > 2) & ~np.isin(node, list(turning.values()))
    inclined = there & ~turned & local & (count[place] < 3)
    return label[there & ~with_row & ~turned & ~inclined], comm.allreduce(len(np.unique(node[inclined])))


def _supports(comm, section, sets):
    """Return labels of the dofs that a *Boundary names: of its lines of nodes on this rank, and its part of sets."""
    labels_held = []
    for piece in pieces(section.path, comm, section.start, section.stop):
        text = EMPTY_FIELD.sub(b",0", NAMED_LINE.sub(b"", piece.text))
        values, counts, lines = ragged(Piece(piece.path, text, piece.start), expected="node, directions, value")
        piece.require((counts > 1) & (counts < 5), lines, "node, first direction, last direction, value")
        table = padded(values, counts, 4)
        node = labels(piece, table[:, 0], lines)
        first, last = (whole(piece, table[:, k], lines, "the direction", 0, 11) for k in (1, 2))
        labels_held += _labels(node, first, np.where(last == 0, first, last))
    for piece in pieces(section.path, MPI.COMM_SELF, section.start, section.stop):
        for name, rest in NAMED_LINE.findall(piece.text):
            name = name.decode("latin-1").strip().strip('"')
            fields = [word.strip() for word in rest.decode("latin-1").split(",")]
            if name.lower() not in sets or not all(word.isdecimal() for word in fields[:2] if word):
                raise section.refusal(
                    f"found *Boundary with '{name}, {', '.join(fields)}', expected a set of nodes, first and last "
                    "direction"
                )
            first = int(fields[0] or 0)
            last = int(fields[1]) if len(fields) > 1 and fields[1] else first
            nodes = sets[name.lower()]
            labels_held += _labels(nodes, np.full(len(nodes), first), np.full(len(nodes), last))
    return labels_held


def _labels(node, first, last):
    """Return labels of the directions (1 to 6) from first to last of each node."""
    inside = [(direction, (first <= direction) & (direction <= last)) for direction in range(1, 7)]
    return [label_of(node[mask], np.full(np.count_nonzero(mask), direction - 1)) for direction, mask in inside]


class MatrixStorage(Reader):
    """Reader of the files that SOLVER=MATRIXSTORAGE writes."""

    name = "CalculiX .sti, .mas or .dof"
    told_by = "lines of an upper triangle, or of node.direction"
    companions = "x.sti, x.mas, x.dof (.gz), x.inp"
    begins, read_model = staticmethod(begins), staticmethod(read_parts)
