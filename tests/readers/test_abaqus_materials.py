"""Materials of Abaqus and CalculiX input files, and the elements that they are given to."""

import numpy as np
import pytest
from foreign import gathered, write

from hpcred.fe.materials import Material
from hpcred.readers.abaqus.input_file import read

pytestmark = pytest.mark.mpi(build="real")

STEEL = Material(name="steel", young=2.1e5, poisson=0.3, density=7.85e-9, expansion=1.2e-5)
NODES = "*Node\n" + "".join(f"{k}, {k % 5}., {k % 3}., {k}.\n" for k in range(1, 13))
MATERIALS = """*Material, name=Steel
*Density
 7.85E-9,
*Elastic
2.1d5, .3
*Expansion, zero=20.
1.2E-5,
"""


def assigned(path, comm, calculix=False):
    """Type and material by kind and number of the element, and the Mesh."""
    mesh = read(path, comm, calculix)
    properties, found = mesh.properties, {}
    for kind, table in properties.table.items():
        table = gathered(comm, table)[0]
        assert comm.allreduce(len(mesh.elements[kind])) == len(table)
        for number, type_, material in table.tolist():
            name = properties.materials[material].name if material >= 0 else None
            found.setdefault((kind, number), []).append((properties.types[type_], name))
    return found, mesh


def test_a_part_with_internal_sets_and_two_instances(comm, folder, monkeypatch):
    """As Abaqus/CAE writes sections; elements of two instances have the same numbers."""
    part = (
        f"*Part, name=rod\n{NODES}*Element, type=C3D4\n1, 1, 2, 3, 4\n2, 3, 4, 5, 6\n"
        "*Element, type=C3D8R, elset=bricks\n7, 1, 2, 3, 4, 5, 6, 7, 8\n"
        "*Elset, elset=_Picked2, internal, generate\n 1, 2, 1\n"
        "*Solid Section, elset=_Picked2, material=STEEL\n1.,\n*Solid Section, elset=bricks, material=soft\n,\n"
        "*End Part\n"
    )
    other = part.replace("name=rod", "name=bar").replace("material=STEEL", "material=soft")
    for k in range(12, 0, -1):
        other = other.replace(f"\n{k}, {k % 5}.", f"\n{k + 20}, {k % 5}.")
    other = other.replace("1, 1, 2, 3, 4\n2, 3, 4, 5, 6", "1, 21, 22, 23, 24\n2, 23, 24, 25, 26").replace(
        "7, 1, 2, 3, 4, 5, 6, 7, 8", "7, 21, 22, 23, 24, 25, 26, 27, 28"
    )
    text = (
        f"{part}{other}*Assembly, name=A\n*Instance, name=r-1, part=rod\n*End Instance\n*Instance, name=b-1, part=bar\n"
        f"*End Instance\n*End Assembly\n{MATERIALS}*Material, name=soft\n*Elastic\n1000., 0.4\n*Step\n*Static\n"
        "*End Step\n"
    )
    for size in (2**21, 16):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        found, mesh = assigned(write(folder / "a.inp", text, comm), comm)
        assert sorted(found["tetra", 1]) == [("C3D4", "Steel"), ("C3D4", "soft")]
        assert sorted(found["tetra", 2]) == [("C3D4", "Steel"), ("C3D4", "soft")]
        assert found["hexahedron", 7] == [("C3D8R", "soft")] * 2
        assert mesh.properties.program == "Abaqus" and not mesh.remarks
        assert mesh.properties.materials[0] == Material(**(vars(STEEL) | {"name": "Steel"}))
        assert set(mesh.sets) == {"elements of r-1.bricks", "elements of b-1.bricks"}
        comm.Barrier()


def test_calculix_with_nested_sets(comm, folder):
    text = (
        f"{NODES}*ELEMENT, TYPE=C3D4, ELSET=A\n1, 1, 2, 3, 4\n2, 3, 4, 5, 6\n3, 6, 7, 8, 9\n*ELEMENT, TYPE=C3D10\n"
        "4, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10\n*ELSET, ELSET=ALL\nA, 4\n*ELSET, ELSET=SOME, GENERATE\n3, 4\n"
        f"{MATERIALS}*SOLID SECTION, ELSET=all, MATERIAL=steel\n*MATERIAL, NAME=ALU\n*ELASTIC, TYPE=ISO\n70000., 0.33\n"
        "*SOLID SECTION, MATERIAL=alu, ELSET=SOME\n*MATERIAL,NAME=UNUSED\n*ELASTIC\n1., 0.\n"
    )
    found, mesh = assigned(write(folder / "a.inp", text, comm), comm, calculix=True)
    assert found == {
        ("tetra", 1): [("C3D4", "Steel")], ("tetra", 2): [("C3D4", "Steel")], ("tetra", 3): [("C3D4", "ALU")],
        ("tetra10", 4): [("C3D10", "ALU")],
    }  # fmt: skip
    assert mesh.properties.program == "CalculiX"
    assert [item.name for item in mesh.properties.materials] == ["Steel", "ALU"]


