"""Stress modes: constant and linear stresses, bending, means at nodes, and refusals."""

import re

import numpy as np
import pytest
import scipy.sparse
from foreign import gathered
from helpers import block_from
from solid_meshes import mesh, model_of, stiffness

import hpcred
from hpcred.body import stress
from hpcred.fe import ElementProperties, Material, solids
from hpcred.fe.element_rules import RULES, rule_of
from hpcred.fe.shape_functions import SOLIDS
from hpcred.fe.strain_matrices import elasticity, nodal_stress_matrices
from hpcred.parallel.shares import row_range

STEEL = Material(name="steel", young=2e11, poisson=0.3)
GRADIENT = np.array([[1e-3, 2e-3, 0.0], [4e-3, -2e-3, 1e-3], [3e-3, -1e-3, 5e-4]])
TYPES = [("CalculiX", name, kind) for name, kinds in RULES["CalculiX"].items() for kind in kinds]
TYPES += [("Abaqus", "C3D8", "hexahedron"), ("ANSYS", "SOLID185", "hexahedron"), ("Nastran", "CTETRA", "tetra10")]


def whole(comm, found):
    """Nodes and stresses of all ranks."""
    return (*gathered(comm, found.node), np.concatenate(comm.allgather(found.stress), axis=1))


def constant():
    """The stress of the displacements GRADIENT x."""
    strain = (GRADIENT + GRADIENT.T) / 2
    return elasticity(2e11, 0.3) @ [*np.diag(strain), *(2 * strain[[0, 1, 2], [1, 2, 0]])]


@pytest.mark.mpi
@pytest.mark.parametrize(("program", "type_", "kind"), TYPES)
def test_a_constant_stress_is_exact_on_distorted_meshes(comm, program, type_, kind):
    points, elements = mesh(kind, distortion=0.2)
    moved = (points @ GRADIENT.T).ravel()
    columns = np.stack([moved, 0 * moved, -2 * moved], axis=1)
    with model_of(kind, program, type_, points, elements, STEEL, comm) as model:
        block = block_from(model.K, columns)
        nodes, values = whole(comm, hpcred.stress_modes(model, block))
        block.destroy()
    assert nodes.tolist() == list(range(1, len(points) + 1))
    wanted = np.broadcast_to(constant(), values.shape[1:])
    assert np.allclose(values[0], wanted, rtol=1e-10, atol=1e-3) and not values[1].any()
    assert np.allclose(values[2], -2 * wanted, rtol=1e-10, atol=1e-3)


