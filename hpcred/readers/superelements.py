"""Take a superelement of another program as a reduced model: its matrices as they are, its nodes as interfaces.

Its files are those of models (see model_source). Rows at nodes stand first, six directions of each node that has all;
modal coordinates and other rows without a place follow. Such files are small, and are read by rank 0.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.sparse import coo_array

from ..body.node_shapes import NodeShape
from ..fe.dofs import DIRECTIONS, SCALAR
from ..files.result_file import Result
from ..linalg.pencil import modes_of
from ..model.damping import GivenDamping
from ..model.frames import Buckens, NoFrame
from ..model.interfaces.motion import rigid_rows
from ..model.interfaces.nodes import NAME, InterfaceNode
from ..model.units import SI, Units, rotational, units_of
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..parallel.progress import Timing, memory_mb
from ..reduction.result.record import Record
from ..reduction.result.reduced_model import ReducedModel
from ..settings.source import Source
from .assembly import number_rows
from .entries import asymmetry, node_and_direction, require_sane
from .model_source import read_export
from .parts import common_size, labels_in_order
from .source_parts import read_source

MOST = 3000  # rows: more is a model, whose dense matrices would fill the memory
SYMMETRIC = 1e-8  # ||A - A^T|| / ||A||, for the digits that files have
FREE = 1e-7  # of |K| |R|: no force of rigid-body motion, but for the digits of files
STILL = 1e-8  # of the largest: negative eigenvalues up to it are those of few digits


@dataclass(frozen=True, eq=False)
class _Rows:
    """Node, direction, position (n, 3) and whether there is a place, of each row."""

    node: np.ndarray
    direction: np.ndarray
    position: np.ndarray
    placed: np.ndarray

    def __getitem__(self, order):
        return _Rows(*(getattr(self, key)[order] for key in ("node", "direction", "position", "placed")))


def read_superelement(source: Source | str | Path, comm, *, variables=None, units: str = "SI") -> Result:
    """Read a superelement as a result in interface coordinates. Collective.

    Parameters
    ----------
    source : Source or path
        Matrix files, or the main file of an export, see load_export.
    comm : MPI.Comm
    variables : dict of str, optional
        Names of the matrices by K, M, D, for files of several superelements, such as {"K": "KAA:2", "M": "MAA:2"}.
    units : str
        Those of the files (see units_of).

    Returns
    -------
    Result
        In SI. Inputs and outputs are all directions of all nodes. `reduced.interfaces` are the nodes with six
        directions; it has no accuracy, since files do not say what another program left out.

    Raises
    ------
    InputError
        For files that cannot be read, rows of which none is at a node, and matrices that are not symmetric.
    """
    made, begun = None, perf_counter()
    with agreed(comm):
        if comm.rank == 0:
            made = _read(source, variables, units_of(units))
    reduced, record, nodes = comm.bcast(made)
    seconds = comm.bcast(perf_counter() - begun)
    timing = Timing(seconds={"read": seconds}, elapsed=seconds, memory_mb_per_rank=tuple(comm.allgather(memory_mb())))
    record = Record.without_reduction(reduced, ranks=comm.size, timing=timing, **record)
    return Result(None, replace(reduced, record=record), nodes=nodes)


def _read(source, variables, units: Units):
    comm, path = MPI.COMM_SELF, Path(source.K if isinstance(source, Source) else source)
    # matrices with numbered rows, and what these are
    parts = read_source(source, comm) if isinstance(source, Source) else read_export(path, comm, variables)
    number_rows(comm, parts)
    size = common_size(parts)
    if size > MOST:
        raise InputError(f"{path}: found {size} rows, expected a superelement of at most {MOST}; convert it as a "
                         "model, and reduce it")  # fmt: skip
    matrices = {}
    for key, entries in parts.matrices.items():
        require_sane(entries.values, f"{parts.files[key]}: found", "real")
        if not asymmetry(comm, entries) <= SYMMETRIC:
            raise InputError(f"{parts.files[key]}: found a matrix {key} that is not symmetric, expected both triangles "
                             "of a symmetric one, as a superelement has")  # fmt: skip
        matrix = coo_array((entries.values, (entries.rows, entries.columns)), shape=(size, size)).toarray()
        matrices[key] = (matrix + matrix.T) / 2
    rows = _rows(path, parts, size, units)
    # nodes with six directions, other nodes, and what has no place
    numbers, inverse = np.unique(rows.node, return_inverse=True)
    whole = rows.placed & np.isin(rows.node, numbers[np.bincount(inverse, rows.placed) == 6])
    order = np.lexsort((rows.direction, rows.node, ~rows.placed, ~whole))
    rows = rows[order]
    # in SI: q = g q_SI, with K in energy and M in mass length^2; modal coordinates keep the mass that they have
    g = np.where(rotational(rows.direction), 1.0, units.length)
    g[~rows.placed] = units.length * np.sqrt(units.mass)
    scale = {"K": units.energy, "M": units.mass * units.length**2, "D": units.mass * units.length**2 / units.time}
    K, M, D = (scale[key] / np.outer(g, g) * matrices.get(key, np.zeros((size, size)))[np.ix_(order, order)]
               for key in "KMD")  # fmt: skip
    return _result(path, K, M, D, rows, parts, units)


def _rows(path, parts, size, units) -> _Rows:
    """Return what the rows are, positions in m. Raises InputError."""
    if parts.row_labels is None and parts.nodes is None:
        raise InputError(f"{path}: its rows are not named, and a superelement without names has no interfaces; give "
                         "its nodes by the file of the run beside it, or by --nodes and --dofs")  # fmt: skip
    label, row = parts.row_labels or labels_in_order(MPI.COMM_SELF, parts.nodes, size, str(path))
    node, direction = node_and_direction(label[np.argsort(row)])
    at_node = direction < SCALAR
    if not at_node.any():
        raise InputError(f"{path}: found {size} rows, none of them a direction of a node, expected nodes to join it "
                         "by; retain some")  # fmt: skip
    known = parts.nodes.label if parts.nodes is not None else np.zeros(0, np.int64)
    position, unknown = np.zeros((size, 3)), at_node & ~np.isin(node, known)
    if unknown.any():
        raise InputError(f"{path}: the node {node[unknown][0]}, which has rows, has no coordinates; put the input "
                         "file of the run beside it, or give them by --nodes")  # fmt: skip
    order = np.argsort(known)
    place = order[np.searchsorted(known[order], node[at_node])]
    position[at_node] = parts.nodes.position[place] * units.length
    return _Rows(node, direction, position, at_node)


def _result(path, K, M, D, rows, parts, units):
    """Return the reduced model, what its record knows, and the shapes of its nodes."""
    count, warnings = int(rows.placed.sum()), [*dict.fromkeys(parts.warnings)]
    alone = {int(nodes[0]): name for name, nodes in parts.sets.items() if len(nodes) == 1 and NAME.fullmatch(name)}
    names = {node: alone.get(node, str(node)) for node in dict.fromkeys(rows.node[:count].tolist())}
    targets = tuple(f"{names[node]}:{DIRECTIONS[d]}" for node, d in zip(
        rows.node[:count].tolist(), rows.direction[:count].tolist(), strict=True))  # fmt: skip
    nodes, interfaces = [], []
    for node, name in names.items():
        mine = np.flatnonzero(rows.placed & (rows.node == node))
        motion = np.zeros((6, len(K)))
        motion[rows.direction[mine], mine] = 1.0
        place, rotates = rows.position[mine[0]], bool((rows.direction[mine] >= 3).any())
        nodes.append(NodeShape(node, place, motion[:3], motion[3:], rotates, name if name != str(node) else ""))
        if len(mine) == 6:
            interfaces.append(InterfaceNode(name, node, tuple(place.tolist())))
    # rigid-body motions, which modal coordinates of fixed interfaces do not take part in
    R, free = np.zeros((len(K), 6)), 0
    resultants = rigid_rows(rows.direction[:count], rows.position[:count])
    R[:count] = rigid_rows(rows.direction[:count], rows.position[:count] - rows.position[:count].mean(axis=0))
    if (np.abs(K @ R).max(axis=0) <= FREE * (np.abs(K) @ np.abs(R)).max(axis=0)).all():
        free = int(np.linalg.matrix_rank(R))  # fewer than six where the rows know only some, as of a beam in a plane
    try:
        squares = modes_of(K, M)[0]
    except np.linalg.LinAlgError:  # neither stiffness nor mass in some direction, as of a spring
        squares = np.zeros(len(K))
    squares[:free] = 0.0
    if (squares < -STILL * squares.max(initial=0.0)).any() or np.linalg.eigvalsh(M)[0] < -STILL * np.abs(M).max():
        warnings.append(f"{path}: K or M has negative eigenvalues: the superelement is unstable, or its file damaged")
    B = np.eye(len(K))[:, :count]
    reduced = ReducedModel(
        M=M, D=D, K=K, B=B, C=B.T.copy(), frequencies=np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi),
        input_names=targets, output_names=targets, interfaces=tuple(interfaces), resultants=resultants,
    )  # fmt: skip
    # a free one in interface coordinates is one of the Buckens frame, as a reduction has it
    in_frame = bool(free == 6 and interfaces and np.linalg.eigvalsh(R.T @ M @ R)[0] > 0)
    record = {
        "model": str(path), "size": len(K), "nonzeros": int(np.count_nonzero(K)), "damping": GivenDamping(),
        "rigid_body_modes": free if in_frame else 0, "frame": Buckens() if in_frame else NoFrame(),
        "coordinates": "interface" if interfaces else "modal", "units": "" if units == SI else units.words,
        "warnings": tuple(warnings),
    }  # fmt: skip
    return reduced, record, nodes
