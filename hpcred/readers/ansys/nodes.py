"""Find the nodes, nodal axes and elements that belong to a matrix file of ANSYS, in a file beside it."""

from dataclasses import dataclass, field
from os.path import commonprefix
from pathlib import Path

import numpy as np

from ...fe.materials import ElementProperties
from ...files.text import first_bytes
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, require_once
from ..nodal_systems import rotation_of_angles, turn_to_global
from ..nodes.table import NodeTable
from . import cdb as ansys_cdb
from . import lists as ansys_lists
from . import rst as ansys_rst

SUFFIXES = (".cdb", ".rst")  # in this order: an archive has elements too
WORKBENCH = "ds.dat"  # the input file that Workbench writes into the folder of the solution
SAME_PLACE = 1e-6  # of the largest coordinate


@dataclass
class FoundNodes:
    """The nodes of a file, the numbers (turned,) and axes (turned, 3, 3) of those with axes of their own; elements,
    their properties, remarks, and node numbers by name of the set."""

    file: str
    nodes: NodeTable
    turned: np.ndarray
    rotation: np.ndarray
    elements: dict
    properties: ElementProperties | None = None
    remarks: list[str] = field(default_factory=list)
    sets: dict[str, np.ndarray] = field(default_factory=dict)

    def refuse_turned(self):
        """Raise InputError where nodes have axes of their own, for matrices whose rows have no names."""
        if len(self.turned):
            raise InputError(
                f"{self.file}: found axes of its own at node {self.turned[0]}, which the rows of the matrices may "
                "follow; name the rows by --dofs, so that they can be turned to global x, y, z"
            )


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a result file, a list of nodes or an archive of ANSYS."""
    return ansys_rst.begins(start) or ansys_lists.begins_nodes(start) or ansys_cdb.begins(start)


def find_nodes(path, comm, lists=False) -> FoundNodes | None:
    """Return the nodes of the .cdb or .rst file beside a file, else of ds.dat, with `lists` also of a list; or None.

    Elements and sets that a .rst file does not have are taken from ds.dat beside it. Collective.
    """
    file = decided(comm, _file_beside, Path(path), lists)
    if file is None:
        return None
    nodes, workbench = read_nodes(file, comm), Path(path).with_name(WORKBENCH)
    if Path(file).suffix.lower() == ".rst" and decided(comm, _is_archive, workbench):
        _take_mesh(comm, nodes, workbench)
    return nodes


def _take_mesh(comm, known, workbench):
    """Put elements and sets of the input file of Workbench into nodes of a result file, where it is of the same model.
    """
    try:
        archive = ansys_cdb.read(workbench, comm, turned=True)
    except InputError as error:
        known.remarks.append(f"{error}; elements and sets are not taken from this file")
        return
    nodes = known.nodes
    there, places = look_up(comm, nodes.label, list(nodes.position.T), archive.label)
    scale = max(comm.allgather(float(np.abs(archive.position).max(initial=0.0))))
    same = there.all() and bool((np.abs(np.array(places).T - archive.position) <= SAME_PLACE * scale).all())
    if not all(comm.allgather(same)):
        known.remarks.append(f"{workbench}: its nodes are not those of {known.file}, and nothing is taken from it")
        return
    known.elements, known.properties, known.sets = archive.elements, archive.properties, archive.sets
    known.remarks += [*archive.remarks, f"{workbench}: elements and named selections are those of this file"]


def _is_archive(path) -> bool:
    return path.is_file() and ansys_cdb.begins(_start(path))


def read_nodes(file, comm) -> FoundNodes:
    """Return the nodes of a result file, an archive or a list of nodes. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(file)
    mesh = {}, None, [], {}
    if ansys_rst.begins(start):
        label, position, angles = ansys_rst.read(file, comm)
    elif ansys_lists.begins_nodes(start):
        label, position, angles = ansys_lists.read_nodes(file, comm)
    else:
        label, position, angles, *mesh = ansys_cdb.read(file, comm)
    turned = (angles != 0).any(axis=1)
    label_turned, rotation = label[turned], rotation_of_angles(angles[turned])
    require_once(comm, label, lambda twice: f"{file}: found the node {twice} more than once, expected one place a node")
    return FoundNodes(str(file), NodeTable.ascending(comm, label, position), label_turned, rotation, *mesh)


def give_mesh(parts, nodes: FoundNodes):
    """Put nodes, elements and sets into the parts of a model."""
    parts.nodes = nodes.nodes
    parts.take_mesh(nodes, nodes.remarks)


def turn_found(comm, parts, nodes: FoundNodes):
    """Turn the matrices of the parts from the nodes' own axes to the global ones, with a word about it. Collective."""
    count = turn_to_global(comm, parts, nodes.turned, nodes.rotation, nodes.file)
    if count:
        parts.warnings.append(
            f"{nodes.file}: {count} nodes have axes of their own; the matrices were turned to global x, y, z"
        )


def _file_beside(path, lists):
    """Return the file with the nodes, or None."""
    for suffix in SUFFIXES:
        same = path.with_suffix(suffix)
        if same.is_file():
            return str(same)
    others = [file for file in sorted(path.parent.iterdir()) if file.suffix.lower() in SUFFIXES and file.is_file()]
    if not others and _is_archive(path.with_name(WORKBENCH)):
        return str(path.with_name(WORKBENCH))
    if not others and lists:
        others = [file for file in sorted(path.parent.iterdir()) if file != path and file.is_file()
                  and ansys_lists.begins_nodes(_start(file))]  # fmt: skip
    alike = [len(commonprefix([path.name, file.name])) for file in others]
    if len(others) > 1 and alike.count(max(alike)) == 1:  # rotor_K.txt, rotor_nodes.txt, plate_nodes.txt
        others = [others[alike.index(max(alike))]]
    if len(others) > 1:
        names = ", ".join(file.name for file in others)
        raise InputError(
            f"{path}: found several files with nodes beside it ({names}), expected one, or {path.stem}.rst or "
            f"{path.stem}.cdb; keep the files of one model in a folder of their own"
        )
    return str(others[0]) if others else None


def _start(path):
    """Return the first bytes of a file; nothing where it cannot be read."""
    try:
        return first_bytes(path)
    except InputError:
        return b""
