"""Loads of input files: positions and signs of every face against hpcred's own pressure, sums, and each refusal."""

import numpy as np
import pytest
import scipy.sparse
from helpers import columns_of, to_dense

from hpcred import Dofs, InputError, SecondOrderModel
from hpcred.loads import DeckLoad, Gravity, Pressure

pytestmark = pytest.mark.mpi(build="real")

GRID = [(x, y, z) for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)]  # numbers from 1
HEXA = {1: (1, 2, 5, 4, 7, 8, 11, 10), 2: (2, 3, 6, 5, 8, 9, 12, 11)}
# corners of P1 .. P6 in the manuals of Abaqus and CalculiX, and of S1 .. of tetrahedra and wedges
MANUAL = {
    "C3D8": ("1234", "5876", "1562", "2673", "3784", "4851"), "C3D4": ("123", "142", "243", "341"),
    "C3D6": ("123", "465", "1452", "2563", "3641"), "C3D5": ("1234", "152", "253", "354", "451"),
}  # fmt: skip
KINDS = {"C3D8": "hexahedron", "C3D4": "tetra", "C3D6": "wedge", "C3D5": "pyramid"}
FIRST = {"C3D8": HEXA[1], "C3D4": (1, 2, 4, 7), "C3D6": (1, 2, 4, 7, 8, 10), "C3D5": (1, 2, 5, 4, 7)}


def model_of(comm, elements=None, points=GRID, mass=None):
    """The nodes of the grid with three dofs each; the mass matrix couples nodes and not directions."""
    points = np.array(points)
    rng = np.random.default_rng(3)
    root = rng.standard_normal((len(points),) * 2)
    mass = np.kron(root @ root.T + 9 * np.eye(len(points)), np.eye(3)) if mass is None else mass
    dofs = Dofs(np.repeat(np.arange(1, len(points) + 1), 3), np.tile(np.arange(3), len(points)),
                np.repeat(points, 3, axis=0))  # fmt: skip
    there = comm.rank == 0
    mine = {kind: np.array(part if there else np.zeros((0, np.shape(part)[1])), int)
            for kind, part in (elements or {}).items()}  # fmt: skip
    return SecondOrderModel.from_scipy(
        scipy.sparse.csr_matrix(mass), mass, comm=comm, dofs=dofs, elements=mine, name="body"
    )


def write(comm, path, text):
    if comm.rank == 0:
        path.write_text(text)
    comm.Barrier()
    return str(path)


def deck(step, kind="C3D8", elements=HEXA, more=""):
    lines = ["*NODE, NSET=ALL", *(f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(GRID, 1)),
             f"*ELEMENT, TYPE={kind}, ELSET=EALL",
             *(f"{k}, {', '.join(map(str, nodes))}" for k, nodes in elements.items()),
             "*NSET, NSET=Ends", "1, 12", "*ELSET, ELSET=right", "2", more, step]  # fmt: skip
    return "\n".join(line for line in lines if line) + "\n"


def step(*lines):
    return "\n".join(["*STEP", "*STATIC", *lines, "*NODE FILE", "U", "*END STEP"])


def column(model, load):
    with model.with_loads([load]) as loaded:
        return columns_of(loaded.B)[:, -1].reshape(-1, 3), loaded.loads[0]


@pytest.mark.parametrize("kind", sorted(MANUAL))
def test_every_face_of_a_dload_is_that_of_the_manual(comm, folder, kind):
    nodes = FIRST[kind]
    with model_of(comm, {KINDS[kind]: [nodes]}) as model:
        for place, corners in enumerate(MANUAL[kind], 1):
            text = deck(step("*DLOAD", f"1, P{place}, 3.0"), kind, {1: nodes})
            name = write(comm, folder / "d.inp", text)
            found, sums = column(model, DeckLoad(name="p", file=name, step=1))
            on = tuple(nodes[int(digit) - 1] for digit in corners)
            expected, own = column(model, Pressure(name="p", on=on, value=3.0))
            assert np.abs(found - expected).max() < 1e-14 and found.any()
            assert sums.force == pytest.approx(own.force) and sums.area == pytest.approx(own.area)


