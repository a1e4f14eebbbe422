"""Matrices B and E B: constant strains, and the stiffness of other programs and of other code."""

import shutil

import numpy as np
import pytest
import scipy.sparse
from conftest import DATA
from fe_data import FE, needs_fe
from foreign import unpack
from shared_data import unpacked
from solid_meshes import PARTS, mesh, stiffness

import hpcred
from hpcred.fe.element_rows import element_rows
from hpcred.fe.element_rules import B_BAR, FULL, REDUCED, RULES, UNIFORM, rule_of
from hpcred.fe.shape_functions import SOLIDS
from hpcred.fe.strain_matrices import elasticity, nodal_stress_matrices, stiffness_matrices, strain_matrices

RULED = [(kind, FULL) for kind in SOLIDS] + [
    ("hexahedron", REDUCED), ("hexahedron", UNIFORM), ("hexahedron", B_BAR), ("hexahedron20", REDUCED)
]  # fmt: skip


def tensor_of(strain):
    """Gradient of displacements with a rotation, of strains xx, yy, zz, gamma xy, yz, zx."""
    xx, yy, zz, xy, yz, zx = strain
    return np.array([[xx, 0.7 * xy, 0.2 * zx], [0.3 * xy, yy, yz], [0.8 * zx, 0.0, zz]])


@pytest.mark.parametrize(("kind", "rule"), RULED)
def test_constant_strains_of_distorted_elements(kind, rule):
    points, elements = mesh(kind, distortion=0.2)
    B, volumes = strain_matrices(kind, rule, points[elements])
    strain = np.array([1e-3, -2e-3, 3e-3, 4e-3, -5e-3, 6e-3])
    moved = (points @ tensor_of(strain).T)[elements].reshape(len(elements), -1)
    assert np.allclose(np.einsum("egia,ea->egi", B, moved), strain, atol=1e-15)
    elastic = elasticity(2e11, 0.3)
    stress = np.einsum("ekia,ea->eki", nodal_stress_matrices(kind, rule, points[elements], elastic), moved)
    assert np.allclose(stress, elastic @ strain, rtol=1e-11)
    assert (volumes > 0).all()


@pytest.mark.parametrize("kind", PARTS)
def test_volumes_fill_the_body(kind):
    points, elements = mesh(kind, distortion=0.0, size=(2.0, 1.0, 0.5))
    for rule in (FULL, B_BAR) if kind == "hexahedron" else (FULL,):
        assert np.isclose(strain_matrices(kind, rule, points[elements])[1].sum(), 1.0)


@pytest.mark.parametrize(("kind", "rule"), RULED)
def test_stiffness_has_rigid_motions_and_the_energy_of_a_constant_strain(kind, rule):
    points, elements = mesh(kind, distortion=0.2)
    K = stiffness(kind, rule, points, elements, 2e11, 0.3)
    assert abs(K - K.T).max() < 1e-14 * abs(K).max()
    turned = np.cross([0.3, -0.5, 0.7], points) + [1.0, 2.0, 3.0]
    assert np.abs(K @ turned.ravel()).max() < 1e-13 * abs(K).max()
    strain = np.array([1e-3, -2e-3, 3e-3, 4e-3, -5e-3, 6e-3])
    moved = (points @ tensor_of(strain).T).ravel()
    volume = strain_matrices(kind, rule, points[elements])[1].sum()
    assert np.isclose(moved @ (K @ moved), volume * strain @ elasticity(2e11, 0.3) @ strain, rtol=1e-12)


def test_components_of_hookes_law():
    elastic = elasticity(2e11, 0.25)
    tension = np.linalg.solve(elastic, [1.0, 0, 0, 0, 0, 0])
    assert np.allclose(tension * 2e11, [1, -0.25, -0.25, 0, 0, 0])
    assert np.allclose(np.linalg.solve(elastic, np.eye(6)[3]), 2 * 1.25 / 2e11 * np.eye(6)[3])


def difference(model, rules, young, poisson):
    """||K of the elements - K|| / ||K|| of a model on one rank, by the rules of its kinds."""
    indptr, indices, values = model.K.getValuesCSR()
    K = scipy.sparse.csr_array((values.real, indices, indptr), (model.size, model.size))
    total = -K
    for kind, elements in element_rows(model).items():
        rows = elements.rows.reshape(len(elements.rows), -1)
        blocks = stiffness_matrices(kind, rules[kind], elements.position, elasticity(young, poisson))
        i, j = (np.broadcast_to(ends, blocks.shape) for ends in (rows[:, :, None], rows[:, None, :]))
        there = (i >= 0) & (j >= 0)
        total += scipy.sparse.coo_array((blocks[there], (i[there], j[there])), K.shape).tocsr()
    return scipy.sparse.linalg.norm(total) / scipy.sparse.linalg.norm(K)


@pytest.mark.parametrize("name", ["C3D8", "C3D10"])
def test_stiffness_of_abaqus(tmp_path, comm, name):
    unpacked(comm, tmp_path, f"block{name}_STIF1.mtx", f"block{name}_MASS1.mtx")
    with hpcred.readers.load_export(shutil.copy(DATA / f"block{name}.inp", tmp_path)) as model:
        (kind,) = model.elements
        assert difference(model, {kind: rule_of("Abaqus", name, kind)}, 2e11, 0.3) < 1e-14
        if name == "C3D8":  # it is not the one without B-bar
            assert difference(model, {kind: FULL}, 2e11, 0.3) > 0.1


def test_stiffness_of_calculix(tmp_path, comm):
    with hpcred.readers.load_export(unpack(tmp_path, comm, "calculix") / "quadratic.inp") as model:
        assert difference(model, {"hexahedron20": FULL, "wedge15": FULL}, 2.1e11, 0.3) < 1e-13


def test_stiffness_of_ansys(tmp_path, comm):
    with hpcred.readers.load_export(unpacked(comm, tmp_path, "ansys/HexBeam.full", "ansys/HexBeam.cdb")) as model:
        rule = rule_of("ANSYS", "SOLID186", "hexahedron20")
        # the archive has the mesh, and the material of another run (7e10, 0.35)
        assert difference(model, {"hexahedron20": rule}, 16.9e6, 0.31) < 1e-12


@needs_fe
def test_stiffness_of_solid185(tmp_path, comm):
    path = unpacked(comm, tmp_path, "ansys/rotorAnsys.full", "ansys/rotorAnsys.rst")
    _, *lines = (FE / "ansys" / "rotor" / "rotorAnsysElements.txt").read_text().splitlines()
    elements = np.array([line.split()[2:] for line in lines if line.strip()], int)
    rule = rule_of("ANSYS", "SOLID185", "hexahedron")
    with (
        hpcred.readers.load_export(path) as bare,
        bare.with_fields(elements={"hexahedron": elements}) as model,
    ):
        assert difference(model, {"hexahedron": rule}, 2.1e9, 0.3) < 1e-12


def test_stiffness_of_the_examples():
    with hpcred.crank(600) as crank, hpcred.solid((3, 2, 2), None, 3, False) as block:
        for model in (crank, block):
            assert difference(model, {"hexahedron": FULL}, 2.1e11, 0.3) < 1e-14


def test_rules_belong_to_solids():
    for types in RULES.values():
        for kinds in types.values():
            assert set(kinds) <= set(SOLIDS)
    assert rule_of("CalculiX", "C3D8I", "hexahedron") is None and rule_of("Kratos", "C3D8", "hexahedron") is None
