"""Read K, M and D without held dofs from ANSYS' assembled matrices (.full), with the nodes of a file beside it.

Each rank reads a share of the columns. The file has rows of held dofs (1 on the diagonal of K, all of M), and rows of
dofs that constraint equations and couplings have eliminated (decoupled, 1 on the diagonal); both are left out. A
distributed run writes a file for each process, body0.full, body1.full, ..., whose contributions are added up.
"""

import re
from dataclasses import dataclass

import numpy as np

from ...files.text import LARGEST_LABEL, first_bytes
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, number_over_ranks, require_once, sort_over_ranks
from ...parallel.shares import row_range
from ..base import Reader
from ..entries import Entries, joined, label_name, label_of, node_and_direction, require_sane
from ..parts import Parts
from . import records as ansys_records
from .nodes import find_nodes, give_mesh, turn_found
from .records import BLOCKS, INTEGER, RecordFile, columns

FILE = 4  # the number of .full files
KINDS = {"K": "stiffness", "M": "mass", "D": "damping"}
STANDARD_END = ansys_records.STANDARD + 3  # where the header of the kind begins
STATIC, BUCKLING, MODAL = 0, 1, 2
ANALYSES = {0: "static", 1: "buckling", 2: "modal", 3: "harmonic", 4: "transient", 7: "substructure", 8: "spectrum"}
NAMES = {
    7: "AX", 8: "AY", 9: "AZ", 10: "VX", 11: "VY", 12: "VZ", 13: "WARP", 19: "PRES", 20: "TEMP", 21: "VOLT", 22: "MAG",
    23: "ENKE", 24: "ENDS", 25: "EMF", 26: "CURR",
}  # fmt: skip
LINES = {MODAL: "run ANTYPE,MODAL with WRFULL,1", STATIC: "run ANTYPE,STATIC with WRFULL,1 and EQSLV,SPARSE",
         BUCKLING: "run ANTYPE,BUCKLE with WRFULL,1"}  # fmt: skip


@dataclass
class Header:
    """The header of a .full file; positions in words."""

    equations: int
    active: int
    nodes: int
    directions: int
    unequal: int
    dofs: int
    equations_of_constraint: int
    constraints: int
    matrices: dict[str, tuple[int, int]]  # place and number of entries
    loads: tuple[int, int, int]  # places of the real and imaginary load vector, and of factors of the rows
    place: int  # of the records below the header
    whole: tuple[int, int] | None  # equations and nodes of all parts, if this is one


def read_parts(path, comm, analysis=MODAL) -> Parts:
    """Return K, M and D of a .full file, with the nodes of the .rst or .cdb file beside it. Collective.

    Of a buckling analysis M is the stiffness of the stress, whose sign is not documented. Raises InputError.
    """
    with agreed(comm):
        files, base = _files(path, analysis)
    # the matrices; of dofs that are removed, held ones are zero and those that follow others are not
    found = [_read(comm, *item) for item in files]
    matrices, label, row, removed, following = found[0] if len(found) == 1 else _joined(comm, files, found)
    follows, _ = look_up(comm, np.unique(sort_over_ranks(comm, following)[0]), [], removed)
    parts = Parts(matrices, dict.fromkeys(matrices, str(path)), row_labels=(label, row), removed=removed[~follows])
    if len(files) > 1:
        parts.warnings.append(f"{path}: joined the parts {', '.join(file.path.name for file, _ in files)}")
    label = np.concatenate([label, removed])
    # the nodes stand in another file of the run
    found = find_nodes(base, comm)
    if found is None:
        parts.warnings.append(
            f"{path}: found neither .cdb nor .rst file beside it, nor ds.dat of Workbench, so the model has no nodes; "
            f"put one there, or write the nodes by CDWRITE,DB,{base.stem},cdb"
        )
    else:
        _require_places(comm, path, found, label)
        give_mesh(parts, found)
        parts.files["nodes"] = found.file
        parts.warnings.append(f"{path}: nodes taken from {found.file}")
        turn_found(comm, parts, found)
    # what follows others moves, so pictures lack it
    if count := comm.allreduce(int(follows.sum())):
        parts.warnings.append(
            f"{path}: {count} dofs that follow others by constraint equations or couplings were removed; K and M "
            "contain their part, but their own motion is not in the model: pictures and stresses leave it out"
        )
    return parts