def test_forces_on_nodes_and_sets_add_up(comm, folder):
    lines = ["*CLOAD", "1, 1, 2.", "Ends, 3, -1.5", "*CLOAD, AMPLITUDE=ramp", "1, 1, 3.", "12, 2, 1e-1"]
    name = write(comm, folder / "c.inp", deck(step(*lines)))
    with model_of(comm) as model:
        found, sums = column(model, DeckLoad(name="c", file=name, step=1))
    expected = np.zeros((12, 3))
    expected[0], expected[11] = (5.0, 0.0, -1.5), (0.0, 0.1, -1.5)
    assert np.abs(found - expected).max() < 1e-15
    assert sums.force == pytest.approx((5.0, 0.1, -3.0))
    assert sums.notes == ["load 'c': it has the reference values of its loads; their *Amplitude is not applied"]
    assert sums.moment == pytest.approx(np.cross(GRID, expected).sum(axis=0))


def test_surfaces_and_sets_of_elements(comm, folder):
    """*Dsload on a surface of sets and elements, *Dload on a set."""
    surface = "*ELSET, ELSET=_top, INTERNAL\n1, 2\n*SURFACE, NAME=Top, TYPE=ELEMENT\n_Top, S2\n2, S4"
    text = deck(step("*DSLOAD", "TOP, P, 2.0", "*DLOAD", "right, P6, 1.0"), more=surface)
    name = write(comm, folder / "s.inp", text)
    with model_of(comm, {"hexahedron": list(HEXA.values())}) as model:
        found, sums = column(model, DeckLoad(name="s", file=name, step=1))
        top, _ = column(model, Pressure(name="s", on=(7, 8, 9, 10, 11, 12), value=2.0))
        end, _ = column(model, Pressure(name="s", on=(3, 6, 9, 12), value=2.0))
    inner = np.zeros((12, 3))
    inner[[1, 4, 7, 10], 0] = 0.25  # on the face between the elements, from the first to the second
    assert np.abs(found - top - end - inner).max() < 1e-14
    assert sums.force == pytest.approx((-1.0, 0.0, -4.0))


def test_weight_and_spin_of_the_whole_body(comm, folder):
    text = deck(step("*DLOAD", "EALL, GRAV, 10., 0., 0., -2.", "EALL, CENTRIF, 9., 1., 0., 0., 0., 0., 4."))
    name = write(comm, folder / "g.inp", text)
    with model_of(comm, {"hexahedron": list(HEXA.values())}) as model:
        found, sums = column(model, DeckLoad(name="g", file=name, step=1))
        weight, own = column(model, Gravity(name="g", value=(0.0, 0.0, -10.0)))
        field = np.array(GRID) - [1.0, 0.0, 0.0]
        field[:, 2] = 0.0
        M = to_dense(model.M)
    spin = (M @ (9.0 * field).ravel()).reshape(-1, 3)
    assert np.abs(found - weight - spin).max() < 1e-12 * np.abs(found).max()
    assert sums.force[2] == pytest.approx(own.force[2]) and sums.spins and not own.spins
    # Abaqus leaves the name out for the whole model, and takes single sets together
    parts = deck(step("*DLOAD", "left, GRAV, 10., 0., 0., -1.", "right, GRAV, 10., 0., 0., -1."),
                 more="*ELSET, ELSET=left\n1")  # fmt: skip
    for text in (parts, deck(step("*DLOAD", ", GRAV, 10., 0., 0., -1."))):
        name = write(comm, folder / "w.inp", text)
        with model_of(comm) as model:
            assert np.allclose(column(model, DeckLoad(name="g", file=name, step=1))[0], weight)


def test_decks_in_other_units(comm, folder):
    """A model that was converted from mm, t, s: forces in N, pressures in MPa, accelerations in mm/s^2."""
    lines = ["*CLOAD", "1, 1, 2.", "*DLOAD", "1, P2, 3.", "EALL, GRAV, 9810., 0., 0., -1."]
    name = write(comm, folder / "u.inp", deck(step(*lines)))
    with model_of(comm, {"hexahedron": list(HEXA.values())}, np.array(GRID) / 1000) as model:
        with model.with_fields(converted_from="mm, t, s (N, MPa)") as converted:
            found, _ = column(converted, DeckLoad(name="u", file=name, step=1))
        pressure, _ = column(model, Pressure(name="u", on=(7, 8, 10, 11), value=3e6))
        weight, _ = column(model, Gravity(name="u", value=(0.0, 0.0, -9.81)))
    expected = pressure + weight
    expected[0, 0] += 2.0
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("of", ["abaqus", "nastran"])
def test_decks_of_another_mesh_are_refused(comm, folder, of):
    """And those in other units than the model was converted from: nodes have the right numbers, but lie elsewhere."""
    if of == "abaqus":
        load = DeckLoad(name="m", file=write(comm, folder / "m.inp", deck(step("*CLOAD", "1, 1, 2."))), step=1)
    else:
        load = DeckLoad(name="m", file=write(comm, folder / "m.bdf", bulk("FORCE,3,1,,2.,1.,0.,0.")), sid=3)
    points = np.array(GRID)
    for places in (points / 1000, points + [0.0, 0.0, 1e-3] * (points == [2.0, 1.0, 1.0]).all(axis=1)[:, None]):
        says = r"m\.\w+: found node \d+ at \(.*\) m .units: SI., expected it at \(.*\) m as in body; .* another mesh"
        with model_of(comm, points=places) as model, pytest.raises(InputError, match=says):
            model.with_loads([load])


