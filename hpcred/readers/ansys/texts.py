"""Read the matrices that ANSYS wrote as texts, given one of them, with their rows and the nodes beside them.

HBMAT writes Harwell-Boeing files, whose title tells which matrix it is, and a .mapping file of the rows. *EXPORT of
APDL Math writes Matrix Market files, whose names tell which matrices they are; the rows come from a .mapping file of
HBMAT, or, if no dof is held, from a vector of node numbers.
"""

import re
from pathlib import Path

from ...files.system_errors import reading_from
from ...files.text import first_bytes
from ...parallel.decisions import decided
from ...parallel.failures import InputError
from ..base import Reader
from ..matrices import harwell_boeing, matrix_market
from ..parts import Parts
from . import lists as ansys_lists
from .nodes import find_nodes, give_mesh, turn_found

TITLE = re.compile(rb"^(stiffness|mass|damping) matrix from ANSYS", re.IGNORECASE)
KEYS = {b"stiffness": "K", b"mass": "M", b"damping": "D"}
NAMES = {"K": re.compile(r"stif|(?<![a-z])k(?![a-z])|mat_?k|kmat", re.IGNORECASE),
         "M": re.compile(r"mass|(?<![a-z])m(?![a-z])|mat_?m(?!at)|mmat", re.IGNORECASE),
         "D": re.compile(r"damp|(?<![a-z])[cd](?![a-z])|mat_?[cd](?![a-z])|[cd]mat", re.IGNORECASE)}  # fmt: skip
COORDINATE = re.compile(rb"^%%matrixmarket +matrix +coordinate +real", re.IGNORECASE)


def read_parts(path, comm):
    """Return the matrices of a set, told by one of them. Collective. Raises InputError."""
    path = Path(path)
    files, mapping, vector = decided(comm, _set_of, path)
    read = harwell_boeing.read if _is_hbmat(first_bytes(path)) else matrix_market.read
    parts = Parts({key: read(file, comm) for key, file in files.items()}, files)
    # all matrices of the set have the same rows
    shapes = {matrix.shape for matrix in parts.matrices.values()}
    if len(shapes) > 1:
        raise InputError(f"{path}: found matrices of different sizes, {_listed(files)}; keep those of one run together")
    size = parts.matrices["K"].shape[0]
    # the node and direction of each row, of HBMAT's mapping or of a written vector
    if mapping or vector:
        parts.files["rows"] = mapping or vector
        if mapping:
            parts.row_labels = ansys_lists.read_mapping(mapping, comm)
        else:
            parts.row_labels = ansys_lists.read_vector(vector, comm, size)
        total = comm.allreduce(len(parts.row_labels[0]))
        if total != size:
            raise InputError(f"{mapping or vector}: found {total} rows, expected {size} as {files['K']} has")
    # the mesh beside it; matrices in nodal axes are turned into global ones
    nodes = find_nodes(path, comm, lists=True) if parts.row_labels is not None else None
    if parts.row_labels is None:
        parts.warnings.append(
            f"{path}: found no file of the rows beside it, so the model has no nodes; write it by HBMAT,...,YES,YES"
        )
    elif nodes is None:
        parts.warnings.append(
            f"{path}: found no file of nodes beside it (.cdb, .rst or a list of nodes), so the model has none; write "
            "them by CDWRITE,DB"
        )
    else:
        give_mesh(parts, nodes)
        parts.files["nodes"] = nodes.file
        turn_found(comm, parts, nodes)
    parts.as_written = nodes is None or not comm.allreduce(len(nodes.turned))
    parts.warnings.append(f"{path}: taken together were {_listed(parts.files)}")
    return parts


def _is_hbmat(start):
    return harwell_boeing.begins(start) and bool(TITLE.match(harwell_boeing.title(start)))


def _is_mmf(start):
    return bool(COORDINATE.match(start)) and ansys_lists.CREATOR in start


def _set_of(path):
    """Return the files K, M and perhaps D, and those of the rows: a mapping, or a vector of nodes, or None."""
    start = first_bytes(path)
    kind = _is_hbmat if _is_hbmat(start) else _is_mmf
    # what lies in the folder, by first bytes and name
    matrices, mappings, vectors = {}, [], []
    for beside in sorted(path.parent.iterdir()):
        if not beside.is_file():
            continue
        try:
            head = first_bytes(beside)
        except InputError:
            continue
        if kind(head):
            matrices.setdefault(_key(beside, head), []).append(beside)
        elif ansys_lists.begins_mapping(head):
            mappings.append(beside)
        elif ansys_lists.begins_vector(head):
            vectors.append(beside)
    # the named file is the one of its kind, of the others there must be one
    own = _key(path, start)
    if own is None:
        raise InputError(
            f"{path}: found a matrix whose name does not say which it is, expected a name with stiff or mass; or give "
            "the files by -K and -M"
        )
    matrices[own] = [path]
    files = {}
    for key, word in (("K", "stiffness"), ("M", "mass"), ("D", "damping")):
        some = matrices.get(key, [])
        if len(some) > 1 or (not some and key != "D"):
            names = " and ".join(beside.name for beside in some) or "none"
            raise InputError(
                f"{path}: found {names} as {word} matrix beside it, expected one; give the files by -K and -M, and the "
                "rows by --dofs"
            )
        if some:
            files[key] = str(some[0])
    # equal files of the rows are no question; one with the matrix's name is meant
    stems = {Path(file).stem for file in files.values()}
    same = [beside for beside in mappings if beside.stem in stems] or mappings
    with reading_from(path):
        texts = {beside.read_bytes() for beside in same} if len(same) > 1 else set()
    if len(texts) > 1 or (not same and len(vectors) > 1):
        names = ", ".join(beside.name for beside in same or vectors)
        raise InputError(f"{path}: found several files of the rows beside it ({names}), expected one, or equal ones")
    return files, str(same[0]) if same else None, str(vectors[0]) if vectors and not same else None


def _key(path, start):
    """Return K, M or D by the title of HBMAT, else by the name of the file; None where that is not clear."""
    match = TITLE.match(harwell_boeing.title(start))
    if match:
        return KEYS[match[1].lower()]
    keys = [key for key, pattern in NAMES.items() if pattern.search(path.stem)]
    return keys[0] if len(keys) == 1 else None


def _listed(files):
    return ", ".join(f"{key} {Path(file).name}" for key, file in files.items())


class Texts(Reader):
    """Matrices of ANSYS as texts."""

    name = "matrices of ANSYS' HBMAT or *EXPORT,...,MMF"
    told_by = "its title, or a Matrix Market header with a mapping beside it"
    companions = "the other matrices, mapping, nodes"
    read_model = staticmethod(read_parts)

    def begins(self, start):
        return _is_hbmat(start) or _is_mmf(start)
