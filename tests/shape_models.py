"""Bodies as people mesh them, beside cubes: thin walls, shells, bad tetrahedra, rigid couplings, several materials."""

import numpy as np
import scipy.sparse
import scipy.spatial
from bodies import block, mapped_block
from solid_meshes import PARTS, mesh

import hpcred
from hpcred.fe.element_rules import B_BAR, FULL
from hpcred.fe.shape_functions import EDGES, gradients_in_space, integration_points, shape_functions
from hpcred.fe.strain_matrices import elasticity, stiffness_matrices
from hpcred.model.interfaces.coupling import couple
from hpcred.parallel.shares import row_range

STEEL = (2.1e11, 0.3, 7850.0)
SOFT = 2.1e7  # N/m^2: 1e-4 of steel
PART = 20_000  # elements whose matrices are made at a time


def assembled(count, elements, matrices):
    """The sum (n, n) of element matrices (e, m, m) or of functions of slices that make them; `elements` (e, k)."""
    parts = []
    for low in range(0, len(elements), PART):
        part = slice(low, low + PART)
        blocks = matrices(part)
        size = blocks.shape[1] // elements.shape[1]
        rows = (size * elements[part][:, :, None] + np.arange(size)).reshape(len(blocks), -1)
        i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None])
        parts.append(scipy.sparse.coo_array((blocks.ravel(), (i.ravel(), j.ravel())), (size * count,) * 2).tocsr())
    return sum(parts[1:], start=parts[0])


def solid_model(comm, kind, points, elements, young=STEEL[0], poisson=STEEL[1], rule=FULL, clamped=None):
    """Solids with their consistent mass. `young`: of each element, or of all; `clamped`: points without rows, by
    default those at the smallest x; None of them with an empty list."""
    N, dN = shape_functions(kind, integration_points(kind)[0])
    weights, elastic = integration_points(kind)[1], elasticity(1.0, poisson)
    young = np.broadcast_to(young, len(elements))

    def masses(part):
        _, determinant = gradients_in_space(dN, points[elements[part]])
        scalar = STEEL[2] * np.einsum("g,eg,gk,gl->ekl", weights, determinant, N, N)
        return np.einsum("ekl,ab->ekalb", scalar, np.eye(3)).reshape(len(scalar), 3 * len(N[0]), -1)

    K = assembled(len(points), elements, lambda part: young[part][:, None, None] * stiffness_matrices(
        kind, rule, points[elements[part]], elastic))  # fmt: skip
    return model_of(comm, points, K, assembled(len(points), elements, masses), clamped,
                    elements={kind: elements[slice(*row_range(comm, len(elements)))] + 1})


def model_of(comm, points, K, M, clamped=None, **more):
    """A model with as many rows a point as K has, and forces at the point of the largest x + y + z."""
    held = points[:, 0] <= points[:, 0].min() + 1e-9 if clamped is None else np.isin(np.arange(len(points)), clamped)
    size = K.shape[0] // len(points)
    dofs = hpcred.Dofs(np.repeat(np.arange(1, len(points) + 1), size), np.tile(np.arange(size), len(points)),
                       np.repeat(points, size, axis=0))  # fmt: skip
    free, stuck = np.flatnonzero(np.repeat(~held, size)), np.flatnonzero(np.repeat(held, size))
    stuck = dofs.take(stuck).take(slice(*row_range(comm, len(stuck)))) if len(stuck) else None
    model = hpcred.SecondOrderModel.from_scipy(K[free][:, free], M[free][:, free], comm=comm, held=stuck,
                                               dofs=dofs.take(free), **more)  # fmt: skip
    far = int(points.sum(axis=1).argmax()) + 1
    return model.with_inputs([(far, name) for name in "xyz"])


def graded_walls(cells, wall, length):
    """Coordinates along an edge of a housing: a wall of one cell at both ends, and `cells` between."""
    return np.concatenate([[0.0], np.linspace(wall, length - wall, cells + 1), [length]])


