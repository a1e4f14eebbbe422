"""Materials and types of elements: ranges, units, files and words."""

import json

import h5py
import numpy as np
import pytest
from foreign import gathered

import hpcred
from hpcred.fe import ElementProperties, Material
from hpcred.fe.materials import MATERIAL, NUMBER, TYPE, check_properties, material_of
from hpcred.model.material_stiffness import _row_norms
from hpcred.parallel.shares import row_range

STEEL = Material(name="steel", young=2.1e11, poisson=0.3, density=7850.0, expansion=1.2e-5)
FOAM = Material(name="Schaum µ", density=30.0, reason="found *Hyperfoam")


@pytest.mark.parametrize(("constants", "says"), [
    ({"young": 0.0}, r"material 'x': young: found 0, expected a positive modulus in Pa"),
    ({"poisson": 0.5}, r"poisson: found 0.5, expected more than -1 and less than 0.5"),
    ({"density": -1.0}, r"density: found -1, expected at least 0"), ({"young": np.nan}, r"young: found nan"),
    ({"expansion": np.inf}, r"expansion: found inf, expected a finite number in 1/K"),
])  # fmt: skip
def test_constants_out_of_range_are_refused(constants, says):
    with pytest.raises(hpcred.InputError, match=says):
        Material(name="x", **constants)
    item = material_of("x", **constants)
    assert not item.isotropic and "expected" in item.reason


def two_types(comm):
    """Two bricks and a tetrahedron of two materials, on nodes 1 to 14."""
    nodes = np.arange(1, 15)
    position = np.repeat(np.random.default_rng(0).random((14, 3)), 3, axis=0)
    dofs = hpcred.Dofs(np.repeat(nodes, 3), np.tile(np.arange(3), 14), position)
    share = slice(*row_range(comm, 2))
    elements = {"hexahedron": np.array([np.arange(1, 9), np.arange(5, 13)])[share],
                "tetra": np.array([[11, 12, 13, 14]])[slice(*row_range(comm, 1))]}  # fmt: skip
    table = {"hexahedron": np.array([[7, 0, 1], [9, 1, -1]])[share],
             "tetra": np.array([[8, 2, 0]])[: len(elements["tetra"])]}  # fmt: skip
    properties = ElementProperties("CalculiX", ("C3D8", "C3D8R", "C3D4"), (STEEL, FOAM), table)
    return hpcred.SecondOrderModel.from_scipy(
        np.eye(42), np.eye(42), comm=comm, dofs=dofs, elements=elements, properties=properties
    )


def compared(comm, properties):
    assert properties.program == "CalculiX" and properties.types == ("C3D8", "C3D8R", "C3D4")
    assert gathered(comm, properties.table["hexahedron"])[0].tolist() == [[7, 0, 1], [9, 1, -1]]
    assert gathered(comm, properties.table["tetra"])[0].tolist() == [[8, 2, 0]]


@pytest.mark.mpi
def test_properties_are_kept_by_files_and_models(comm, folder):
    with two_types(comm) as model:
        hpcred.write_model(folder / "a.h5", model)
    with hpcred.read_model(folder / "a.h5", comm) as model, model.with_inputs([(3, "x")]) as loaded:
        compared(comm, loaded.properties)
        assert loaded.properties.materials == (STEEL, FOAM)
        report = hpcred.inspect(loaded)
        assert report["element_types"] == {"C3D8": 1, "C3D8R": 1, "C3D4": 1}
        assert report["materials"] == {
            "steel": "E = 2.1e+11 Pa, nu = 0.3, density = 7850 kg/m^3, expansion = 1.2e-05 1/K",
            "Schaum µ": "density = 30 kg/m^3, not isotropic and linear: found *Hyperfoam",
        }
        with hpcred.reduce(loaded, [hpcred.StaticCorrection()]) as rom:
            hpcred.write_result(folder / "r.h5", rom, loaded)
    if comm.rank == 0:
        with h5py.File(folder / "r.h5") as file:
            assert file["element_properties/hexahedron"][...].tolist() == [[7, 0, 1], [9, 1, -1]]
            steel, foam = json.loads(file["materials"][()])
            assert steel["young"] == STEEL.young and foam["young"] is None and foam["reason"] == FOAM.reason


