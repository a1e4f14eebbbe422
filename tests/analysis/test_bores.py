"""Holes and pins of meshes whose geometry is known, and bodies that have none."""

import numpy as np
import pytest
from bodies import block, mapped_block, model_of_mesh
from scipy.spatial.transform import Rotation

import hpcred
from hpcred import InputError, Interface, Nodes


def ring(inner, outer, height, cells, turn=360.0, quadratic=False, axial=lambda z: 1.0):
    """A ring around z of `cells` through, around and along it; `axial`: a factor of the radii by z."""

    def place(unit):
        radius, angle, z = inner + (outer - inner) * unit[:, 0], np.radians(turn) * unit[:, 1], height * unit[:, 2]
        radius = radius * np.vectorize(axial, otypes=[float])(z)
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])

    return mapped_block(*cells, place, quadratic)


def joined(*bodies):
    """Bodies as one mesh; nodes of different bodies stay apart."""
    points, cells, first = [], {}, 0
    for part, elements in bodies:
        points.append(part)
        for kind, nodes in elements.items():
            cells.setdefault(kind, []).append(nodes + first)
        first += len(part)
    return np.concatenate(points), {kind: np.concatenate(parts) for kind, parts in cells.items()}


def bores_of(points, cells, comm, **keywords):
    with model_of_mesh(points, cells, comm) as model:
        return hpcred.find_bores(model, **keywords)


@pytest.mark.mpi(build="real")
@pytest.mark.parametrize("quadratic", [False, True])
@pytest.mark.parametrize("size, digits", [(1.0, None), (1e-7, None), (1e7, None), (1.0, 6)])
@pytest.mark.parametrize("around", [8, 30])
def test_a_turned_ring_has_a_hole_and_a_pin(comm, quadratic, size, digits, around):
    points, cells = ring(0.3, 0.5, 0.4, (2, around, 3), quadratic=quadratic)
    radius = np.hypot(*points[:, :2].T)
    turned, away = Rotation.from_rotvec([0.4, -1.1, 0.7]), np.array([2.0, -1.0, 0.5])
    moved = size * (turned.apply(points) + away)
    if digits is not None:
        moved = np.vectorize(lambda x: float(f"{x:.{digits - 1}e}"))(moved)
    bore, pin = bores_of(moved, cells, comm)
    near = 1e-6 if digits is None else 2e-5
    for found, r in ((bore, 0.3), (pin, 0.5)):
        assert found.turn == 360.0
        assert np.isclose(found.radius, size * r, rtol=near)
        assert np.isclose(found.length, size * 0.4, rtol=10 * near)
        assert np.allclose(found.centre, size * (turned.apply([0, 0, 0.2]) + away), atol=near * size)
        assert np.isclose(abs(turned.apply([0, 0, 1.0]) @ found.axis), 1.0, atol=near)
        assert found.nodes == tuple(np.flatnonzero(np.isclose(radius, r)) + 1)
    assert (bore.name, bore.kind, pin.name, pin.kind) == ("bore1", "bore", "pin1", "pin")


def test_radii_have_seven_digits(comm):
    bore, pin = bores_of(*ring(0.31234567891, 5.12345678912, 0.4, (2, 24, 2)), comm)
    assert (bore.radius, pin.radius) == (0.3123457, 5.123457)


@pytest.mark.parametrize("turn, found", [(100.0, 0), (150.0, 2), (350.0, 2)])
def test_parts_of_a_cylinder(comm, turn, found):
    bores = bores_of(*ring(0.3, 0.5, 0.4, (2, 24, 2), turn), comm)
    assert [item.turn for item in bores] == [pytest.approx(turn, abs=0.1)] * found
    if found:
        assert [item.radius for item in bores] == [0.3, 0.5]
    assert len(bores_of(*ring(0.3, 0.5, 0.4, (2, 24, 2), turn), comm, turn=90.0)) == 2