@pytest.mark.mpi
def test_linear_stresses_of_curved_kinds_are_exact_at_the_nodes(comm):
    """Quadratic displacements of straight elements, whose strains the extrapolation has at the nodes."""
    for kind, type_ in (("tetra10", "C3D10"), ("hexahedron20", "C3D20"), ("hexahedron20", "C3D20R")):
        points, elements = mesh(kind, distortion=0.0, size=(2.0, 1.0, 0.5))
        x, y, z = points.T
        moved = 1e-3 * np.stack([x * x + x * y, y * z - 2 * y * y, x * z + 0.5 * z * z], axis=1)
        strain = 1e-3 * np.stack([2 * x + y, z - 4 * y, x + z, x, y, z], axis=1)
        with model_of(kind, "CalculiX", type_, points, elements, STEEL, comm) as model:
            block = block_from(model.K, moved.reshape(-1, 1))
            _, values = whole(comm, hpcred.stress_modes(model, block))
            block.destroy()
        wanted = strain @ elasticity(2e11, 0.3)
        assert np.allclose(values[0], wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.mpi
def test_stresses_at_a_node_are_the_mean_of_its_elements(comm, monkeypatch):
    """Against a loop over elements; with few elements and columns at a time, and two materials."""
    monkeypatch.setattr(solids, "AT_ONCE", 3000)
    monkeypatch.setattr(stress, "WIDTH", 2)
    points, elements = mesh("hexahedron", cells=(3, 2, 2))
    columns = np.random.default_rng(7).standard_normal((3 * len(points), 5))
    soft = Material(name="soft", young=1e10, poisson=0.1)
    with model_of("hexahedron", "Abaqus", "C3D8", points, elements, STEEL, comm) as one:
        table = one.properties.table["hexahedron"].copy()
        table[:, 2] = table[:, 0] % 2
        properties = ElementProperties("Abaqus", ("C3D8",), (STEEL, soft), {"hexahedron": table})
        with one.with_fields(properties=properties) as model:
            block = block_from(model.K, columns)
            found = hpcred.stress_modes(model, block)
            nodes, values = whole(comm, found)
            few_nodes, few = whole(comm, hpcred.stress_modes(model, block, [5, 17, 5]))
            block.destroy()
    total, count = np.zeros((5, len(points), 6)), np.zeros(len(points))
    for number, element in enumerate(elements, 1):
        item = (STEEL, soft)[number % 2]
        matrices = nodal_stress_matrices("hexahedron", rule_of("Abaqus", "C3D8", "hexahedron"), points[element][None],
                                         elasticity(item.young, item.poisson))[0]  # fmt: skip
        rows = (3 * element[:, None] + np.arange(3)).ravel()
        for place, node in enumerate(element):
            total[:, node] += (matrices[place] @ columns[rows]).T
            count[node] += 1
    mean = total / count[:, None]
    assert np.allclose(values, mean, rtol=1e-10, atol=1e-10 * np.abs(mean).max())
    assert nodes.tolist() == list(range(1, len(points) + 1))
    assert few_nodes.tolist() == [5, 17] and np.allclose(few, values[:, [4, 16]], rtol=1e-12)
    assert found.source == ("hpcred, E B V at integration points of Abaqus, extrapolated and averaged: hexahedron of "
                            "soft, hexahedron of steel")  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize(("type_", "kind"), [("C3D20", "hexahedron20"), ("C3D20R", "hexahedron20")])
def test_bending_of_a_cantilever(comm, type_, kind):
    """sigma_xx = M z / I in the middle of a beam that a force at its end bends, with static correction as the basis."""
    length, width, height, force = 1.0, 0.05, 0.1, 1000.0
    points, elements = mesh(kind, cells=(12, 1, 2), size=(length, width, height), distortion=0.0)
    K = stiffness(kind, rule_of("CalculiX", type_, kind), points, elements, 2e11, 0.3)
    clamped = np.flatnonzero(points[:, 0] == 0)
    tip = np.flatnonzero(points[:, 0] == length)
    with model_of(kind, "CalculiX", type_, points, elements, STEEL, comm, K=K, held=clamped) as model:
        local = np.zeros((model.local_rows, 1))
        local[np.isin(model.dofs.node, tip + 1) & (model.dofs.direction == 2), 0] = 1 / len(tip)
        with (
            model.with_input_columns(local, ["tip"]) as loaded,
            hpcred.reduce(loaded, [hpcred.StaticCorrection()]) as rom,
        ):
            found = hpcred.stress_modes(loaded, rom.columns)
            nodes, values = whole(comm, found)
            q = np.linalg.solve(rom.K, rom.B[:, 0] * force)
        assert found.remarks == ()
    sigma = np.tensordot(q, values, axes=(0, 0))
    x, _, z = points[nodes - 1].T
    middle = np.isclose(x, length / 2)
    inertia = width * height**3 / 12
    wanted = -force * (length - x) * (z - height / 2) / inertia
    assert middle.sum() > 8
    assert np.allclose(sigma[middle, 0], wanted[middle], rtol=0, atol=5e-3 * wanted[middle].max())
    assert np.isclose(hpcred.body.von_mises(sigma[middle]).max(), np.abs(wanted[middle]).max(), rtol=0.02)


@pytest.mark.mpi
@pytest.mark.costly
def test_static_solutions_in_the_basis_make_stresses_near_loads_exact(comm):
    """Under a force at a corner; twenty modes alone miss most of it there, and little in the middle."""
    found = []
    with hpcred.solid((12, 3, 3), None, 3, comm=comm) as model:
        for basis in ([hpcred.StaticCorrection()], [hpcred.Modes(count=20)],
                      [hpcred.Modes(count=20), hpcred.StaticCorrection()]):  # fmt: skip
            with hpcred.reduce(model, basis) as rom:
                nodes, values = whole(comm, hpcred.stress_modes(model, rom.columns))
                found.append(np.tensordot(np.linalg.solve(rom.K, rom.B[:, 2]), values, axes=(0, 0)))
    layer = (nodes - 1) // 16  # along x, from the second one
    exact, modes, both = found
    scale = np.abs(exact).max()
    assert np.abs(both - exact).max() < 1e-9 * scale
    assert np.abs(modes - exact)[layer >= 10].max() > 0.5 * scale
    assert np.abs(modes - exact)[(layer > 2) & (layer < 8)].max() < 0.03 * scale


@pytest.mark.mpi
def test_held_nodes_do_not_move_and_have_a_stress(comm):
    """The same stresses with clamped nodes that have no rows as with rows that do not move."""
    points, elements = mesh("tetra", cells=(2, 1, 1))
    columns = np.random.default_rng(3).standard_normal((3 * len(points), 2))
    held = [0, 3]
    stuck = np.isin(np.arange(3 * len(points)) // 3, held)
    columns[stuck] = 0
    results = []
    for stuck_nodes, given in (([], columns), (held, columns[~stuck])):
        with model_of("tetra", "CalculiX", "C3D4", points, elements, STEEL, comm, held=stuck_nodes) as model:
            block = block_from(model.K, given)
            results.append(whole(comm, hpcred.stress_modes(model, block)))
            block.destroy()
    assert results[0][0].tolist() == results[1][0].tolist()
    assert np.allclose(results[0][1], results[1][1], rtol=1e-12)


@pytest.mark.mpi
@pytest.mark.costly
def test_sets_of_nodes(comm):
    with hpcred.crank(600, comm=comm) as model, hpcred.reduce(
        model.with_inputs([(1, "x")]), [hpcred.Modes(count=8)], hpcred.Buckens()
    ) as rom:
        nodes, values = whole(comm, hpcred.stress_modes(model, rom.columns))
        some, few = whole(comm, hpcred.stress_modes(model, rom.columns, ["SMALL_EYE", 1]))
        members = np.unique(np.concatenate(comm.allgather(model.sets["SMALL_EYE"])))
        assert some.tolist() == sorted({1, *members.tolist()})
        scale = np.abs(values).max()
        assert np.allclose(few, values[:, np.searchsorted(nodes, some)], rtol=0, atol=1e-12 * scale)
        with pytest.raises(hpcred.InputError, match=r"stress: crank has no node set 'EYE'; it has BIG_EYE, SMALL_EYE"):
            hpcred.stress_modes(model, rom.columns, ["EYE"])
        with pytest.raises(hpcred.InputError, match=r"stress: node 99999 of crank belongs to no solid element"):
            hpcred.stress_modes(model, rom.columns, [1, 99999])


@pytest.mark.mpi
def test_no_elements_are_missing_where_straight_ones_have_no_forces(comm):
    """Uniform strains give straight tetrahedra with ten nodes no forces at their corners, and K only round-off."""
    points, elements = mesh("tetra10", cells=(3, 2, 1), distortion=0.0)
    K = stiffness("tetra10", rule_of("CalculiX", "C3D10", "tetra10"), points, elements, 2e11, 0.3).tocoo()
    round_off = 1 + 1e-13 * np.sin(K.row * K.col)
    K = scipy.sparse.csr_array((K.data * round_off, (K.row, K.col)), K.shape)
    with model_of("tetra10", "CalculiX", "C3D10", points, elements, STEEL, comm, K=K) as model:
        assert solids.Solids(model).warnings() == []
        kept = elements[points[elements, 0].max(axis=1) < 0.7] + 1  # two of three layers
        share = {"tetra10": kept[slice(*row_range(comm, len(kept)))]}
        middles = np.isclose(points[elements[:, :4].max() + 1 :, 0], 2 / 3).sum()
        properties = ElementProperties.of_one(comm, share, STEEL)
        with model.with_fields(elements=share, properties=properties, held=None) as lacking:
            (remark,) = solids.Solids(lacking).warnings()
            assert f"are not those of K at {middles} nodes" in remark


@pytest.mark.mpi
@pytest.mark.costly
def test_energy_of_other_materials_is_noticed(comm):
    with hpcred.crank(600, comm=comm) as model, hpcred.reduce(
        model.with_inputs([(1, "x")]), [hpcred.Modes(count=8)], hpcred.Buckens()
    ) as rom:
        assert hpcred.stress_modes(model, rom.columns).remarks == ()
        other = Material(name="aluminium", young=0.7e11, poisson=0.3)
        with model.with_material(other) as light:
            (remark,) = hpcred.stress_modes(light, rom.columns).remarks
            assert re.search(r"strain energy of the solid elements is 0.3333 of that of K", remark)
            assert hpcred.stress_modes(light, rom.columns, [1]).remarks == ()


@pytest.mark.mpi
def test_elements_with_nodes_without_rows_are_left_out(comm):
    points, elements = mesh("hexahedron", cells=(3, 1, 1))
    with model_of("hexahedron", "CalculiX", "C3D8", points, elements, STEEL, comm) as whole_model:
        cells = whole_model.elements["hexahedron"].copy()
        cells[cells == 1] = 99
        with whole_model.with_fields(elements={"hexahedron": cells}) as model:
            block = block_from(model.K, (points @ GRADIENT.T).reshape(-1, 1))
            found = hpcred.stress_modes(model, block)
            nodes, values = whole(comm, found)
            block.destroy()
            lonely, other = (hpcred.outputs.StressOutput(node=int(node) + 1, stress="xx")
                             for node in (elements[0, 3], elements[2, 1]))  # fmt: skip
            with pytest.raises(hpcred.InputError, match=r"outputs: node \d+ of .* has no stress, since its elements"):
                model.with_outputs([other, lonely])
    there = sorted(set(elements[1:].ravel() + 1))
    assert nodes.tolist() == there and np.allclose(values[0], constant(), rtol=1e-10, atol=1e-3)
    assert any("stress: elements at 1 nodes that have no row" in remark for remark in found.remarks)


def refusal(comm, kind, program, type_, material, nodes=None, **changed):
    points, elements = mesh(kind, distortion=0.0)
    with model_of(kind, program, type_, points, elements, material, comm, name="body") as made, made.with_fields(
        **changed
    ) as model:
        block = block_from(model.K, np.ones((3 * len(points), 1)))
        with pytest.raises(hpcred.InputError) as error:
            hpcred.stress_modes(model, block, nodes)
        block.destroy()
    return str(error.value)


@pytest.mark.mpi(build="real")
def test_what_cannot_be_computed_is_refused_by_name(comm):
    plastic = Material(name="mild", density=7850.0, reason="found *Plastic")
    text = refusal(comm, "hexahedron", "CalculiX", "C3D8I", STEEL)
    assert "body: stress: found elements C3D8I of CalculiX (hexahedron), whose stresses are not those" in text
    assert "`hpcred recover --deck`" in text
    assert "elements CHEXA of Nastran (hexahedron)" in refusal(comm, "hexahedron", "Nastran", "CHEXA", STEEL)
    text = refusal(comm, "tetra10", "CalculiX", "C3D10", plastic)
    assert "found elements C3D10 of the material 'mild' (found *Plastic), expected Young's modulus" in text
    assert "elements whose types and materials are not known" in refusal(comm, "tetra", "CalculiX", "C3D4", STEEL,
                                                                          properties=None)  # fmt: skip
    assert "body: stress: found no elements, expected solids (tetra, tetra10," in refusal(
        comm, "tetra", "CalculiX", "C3D4", STEEL, elements={}, properties=None
    )
    bare = ElementProperties("CalculiX", ("C3D4",), (), {"tetra": np.zeros((0, 3), int)})
    assert "expected solids" in refusal(comm, "tetra", "CalculiX", "C3D4", STEEL, properties=bare, elements={
        "quad": np.array([[1, 2, 3, 4]])})  # fmt: skip


@pytest.mark.mpi
def test_models_without_nodes_are_refused(comm):
    K = scipy.sparse.eye(4, format="csr")
    with hpcred.SecondOrderModel.from_scipy(K, K, comm=comm) as model:
        block = block_from(model.K, np.ones((4, 1)))
        with pytest.raises(hpcred.InputError, match=r"no node coordinates, which a stress needs"):
            hpcred.stress_modes(model, block)
        block.destroy()


def test_von_mises_of_known_states():
    assert np.allclose(hpcred.body.von_mises([[3.0, 0, 0, 0, 0, 0], [2, 2, 2, 0, 0, 0]]), [3, 0])
    assert np.allclose(hpcred.body.von_mises([[0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, -1]]), 3**0.5)
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    tensor = rng.standard_normal((3, 3))
    tensor += tensor.T
    states = [np.array([*np.diag(t), t[0, 1], t[1, 2], t[2, 0]]) for t in (tensor, turn @ tensor @ turn.T)]
    assert np.isclose(*hpcred.body.von_mises(states))


def test_all_kinds_of_solids_are_tested():
    assert {kind for _, _, kind in TYPES} == set(SOLIDS)