@pytest.mark.parametrize(("lines", "wanted"), [
    ("*Elastic, type=ORTHO\n1., 2., 3.\n", "found *Elastic, type=ORTHO"),
    ("*Elastic\n2e5, 0.3\n*Plastic\n100., 0.\n", "found *Plastic"),
    ("*Hyperelastic, neo hooke\n1., 0.1\n", "found *Hyperelastic"),
    ("*Elastic\n2e5, 0.3\n*Depvar\n3\n*User Material, constants=1\n1.\n", "found *Depvar; found *Usermaterial"),
    ("*Density\n1.\n", "found no *Elastic"),
    ("*Elastic\n", "found *Elastic with '', expected Young's modulus and Poisson's ratio"),
    ("*Elastic\n<E>, 0.3\n", "found *Elastic with '<E>, 0.3', expected Young's modulus and Poisson's ratio"),
    ("*Elastic\n2e5\n", "found *Elastic with '2e5', expected Young's modulus and Poisson's ratio"),
    ("*Elastic\n2e5, 0.5\n", "poisson: found 0.5, expected more than -1 and less than 0.5"),
    ("*Elastic\n-2e5, 0.3\n", "young: found -200000, expected a positive modulus in Pa"),
    ("*Elastic\n2_000, 0.3\n", "found *Elastic with '2_000, 0.3', expected Young's modulus and Poisson's ratio"),
])  # fmt: skip
def test_materials_that_are_not_isotropic_and_linear_have_a_reason(comm, folder, lines, wanted):
    text = (
        f"{NODES}*Element, type=C3D4, elset=a\n1, 1, 2, 3, 4\n*Solid Section, elset=a, material=m\n*Material, name=m\n"
        f"{lines}*Step\n*Elastic\n1., 0.\n"
    )
    found, mesh = assigned(write(folder / "a.inp", text, comm), comm)
    assert found == {("tetra", 1): [("C3D4", "m")]}
    (item,) = mesh.properties.materials
    assert not item.isotropic and item.reason == wanted and item.young is None


def test_sections_without_a_known_material(comm, folder):
    text = (
        f"{NODES}*Element, type=C3D4\n1, 1, 2, 3, 4\n2, 1, 2, 3, 5\n3, 1, 2, 3, 6\n"
        "*Elset, elset=a\n1\n*Elset, elset=b\n2\n"
        "*Solid Section, elset=a, composite\n1., 3, m\n*Solid Section, elset=b, material=gone\n"
        "*Solid Section, elset=nowhere, material=gone\n"
    )
    found, mesh = assigned(write(folder / "a.inp", text, comm), comm)
    assert found["tetra", 3] == [("C3D4", None)] and found["tetra", 2] == [("C3D4", "gone")]
    assert [item.reason for item in mesh.properties.materials] == [
        "found *Solid Section with COMPOSITE", "found no *Material of this name"]  # fmt: skip


def test_the_first_line_of_a_table_of_temperatures_counts(comm, folder):
    text = (
        f"{NODES}*Element, type=C3D4, elset=a\n1, 1, 2, 3, 4\n*Solid Section, elset=a, material=m\n*Material, name=m\n"
        "*Elastic\n** at room temperature\n2e5, 0.3, 20.\n1e5, 0.3, 500.\n*Expansion, type=ORTHO\n1e-5, 1e-5, 2e-5\n"
    )
    _, mesh = assigned(write(folder / "a.inp", text, comm), comm)
    assert mesh.properties.materials == (Material(name="m", young=2e5, poisson=0.3),)
    (remark,) = mesh.remarks
    assert "*Elastic of the material 'm' has 2 lines, such as for several temperatures; the first one counts" in remark


def test_shells_and_beams_have_types_and_no_material(comm, folder):
    text = f"{NODES}*Element, type=S4R\n1, 1, 2, 3, 4\n*Element, type=B31\n2, 1, 2\n*Element, type=MASS\n3, 1\n"
    found, mesh = assigned(write(folder / "a.inp", text, comm), comm)
    assert found == {("quad", 1): [("S4R", None)], ("line", 2): [("B31", None)]}
    assert mesh.properties.types == ("S4R", "B31") and mesh.properties.materials == ()
    assert all(table.dtype == np.int64 for table in mesh.properties.table.values())