@pytest.mark.mpi
def test_units_of_materials(comm):
    with two_types(comm) as model, hpcred.model.in_si(model, hpcred.model.units_of("mm,t,s")) as converted:
        steel, foam = converted.properties.materials
        assert steel.young == pytest.approx(2.1e17) and steel.density == pytest.approx(7850e12)
        assert (steel.poisson, steel.expansion) == (0.3, 1.2e-5) and foam.density == pytest.approx(30e12)
        compared(comm, converted.properties)


@pytest.mark.mpi
def test_a_material_for_all_elements(comm):
    with two_types(comm) as model, model.with_material(FOAM) as other:
        assert other.properties.materials == (FOAM,) and other.properties.types == model.properties.types
        for kind, part in other.properties.table.items():
            assert (part[:, MATERIAL] == 0).all() and (part[:, TYPE] == model.properties.table[kind][:, TYPE]).all()
        compared(comm, model.properties)
        with model.with_fields(properties=None) as bare, bare.with_material(STEEL) as plain:
            assert plain.properties.types == ("hexahedron", "tetra")
            assert gathered(comm, plain.properties.table["hexahedron"])[0].tolist() == [[1, 0, 0], [2, 0, 0]]
        with pytest.raises(hpcred.InputError, match=r"material: found 'steel', expected Material"):
            model.with_material("steel")


@pytest.mark.mpi
def test_examples_know_their_materials(comm):
    with hpcred.solid((3, 2, 1), comm=comm, young=7e10) as block, hpcred.crank(600, comm=comm) as crank:
        for model, young in ((block, 7e10), (crank, 2.1e11)):
            table = model.properties.table["hexahedron"]
            numbers = gathered(comm, table[:, NUMBER])[0]
            assert numbers.tolist() == list(range(1, len(numbers) + 1))
            assert len(table) == len(model.elements["hexahedron"])
            assert model.properties.materials[0].young == young and model.properties.types == ("hexahedron",)


@pytest.mark.parametrize(("table", "says"), [
    ({}, r"from_.*: element properties: found none of tetra, expected \(1, 3\)"),
    ({"tetra": np.zeros((2, 3), int)}, r"found an array \(2, 3\) of tetra"),
    ({"tetra": np.array([[1, 1, 0]])}, r"found the type 1 of tetra, expected less than 1"),
    ({"tetra": np.array([[1, 0, 4]])}, r"found the material 4 of tetra, expected less than 1"),
])  # fmt: skip
def test_properties_of_other_elements_are_refused(table, says):
    properties = ElementProperties("Abaqus", ("C3D4",), (STEEL,), table)
    with pytest.raises(hpcred.InputError, match=says):
        hpcred.SecondOrderModel.from_scipy(
            np.eye(3), np.eye(3), name="from_scipy", elements={"tetra": np.array([[1, 2, 3, 4]])}, properties=properties
        )


@pytest.mark.parametrize(("column", "place", "says"), [(TYPE, 2, "the type 2"), (MATERIAL, 1, "the material 1")])
def test_a_place_beyond_the_names_is_refused_whatever_the_others_are(column, place, says):
    table = np.array([[1, 0, -1], [2, 1, 0], [3, 0, 0]])
    elements = {"tetra": np.ones((3, 4), int)}
    properties = ElementProperties("hpcred", ("a", "b"), (STEEL,), {"tetra": table})
    check_properties(properties, elements, "m")
    table[1, column] = place
    with pytest.raises(hpcred.InputError, match=says):
        check_properties(properties, elements, "m")


def test_norms_of_rows():
    """The Euclidean ones."""
    K = np.array([[3.0, 4.0, 0.0], [4.0, 9.0, 0.0], [0.0, 0.0, 2.0]])
    with hpcred.SecondOrderModel(np.eye(3), None, K) as model:
        assert np.allclose(_row_norms(model.K), [5.0, 97**0.5, 2.0])
