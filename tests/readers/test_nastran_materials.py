"""Materials of solids in input files of Nastran."""

import pytest
from foreign import gathered, write

from hpcred import InputError
from hpcred.fe.materials import Material
from hpcred.readers.nastran import bulk

pytestmark = pytest.mark.mpi(build="real")

GRIDS = "".join(f"GRID,{k},,{k % 5}.,{k % 3}.,{k}.\n" for k in range(1, 21))
SOLIDS = """CTETRA,1,7,1,2,3,4
CTETRA,2,8,1,2,3,4,5,6
,7,8,9,10
CHEXA,3,7,1,2,3,4,5,6
,7,8
CPENTA,4,9,1,2,3,4,5,6
CTETRA,11,,5,6,7,8
CQUAD4,5,7,1,2,3,4
CONROD,6,1,2,99
PSOLID,7,1
PSOLID,8,2,,,,FULL
PSOLID,9,3
PSOLID,11,1
"""


def materials(path, comm):
    """Type and material by kind and number, and the materials."""
    deck = bulk.read_deck(path, comm)
    properties, found = deck.properties, {}
    for kind, table in properties.table.items():
        assert len(table) == len(deck.elements[kind])
        for number, type_, material in gathered(comm, table)[0].tolist():
            name = properties.materials[material].name if material >= 0 else None
            found[kind, number] = properties.types[type_], name
    return found, properties


def test_solids_have_the_material_of_their_property(comm, folder, monkeypatch):
    text = GRIDS + SOLIDS + "MAT1,1,2.1+11,,0.3,7850.,1.2-5\nMAT1    2       7.E10   2.69E10         2700.\nMAT9,3,1.\n"
    for size in (2**21, 16):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        found, properties = materials(write(folder / "a.bdf", text, comm), comm)
        assert found == {
            ("tetra", 1): ("CTETRA", "MAT1 1"), ("tetra10", 2): ("CTETRA", "MAT1 2"),
            ("hexahedron", 3): ("CHEXA", "MAT1 1"), ("wedge", 4): ("CPENTA", "MAT9 3"),
            ("tetra", 11): ("CTETRA", "MAT1 1"), ("quad", 5): ("CQUAD4", "MAT1 1"), ("line", 6): ("CONROD", None),
        }  # fmt: skip
        assert properties.program == "Nastran"
        assert properties.materials == (
            Material(name="MAT1 1", young=2.1e11, poisson=0.3, density=7850.0, expansion=1.2e-5),
            Material(name="MAT1 2", young=7e10, poisson=7e10 / 5.38e10 - 1, density=2700.0),
            Material(name="MAT9 3", reason="found MAT9"),
        )
        comm.Barrier()


@pytest.mark.parametrize(("cards", "wanted"), [
    ("MAT1,1,2.+11,,0.3\nMATS1,1,,PLASTIC", {"reason": "found MATS1"}),
    ("MAT1,1,,8.+10,.25", {"young": 2e11, "poisson": 0.25}),
    ("MAT1,1,2.+11,8.+10,.25", {"young": 2e11, "poisson": 0.25}),
    ("MAT1,1,2.+11,1.+10,.25", {"reason": "found E 2e+11, G 1e+10 and NU 0.25, which do not fit"}),
    ("MAT1,1,2.+11", {"reason": "found a MAT1 without two of E, G and NU"}),
    ("MAT1,1,2.+11,,.5", {"reason": "poisson: found 0.5, expected more than -1 and less than 0.5"}),
    ("MAT1,1,2.+11,,.3,10.\nPARAM,WTMASS,.1", {"young": 2e11, "poisson": 0.3, "density": 1.0}),
])  # fmt: skip
def test_constants(comm, folder, cards, wanted):
    text = f"{GRIDS}CTETRA,1,7,1,2,3,4\nPSOLID,7,1\n{cards}\n"
    _, properties = materials(write(folder / "a.bdf", text, comm), comm)
    (item,) = properties.materials
    assert {key: getattr(item, key) for key in wanted} == pytest.approx(wanted)
    assert item.isotropic == ("reason" not in wanted)


@pytest.mark.parametrize(("cards", "says"), [
    ("CTETRA,1,x,1,2,3,4", "line 21: found 'CTETRA,1,x,1,2,3,4', expected the number of a property, a whole number"),
    ("PSOLID,7,x", "line 21: PSOLID: found 'X' for the number of a material, expected a whole number"),
    ("MAT1,1,2.+x,,0.3", "line 21: MAT1: found '2.\\+X' for Young's modulus, expected a number"),
])  # fmt: skip
def test_damaged_cards_are_refused(comm, folder, cards, says):
    with pytest.raises(InputError, match=says):
        bulk.read_deck(write(folder / "a.bdf", f"{GRIDS}{cards}\nCTETRA,9,7,1,2,3,4\n", comm), comm)


def test_a_deck_without_elements_has_no_properties(comm, folder):
    assert bulk.read_deck(write(folder / "a.bdf", GRIDS, comm), comm).properties is None