def test_steps_are_told_apart(comm, folder):
    text = deck(step("*CLOAD", "1, 1, 1.") + "\n" + step("*CLOAD, OP=NEW", "1, 2, 7."))
    name = write(comm, folder / "t.inp", text)
    with model_of(comm) as model:
        for number, force in ((1, (1.0, 0.0, 0.0)), (2, (0.0, 7.0, 0.0))):
            assert column(model, DeckLoad(name="t", file=name, step=number))[1].force == pytest.approx(force)


BULK = ["SOL 101", "CEND", "BEGIN BULK", *(f"GRID,{k},,{x},{y},{z}" for k, (x, y, z) in enumerate(GRID, 1)),
        *(f"CHEXA,{k},1,{','.join(map(str, n[:6]))}\n,{n[6]},{n[7]}" for k, n in HEXA.items()),
        "CORD2R,5,,0.,0.,0.,0.,0.,1.,\n,0.,1.,0."]  # fmt: skip  # x of 5 is y


def bulk(*cards):
    return "\n".join([*BULK, *cards, "ENDDATA"]) + "\n"


def test_forces_pressures_and_weight_of_nastran(comm, folder):
    cards = ["FORCE,3,1,,2.,1.,0.,0.5", "FORCE,3,12,5,3.,1.,0.,0.", "FORCE,4,1,,99.,1.,0.,0.",
             "PLOAD4,3,1,2.,,,,7,11", "PLOAD4,3,2,1.,1.,,,3,12", "GRAV,3,,10.,0.,0.,-1."]  # fmt: skip
    name = write(comm, folder / "n.bdf", bulk(*cards))
    with model_of(comm, {"hexahedron": list(HEXA.values())}) as model:
        found, sums = column(model, DeckLoad(name="n", file=name, sid=3))
        top, _ = column(model, Pressure(name="n", on=(7, 8, 10, 11), value=2.0))
        end, _ = column(model, Pressure(name="n", on=(3, 6, 9, 12), value=1.0))
        weight, own = column(model, Gravity(name="n", value=(0.0, 0.0, -10.0)))
    expected = top + end + weight
    expected[0] += (2.0, 0.0, 1.0)
    expected[11] += (0.0, 3.0, 0.0)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    assert sums.force == pytest.approx(np.add(own.force, (2.0 - 1.0, 3.0, 1.0 - 2.0)))


