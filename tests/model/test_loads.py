"""Load vectors against closed forms: shares of single faces, resultants, moments; and each refusal."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
from helpers import block_with_ends, columns_of, dense_model, few_on_ranks, gather, to_dense

import hpcred
from hpcred import Dofs, InputError, Nodes, SecondOrderModel
from hpcred.fe import Material
from hpcred.fe.elements import FACES
from hpcred.loads import Centrifugal, Gravity, LineLoad, MovingLoad, Pressure, Temperature, Traction
from hpcred.model.loads.columns import loads_of, resultants
from hpcred.model.rigid_body.modes import rigid_motions

pytestmark = pytest.mark.mpi

END = Nodes(box=((0.03, -1.0, -1.0), (0.03, 1.0, 1.0)))
# nodes of one element of each kind, in the order of VTK, of edges of 1 m
CORNERS = {
    "tetra": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "wedge": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)],
    "hexahedron": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    "pyramid": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)],
    "quad": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], "triangle": [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
}  # fmt: skip
MIDDLES = {
    "tetra10": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "wedge15": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "hexahedron20": [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
    "quad8": [(0, 1), (1, 2), (2, 3), (3, 0)], "triangle6": [(0, 1), (1, 2), (2, 0)],
}  # fmt: skip
SHARES = {3: [1 / 3] * 3, 4: [1 / 4] * 4, 6: [0] * 3 + [1 / 3] * 3, 8: [-1 / 12] * 4 + [1 / 3] * 4}  # of a flat face


def points_of(kind):
    corners = np.array(CORNERS.get(kind) or CORNERS[kind.rstrip("0123456789")], dtype=float)
    return np.concatenate([corners, *(corners[list(pair)].mean(axis=0)[None] for pair in MIDDLES.get(kind, ()))])


def model_of(comm, points, elements, sets=None, held=None):
    """A model with three dofs a node, numbered from 1, with matrices of no meaning; elements on the last rank."""
    count = len(points)
    dofs = Dofs(np.repeat(np.arange(1, count + 1), 3), np.tile(np.arange(3), count), np.repeat(points, 3, axis=0))
    free = np.ones(3 * count, bool)
    if held is not None:
        free[np.isin(dofs.node, held)] = False
    there = comm.rank == comm.size - 1
    mine = {kind: np.array(part if there else np.zeros((0, np.shape(part)[1])), int) for kind, part in elements.items()}
    eye = scipy.sparse.eye(int(free.sum()))
    return SecondOrderModel.from_scipy(
        eye, eye, comm=comm, dofs=dofs.take(free), elements=mine,
        held=dofs.take(~free if there else np.zeros(0, int)) if held is not None else None,
        sets={name: np.array(part if there else [], int) for name, part in (sets or {}).items()},
    )  # fmt: skip


def loaded(model, load):
    """Its only new column (n, 3) by node, and its LoadColumn."""
    with model.with_loads([load]) as found:
        return columns_of(found.B)[:, -1].reshape(-1, 3), found.loads[-1]


@pytest.mark.mpi(build="real")
@pytest.mark.parametrize("kind", few_on_ranks([*MIDDLES, *CORNERS], 3))
def test_shares_of_flat_faces(comm, kind):
    """Each face of one element: pressure pushes inwards, by a third of the corners of a triangle, the middles of a
    curved one, -1/12 of corners and 1/3 of middles of a curved quadrilateral; both directions of numbering."""
    points = points_of(kind)
    middle = points.mean(axis=0)
    for turned in (False, True):
        order = np.arange(len(points))
        if turned and kind in ("hexahedron", "tetra"):  # an element that is numbered inside out
            order = order[[3, 2, 1, 0, 7, 6, 5, 4]] if kind == "hexahedron" else order[[0, 2, 1, 3]]
        for face in FACES[kind]:
            nodes = order[list(face)]
            a, b, c = points[nodes[:3]]
            n = np.cross(b - a, c - a) / (2.0 if len(face) in (3, 6) else 1.0)
            shell = kind.startswith(("quad", "triangle"))
            push = -n if not shell and n @ (a - middle) > 0 else n
            with model_of(comm, points, {kind: order[None] + 1}) as model:
                b, sums = loaded(model, Pressure(name="p", on=tuple((nodes + 1).tolist()), value=3.0))
                t, _ = loaded(model, Traction(name="t", on=tuple((nodes + 1).tolist()), value=(1.0, 0.0, -2.0)))
            shares = np.zeros(len(points))
            shares[nodes] = SHARES[len(face)]
            area = np.linalg.norm(n)
            assert np.abs(b - 3.0 * shares[:, None] * push).max() < 1e-13
            assert np.abs(t - shares[:, None] * area * np.array([1.0, 0.0, -2.0])).max() < 1e-13
            assert sums.force == pytest.approx(3.0 * push, abs=1e-13) and sums.area == pytest.approx(area)
            at = points[np.unique(nodes[:3] if len(face) in (3, 6) else nodes[:4])].mean(axis=0)
            assert sums.moment == pytest.approx(np.cross(at, 3.0 * push), abs=1e-13)


@pytest.mark.parametrize("size", [2000, 6000])
def test_pressure_in_a_bore_is_in_balance(comm, size):
    """Of a closed ring the sums vanish, and each half pushes by p times diameter times length."""
    with hpcred.crank(size, comm) as model:
        b, sums = loaded(model, Pressure(name="oil", on="BIG_EYE", value=2e6))
        position = np.concatenate(comm.allgather(model.dofs.position))[::3]
        scale = np.abs(b).sum()
        assert np.abs(sums.force).max() < 1e-12 * scale and np.abs(sums.moment).max() < 1e-12 * scale
        arm = position[:, :2]
        radial = (b[:, :2] * arm).sum(axis=1)
        assert radial.sum() > 0.9 * scale * 0.5 * np.linalg.norm(arm[np.abs(b).max(axis=1) > 0], axis=1).min()
        # half of the ring: the projected area between its ends
        ring = np.abs(b).max(axis=1) > 0
        radius, length = np.linalg.norm(arm[ring], axis=1).max(), np.ptp(position[ring, 2])
        right = ring & (arm[:, 0] > 1e-9)
        on = ring & (np.abs(arm[:, 0]) <= 1e-9)
        pushed = b[right, 0].sum()
        assert not on.any() or np.abs(b[on, 0]).max() < 0.2 * pushed
        assert pushed == pytest.approx(2e6 * 2 * radius * length, rel=0.05)
        assert sums.area == pytest.approx(2 * np.pi * radius * length, rel=0.05)


def test_gravity_is_mass_times_acceleration(comm):
    """M R a in numpy, also of nodes that turn; the sums are mass and centre of mass."""
    for make in (lambda: hpcred.solid((3, 2, 2), clamped=False, comm=comm), lambda: hpcred.linkage(comm)):
        with make() as model:
            K, M, _ = dense_model(model)
            R = gather(rigid_motions(model))
            a = np.array([0.5, -1.0, -9.81])
            with model.with_loads([Gravity(name="g", value=tuple(a))]) as found:
                b = columns_of(found.B)[:, -1]
                (sums,) = found.loads
            assert np.abs(b - M @ R[:, :3] @ a).max() < 1e-12 * np.abs(b).max()
            assert sums.force == pytest.approx((R.T @ b)[:3], abs=1e-12 * np.abs(R.T @ b).max())
            assert sums.moment == pytest.approx((R.T @ b)[3:], abs=1e-12 * np.abs(R.T @ b).max())


def test_centrifugal_forces_are_mass_times_distance(comm):
    """omega^2 M (r - its part along the axis) in numpy, with its sums; nodes that turn are refused."""
    axis, point = np.array([1.0, 2.0, -2.0]), np.array([0.01, -0.02, 0.3])
    with hpcred.solid((3, 2, 2), clamped=False, comm=comm) as model:
        _, M, _ = dense_model(model)
        position = np.concatenate(comm.allgather(model.dofs.position))[::3]
        load = Centrifugal(name="spin", axis=tuple(axis), point=tuple(point), value=20.0)
        b, sums = loaded(model, load)
    arm = position - point
    field = 400.0 * (arm - np.outer(arm @ axis, axis) / 9.0)
    expected = (M @ field.ravel()).reshape(-1, 3)
    assert np.abs(b - expected).max() < 1e-12 * np.abs(b).max()
    assert sums.force == pytest.approx(expected.sum(axis=0)) and sums.spins
    assert sums.moment == pytest.approx(np.cross(position, expected).sum(axis=0))
    with hpcred.linkage(comm) as model, pytest.raises(InputError, match="'spin': found a centrifugal load and nodes"):
        model.with_loads([load])


@pytest.mark.parametrize(
    ("mass", "held", "gravity", "says"),
    [
        ("consistent", (2,), (0.0, 0.0, -9.81), "the mass of 4 held dofs is not in M, nor is its part in the forces"),
        ("consistent", (2,), (1.0, 0.0, 0.0), ""),  # its forces are in directions that are not held
        ("consistent", (), (0.0, 0.0, -9.81), ""),
        ("lumped", (0, 2), (1.0, 0.0, -9.81), "the mass of 8 held dofs is not in M, and missing in its sums"),
    ],
)
def test_gravity_of_bodies_that_are_held(comm, mass, held, gravity, says):
    """A rod of springs that its first four nodes hold: what is wrong with its weight, and only that, is said."""
    count = 20
    scalar = scipy.sparse.diags([1.0, 4.0, 1.0], [-1, 0, 1], shape=(count, count))
    scalar = scalar if mass == "consistent" else 6.0 * scipy.sparse.eye(count)
    M = scipy.sparse.kron(scalar, scipy.sparse.eye(3)).tocsr()
    dofs = Dofs(np.repeat(np.arange(1, count + 1), 3), np.tile(np.arange(3), count), np.zeros((3 * count, 3)))
    still = (dofs.node <= 4) & np.isin(dofs.direction, held)
    there = comm.rank == comm.size - 1
    free = M[~still][:, ~still]
    with SecondOrderModel.from_scipy(
        scipy.sparse.eye(free.shape[0]), free, comm=comm, dofs=dofs.take(~still), held=dofs.take(still & there),
    ) as model, model.with_loads([Gravity(name="g", value=gravity)]) as found:  # fmt: skip
        exact = (M @ np.tile(gravity, count))[~still]
        b = columns_of(found.B)[:, -1]
        (sums,) = found.loads
    assert sums.remark.startswith(says) and bool(sums.remark) == bool(says)
    assert np.allclose(b, exact) == ("forces" not in says)


def test_line_loads_on_edges_and_beams(comm):
    """Straight edges: halves at ends, 1/6 and 4/6 with a middle; a beam of two elements; each edge once."""
    points = points_of("hexahedron20")
    with model_of(comm, points, {"hexahedron20": np.arange(20)[None] + 1}) as model:
        b, sums = loaded(model, LineLoad(name="l", on=(1, 2, 9), value=(0.0, 0.0, -6.0)))
        expected = np.zeros((20, 3))
        expected[[0, 1, 8], 2] = -1.0, -1.0, -4.0
        assert np.abs(b - expected).max() < 1e-13
        assert sums.force == pytest.approx((0.0, 0.0, -6.0)) and sums.moment == pytest.approx((0.0, 3.0, 0.0))
    points = np.array([(0.0, 0, 0), (1, 0, 0), (3, 0, 0)])
    with model_of(comm, points, {"line": [[1, 2], [2, 3]]}) as model:
        b, _ = loaded(model, LineLoad(name="l", on=(1, 2, 3), value=(0.0, 2.0, 0.0)))
        assert b[:, 1] == pytest.approx([1.0, 3.0, 2.0]) and not b[:, [0, 2]].any()
    with hpcred.solid((3, 2, 2), comm=comm) as model:
        edge = Nodes(box=((0.03, -1.0, 0.0), (0.03, 1.0, 0.0)))
        _, sums = loaded(model, LineLoad(name="l", on=edge, value=(0.0, 0.0, 1.0)))
        assert sums.force == pytest.approx((0.0, 0.0, 0.02))


@pytest.mark.parametrize("middle", [0.5, 0.4, 0.6])
def test_shares_of_an_edge_whose_middle_is_beside_the_middle(comm, middle):
    """x(s) = (1 + s)/2 + c (1 - s^2), c = middle - 1/2: with dx/ds = 1/2 - 2 c s the shares of a load of 1 are the
    integrals 1/6 + 2 c/3, 1/6 - 2 c/3 and 2/3; its moment is that of a uniform load."""
    points = np.array([(0.0, 0, 0), (1, 0, 0), (middle, 0, 0)]) + [3.0, -2.0, 0.5]
    with model_of(comm, points, {"line3": [[1, 2, 3]]}) as model:
        b, sums = loaded(model, LineLoad(name="l", on=(1, 2, 3), value=(0.0, 1.0, 0.0)))
    c = middle - 0.5
    assert b[:, 1] == pytest.approx([1 / 6 + 2 * c / 3, 1 / 6 - 2 * c / 3, 2 / 3], abs=1e-13)
    assert sums.moment == pytest.approx((-0.5, 0.0, 3.5), abs=1e-13)


def test_the_length_of_an_edge_that_is_a_parabola(comm):
    """y = 4 h x (1 - x): the shares are the integrals of N sqrt(1 + y'^2), by the trapezoidal rule."""
    h = 0.05
    points = np.array([(0.0, 0, 0), (1, 0, 0), (0.5, h, 0)]) + [3.0, -2.0, 0.5]
    with model_of(comm, points, {"line3": [[1, 2, 3]]}) as model:
        b, _ = loaded(model, LineLoad(name="l", on=(1, 2, 3), value=(0.0, 0.0, 1.0)))
    x = np.linspace(0.0, 1.0, 20001)
    length, weights = np.sqrt(1 + (4 * h * (1 - 2 * x)) ** 2), np.full(len(x), 1 / (len(x) - 1))
    weights[[0, -1]] /= 2
    N = np.stack([(1 - x) * (1 - 2 * x), x * (2 * x - 1), 4 * x * (1 - x)])
    assert b[:, 2] == pytest.approx(N @ (weights * length), rel=1e-4)


def test_loads_come_behind_the_inputs_and_are_kept_in_the_file(comm, folder):
    with hpcred.solid((3, 2, 2), inputs=2, comm=comm) as model:
        first = columns_of(model.B)
        spin = Centrifugal(name="s", axis=(0.0, 0.0, 1.0))
        loads = [Pressure(name="p", on=END), Gravity(name="g", value=(0.0, 0.0, -9.81)), spin]
        wind = np.arange(model.first_row, model.first_row + model.local_rows, dtype=float)
        with model.with_loads(loads, {"wind": wind}) as found:
            assert found.input_names == (*model.input_names, "p", "g", "s", "wind") == found.output_names
            assert np.array_equal(columns_of(found.B)[:, :2], first)
            assert np.array_equal(columns_of(found.B)[:, -1], np.arange(model.size))
            assert [item.name for item in found.loads] == ["p", "g", "s", "wind"]
            assert [item.spins for item in found.loads] == [False, False, True, False]
            hpcred.write_model(folder / "loaded.h5", found)
            with hpcred.read_model(folder / "loaded.h5", comm) as again:
                assert again.loads == found.loads and again.input_names == found.input_names
                assert np.array_equal(columns_of(again.B), columns_of(found.B))
            with found.with_inputs([(20, "x")]) as other:
                assert other.loads == ()
        with model.with_input_columns(None, []) as bare, bare.with_loads(loads) as alone:
            assert alone.input_names == ("p", "g", "s")


def test_loads_on_held_dofs_count_in_the_sums(comm):
    points = points_of("hexahedron")
    face = tuple(np.flatnonzero(points[:, 2] == 1) + 1)
    top = Pressure(name="p", on=tuple(map(int, face)))
    with (
        model_of(comm, points, {"hexahedron": np.arange(8)[None] + 1}, held=[5, 6]) as model,
        model.with_loads([top]) as found,
    ):
        (sums,) = found.loads
        assert sums.force == pytest.approx((0.0, 0.0, -1.0)) and sums.moment == pytest.approx((-0.5, 0.5, 0.0))
        assert sums.held_force == pytest.approx((0.0, 0.0, -0.5))
        assert columns_of(found.B).sum() == pytest.approx(-0.5)
        assert "[0, 0, -0.5] N of it act on held dofs" in sums.notes[0]
    with (
        model_of(comm, points, {"hexahedron": np.arange(8)[None] + 1}, held=[5, 6, 7, 8]) as model,
        pytest.raises(InputError, match="load 'p': every force of it acts on held dofs or is zero"),
    ):
        model.with_loads([top])


def test_the_load_of_an_interface_is_that_of_its_nodes(comm):
    with block_with_ends(comm, clamped=True) as model:
        of_interface, _ = loaded(model, Traction(name="t", on="right", value=(0.0, 1.0, 0.0)))
        box = Nodes(box=((0.06, -1.0, -1.0), (0.06, 1.0, 1.0)))
        of_box, _ = loaded(model, Traction(name="t", on=box, value=(0.0, 1.0, 0.0)))
        assert np.array_equal(of_interface, of_box) and of_box.any()


def test_a_load_on_a_rigid_set_is_transferred_to_its_reference_node(comm):
    """The reduced model has the compliance of the coupled one: the load's resultant on the reference node."""
    with block_with_ends(comm, "rigid", clamped=True) as model, model.with_loads(
        [Traction(name="t", on="right", value=(0.0, 1.0, 0.0))]
    ) as found:
        (sums,) = found.loads
        H = hpcred.frequency_response(found, [0.0])[0].real
        names = found.input_names
        wrench = np.zeros(6)
        wrench[:3] = sums.force
        wrench[3:] = np.subtract(sums.moment, np.cross(found.interfaces[0].position, sums.force))
        at = [names.index(f"right:{d}") for d in ("x", "y", "z", "rx", "ry", "rz")]
        assert H[-1, -1] == pytest.approx(wrench @ H[np.ix_(at, at)] @ wrench, rel=1e-8)


STEEL = Material(name="steel", young=2.1e11, poisson=0.3, density=7850.0, expansion=1.2e-5)


def test_a_free_body_expands_under_a_temperature(comm, folder):
    """K alpha T x is the load, and its sums are zero; of a field in a file, linear in space, against another body."""
    with hpcred.solid((3, 2, 2), clamped=False, comm=comm) as model:
        hot = model.with_material(STEEL)
        K, _, _ = dense_model(model)
        x = np.concatenate(comm.allgather(model.dofs.position))
        direction = np.concatenate(comm.allgather(model.dofs.direction))
        with hot.with_loads([Temperature(name="hot", value=40.0)]) as found:
            b, (sums,) = columns_of(found.B)[:, -1], found.loads
        expanded = 1.2e-5 * 40.0 * x[np.arange(len(x)), direction]
        assert np.abs(K @ expanded - b).max() < 1e-9 * np.abs(b).max()
        assert not any(sums.force) and not any(sums.moment) and "E alpha T / (1 - 2 nu)" in sums.remark
        # T = T0 + g x: u of the bent and stretched body without stress, of constant gradient in y
        T = 5.0 + 3000.0 * x[::3, 1]
        node = np.concatenate(comm.allgather(model.dofs.node))[::3]
        if comm.rank == 0:
            np.savetxt(folder / "T.txt", np.column_stack([node, T]), fmt="%d %.17g")
        comm.Barrier()
        field = Temperature(name="field", file=str(folder / "T.txt"), value=2.0)
        with hot.with_loads([field]) as found:
            b = columns_of(found.B)[:, -1]
        # energy of the expansion against the load: b . u = integral of (E alpha T / (1 - 2 nu)) div u
        u = x[np.arange(len(x)), direction]
        volume = 0.03 * 0.02 * 0.02
        mean = 2.0 * (5.0 + 3000.0 * 0.01)
        assert b @ u == pytest.approx(3 * 2.1e11 * 1.2e-5 / 0.4 * mean * volume, rel=1e-10)


@pytest.mark.mpi(build="real")
def test_refused_temperatures(comm, folder):
    hot = Temperature(name="hot")
    with hpcred.solid((2, 1, 1), comm=comm) as model:
        cold = model.with_material(Material(name="lead", young=1e10, poisson=0.4))
        with pytest.raises(InputError, match="load 'hot': found the material 'lead' without a coefficient of thermal"):
            cold.with_loads([hot])
        with model.with_fields(properties=None) as bare, pytest.raises(InputError, match="types and materials of the"):
            bare.with_loads([hot])
        warm = model.with_material(STEEL)
        if comm.rank == 0:
            (folder / "T.txt").write_text("1 20.0\n2 30.0\n")
            (folder / "twice.txt").write_text("1 20.0\n1 30.0\n")
            (folder / "words.txt").write_text("1 warm\n")
        comm.Barrier()
        for name, words in (("T.txt", "found no temperature of the node 3, expected one for each node of the solids"),
                            ("twice.txt", "found the node 1 twice, expected one temperature for each"),
                            ("words.txt", r"line 1: found '1 warm', expected 2 numbers")):  # fmt: skip
            with pytest.raises(InputError, match=words):
                warm.with_loads([Temperature(name="hot", file=str(folder / name))])
    with hpcred.linkage(comm) as model, pytest.raises(InputError, match="load 'hot': found .* expected solids only"):
        model.with_loads([hot])


def test_materials_expand_by_their_own_coefficients(comm):
    """The load of a uniform rise is the sum over materials of K of their elements times alpha T x."""
    rubber = replace(STEEL, name="rubber", expansion=7e-5)
    hot = Temperature(name="hot", value=40.0)
    with hpcred.solid((4, 2, 3), clamped=False, comm=comm) as block, block.with_material(STEEL) as plain:
        table = {kind: part.copy() for kind, part in plain.properties.table.items()}
        for part in table.values():
            part[:, 2] = part[:, 0] % 4 >= 2
        mixed = replace(plain.properties, materials=(STEEL, rubber), table=table)
        with plain.with_fields(properties=mixed) as model:
            b, _ = loaded(model, hot)
            parts = [to_dense(hpcred.material_stiffness(model, item.name)) for item in (STEEL, rubber)]
            x = np.concatenate(comm.allgather(model.dofs.position))[::3].ravel()
    expected = sum(K @ (item.expansion * 40.0 * x) for K, item in zip(parts, (STEEL, rubber), strict=True))
    assert np.abs(b.ravel() - expected).max() < 1e-10 * np.abs(expected).max()


def test_all_inputs_that_are_no_directions_of_nodes_have_their_sums(comm):
    """Known loads as they are, with what acts on held dofs; columns from elsewhere by their sums, R^T b in numpy."""
    points = points_of("hexahedron")
    top = Pressure(name="p", on=(5, 6, 7, 8))
    with model_of(comm, points, {"hexahedron": np.arange(8)[None] + 1}, held=[5, 6]) as model, model.with_loads(
        [top]
    ) as found:
        (known,) = found.loads
        R, column = gather(rigid_motions(found)), np.random.default_rng(4).normal(size=found.size)
        mine = slice(found.first_row, found.first_row + found.local_rows)
        both = np.stack([columns_of(found.B)[mine, 0], column[mine]], axis=1)
        with found.with_input_columns(both, ["p", "wind"]) as bare, bare.with_fields(loads=(known,)) as more:
            pressure, wind = loads_of(more)
            sums = resultants(more)
    assert pressure == known and any(known.held_force)
    assert (wind.name, wind.kind, wind.notes) == ("wind", "given", [])
    assert [*wind.force, *wind.moment] == pytest.approx(R.T @ column, rel=1e-12)
    assert sums[1] == pytest.approx(R.T @ column, rel=1e-12)
    assert sums[0] == pytest.approx([*known.force, *known.moment], abs=1e-13)
    assert [*wind.held_force, *wind.held_moment] == [0.0] * 6


def test_a_moving_load_is_a_force_anywhere_on_its_path(comm):
    """Points on nodes and between them; sums and moments of any place; deflection against a force at each node."""
    line = Nodes(box=((-1.0, 0.0, 0.02), (1.0, 0.0, 0.02)))
    wheel = MovingLoad(name="wheel", on=line, along=(1.0, 0.0, 0.0), value=(0.0, 0.0, -100.0), points=6)
    with hpcred.solid((12, 1, 2), clamped=True, comm=comm) as model, model.with_loads([wheel]) as loaded:
        assert loaded.input_names[-6:] == tuple(f"wheel.{k}" for k in range(1, 7))
        start, end = 0.01, 0.12
        for k, item in enumerate(loaded.loads):
            at = start + (end - start) * k / 5
            assert item.force == pytest.approx((0.0, 0.0, -100.0))
            assert item.moment == pytest.approx((0.0, 100.0 * at, 0.0), abs=1e-9)
        places = np.linspace(0.0, 1.0, 12)
        factors = wheel.factors(places)
        assert factors.sum(axis=1) == pytest.approx(1.0)
        assert factors @ np.linspace(0, 1, 6) == pytest.approx(places)
        assert not wheel.factors([-0.1, 1.1]).any()
        B = columns_of(loaded.B)[:, -6:] @ factors.T
        node, direction = (np.concatenate(comm.allgather(getattr(model.dofs, key))) for key in ("node", "direction"))
        x = np.concatenate(comm.allgather(model.dofs.position))
        on = np.flatnonzero((direction == 2) & (np.abs(x[:, 1]) < 1e-9) & (np.abs(x[:, 2] - 0.02) < 1e-9))
        on = on[np.argsort(x[on, 0])]
        K, _, _ = dense_model(model)
        exact = np.zeros((len(K), 12))
        exact[on, np.arange(12)] = -100.0
        tip = on[-1]
        ours, theirs = np.linalg.solve(K, B)[tip], np.linalg.solve(K, exact)[tip]
        assert np.abs(ours - theirs).max() < 1e-2 * np.abs(theirs).max()
        ordered = MovingLoad(name="wheel", on=tuple(node[on].tolist()), value=(0.0, 0.0, -100.0), points=12)
        with model.with_loads([ordered]) as each:
            assert np.abs(columns_of(each.B)[:, -12:] - exact).max() < 1e-10
        ends = MovingLoad(name="wheel", on=tuple(node[on[[0, -1]]].tolist()), along=(1.0, 0.0, 0.0),
                          value=(0.0, 0.0, -100.0), points=2)  # fmt: skip
        with model.with_loads([ends]) as each:
            assert np.abs(columns_of(each.B)[:, -2:] - exact[:, [0, -1]]).max() < 1e-10


@pytest.mark.mpi(build="real")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MovingLoad(name="w", on=END, value=(0, 0, 1)), "load 'w': along: missing; expected the direction in"),
        (lambda: MovingLoad(name="w", on=(1, 2), value=(0, 0, 1), points=1), "'w': points: found 1, expected 2 to"),
        (lambda: MovingLoad(name="w", on=(1, 2), value=(0, 0, 1), along=(0, 0, 0)), "along: found .* no direction"),
        (lambda: MovingLoad(name="w", on=(1, 2, 3), value=(0, 0, 1)), "points: found 5 points on a path of 3 nodes"),
        (lambda: MovingLoad(name="w", on=(1, 999), value=(0, 0, 1)), "on: node 999 has no row in solid, or does not"),
        (lambda: MovingLoad(name="w", on=END, along=(0, 1, 0), value=(0, 0, 1)), "w': along: found nodes side by side"),
        (lambda: MovingLoad(name="w", on=END, along=(0, 1, 0.1), value=(0, 0, 1)), r"side by side, .* is 0.104721 m"),
        (lambda: MovingLoad(name="w", on=Nodes(sphere=((9, 0, 0), 1)), along=(1, 0, 0), value=(0, 0, 1)),
         r"load 'w': on: none lies there; the nodes of solid lie between \(0.01, 0, 0\) and"),
    ],
)
def test_refused_moving_loads(comm, make, words):
    with hpcred.solid((3, 2, 2), comm=comm) as model, pytest.raises(InputError, match=words):
        model.with_loads([make()])