def housing(cells, wall=0.003, size=(0.3, 0.2, 0.15), kind="hexahedron"):
    """Points and elements of a box that is open on top, with thin walls of one element."""
    counts = [max(int(cells * edge / size[0]), 1) for edge in size]
    axes = [graded_walls(count, wall, edge) for count, edge in zip(counts, size, strict=True)]
    points, hexahedra = block(*(len(axis) - 1 for axis in axes))
    shape = [len(axis) - 1 for axis in axes]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j, k = np.unravel_index(np.arange(len(hexahedra)), shape)
    walls = (i == 0) | (i == shape[0] - 1) | (j == 0) | (j == shape[1] - 1) | (k == 0)
    elements = hexahedra[walls & (k < shape[2] - 1)]
    if kind.startswith("tetra"):
        elements = np.concatenate([elements[:, list(part)] for part in PARTS["tetra"]])
    used, elements = np.unique(elements, return_inverse=True)
    points, elements = points[used], elements.reshape(-1, 4 if kind.startswith("tetra") else 8)
    return with_middles(kind, points, elements) if kind in EDGES else (points, elements)


def with_middles(kind, points, elements):
    """Of elements with straight edges, with a point in the middle of each."""
    pairs = np.sort(elements[:, np.array(EDGES[kind])], axis=2)
    middles, place = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    more = place.reshape(pairs.shape[:2]) + len(points)
    return np.concatenate([points, points[middles].mean(axis=1)]), np.hstack([elements, more])


def delaunay(count, size=(1.0, 1.0, 1.0), kind="tetra", seed=3, worst=1e-3):
    """Tetrahedra of random points in a block, slivers among them: `worst` is the least volume kept, of that of a
    regular tetrahedron with the same longest edge."""
    rng, size = np.random.default_rng(seed), np.array(size)
    points = rng.random((count, 3))
    on_faces = rng.random(count) < 1.5 * count ** (-1 / 3)
    points[on_faces, rng.integers(0, 3, on_faces.sum())] = rng.integers(0, 2, on_faces.sum())
    points = np.concatenate([points, block(1, 1, 1)[0]]) * size
    elements = scipy.spatial.Delaunay(points).simplices
    edges = points[elements[:, 1:]] - points[elements[:, :1]]
    volumes = np.linalg.det(edges) / 6
    elements[volumes < 0] = elements[volumes < 0][:, [1, 0, 2, 3]]
    ends = points[elements]
    longest = np.linalg.norm(ends[:, :, None] - ends[:, None], axis=3).max(axis=(1, 2))
    elements = elements[np.abs(volumes) > worst * longest**3 / 72**0.5]
    used, elements = np.unique(elements, return_inverse=True)
    points, elements = points[used], elements.reshape(-1, 4)
    return with_middles(kind, points, elements) if kind in EDGES else (points, elements)


