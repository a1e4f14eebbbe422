"""What is said of matrices from another program."""


import numpy as np
import pytest
from conftest import DATA
from helpers import PLACES, few_on_ranks, truss

import hpcred
from hpcred.analysis.likely_units import fitting_units
from hpcred.analysis.summary import _on_diagonals
from hpcred.fe.dofs import Dofs
from hpcred.fe.elements import solid_volume
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.model.units import Units, units_of
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

KRATOS = DATA / "kratos"


def cantilever(comm):
    files = {key: str(KRATOS / name) for key, name in
             (("K", "K.mm.gz"), ("M", "M.mm.gz"), ("nodes", "nodes.txt"), ("dofs", "dofs.txt"))}  # fmt: skip
    return load_source(Source(**files), comm, "cantilever")


def scaled(model, length, mass, time, times=1.0):
    """The same body in other units, whose sizes in SI are given, with `times` the mass."""
    indptr, indices, K = model.K.getValuesCSR()
    M = model.M.getValuesCSR()[2].real
    dofs, held = (part and Dofs(part.node, part.direction, part.position / length) for part in (model.dofs, model.held))
    values = {"K": K.real / (mass / time**2), "M": times * M / mass}
    return SecondOrderModel.from_csr(model.comm, model.size, indptr, indices, values, dofs=dofs, held=held)


@pytest.mark.costly
def test_kratos_cantilever(comm):
    """Frequencies of the program, held nodes, and a mass that is too small."""
    with cantilever(comm) as model, model.with_inputs([(99, "z")]) as loaded:
        with hpcred.reduce(loaded, [hpcred.Modes(count=4)]) as rom:
            assert np.allclose(rom.frequencies, [100.0459, 100.0459, 608.565, 608.565], rtol=5e-7)
        report = hpcred.inspect(model)
        assert report["masses_in_x_y_z_kg"] == pytest.approx([73.26667] * 3) and report["held_dofs"] == 27
        assert np.allclose(report["extent_m"], [[0, 0, 0], [1, 0.1, 0.1]])
        assert report["nodes"] == 90 or comm.size > 1
        assert any("9 of 99 nodes have no row" in line for line in report["warnings"])
        assert any("mass of 73.2667 is without theirs" in line for line in report["warnings"])
        assert any("without theirs" in line for line in hpcred.inspect(model)["warnings"])
        assert any(line.endswith("a held body") for line in report["sentences"])


@pytest.mark.parametrize(
    "name, sizes",
    few_on_ranks([
        ("mm, t, s (N, MPa)", (1e-3, 1e3, 1)), ("m, kg, s", (1, 1, 1)), ("mm, kg, ms (kN, GPa)", (1e-3, 1, 1e-3)),
        ("mm, kg, s (mN, kPa)", (1e-3, 1, 1)), ("mm, g, ms (N, MPa)", (1e-3, 1e-3, 1e-3)),
        ("inch, lbf s^2/inch, s (lbf, psi)", (0.0254, 175.1268, 1)),
    ]),
)  # fmt: skip
def test_units_are_recognised(comm, name, sizes):
    """Three bodies (steel, an unknown material, bricks and tetrahedra) in all systems: the right one, or none."""
    blocks = [load_export(DATA / f"{block}.inp", comm) for block in ("blockC3D8", "blockC3D10")]
    found = []
    for model in (cantilever(comm), *blocks):
        with model, scaled(model, *sizes) as other:
            found.append(hpcred.inspect(other)["units"])
    assert set(found) <= {name, None} and name in found


BODIES = {
    "rod": lambda comm: hpcred.crank(600, comm),
    "sheet": lambda comm: hpcred.solid((12, 12, 1), size=(1.0, 1.0, 0.002), clamped=False, comm=comm),
    "frame of beams": lambda comm: hpcred.linkage(comm),  # which fills nothing of its box
}


@pytest.mark.parametrize("name", BODIES)
def test_other_units_are_noticed_both_ways(comm, name):
    """A body in m that is said to be in mm, and one in mm that is taken as it is; not where all is right."""
    millimetres = units_of("mm,t,s")

    def doubts(model):
        return [line for line in hpcred.inspect(model)["warnings"] if "the numbers look like" in line]

    with BODIES[name](comm) as model, hpcred.model.in_si(model, millimetres) as said_to_be_mm:
        assert not doubts(model)
        (line,) = doubts(said_to_be_mm)
        assert "look like m, kg, s" in line and "not mm,t,s; convert with --units SI" in line
        with hpcred.model.in_si(model, Units("", 1e3, 1e-3, 1.0)) as made, made.with_fields(converted_from="") as bare:
            (line,) = doubts(bare)
            assert "not SI; convert with --units mm,t,s" in line
            with hpcred.model.in_si(bare, millimetres) as right:
                assert not doubts(right)