@pytest.mark.mpi(build="real")
@pytest.mark.parametrize(
    ("load", "words"),
    [
        (Pressure(name="p", on="NOSE"), "load 'p': on: solid has no node set or interface 'NOSE'; it has none"),
        (Pressure(name="p", on=(1, 2, 3)), "load 'p': on: no face of the surface of solid has all its nodes there"),
        (Pressure(name="p", on=(1, 2, 999)), "load 'p': on: node 999 does not exist in solid"),
        (Pressure(name="p", on=Nodes(box=((10, 0, 0), (30, 20, 20)))), "load 'p': on: none lies there; the nodes"),
        (Pressure(name="p", on=Nodes(bore=((0, 0, 0), (0, 0, 1), 0.1))), "load 'p': on.bore: no face of solid lies"),
        (LineLoad(name="l", on=END, value=(1, 0, 0)), "load 'l': on: found 4 whole faces among these nodes, expected"),
        (LineLoad(name="l", on=(1, 14), value=(1, 0, 0)), "load 'l': on: no edge of an element on the surface of"),
    ],
)  # fmt: skip
def test_refused_loads(comm, load, words):
    with hpcred.solid((3, 2, 2), inputs=2, comm=comm) as model, pytest.raises(InputError, match=words):
        model.with_loads([load])