def _files(path, analysis):
    """Return the file, or the parts of its distributed run, with headers; and the name of the whole."""
    # a whole file stands alone
    file = RecordFile(path, FILE)
    files = [(file, header_of(file, analysis))]
    if files[0][1].whole is None:
        return files, file.path
    # parts of a distributed run are numbered from 0 behind the name of the job
    number = r"(0|[1-9]\d{0,5})"
    name = re.fullmatch(f"(.*?){number}", file.path.stem)
    if name is None:
        raise InputError(
            f"{path}: found the part of one process of a distributed run, expected a name with its number, such as "
            f"{file.path.stem}0.full, beside those of the others; or join the parts by COMBINE,FULL in /AUX2"
        )
    beside = {int(match[1]): item for item in file.path.parent.iterdir() if item.suffix == file.path.suffix
              and (match := re.fullmatch(re.escape(name[1]) + number, item.stem))}  # fmt: skip
    missing = next((k for k in range(max(beside)) if k not in beside), None)
    if missing is not None or len(beside) < 2:
        raise InputError(
            f"{path}: found the part of one process of a distributed run, expected those of all, but there is no "
            f"{name[1]}{max(beside) + 1 if missing is None else missing}{file.path.suffix} beside it; put all parts "
            "into one folder, or join them by COMBINE,FULL in /AUX2"
        )
    # all must be of one run
    files = [RecordFile(beside[k], FILE) for k in sorted(beside)]
    files = [(item, header_of(item, analysis)) for item in files]
    for item, header in files:
        if header.whole != files[0][1].whole or set(header.matrices) != set(files[0][1].matrices):
            raise InputError(
                f"{item.path}: found a file of another run than {files[0][0].path.name} has, expected the parts of one "
                "distributed run only; keep each run in a folder of its own"
            )
    return files, file.path.with_name(f"{name[1]}{file.path.suffix}")


def _read(comm, file, header):
    """Return matrices, labels and numbers of rows, labels of removed ones, and of those that follow others."""
    label, held, slaves = rows_of(comm, file, header)
    removed = np.union1d(held, slaves)
    matrices = {}
    for key, (place, terms) in header.matrices.items():
        matrices[key] = _matrix(comm, file, header, key, place, terms, removed, slaves)
    row = (comm.exscan(len(label)) or 0) + np.arange(len(label))
    kept, follows = ~np.isin(row, removed), np.isin(row, np.setdiff1d(slaves, held))
    row = row[kept] - np.searchsorted(removed, row[kept])
    return matrices, label[kept], row, label[~kept], label[follows]


