"""Small dense second methods for the tests, and command lines that must be refused."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse

from hpcred.body.geometric_stiffness import OF_BODY, GeometricStiffness
from hpcred.cli.main import run
from hpcred.examples.linkage import Rod, beam_element, linkage
from hpcred.examples.solid import solid
from hpcred.fe.dofs import DIRECTIONS, Dofs
from hpcred.files.model_file import write_model
from hpcred.linalg.blocks import create_block, local_rows
from hpcred.model.interfaces.nodes import Interface, InterfaceNode, Nodes
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.parallel.shares import row_range
from hpcred.reduction.result.reduced_model import ReducedModel
from hpcred.writers.base import ExportSource

LINKAGE_JOB = """
model = "model.h5"
output = "result.h5"
inputs = [[20, "z"], [1, "x"]]
[frame]
kind = "buckens"
[damping]
kind = "rayleigh"
alpha = 2.0
beta = 1e-5
"""  # without a basis
MODES_JOB = LINKAGE_JOB + """[[basis]]
kind = "modes"
index = [7, 8, 9, 10, 11, 12]
"""
CHORD_JOB = """
model = "model.h5"
inputs = [[20, "z"]]
[frame]
kind = "chord"
nodes = [1, 7, 14]
axes = "yxz"
[[basis]]
kind = "krylov"
frequency = 100.0
order = 1
"""
SIMULATION = """
body = "result.h5"
end = 0.05
steps = 20
observe = [10]
[[force]]
kind = "sine"
node = 20
amplitude = [0.0, 0.0, -10.0]
frequency = 5.0
[[force]]
kind = "table"
node = 1
times = [0.0, 0.01]
values = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
[[constraint]]
node = 1
[[constraint]]
node = 7
directions = ["x", "z"]
[[constraint]]
node = 14
directions = ["z"]
"""
PLACES = np.array([[0.0, 0.0, 5.0], [1.0, 0.5, 5.0], [0.0, 2.0, 5.0]])  # of the nodes of a truss


def few_on_ranks(values, count=1):
    """Values of a parameter (tuples of several), of which only the first `count` are quick on several ranks."""
    rest = [pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.costly)
            for value in values[count:]]  # fmt: skip
    return [*values[:count], *rest]


def reduce_linkage(folder, job=MODES_JOB):
    """Make model.h5, job.toml and the results of the job of the linkage in a folder."""
    with linkage() as model:
        write_model(folder / "model.h5", model)
    (folder / "job.toml").write_text(job)
    assert run(["reduce", str(folder / "job.toml")]) == 0


def to_dense(mat):
    """A distributed sparse matrix as numpy array on all ranks."""
    indptr, indices, values = mat.getValuesCSR()
    local = np.zeros((len(indptr) - 1, mat.getSize()[1]))
    local[np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)), indices] = values.real
    return np.concatenate(mat.comm.tompi4py().allgather(local))


def columns_of(mat):
    """A distributed dense matrix as numpy array on all ranks."""
    return np.concatenate(mat.comm.tompi4py().allgather(mat.getDenseArray().real.copy()))


def gather(block):
    """The active columns of a block on all ranks."""
    with local_rows(block) as rows:
        mine = rows.real.copy()
    return np.concatenate(block.comm.tompi4py().allgather(mine))


def block_from(mat, array):
    """A block with the layout of mat from columns that all ranks have."""
    block = create_block(mat, array.shape[1])
    first, last = mat.getOwnershipRange()
    with local_rows(block) as rows:
        rows[...] = array[first:last]
    return block


def dense_model(model):
    """K, M, B as numpy arrays."""
    return to_dense(model.K), to_dense(model.M), columns_of(model.B)


def moments(K, M, B, C, shift, count):
    """C ((K + shift M)^-1 M)^j (K + shift M)^-1 B for j = 0 .. count - 1: derivatives in s^2 but for j!."""
    A = K + shift * M
    X = np.linalg.solve(A, B)
    result = []
    for _ in range(count):
        result.append(C @ X)
        X = np.linalg.solve(A, M @ X)
    return result


def second_order_moments(K, M, D, B, C, s, count):
    """Taylor coefficients of C (s^2 M + s D + K)^-1 B at s, by the bare recurrence."""
    A = s * s * M + s * D + K
    R = [np.linalg.solve(A, B.astype(complex))]
    R.append(-np.linalg.solve(A, (2 * s * M + D) @ R[0]))
    while len(R) < count:
        R.append(-np.linalg.solve(A, (2 * s * M + D) @ R[-1] + M @ R[-2]))
    return [C @ r for r in R[:count]]


def close(a, b):
    """Largest difference relative to the largest entry."""
    return np.abs(a - b).max() / np.abs(a).max()


def bar(comm, length, elements, **rod):
    """A free straight beam along x with nodes 1 .. elements + 1, six dofs a node."""
    nodes = np.linspace([0, 0, 0], [length, 0, 0], elements + 1)
    size = 6 * len(nodes)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        part = slice(6 * e, 6 * e + 12)
        stiffness, mass = beam_element(nodes[e], nodes[e + 1], Rod(**rod))
        K[part, part] += stiffness
        M[part, part] += mass
    first, last = row_range(comm, size, 6)
    mine = np.arange(first, last)
    indptr = size * np.arange(last - first + 1)
    values = {"K": K[first:last].ravel(), "M": M[first:last].ravel()}
    dofs = Dofs(mine // 6 + 1, (mine % 6).astype(np.int8), nodes[mine // 6])
    model = SecondOrderModel.from_csr(comm, size, indptr, np.tile(np.arange(size), last - first), values, dofs=dofs)
    return model.with_inputs([(1, "x")])


def refused(capsys, *arguments):
    """The one sentence with which a command line is refused; nothing may have been written."""
    before = sorted(Path().iterdir())
    capsys.readouterr()
    status = run(list(arguments))
    message = capsys.readouterr().err
    assert status == 2, message
    assert message.startswith("hpcred: error: ") and message.count("\n") == 1, message
    assert "Traceback" not in message
    assert sorted(Path().iterdir()) == before
    return message


def said(capsys, *arguments):
    """What a command line prints, in words with one blank between them."""
    capsys.readouterr()
    assert run(list(arguments)) == 0
    return " ".join(capsys.readouterr().out.split())


def write_matrices(change):
    """K.mtx and M.mtx of a chain of four masses, after a change of the arrays."""
    mats = {"K": np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1), "M": np.eye(4)}
    mats.update(change(**mats) or {})
    for key, mat in mats.items():
        scipy.io.mmwrite(f"{key}.mtx", scipy.sparse.coo_matrix(mat), symmetry="general")


def damped(solid, unsymmetric=False):
    """The solid with Rayleigh damping, two discrete dampers, and perhaps a gyroscopic pair; D as numpy too."""
    K, M, B = dense_model(solid)
    D = 10.0 * M + 1e-5 * K
    D[5, 5] += 3e3
    D[40, 40] += 1e4
    if unsymmetric:
        D[5, 40] += 2e3
        D[40, 5] -= 2e3
    model = SecondOrderModel.from_scipy(K, M, D, solid.comm)
    model = with_columns(model, "input", B)
    return model, K, M, D, B


def with_columns(model, key, array):
    """The model with columns that all ranks have as its inputs or outputs (key: input, output)."""
    mine = slice(model.first_row, model.first_row + model.local_rows)
    return getattr(model, f"with_{key}_columns")(array[mine], [f"{key} {i}" for i in range(array.shape[1])])


def names(folder, comm):
    """What is in a folder while no rank writes."""
    comm.Barrier()
    found = sorted(folder.iterdir())
    comm.Barrier()
    return found


def face(name, x, **more):
    """An interface at the nodes of the block of `block_with_ends` whose first coordinate is x."""
    nodes = Nodes(box=((x - 1e-6, -1.0, -1.0), (x + 1e-6, 1.0, 1.0)))
    return Interface(name=name, nodes=nodes, **more)


def block_with_ends(comm, kind="averaging", clamped=False, cells=(6, 2, 3)):
    """A block of 10 mm cells with interfaces at its ends (the right one where clamped), and all their inputs."""
    length = 0.01 * cells[0]
    with solid(cells, clamped=clamped, comm=comm) as model:
        ends = [face("right", length, kind=kind)] if clamped else [
            face("left", 0.0, kind=kind), face("right", length, kind=kind)]  # fmt: skip
        with model.with_interfaces(ends) as marked:
            return marked.with_inputs([(item.name, "all") for item in ends])


def rigid_motions_at(points):
    """The motions (6k, 6) of nodes at points for unit translations and rotations about the origin."""
    return np.concatenate([
        np.block([[np.eye(3), np.cross(np.eye(3), point).T], [np.zeros((3, 3)), np.eye(3)]]) for point in points
    ])  # fmt: skip


def interface_model(modes=5, held=False, damping=0.0, loss_factor=0.0):
    """A bent beam of three straight parts in space by Craig-Bampton with its two ends as interface nodes, in numpy.

    `held`: one node between is clamped. `damping`: that of a full random D.
    """
    corners = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0.1], [0.5, 0.2, 0.4]]) + [0.1, -0.2, 0.05]
    parts = [np.linspace(corners[k], corners[k + 1], 4)[:-1] for k in range(3)]
    nodes = np.concatenate([*parts, corners[3:]])
    size = 6 * len(nodes)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for e in range(len(nodes) - 1):
        part = slice(6 * e, 6 * e + 12)
        stiffness, mass = beam_element(nodes[e], nodes[e + 1], Rod())
        K[part, part] += stiffness
        M[part, part] += mass
    ends = np.r_[0:6, size - 6 : size]
    inner = np.setdiff1d(np.arange(size), [*ends, *(range(24, 30) if held else ())])
    values, shapes = scipy.linalg.eigh(K[np.ix_(inner, inner)], M[np.ix_(inner, inner)])
    T = np.zeros((size, 12 + modes))
    T[ends, :12] = np.eye(12)
    T[np.ix_(inner, range(12))] = -np.linalg.solve(K[np.ix_(inner, inner)], K[np.ix_(inner, ends)])
    T[inner, 12:] = shapes[:, :modes]
    Kr, Mr = T.T @ K @ T, T.T @ M @ T
    Kr[:12, 12:], Kr[12:, :12], Kr[12:, 12:], Mr[12:, 12:] = 0, 0, np.diag(values[:modes]), np.eye(modes)
    Kr, Mr = (Kr + Kr.T) / 2, (Mr + Mr.T) / 2
    count = len(Kr)
    mix = np.random.default_rng(3).normal(size=(count, count))
    D = damping * np.linalg.cholesky(Mr) @ (mix @ mix.T) @ np.linalg.cholesky(Mr).T
    frequencies = np.sqrt(np.abs(scipy.linalg.eigh(Kr, Mr, eigvals_only=True))) / (2 * np.pi)
    interfaces = (InterfaceNode("left", 101, tuple(nodes[0])), InterfaceNode("right", 205, tuple(nodes[-1])))
    return ReducedModel(Mr, (D + D.T) / 2, Kr, np.eye(count)[:, :3], np.eye(count)[6:8], frequencies, loss_factor,
                        ("left x", "left y", "left z"), ("right x", "right y"), interfaces)  # fmt: skip


def exported(writer, path, item):
    """Write a body, a reduced model or shapes by a Writer; its remarks or names of shapes."""
    source = ExportSource(SimpleNamespace(path=path, reduced=item, shapes=lambda: nullcontext(item)), Path(path).stem)
    source.body = item
    source.options = writer.options and writer.options()
    return writer().write(path, source)


def truss(comm, directions, mass=3.0, places=PLACES, left_out=()):
    """Point masses joined by rods, with some of the directions; `left_out`: (node, direction) pairs that are held."""
    count = len(places)
    K = np.zeros((3 * count, 3 * count))
    for a in range(count):
        for b in range(a):
            along = (places[a] - places[b]) * [d in directions for d in range(3)]
            pull = np.zeros(3 * count)
            pull[3 * a : 3 * a + 3], pull[3 * b : 3 * b + 3] = along, -along
            K += 1e5 * np.outer(pull, pull)
    kept = [i for i in range(3 * count) if i % 3 in directions and (i // 3 + 1, i % 3) not in left_out]
    node, direction = np.array(kept) // 3 + 1, (np.array(kept) % 3).astype(np.int8)
    dofs = Dofs(node, direction, places[node - 1])
    M = mass * np.eye(len(kept))
    return SecondOrderModel.from_scipy(K[np.ix_(kept, kept)], M, comm=comm, dofs=dofs, name="truss")


def made_up_stiffness(body, size=1.0):
    """The body with a geometric stiffness of random numbers, for all states."""
    states = (*OF_BODY, *(f"{node.label}:{direction}" for node in body.nodes for direction in DIRECTIONS[:6]))
    matrices = np.random.default_rng(8).normal(scale=size, size=(len(states), *[body.reduced.size] * 2))
    stiffness = GeometricStiffness(states, matrices + matrices.transpose(0, 2, 1), body.floating_frame.origin)
    return replace(body, geometric_stiffness=stiffness)