@pytest.mark.mpi(build="real")
def test_refusals_of_names_and_models(comm):
    with hpcred.solid((3, 2, 2), inputs=2, comm=comm) as model:
        twice = [Pressure(name="p", on=END), Gravity(name="p", value=(0.0, 0.0, 1.0))]
        with pytest.raises(InputError, match="load 'p': found two inputs of this name, expected each once"):
            model.with_loads(twice)
        with pytest.raises(InputError, match="load 'wind': found NaN or Inf in column 1"):
            model.with_loads(given={"wind": np.full(model.local_rows, np.nan)})
        words = "load 'p': solid has no elements, and so no faces and edges"
        with model.with_fields(elements={}) as bare, pytest.raises(InputError, match=words):
            bare.with_loads([Pressure(name="p", on=END)])
        words = "has no node coordinates, which load 'g' needs"
        with model.with_fields(dofs=None) as bare, pytest.raises(InputError, match=words):
            bare.with_loads([Gravity(name="g", value=(0.0, 0.0, 1.0))])
    places = np.repeat(points_of("hexahedron")[:7], 3, axis=0)
    dofs = Dofs(np.repeat(np.arange(1, 8), 3), np.tile(np.arange(3), 7), places)
    mine = {"hexahedron": np.arange(1, 9)[None] if comm.rank == 0 else np.zeros((0, 8), int)}
    eye, words = scipy.sparse.eye(21), "load 'p': node 8 of its faces or edges has no row in model, since it follows"
    with (
        SecondOrderModel.from_scipy(eye, eye, comm=comm, elements=mine, dofs=dofs) as lacking,
        pytest.raises(InputError, match=words),
    ):
        lacking.with_loads([Pressure(name="p", on=(5, 6, 7, 8))])