def test_combined_sets_and_ranges_of_nastran(comm, folder):
    cards = ["LOAD,9,2.,3.,1,0.5,2", "FORCE,1,1,,1.,1.,0.,0.", "MOMENT,8,1,,1.,1.,0.,0.", "FORCE,2,1,,1.,0.,1.,0.",
             "PLOAD4,7,1,1.,,,,THRU,5", "CQUAD4,5,1,1,2,5,4"]  # fmt: skip
    name = write(comm, folder / "n.bdf", bulk(*cards))
    with model_of(comm, {"quad": [(1, 2, 5, 4)]}) as model:
        _, sums = column(model, DeckLoad(name="n", file=name, sid=9))
        assert sums.force == pytest.approx((6.0, 1.0, 0.0))
        with pytest.raises(InputError, match="load 'n': node 1 has no dof in rx in body"):
            model.with_loads([DeckLoad(name="n", file=name, sid=8)])
    shells = bulk(*cards).replace("CHEXA,", "$").replace("\n,11", "\n$").replace("\n,12", "\n$")
    name = write(comm, folder / "q.bdf", shells)
    with model_of(comm, {"quad": [(1, 2, 5, 4)]}) as model:
        found, sums = column(model, DeckLoad(name="n", file=name, sid=7))
        assert sums.force == pytest.approx((0.0, 0.0, 1.0)) and found[[0, 1, 3, 4], 2] == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("lines", "number", "says"),
    [
        (["*CLOAD", "1, 1, 2."], 2, "found 1 steps, expected a step 2"),
        ([], 1, r"found no loads in step 1, expected \*Cload, \*Dload or \*Dsload"),
        (["*TEMPERATURE", "ALL, 20."], 1, r"line \d+: found \*Temperature in step 1, which is not read"),
        (["*CLOAD, AMPLITUDE=A, SECTOR=2", "1, 1, 2."], 1, r"found \*Cload with the parameter sector, which is not"),
        (["*CLOAD", "1, 7, 2."], 1, "found the direction 7 of a force, expected 1 to 6"),
        (["*CLOAD", "1, 1.5, 2."], 1, "found the direction 1.5 of a force, expected 1 to 6"),
        (["*CLOAD", "1, 1"], 1, r"line \d+: found '1, 1', expected a node or node set, direction 1 to 6, value"),
        (["*CLOAD", "1, 1, x"], 1, r"line \d+: found '1, 1, x', expected a node or node set, direction 1 to 6, value"),
        (["*CLOAD", "1, 1, nan"], 1, r"line \d+: found '1, 1, nan', expected a node or node set"),
        (["*CLOAD", "1, 4, 2."], 1, "load 'd': node 1 has no dof in rx in body; it follows another node"),
        (["*CLOAD", "99, 1, 2."], 1, "load 'd': node 99 of .*d.inp has no row in body; it does not exist"),
        (["*CLOAD", "Endz, 1, 2."], 1, r"loads on the node set 'Endz', which the file does not define \(did you mean"),
        (["*DLOAD", "1, P7, 2."], 1, "found P7 on the element 1, a hexahedron, which has no such face"),
        (["*DLOAD", "9, P1, 2."], 1, "found P1 on the element 9, of which the file has no solid"),
        (["*DLOAD", "lefd, P1, 2."], 1, "loads on the element set 'lefd', which the file does not define"),
        (["*DLOAD", "1, BX, 2."], 1, "found the label BX, which is not read; expected P1 to P6, GRAV or CENTRIF"),
        (["*DLOAD", "1, P1, 2., 3."], 1, "found several numbers behind P1, expected a pressure"),
        (["*DLOAD", "right, GRAV, 9.81, 0., 0., -1."], 1, r"found GRAV on 1 of 2 elements \(named 1 times\), expected"),
        (["*DLOAD", "EALL, GRAV, 9.81, 0., 0."], 1, "found 3 numbers behind GRAV, expected g and a direction"),
        (["*DLOAD", "EALL, CENTRIF, 9., 0., 0., 0., 0., 0., 0."], 1, "behind CENTRIF, expected omega.2, a point and"),
        (["*DSLOAD", "Side, P, 1."], 1, r"found the surface 'Side', which no \*Surface defines"),
        (["*DSLOAD", "Side, TRVEC, 1."], 1, "found the label TRVEC of .Dsload, expected P"),
        (["*BOUNDARY", "1, 1, 1, 0.5", "*CLOAD", "1, 1, 2."], 1, "found a displacement that is prescribed"),
    ],
)  # fmt: skip
def test_refused_steps(comm, folder, lines, number, says):
    name = write(comm, folder / "d.inp", deck(step(*lines)))
    with model_of(comm) as model, pytest.raises(InputError, match=says):
        model.with_loads([DeckLoad(name="d", file=name, step=number)])


def test_loads_that_go_on_are_refused(comm, folder):
    name = write(comm, folder / "d.inp", deck(step("*CLOAD", "1, 1, 1.") + "\n" + step("*CLOAD", "1, 2, 7.")))
    with model_of(comm) as model, pytest.raises(InputError, match=r"line \d+: found loads of \*Cload that go on in"):
        model.with_loads([DeckLoad(name="d", file=name, step=2)])
    name = write(comm, folder / "t.inp", deck(step("*CLOAD", "1, 1, 1."), more="*TRANSFORM, NSET=ALL\n0,1,0,-1,0,0"))
    with model_of(comm) as model, pytest.raises(InputError, match=r"found \*Transform, which turns the directions"):
        model.with_loads([DeckLoad(name="d", file=name, step=1)])
    mass = "*ELEMENT, TYPE=MASS, ELSET=point\n7, 3"
    name = write(comm, folder / "m.inp", deck(step("*DLOAD", "EALL, GRAV, 9.81, 0., 0., -1."), more=mass))
    with model_of(comm) as model, pytest.raises(InputError, match="found GRAV and elements of type MASS, of which"):
        model.with_loads([DeckLoad(name="d", file=name, step=1)])