def _joined(comm, files, shares):
    """Read the sum of the parts of a distributed run, like _read. Collective. Raises InputError."""
    # rows of all parts by node and direction; those on the border of two parts are the same row
    names, place = number_over_ranks(comm, np.concatenate([label for _, label, *_ in shares]))
    size = comm.allreduce(len(names))
    gone, _ = number_over_ranks(comm, np.concatenate([removed for *_, removed, _ in shares]))
    both, _ = look_up(comm, gone, [], names)
    nodes, _ = number_over_ranks(comm, np.unique(node_and_direction(np.concatenate([names, gone]))[0]))
    total = size + comm.allreduce(len(gone)), comm.allreduce(len(nodes))
    with agreed(comm):
        first, header = files[0]
        if both.any():
            raise InputError(
                f"{first.path}: found {label_name(names[both][0])} removed in one part of the distributed run, but not "
                "in another, expected the same in all; join the parts by COMBINE,FULL in /AUX2"
            )
        if total != header.whole:
            raise InputError(
                f"{first.path}: found {total[0]} rows of {total[1]} nodes in {len(files)} parts of a distributed run, "
                f"expected {header.whole[0]} of {header.whole[1]}; put all parts into one folder"
            )
    # the terms of each part in the numbers of the whole; where parts meet they are added
    numbers = np.split(place, np.cumsum([len(label) for _, label, *_ in shares])[:-1])
    matrices = {}
    for key in header.matrices:
        triplets = []
        for (of_part, _, row, *_), number in zip(shares, numbers, strict=True):
            share = of_part.pop(key)
            asked = np.unique(np.concatenate([share.rows, share.columns]))
            _, (new,) = look_up(comm, row, [number], asked)
            triplets.append((*(new[np.searchsorted(asked, end)] for end in (share.rows, share.columns)), share.values))
        matrices[key] = Entries((size, size), *joined(triplets, (np.int64, np.int64, float)))
    # the rows of the whole, and those that were removed or follow others
    row = (comm.exscan(len(names)) or 0) + np.arange(len(names))
    return matrices, names, row, gone, np.concatenate([following for *_, following in shares])


def _require_places(comm, path, mesh, label):
    """Raise InputError where a node of the matrices is not in the file of nodes, also where all its dofs are held."""
    node = np.unique(node_and_direction(label)[0])
    there, _ = look_up(comm, mesh.nodes.label, [], node)
    with agreed(comm):
        if not there.all():
            raise InputError(
                f"{path}: found rows of the node {node[~there][0]}, which is not in {mesh.file}; one of the files is "
                "damaged, or of another model"
            )