@pytest.mark.parametrize("times, name", few_on_ranks(
    [(30, "sheet"), (1e5, "frame of beams"), (1, "rod"), (1e3, "rod"), (1, "sheet"), (1e3, "frame of beams")], 2))
def test_point_masses_are_of_no_material(comm, name, times):
    """A mass at one node of so many times that of the body had made t look like kg."""
    with BODIES[name](comm) as model:
        with model.shared() as bare:
            expected = hpcred.inspect(bare)["units"]
            indptr, indices, K = bare.K.getValuesCSR()
            M = bare.M.getValuesCSR()[2].real.copy()
            added = times * max(hpcred.inspect(bare)["masses_in_x_y_z_kg"])
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        first = rows + model.first_row == indices
        first &= (model.dofs.node[rows] == min(comm.allgather(model.dofs.node.min()))) & (
            model.dofs.direction[rows] < 3
        )
        M[first] += added
        for units in ("", "mm, t, s (N, MPa)"):
            with SecondOrderModel.from_csr(
                comm, model.size, indptr, indices, {"K": K.real, "M": M}, dofs=model.dofs, elements=model.elements,
                converted_from=units,
            ) as heavy:  # fmt: skip
                report = hpcred.inspect(heavy)
                assert max(report["masses_in_x_y_z_kg"]) == pytest.approx(added * (1 + 1 / times))
                assert report["units"] == expected
                assert not any("the numbers look like" in line for line in report["warnings"])


@pytest.mark.parametrize("kind", ["hexahedron", "wedge", "tetra", "pyramid"])
def test_the_volume_of_solids_is_that_of_their_corners(comm, kind):
    """Affine images of unit elements, one on each rank, with nodes that two ranks share known to one."""
    corners = {
        "hexahedron": ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], 1.0),
        "wedge": ([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1]], 1 / 2),
        "tetra": ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], 1 / 6),
        "pyramid": ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.2, 0.4, 1]], 1 / 3),
    }
    points, volume = np.array(corners[kind][0], dtype=float), corners[kind][1]
    A = np.array([[2.0, 0.3, 0.0], [0.1, 1.5, 0.2], [0.0, 0.4, 3.0]])
    label = np.arange(1, len(points) + 1) if comm.rank == 0 else np.zeros(0, int)
    elements = {kind: np.arange(1, len(points) + 1)[None], "triangle": np.zeros((0, 3), int)}
    found = solid_volume(comm, elements, label, (points @ A.T)[: len(label)])
    assert found == pytest.approx(comm.size * volume * np.linalg.det(A))
    assert solid_volume(comm, elements | {"line": np.array([[1, 2]])}, label, points[: len(label)]) is None
    assert solid_volume(comm, {kind: elements[kind] + 1}, label, points[: len(label)]) is None


def test_a_body_of_no_usual_material_has_no_units(comm):
    with cantilever(comm) as model, scaled(model, 1, 1e5, 1) as other:
        report = hpcred.inspect(other)
        assert report["units"] is None and not any("looks like" in line for line in report["sentences"])


def test_a_free_body_with_few_digits_is_told_from_a_held_one(comm):
    with load_export(DATA / "blockC3D8.inp", comm) as model:
        lines = hpcred.inspect(model)["sentences"]
        assert any("a free body, which no rigid-body motion loads" in line for line in lines)
        indptr, indices, K = model.K.getValuesCSR()
        rounded = np.array([float(f"{value:.6e}") for value in K.real])
        values = {"K": rounded, "M": model.M.getValuesCSR()[2].real}
        with SecondOrderModel.from_csr(comm, model.size, indptr, indices, values, dofs=model.dofs) as coarse:
            lines = hpcred.inspect(coarse)["sentences"]
            assert any("few digits" in line or "to the digits of the files" in line for line in lines)


@pytest.mark.parametrize(
    "directions, left_out, says, count",
    [
        ((0, 1), "", "a free body, which no rigid-body motion loads; no node has a dof in z", 3),
        ((1,), "", "a held body, free in y; no node has a dof in x or z", 1),
        ((0, 1), "1x 1y 2x", "a held body; no node has a dof in z", 0),
        ((0, 1), "1x 1y", "a held body, with 1 rigid-body motion that K does not resist; no node has a dof in z", 1),
        ((0, 1, 2), "1x 1y 1z", "a held body, with 3 rigid-body motions that K does not resist", 3),
        ((0, 1, 2), "", "a free body, which no rigid-body motion loads", 6),
    ],
)
def test_motions_that_no_node_can_make_are_not_called_free(comm, directions, left_out, says, count):
    """A body in a plane is neither free nor held across it; turns about supports are found wherever these are."""
    places = np.append(PLACES, [[0.4, 0.8, 6.0 if 2 in directions else 5.0]], axis=0)
    left_out = [(int(node), "xyz".index(direction)) for node, direction in left_out.split()]
    with truss(comm, directions, places=places, left_out=left_out) as model:
        report = hpcred.inspect(model)
        assert report["sentences"][1].endswith(f": {says}")
        missing = [k for k in range(3) if "xyz"[k] in says.partition("dof in ")[2].split(" or ")]
        assert [k for k, value in enumerate(report["rigid_body_residuals"][:3]) if value is None] == missing
        assert hpcred.inspect(model)["rigid_body_modes"] == count