@pytest.mark.mpi(ranks=(1,), build="real")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Pressure(name="1p", on="A"), "load.name: found '1p', expected a word that begins with a letter"),
        (lambda: Pressure(name="p", on="A", value=0.0), "load 'p': value: found 0.0, which is no load; leave it out"),
        (lambda: Gravity(name="g", value=(0, 0, 0)), r"load 'g': value: found \(0.0, 0.0, 0.0\), which is no load"),
        (lambda: Centrifugal(name="c", axis=(0, 0, 0)), r"'c': axis: found \(0.0, 0.0, 0.0\), which has no direction"),
        (lambda: Centrifugal(name="c", axis=(0, 0, 1), value=0), "load 'c': value: found 0.0, which is no load"),
        (lambda: Centrifugal(name="c", axis=(0, 0, 1), point=(0, 0, np.nan)), "load 'c': point: found nan"),
        (lambda: Gravity(name="g", value=(0, 0, np.inf)), "load 'g': value: found inf, expected a finite number"),
        (lambda: Pressure(name="p", on=()), "load 'p': on: expected at least one number of a node, and each once"),
        (lambda: Pressure(name="p", on=(1, 1)), "load 'p': on: expected at least one number of a node, and each once"),
        (lambda: Traction(name="t", on="A", value=1.0), "load 't': value: found 1.0, expected"),
    ],
)
def test_refused_settings(make, words):
    with pytest.raises(InputError, match=words):
        make()