def shell_element(a, b, thickness, young, poisson, density):
    """K and the diagonal of M (24,) of a flat rectangle a x b in x, y with x, y, z, rx, ry, rz a node: membrane,
    Mindlin plate with the shear of Bathe and Dvorkin (Int. J. Numer. Meth. Eng. 21(2), 1985), drilling by a penalty."""
    plane = young / (1 - poisson**2) * np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])
    shear = young / (2 * (1 + poisson))
    scale = np.array([2 / a, 2 / b])
    K = np.zeros((24, 24))

    def at(places):
        N, dN = shape_functions("quad", np.array([places], dtype=float))
        return N[0], dN[0, :, :2] * scale

    def shear_at(places, axis):
        N, dN = at(places)
        row = np.zeros((4, 6))
        row[:, 2], row[:, 4 if axis == 0 else 3] = dN[:, axis], N if axis == 0 else -N
        return row.ravel()

    points, weights = integration_points("quad")
    for (x, y), weight in zip(points, weights, strict=True):
        N, dN = at((x, y))
        membrane, bending, drill = np.zeros((3, 4, 6)), np.zeros((3, 4, 6)), np.zeros((4, 6))
        membrane[0, :, 0] = membrane[2, :, 1] = bending[0, :, 4] = dN[:, 0]
        membrane[1, :, 1] = membrane[2, :, 0] = bending[2, :, 4] = dN[:, 1]
        bending[1, :, 3], bending[2, :, 3] = -dN[:, 1], -dN[:, 0]
        drill[:, 5], drill[:, 0], drill[:, 1] = N, dN[:, 1] / 2, -dN[:, 0] / 2
        gamma = np.array([
            (1 - y) / 2 * shear_at((0, -1), 0) + (1 + y) / 2 * shear_at((0, 1), 0),
            (1 - x) / 2 * shear_at((-1, 0), 1) + (1 + x) / 2 * shear_at((1, 0), 1),
        ])  # fmt: skip
        membrane, bending, drill = membrane.reshape(3, 24), bending.reshape(3, 24), drill.reshape(1, 24)
        area = weight * a * b / 4
        K += area * thickness * (membrane.T @ plane @ membrane + thickness**2 / 12 * bending.T @ plane @ bending
                                 + 5 / 6 * shear * gamma.T @ gamma + 0.1 * shear * drill.T @ drill)  # fmt: skip
    share = density * thickness * a * b / 4
    return K, np.tile([share] * 3 + [share * thickness**2 / 12] * 3, 4)


def shell_housing(comm, cells, thickness=0.003, size=(0.3, 0.2, 0.15), clamped=None):
    """A box of shells that is open on top: six rows a node, in global directions."""
    edge = size[0] / cells
    counts = [max(round(length / edge), 1) for length in size]
    steps = np.array(size) / counts
    grid = np.array(counts) + 1
    quads, faces = [], []
    for axis, level in ((2, 0), (0, 0), (0, counts[0]), (1, 0), (1, counts[1])):
        one, two = [other for other in range(3) if other != axis]
        i, j = (part.ravel() for part in np.meshgrid(range(counts[one]), range(counts[two]), indexing="ij"))
        place = np.zeros((len(i), 4, 3), int)
        place[:, :, axis] = level
        place[:, :, one] = i[:, None] + np.array([0, 1, 1, 0])
        place[:, :, two] = j[:, None] + np.array([0, 0, 1, 1])
        quads.append(np.ravel_multi_index(np.moveaxis(place, 2, 0), grid))
        faces.append((one, two))
    used, numbers = np.unique(np.concatenate(quads), return_inverse=True)
    points = np.stack(np.unravel_index(used, grid), axis=1) * steps
    K = M = 0
    at = 0
    for nodes, (one, two) in zip(quads, faces, strict=True):
        elements = numbers.reshape(-1, 4)[at : at + len(nodes)]
        at += len(nodes)
        axes = np.zeros((3, 3))
        axes[0, one] = axes[1, two] = 1.0
        axes[2] = np.cross(axes[0], axes[1])
        stiffness, mass = shell_element(steps[one], steps[two], thickness, *STEEL)
        turn = np.kron(np.eye(8), axes)
        K = K + assembled(len(points), elements, lambda part, A=turn.T @ stiffness @ turn, e=elements: np.broadcast_to(
            A, (len(e[part]), 24, 24)))  # fmt: skip
        whole = np.diag(mass)
        M = M + assembled(len(points), elements, lambda part, A=turn.T @ whole @ turn, e=elements: np.broadcast_to(
            A, (len(e[part]), 24, 24)))  # fmt: skip
    return model_of(comm, points, K, M, clamped)


def slender_beam(comm, cells):
    """A bar of hexahedra, 100 times as long as thick."""
    return hpcred.solid((cells, 4, 4), size=(1.0, 0.01, 0.01), inputs=3, comm=comm)