def test_masses_are_compared_in_the_directions_that_nodes_have(comm):
    with truss(comm, (0, 1), left_out=[(3, 0)]) as model:
        assert any("the masses in x and y are 6 and 9 kg" in line for line in hpcred.inspect(model)["warnings"])


def test_exchanged_matrices_are_said_first(comm):
    """Of clamped and free bodies, by the digits of a file too; not of the same bodies as they are."""
    for clamped in (True, False):
        with hpcred.solid((6, 2, 2), clamped=clamped, comm=comm) as model:
            indptr, indices, K = model.K.getValuesCSR()
            values = {"K": model.M.getValuesCSR()[2].real, "M": np.array([float(f"{v:.8e}") for v in K.real])}
            assert not any("EXCHANGED" in line for line in hpcred.inspect(model)["warnings"])
            with SecondOrderModel.from_csr(
                comm, model.size, indptr, indices, values, dofs=model.dofs, remarks=("a remark",)
            ) as other:
                if clamped:
                    warnings = hpcred.inspect(other)["warnings"]
                    assert "K AND M ARE EXCHANGED" in warnings[0] and warnings[1] == "a remark"
                else:  # whose masses are round-off, of whatever sign
                    try:
                        said = hpcred.inspect(other)["warnings"][0]
                    except hpcred.InputError as error:
                        said = str(error)
                    assert "K AND M ARE EXCHANGED" in said


@pytest.mark.parametrize("density", few_on_ranks([7850.0, 2900.0]))
@pytest.mark.parametrize("name, times, words, said", [
    ("mm,t,s", 1e3, "a density in kg/mm^3 in place of t/mm^3 would explain it", ("", "mm,t,s", "mm,kg,s")),
    ("inch,lbf,s", 386.0886, "a density in lbm/inch^3 in place of lbf s^2/inch^4 would explain it", ("inch,lbf,s",)),
    ("SI", 1e-3, "a density in g/cm^3 or t/m^3 in place of kg/m^3 would explain it", ("",)),
])  # fmt: skip
def test_a_density_in_other_units_than_the_rest(comm, density, name, times, words, said):
    """A block of steel, or of its stiffness and aluminium's density, with M that many times too large: density and wave
    speed together are of no material, in whatever units the matrices are said to be; the right ones are."""
    units = units_of(name)
    with hpcred.solid((8, 2, 2), size=(4.0, 1.0, 1.0), density=density, clamped=False, comm=comm) as model:
        assert not any("would explain it" in line for line in hpcred.inspect(model)["warnings"])
        with scaled(model, *units.sizes, times) as wrong:
            for text in said:
                with hpcred.model.in_si(wrong, units_of(text)) if text else wrong.shared() as read:
                    report = hpcred.inspect(read)
                    assert sum(words in line for line in report["warnings"]) == 1 and report["units"] is None
        with scaled(model, *units.sizes) as right, hpcred.model.in_si(right, units) as read:
            assert not any("would explain it" in line for line in hpcred.inspect(read)["warnings"])


def test_a_light_material_fits_the_units_that_it_has(comm):
    """Wood along its fibres."""
    with hpcred.solid((8, 2, 2), size=(4.0, 1.0, 1.0), young=1e10, density=500.0, clamped=False, comm=comm) as model:
        assert "m, kg, s" in [units.name for units in fitting_units(model, 2000.0, np.array([4.0, 1.0, 1.0]))]


@pytest.mark.parametrize("trace", [-2.0, -1e-9, 1e-9, 0.5])
def test_a_damping_matrix_of_the_other_sign(comm, trace):
    """By its trace, in any units."""
    with hpcred.SecondOrderModel.from_scipy(np.eye(2), np.eye(2), np.diag([trace, 0.0]), comm) as model:
        assert any("negative trace, -D" in line for line in _on_diagonals(model)) == (trace < 0)


def test_soft_and_heavy_materials_are_no_mistakes(comm):
    """Rubber, foam, lead, and beams in a large box: each has a density and a stiffness of its own."""
    for young, density in ((5e6, 1100.0), (1e7, 60.0), (1.6e10, 11340.0), (4e11, 19300.0), (1.2e12, 3500.0)):
        with hpcred.solid((8, 2, 2), young=young, density=density, clamped=False, comm=comm) as model:
            assert not any("would explain it" in line for line in hpcred.inspect(model)["warnings"])