def test_coaxial_cylinders_are_told_apart(comm):
    """A fork of two eyes, a sleeve of another radius between them, and a pin in one eye, at the same radius."""
    eyes = [ring(0.3, 0.5, 0.2, (1, 20, 2)) for _ in range(2)]
    eyes[1][0][:, 2] += 1.0
    sleeve = ring(0.2, 0.25, 0.5, (1, 16, 2))
    sleeve[0][:, 2] += 0.3
    pin = ring(0.1, 0.3, 0.2, (1, 20, 2))
    found = bores_of(*joined(*eyes, sleeve, pin), comm)
    named = sorted((item.kind, item.radius, round(item.start[2], 6), round(item.end[2], 6)) for item in found)
    assert named == [
        ("bore", 0.1, 0.0, 0.2), ("bore", 0.2, 0.3, 0.8), ("bore", 0.3, 0.0, 0.2), ("bore", 0.3, 1.0, 1.2),
        ("pin", 0.25, 0.3, 0.8), ("pin", 0.3, 0.0, 0.2), ("pin", 0.5, 0.0, 0.2), ("pin", 0.5, 1.0, 1.2),
    ]  # fmt: skip
    count = {(item.kind, item.radius, item.start[2]): len(item.nodes) for item in found}
    assert count["bore", 0.3, 0.0] == count["pin", 0.3, 0.0] == 60  # though both lie on one cylinder


def test_grooves_and_chamfers(comm):
    """A bore with two grooves along it is one bore; chamfers of 45 degrees are none of it."""
    halves = []
    for k in range(2):
        points, cells = ring(0.3, 0.5, 0.4, (1, 12, 2), 170.0)
        halves.append((Rotation.from_euler("z", 180.0 * k, degrees=True).apply(points), cells))
    bore, _ = bores_of(*joined(*halves), comm)
    assert bore.turn == pytest.approx(340.0, abs=0.1) and len(bore.nodes) == 2 * 13 * 3

    def chamfered(unit):
        z = np.array([0.0, 0.05, 0.2, 0.35, 0.4])[np.rint(4 * unit[:, 2]).astype(int)]
        inner = 0.3 + np.maximum(0.05 - z, 0) + np.maximum(z - 0.35, 0)
        radius, angle = inner + (0.5 - inner) * unit[:, 0], 2 * np.pi * unit[:, 1]
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])

    for around, size in ((8, 1.0), (24, 1.0), (24, 1e-3)):
        points, cells = mapped_block(1, around, 4, chamfered)
        bore, pin = bores_of(size * points, cells, comm)
        ends = [bore.radius / size, bore.start[2] / size, bore.end[2] / size, pin.length / size]
        assert ends == pytest.approx([0.3, 0.05, 0.35, 0.4], abs=1e-6) and len(bore.nodes) == 3 * around


def test_a_rough_hole_is_one(comm):
    """Nodes up to 2e-4 of the radius off the cylinder, and places with six digits far from the origin."""
    points, cells = ring(0.3, 0.5, 0.4, (1, 24, 3))
    off = 1 + np.random.default_rng(3).uniform(-2e-4, 2e-4, (len(points), 1))
    rough, far = points * np.hstack([off, off, np.ones_like(off)]), np.round(points + [9000.0, 0.0, 0.0], 2)
    for found, near in ((rough, 1e-4), (far, 1e-2)):
        bore, pin = bores_of(found, cells, comm)
        assert (bore.radius, pin.radius) == (pytest.approx(0.3, rel=near), pytest.approx(0.5, rel=near))
        assert len(bore.nodes) == len(pin.nodes) == 4 * 24


def ball(unit):
    """A part of a ball without its poles."""
    radius, angle, height = 0.5 + 0.5 * unit[:, 0], 2 * np.pi * unit[:, 1], np.pi * (unit[:, 2] - 0.5) * 0.8
    return radius[:, None] * np.column_stack(
        [np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height)])  # fmt: skip


def tyre(unit):
    """A torus of square cells: around its middle line, and around z."""
    section = 0.15 + 0.15 * unit[:, 0]
    small, large = 2 * np.pi * unit[:, 1], 2 * np.pi * unit[:, 2]
    radius = 1.0 + section * np.cos(small)
    return np.column_stack([radius * np.cos(large), radius * np.sin(large), section * np.sin(small)])