def two_materials(comm, cells):
    """A block of steel with every second layer, and one of eight blocks, of a rubber 1e-4 as stiff."""
    points, elements = block(cells, cells, cells)
    middle = points[elements].mean(axis=1)
    layer = (middle[:, 0] * 8).astype(int) % 2 == 1
    return solid_model(comm, "hexahedron", points, elements, np.where(layer, SOFT, STEEL[0]))


def scattered_materials(comm, cells):
    """A block whose elements are steel or 1e-4 as stiff at random."""
    points, elements = block(cells, cells, cells)
    soft = np.random.default_rng(5).random(len(elements)) < 0.5
    return solid_model(comm, "hexahedron", points, elements, np.where(soft, SOFT, STEEL[0]))


def rigid_faces(comm, cells):
    """A free block of which two faces follow a node each, the first of them held."""
    points, elements = block(cells, cells, cells)
    plates = {"near": points[:, 0] < 1e-9, "far": points[:, 0] > 1 - 1e-9}
    model = solid_model(comm, "hexahedron", points, elements, clamped=np.flatnonzero(points[:, 1] < 1e-9))
    numbers = np.arange(1, len(points) + 1)
    return model, [hpcred.Interface(name=name, nodes=tuple(numbers[chosen & (points[:, 1] > 1e-9)].tolist()),
                                    kind="rigid") for name, chosen in plates.items()]  # fmt: skip


def rigidly_coupled(comm, cells):
    """A block, held at one side, of which two faces follow a node each."""
    model, interfaces = rigid_faces(comm, cells)
    return couple(model.with_interfaces(interfaces))[0].with_fields(interfaces=())  # it is done


def ring(comm, cells):
    """Half of a ring of curved hexahedra with 20 nodes, whose ends at x = 0 are held."""

    def place(unit):
        radius, angle = 0.8 + 0.2 * unit[:, 0], np.pi * (unit[:, 1] - 0.5)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.3 * unit[:, 2]], axis=1)

    points, cells = mapped_block(max(cells // 8, 1), cells, max(cells // 5, 1), place, quadratic=True)
    return solid_model(comm, "hexahedron20", points, cells["hexahedron20"])


SHAPES = {  # name: function of comm and a number that grows with the dofs
    "cube": lambda comm, n: hpcred.solid((n, n, n), inputs=3, comm=comm),
    "housing, hexahedra": lambda comm, n: solid_model(comm, "hexahedron", *housing(3 * n, wall=0.025 / n)),
    "housing, tetrahedra of 10": lambda comm, n: solid_model(
        comm, "tetra10", *housing(n, wall=0.1 / n, kind="tetra10")),
    "housing, shells": lambda comm, n: shell_housing(comm, 2 * n),
    "housing, shells on 3 points": lambda comm, n: shell_housing(comm, 2 * n, clamped=[0, n, 5 * n]),
    "random tetrahedra of 4": lambda comm, n: solid_model(comm, "tetra", *delaunay(n**3)),
    "random tetrahedra of 10": lambda comm, n: solid_model(comm, "tetra10", *delaunay(n**3 // 8, kind="tetra10")),
    "slab of flat tetrahedra": lambda comm, n: solid_model(comm, "tetra", *delaunay(n**3, (1.0, 1.0, 0.05))),
    "ring, curved hexahedra of 20": ring,
    "rigid faces": rigidly_coupled,
    "soft layers, 1e-4": two_materials,
    "soft elements, 1e-4": scattered_materials,
    "nu = 0.499, B-bar": lambda comm, n: solid_model(comm, "hexahedron", *block(n, n, n), poisson=0.499, rule=B_BAR),
    "nu = 0.499, tetrahedra of 10": lambda comm, n: solid_model(
        comm, "tetra10", *mesh("tetra10", (n // 2,) * 3, distortion=0.0), poisson=0.499),
    "bar 100:1": lambda comm, n: slender_beam(comm, 4 * n),
}  # fmt: skip
