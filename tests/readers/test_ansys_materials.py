"""Materials and types of elements in archives of ANSYS."""

import pytest
from ansys_files import archive, element
from foreign import gathered, write
from shared_data import unpacked

import hpcred
from hpcred.fe.materials import Material
from hpcred.readers.ansys import cdb

pytestmark = pytest.mark.mpi(build="real")

PLACES = {number: (float(number), 0.0, 0.0) for number in range(1, 30)}
STEEL = """MPTEMP,R5.0, 1, 1,  0.00000000    ,
MPDATA,R5.0, 1,EX  ,       1, 1, 2.100000000E+11,
MPTEMP,R5.0, 1, 1,  0.00000000    ,
MPDATA,R5.0, 1,NUXY,       1, 1, 0.300000000    ,
MPDATA,R5.0, 1,DENS,       1, 1,  7850.00000    ,
MPDATA,R5.0, 1,ALPX,       1, 1, 1.200000000E-05,
"""


def solids(path, comm):
    """Type and material by kind and number of the element, and the Archive."""
    found = {}
    mesh = cdb.read(path, comm)
    for kind, table in mesh.properties.table.items():
        assert len(table) == len(mesh.elements[kind])
        for number, type_, material in gathered(comm, table)[0].tolist():
            name = mesh.properties.materials[material].name if material >= 0 else None
            found[kind, number] = mesh.properties.types[type_], name
    return found, mesh


def with_elements(lines, head="", materials=STEEL):
    """The text of an archive with elements (type, number, nodes, material)."""
    blocks = "".join(element(type_, number, nodes).replace(f"{1:9d}", f"{material:9d}", 1)
                     for type_, number, nodes, material in lines)  # fmt: skip
    text = archive(PLACES, elements=f"EBLOCK,19,SOLID,{len(lines):10d},{len(lines):10d}\n(19i9)\n{blocks}{-1:9d}\n")
    return text.replace("FINISH", f"{materials}FINISH").replace("ET,2,181\n", head or "ET,2,181\n")


def test_types_and_materials_of_elements(comm, folder, monkeypatch):
    lines = [
        (1, 11, range(1, 9), 1), (1, 12, [1, 2, 3, 3, 5, 5, 5, 5], 1), (3, 13, range(1, 21), 2),
        (2, 14, [4, 5, 6, 7], 1), (3, 15, range(2, 22), 7), (4, 16, range(1, 11), 1),
    ]  # fmt: skip
    head = "ET,2,181\nET,3,SOLID186\nET,4,187\nKEYOPT,3,2,1\nKEYOP,1,1,5\nKEYOPT,4,6,0\n"
    text = with_elements(lines, head, f"{STEEL}MP,EX,2,7e10 ! aluminium\nMP,PRXY,2,.33\nMP,EX,3,1.\n")
    wanted = {
        ("hexahedron", 11): ("SOLID185", "MAT 1"), ("tetra", 12): ("SOLID185", "MAT 1"),
        ("hexahedron20", 13): ("SOLID186 KEYOPT(2)=1", "MAT 2"), ("quad", 14): ("SHELL181", "MAT 1"),
        ("hexahedron20", 15): ("SOLID186 KEYOPT(2)=1", None), ("tetra10", 16): ("SOLID187", "MAT 1"),
    }  # fmt: skip
    for size in (2**21, 300):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        for content in (text, text.replace("\n", "\r\n")):
            found, mesh = solids(write(folder / "a.cdb", content, comm), comm)
            assert found == wanted and not mesh.remarks
            assert mesh.properties.program == "ANSYS"
            assert mesh.properties.materials == (
                Material(name="MAT 1", young=2.1e11, poisson=0.3, density=7850.0, expansion=1.2e-5),
                Material(name="MAT 2", young=7e10, poisson=0.33),
            )
            comm.Barrier()


def test_key_options_of_a_block_of_types(comm, folder):
    types = f"ETBLOCK,{2:9d},{2:9d}\n(2i9,19a9)\n" + f"{1:9d}{185:9d}{0:9d}{3:9d}\n{2:9d}{181:9d}{0:9d}\n{-1:9d}\n"
    text = with_elements([(1, 1, range(1, 9), 1)]).replace("ET,        1,185\nET,2,181\n", types)
    assert solids(write(folder / "a.cdb", text, comm), comm)[0] == {
        ("hexahedron", 1): ("SOLID185 KEYOPT(2)=3", "MAT 1")}  # fmt: skip


@pytest.mark.parametrize(("lines", "wanted", "remark"), [
    ("MP,EX,1,2e11\n", {"young": 2e11, "poisson": 0.3}, ""),
    ("UIMP,1,EX  , , ,2.0D+11,\nUIMP,1,NUXY, , ,.25,\n", {"young": 2e11, "poisson": 0.25}, ""),
    ("MPDATA,EX,1,,2e11\n", {"young": 2e11}, ""),
    ("MPDATA,EX,1,1,2e11,1e11\n", {"young": 2e11}, "EX of the material 1 have several temperatures; the first one"),
    ("MPDATA,R5.0, 2,EX,1,1,2e11,1e11\nMPDATA,R5.0,2,EX,1,7,3e11\n", {"young": 2e11}, "EX of the material 1"),
    ("MP,EX,1,2e11,-1e7\n", {"young": 2e11}, "EX of the material 1"),
    ("MP,EX,1,2e11\nMP,EY,1,1e11\n", {"reason": "found EY", "young": None}, ""),
    ("MP,EX,1,2e11\nTB,BISO,1,1,2,\nTBDATA,,2e8,1e9\n", {"reason": "found TB,BISO", "young": None}, ""),
    ("MP,EX,1,2e11\nTB,SDAMP,1\n", {"young": 2e11}, ""), ("MP,DENS,1,7850\n", {"reason": "found no EX"}, ""),
    ("MP,EX,1,E0\n", {"reason": "found EX 'E0', expected a number"}, ""),
    ("MP,EX,1,-1\n", {"reason": "young: found -1, expected a positive modulus in Pa"}, ""),
])  # fmt: skip
def test_constants(comm, folder, lines, wanted, remark):
    _, mesh = solids(write(folder / "a.cdb", with_elements([(1, 1, range(1, 9), 1)], "", lines), comm), comm)
    (item,) = mesh.properties.materials
    assert {key: getattr(item, key) for key in wanted} == wanted
    assert len(mesh.remarks) == bool(remark) and all(remark in text and "a.cdb" in text for text in mesh.remarks)


def test_the_beam_of_pymapdl(comm, folder):
    with hpcred.readers.load_export(unpacked(comm, folder, "ansys/HexBeam.full", "ansys/HexBeam.cdb"), comm) as model:
        assert model.properties.types == ("SOLID186",)
        assert model.properties.materials == (Material(name="MAT 1", young=7e10, poisson=0.35, density=2700.0),)