@pytest.mark.parametrize(
    ("cards", "sid", "says"),
    [
        (["FORCE,3,1,,2.,1.,0.,0."], 4, "found no FORCE, MOMENT, PLOAD4 or GRAV of the load set 4"),
        (["LOAD,4,1.,1.,3"], 4, "of the load set 3, which LOAD 4 names"),
        (["LOAD,4,1.,1.,3,1.,3", "FORCE,3,1,,2.,1.,0.,0."], 4, r"line \d+: LOAD: found the load set 3 twice"),
        (["LOAD,4,1.,1.,3", "LOAD,4,1.,1.,5"], 4, "found a second LOAD of the number 4, expected one"),
        (["FORCE,3,1,,2.,1.,0.,0.", "PLOAD2,3,1.,1"], 3, "found 'PLOAD2,3,1.,1', expected only FORCE, MOMENT, PLOAD4"),
        (["FORCE,3,1,7,2.,1.,0.,0."], 3, "expected the basic system or a rectangular one, which the file defines"),
        (["FORCE,3,1,,2.,x,0.,0."], 3, "expected a component, a number"),
        (["PLOAD4,3,1,2.,3.,,,7,11"], 3, "expected one pressure on the whole face"),
        (["PLOAD4,3,1,2.,,,,7,11\n,,0.,0.,1."], 3, r"expected a pressure at right angles to the face \(no second line"),
        (["PLOAD4,3,1,2.,,,,7,8"], 3, r"PLOAD4: the grid points \[7, 8\] tell no face of the element 1; expected G1"),
        (["PLOAD4,3,9,2."], 3, "PLOAD4: found a pressure on the element 9, which is none of solids or shells"),
        (["FORCE,3,88,,2.,1.,0.,0."], 3, "load 'n': node 88 of .*n.bdf has no row in body"),
    ],
)
def test_refused_sets_of_nastran(comm, folder, cards, sid, says):
    name = write(comm, folder / "n.bdf", bulk(*cards))
    with model_of(comm) as model, pytest.raises(InputError, match=says):
        model.with_loads([DeckLoad(name="n", file=name, sid=sid)])


def test_other_files_are_refused(comm, folder):
    name = write(comm, folder / "x.txt", "1, 2, 3\n")
    with model_of(comm) as model:
        with pytest.raises(InputError, match="found no input file of Abaqus, CalculiX or Nastran, and no .full"):
            model.with_loads([DeckLoad(name="n", file=name, step=1)])
        name = write(comm, folder / "n.bdf", bulk())
        with pytest.raises(InputError, match="n.bdf is an input file of Nastran; expected `sid`"):
            model.with_loads([DeckLoad(name="n", file=name, step=1)])
        with pytest.raises(InputError, match="n.bdf is an input file of Nastran; expected `sid`"):
            model.with_loads([DeckLoad(name="n", file=name)])
    with pytest.raises(InputError, match="load 'n': expected `step` .* or `sid`"):
        DeckLoad(name="n", file="a.inp", step=1, sid=2)


@pytest.mark.costly
def test_a_step_that_is_cut_off_is_refused(comm, folder):
    """Each cut of the file in or behind its step: all of the loads, or a refusal."""
    whole = deck(step("*CLOAD", "1, 1, 5.0", "12, 2, 7.0"))
    with model_of(comm) as model:
        expected, _ = column(model, DeckLoad(name="c", file=write(comm, folder / "w.inp", whole), step=1))
        for stop in range(whole.index("*STEP") + 5, len(whole), 3):
            load = DeckLoad(name="c", file=write(comm, folder / "c.inp", whole[:stop]), step=1)
            try:
                found, _ = column(model, load)
            except InputError:
                continue
            assert np.array_equal(found, expected)
        nothing = write(comm, folder / "n.inp", whole.replace("*END STEP", ""))
        with pytest.raises(InputError, match=r"line \d+: found no \*End Step of step 1, expected one"):
            column(model, DeckLoad(name="c", file=nothing, step=1))
        nested = write(comm, folder / "s.inp", whole.replace("*END STEP", "") + step("*CLOAD, OP=NEW", "1, 1, 5.0"))
        for number in (1, 2):
            with pytest.raises(InputError, match="found no .End Step of step 1"):
                column(model, DeckLoad(name="c", file=nested, step=number))


def test_an_included_file_of_loads_without_a_last_line_break_is_told(comm, folder):
    write(comm, folder / "loads.inc", "*CLOAD\n1, 1, 5.0\n12, 2, 7.0")
    name = write(comm, folder / "i.inp", deck(step("*INCLUDE, INPUT=loads.inc")))
    with model_of(comm) as model:
        _, sums = column(model, DeckLoad(name="c", file=name, step=1))
    assert "loads.inc: found no line break at its end" in sums.remark