def header_of(file: RecordFile, analysis=MODAL) -> Header:
    """Return the header of a file of an analysis, with M unless it is a static one. Raises InputError."""
    length, _ = file.frame(STANDARD_END)
    head, place = file.integers(STANDARD_END, length, "the header")
    # what kind of file it is
    if len(head) < 40:
        raise file.damaged(STANDARD_END, f"a header of {len(head)} words")
    if head[0] == FILE:
        raise InputError(
            f"{file.path}: found the frontal solver's form of the file, expected that of the sparse solver; add "
            "EQSLV,SPARSE or take a release after 5.7"
        )
    if head[0] != -FILE:
        raise file.damaged(STANDARD_END, f"the file number {head[0]} in the header")

    # lengths and places have 64 bits, in two words that need not be neighbours
    def wide(low, high):
        return (int(head[high]) << 32) | (int(head[low]) & 0xFFFFFFFF)

    end, kan = wide(22, 23), int(head[4])
    # a copy that was cut off is told by the place of the end
    if end and (end > file.size or (end < file.size and file.words(end, 1)[0] != -1)):
        raise file.damaged(end, f"no end of the file, though the header says so ({file.size} words),")
    if end and end < file.size and not any(-(-(end + 1) // block) * block == file.size for block in BLOCKS):
        raise file.damaged(end, f"the end of the file, but {file.size} words")
    # a distributed run writes a part for each process; only parts without equations between them are whole
    is_part = len(head) > 62 and bool(head[62])
    if is_part and (len(head) <= 67 or head[67]):
        raise InputError(
            f"{file.path}: found the part of one process of a distributed run with constraint equations between parts "
            "(or no word on them), expected none; join the parts by COMBINE,FULL in /AUX2, or run on one process (-smp)"
        )
    # what the analysis was for
    if kan != analysis:
        analysis_found = f"a {ANALYSES.get(kan, f'kind {kan} of')} analysis"
        if kan == 1:
            analysis_found = "a buckling analysis, whose second matrix is stress stiffening and no mass"
        wanted = f"those of a {ANALYSES[analysis]} analysis; {LINES[analysis]}"
        raise InputError(f"{file.path}: found {analysis_found}, expected {wanted}")
    if head[13]:
        raise InputError(
            f"{file.path}: found unsymmetric matrices, expected symmetric ones; use the symmetric solver "
            "(MODOPT,LANB), without friction, rotating frames or fluids"
        )
    # where the matrices begin, and how many terms each has
    places = {"K": wide(18, 19), "M": wide(26, 27), "D": wide(28, 29)}
    terms = {"K": wide(8, 9) or int(head[12]), "M": wide(33, 21), "D": wide(34, 39)}
    for key in "K" if analysis == STATIC else "KM":
        if not places[key]:
            raise InputError(f"{file.path}: found no {KINDS[key]} matrix, expected one; {LINES[analysis]}")
    matrices = {key: (places[key], terms[key]) for key in "KMD" if places[key]}
    header = Header(
        equations=int(head[1]), active=int(head[2]), nodes=int(head[6]), directions=int(head[7]), unequal=int(head[32]),
        dofs=wide(35, 36), equations_of_constraint=int(head[20]), constraints=wide(30, 31), matrices=matrices,
        loads=(wide(37, 38), wide(24, 25), wide(59, 60) if len(head) > 60 else 0),
        place=place, whole=(int(head[61]), int(head[65])) if is_part else None,
    )  # fmt: skip
    if not 0 < header.active <= header.equations or not 0 < header.directions <= 32 or header.nodes < 1:
        raise file.damaged(STANDARD_END, "impossible numbers of equations, nodes or dofs in the header")
    if header.unequal != header.nodes:
        raise InputError(
            f"{file.path}: found {header.unequal} nodes in the matrices but {header.nodes} in the table of nodes; "
            "Lagrange multipliers (contact, joints, mixed u-P elements) cannot be read; use penalty contact or MPCs"
        )
    return header


def rows_of(comm, file: RecordFile, header: Header) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return labels of the rows of this rank, and all rows (from 0) that are held, and that follow others."""
    with agreed(comm):
        kinds, after = file.integers(header.place, header.directions, "the list of dofs")
        if file.count(after) != header.nodes:
            raise file.damaged(after, f"a table of {file.count(after)} nodes, expected {header.nodes},")
        first, last = row_range(comm, header.nodes)
        # nodes and their numbers of dofs: each rank has a share of the nodes
        node = file.part(after, first, last)
        if len(node) and not 1 <= node.min() <= node.max() <= LARGEST_LABEL:
            raise file.damaged(after, f"the node number {node.min()}")
        count = file.part(header.dofs, first, last).astype(np.int64)
        possible = ((count >= 0) & (count <= len(kinds))).all()
        if file.count(header.dofs) != header.nodes or not possible:
            raise file.damaged(header.dofs, "no table of dofs a node")
        mine = int(count.sum())
    total, low = comm.allreduce(mine), comm.exscan(mine) or 0
    with agreed(comm):
        # behind them the direction of each dof, negative where it is held, and a table that agrees
        if total != header.equations:
            raise file.damaged(header.dofs, f"{total} dofs of nodes, but {header.equations} equations,")
        place = header.dofs + file.frame(header.dofs)[0] + 3
        held_place = place + file.frame(place)[0] + 3
        if file.count(place) != total or file.count(held_place) != total:
            raise file.damaged(place, "tables of dofs that are not one number an equation")
        kind = file.part(place, low, low + mine)
        number = file.part(held_place, low, low + mine)
        if mine and not 1 <= np.abs(kind).min() <= np.abs(kind).max() <= len(kinds):
            raise file.damaged(place, "a dof that the list of dofs does not have")
        if ((kind < 0) != (number > 0)).any():
            raise file.damaged(place, "two tables that do not agree on which dofs are held")
        # displacements and rotations are rows; temperatures and warping have no place in a body
        direction = kinds[np.abs(kind) - 1]
        other = (kind > 0) & ((direction < 1) | (direction > 6))
        if other.any():
            dof = int(direction[other][0])
            raise InputError(
                f"{file.path}: found the dof {NAMES.get(dof, f'number {dof}')} at node "
                f"{np.repeat(node, count)[other][0]}, expected displacements and rotations (UX, UY, UZ, ROTX, ROTY, "
                "ROTZ) only; take structural elements"
            )
        label = label_of(np.repeat(node, count), np.minimum(direction - 1, 7))
        slaves = _slaves(file, header) if comm.rank == 0 else None
    # the header counts the same rows as the tables
    held = np.concatenate(comm.allgather(low + np.flatnonzero(kind < 0)))
    slaves = comm.bcast(slaves)
    require_once(comm, label, lambda twice: f"{file.path}: found two rows of {label_name(twice)}; the file is damaged")
    if total - len(np.union1d(held, slaves)) != header.active:
        raise InputError(
            f"{file.path}: found {total} rows, {len(held)} of them held and {len(slaves)} that follow others, but "
            f"{header.active} active ones in the header; the file is damaged"
        )
    return label, held, slaves


def _slaves(file, header):
    """Return rows (from 0) of the dofs that constraint equations and couplings have eliminated."""
    if not header.equations_of_constraint:
        return np.zeros(0, np.int64)
    if not header.constraints:
        raise file.damaged(STANDARD_END, "constraint equations without their place")
    rows, _ = file.integers(header.constraints, header.equations_of_constraint, "a list of constraint equations")
    if rows.min() < 1 or rows.max() > header.equations or len(np.unique(rows)) != len(rows):
        raise file.damaged(header.constraints, "a constraint equation for no row or twice for one")
    return np.sort(rows.astype(np.int64)) - 1


def _matrix(comm, file, header, key, place, terms, removed, slaves):
    """Return both triangles of a matrix, rows numbered (from 0) without the removed ones."""
    size = header.equations - len(removed)
    with agreed(comm):
        is_diagonal = not file.frame(place)[1] & INTEGER
    if is_diagonal:
        return _diagonal(comm, file, header, key, place, removed, size)
    with agreed(comm):
        share = columns(file, place, header.equations, terms, comm.rank, comm.size)
        blocks, chain = _kept(file, share, key, header, removed, slaves)
    _require_all(comm, file, header, key, place, terms, chain)
    return _mirrored(comm, blocks, size)


def _mirrored(comm, blocks, size):
    """Return entries of both triangles from pieces of one and of the diagonal, which are emptied on the way."""
    with agreed(comm):
        total = sum(2 * len(i) + len(k) for i, _, _, k, _ in blocks)
        entries = Entries((size, size), np.empty(total, np.int32), np.empty(total, np.int32), np.empty(total))
        at = 0
        while blocks:
            i, j, values, k, diagonal = blocks.pop()
            for rows, columns_, numbers in ((i, j, values), (j, i, values), (k, k, diagonal)):
                here = slice(at, at + len(rows))
                entries.rows[here], entries.columns[here], entries.values[here] = rows, columns_, numbers
                at += len(rows)
    return entries


def _kept(file, pieces, key, header, removed, slaves):
    """Return entries below the diagonal and on it, in rows without the removed; and what the pieces cover."""
    blocks, chain = [], []
    for block in pieces:
        rows, column = block.rows, block.column
        low, high = min(column.min(), rows.min(initial=1)), max(column.max(), rows.max(initial=1))
        if low < 1 or high > header.equations:
            wrong = high if low > 0 else low
            raise file.damaged(block.begin, f"the row {wrong} of {header.equations} in {KINDS[key]}")
        head = (np.cumsum(block.counts) - block.counts)[block.counts > 0]
        descends = rows[1:] <= rows[:-1]
        descends[head[1:] - 1] = False  # from one column to the next
        if descends.any() or (np.diff(column) != 1).any() or (rows[head] <= column[block.counts > 0]).any():
            raise file.damaged(block.begin, "columns whose rows do not ascend below the diagonal, which comes last,")
        for values in (block.values, block.diagonal):
            require_sane(values, f"{file.path}: found, near word {block.begin},", KINDS[key])
        chain.append((block.begin, block.end, int(column[0]), int(column[-1]), len(rows) + len(column)))
        i, j, k = rows - 1, np.repeat(column - 1, block.counts), column - 1
        if len(removed):
            _require_decoupled(file, i, j, block.values, slaves, key)
            stays, stays_too = ~(_among(i, removed) | _among(j, removed)), ~_among(k, removed)
            i, j, k = (places - np.searchsorted(removed, places) for places in (i[stays], j[stays], k[stays_too]))
            blocks.append((i.astype(np.int32), j.astype(np.int32), block.values[stays], k.astype(np.int32),
                           block.diagonal[stays_too]))  # fmt: skip
        else:
            blocks.append((i, j, block.values, k, block.diagonal))
    return blocks, chain


def _require_decoupled(file, i, j, values, slaves, key):
    """Raise InputError where a row that follows others still has entries beside the diagonal."""
    if not len(slaves):
        return
    coupled = (_among(i, slaves) | _among(j, slaves)) & (values != 0)
    if coupled.any():
        raise InputError(
            f"{file.path}: found a {KINDS[key]} matrix to which constraint equations were not applied yet (row "
            f"{i[coupled][0] + 1}), expected their dofs without coupling; replace constraint equations and couplings "
            "by elements, or write the matrices with HBMAT"
        )


def _among(rows, some):
    """Return which rows are among some, which ascend."""
    return some[np.minimum(np.searchsorted(some, rows), len(some) - 1)] == rows


def _require_all(comm, file, header, key, place, terms, chain):
    """Raise InputError unless the pieces of all ranks are the whole matrix, one after the other."""
    pieces = sum(comm.allgather(chain), [])
    position, column, total = place, 0, 0
    for begin, end, first, last, count in pieces:
        if begin != position or first != column + 1:
            raise file.damaged(position, f"the column {first} of {KINDS[key]}, expected {column + 1},")
        position, column, total = end, last, total + count
    if column != header.equations or total != terms:
        raise InputError(
            f"{file.path}: found {column} columns with {total} entries in the {KINDS[key]} matrix, the header says "
            f"{header.equations} and {terms}; the file is damaged"
        )


def _diagonal(comm, file, header, key, place, removed, size):
    """Return a lumped matrix, written as one record of its diagonal."""
    with agreed(comm):
        if file.count(place) != header.equations:
            raise file.damaged(place, f"a diagonal of {file.count(place)} numbers, expected {header.equations},")
        low, high = row_range(comm, header.equations)
        values = file.part(place, low, high).astype(float)
        require_sane(values, f"{file.path}: found, near word {place},", KINDS[key])
        row = np.arange(low, high)
        kept = ~np.isin(row, removed)
        row = row[kept] - np.searchsorted(removed, row[kept])
    return Entries((size, size), row, row.copy(), values[kept])


def has_stress_stiffness(path) -> bool:
    """Test whether a file is one of a buckling analysis. Raises InputError for a damaged one."""
    start = first_bytes(path)
    if not ansys_records.begins(start) or ansys_records.file_number(start) != FILE:
        return False
    file = RecordFile(path, FILE)
    length, _ = file.frame(STANDARD_END)
    return file.integers(STANDARD_END, length, "the header")[0][4:5].tolist() == [BUCKLING]


class Full(Reader):
    """ANSYS' .full files."""

    name, told_by = "ANSYS' .full file", "the header of its first record"
    companions = ".cdb, .rst or a list with nodes"
    begins, read_model = staticmethod(ansys_records.begins), staticmethod(read_parts)