def slow(*mesh):
    return pytest.param(mesh, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    "mesh",
    [
        block(3, 4, 5),
        ring(0.3, 0.5, 0.4, (1, 6, 1)),  # a nut
        ring(0.3, 0.5, 0.4, (1, 4, 1)),
        ring(0.3, 0.5, 0.4, (1, 24, 1), axial=lambda z: 1 - 0.05 * z),
        ring(0.3, 0.5, 0.4, (1, 24, 8), axial=lambda z: 1 - 0.05 * z),
        slow(*ring(0.3, 0.5, 0.4, (1, 60, 40), axial=lambda z: 1 - 0.05 * z)),
        mapped_block(1, 16, 7, ball),  # with a belt whose nodes lie on a cylinder
        slow(*mapped_block(1, 36, 12, ball)),
        slow(*mapped_block(1, 90, 60, ball)),
        slow(*mapped_block(1, 12, 24, tyre)),
        mapped_block(1, 6, 10, tyre),
        slow(*mapped_block(1, 24, 60, tyre)),
    ],
    ids=["block", "nut", "square", "cone", "long cone", "fine cone", "ball", "ball of 12", "fine ball", "tyre",
         "tyre of 6", "fine"],
)  # fmt: skip
def test_what_is_no_cylinder_is_not_taken_for_one(comm, mesh):
    points, cells = mesh
    assert bores_of(points, cells if isinstance(cells, dict) else {"hexahedron": cells}, comm) == ()


@pytest.mark.mpi
def test_interfaces_on_bores_have_their_nodes(comm):
    with hpcred.crank(3000, comm) as rod:
        big, small, *pins = hpcred.find_bores(rod)
        sets = {name: set().union(*comm.allgather(set(part.tolist()))) for name, part in rod.sets.items()}
        assert str(big).endswith(f"{len(big.nodes)} nodes") and len(repr(big)) < 200  # not their numbers
        assert set(big.nodes) == sets["BIG_EYE"] and set(small.nodes) == sets["SMALL_EYE"]
        assert (big.radius, small.radius, small.centre) == (0.025, 0.012, (0.2, 0.0, 0.0))
        assert [(item.kind, item.radius) for item in pins] == [("pin", 0.04), ("pin", 0.02)]
        named = Interface(name="big", nodes=Nodes(set="BIG_EYE"), at=(0, 0, 0))
        by_hand = Interface(name="big", nodes=Nodes(bore=((0, 0, -0.02), (0, 0, 0.02), 0.025001)), at=(0, 0, 0))
        expected = rod.with_interfaces([named]).digest_of("B")
        for interface in (big.interface("big"), by_hand):
            assert rod.with_interfaces([interface]).digest_of("B") == expected
        found = rod.with_interfaces([item.interface(kind="rigid") for item in pins]).interfaces
        assert [item.count for item in found] == [len(item.nodes) for item in pins]
        assert found[0].position == (0.0, 0.0, 0.0)  # of a part of a turn as well


@pytest.mark.mpi
def test_what_has_no_bore_is_refused(comm):
    with hpcred.linkage(comm) as beams, pytest.raises(InputError, match="linkage has no elements with faces"):
        hpcred.find_bores(beams)
    wrong = Interface(name="a", nodes=Nodes(bore=((0, 0, 0), (0, 0, 1), 0.03)))
    with hpcred.linkage(comm) as beams, pytest.raises(InputError, match="no face of linkage lies on the cylinder"):
        beams.with_interfaces([wrong])
    with hpcred.crank(600, comm) as rod:
        with pytest.raises(InputError, match="'a': nodes.bore: no face of crank lies .* 0.03 m around a hole; `hpcred"):
            rod.with_interfaces([wrong])
        with pytest.raises(InputError, match="turn: found 0, expected degrees"):
            hpcred.find_bores(rod, turn=0)
        with pytest.raises(InputError, match="find_bores: unknown keyword 'trun' .did you mean 'turn'"):
            hpcred.find_bores(rod, trun=90)
    bare = hpcred.SecondOrderModel.from_scipy(np.eye(6), np.eye(6), comm=comm)
    with bare, pytest.raises(InputError, match="no node coordinates, and so no surface"):
        hpcred.find_bores(bare)
