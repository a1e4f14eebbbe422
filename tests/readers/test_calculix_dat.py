"""Displacements and stresses that CalculiX prints at integration points, at nodes."""

import shutil

import numpy as np
import pytest
from calculix_prints import DECK, MOVED, ORDER, PLACES, linear_field, printed, table
from calculix_runs import input_lines, run_calculix
from foreign import gathered
from solid_meshes import mesh

from hpcred.fe.element_rules import CALCULIX, rule_of
from hpcred.fe.strain_matrices import elasticity, nodal_stress_matrices
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import MPI
from hpcred.readers.stresses.source import read_answers


def written(folder, text, deck=DECK):
    (folder / "job.inp").write_text(deck)
    (folder / "job.dat").write_text(text)


@pytest.mark.mpi
@pytest.mark.parametrize("sets", [1, 3])
def test_a_linear_stress_is_itself_at_nodes(comm, folder, sets):
    """The points of an element in any order, and in several sets; other elements have no stresses."""
    fields = [linear_field(seed) for seed in (1, 2, 3)]
    if comm.rank == 0:
        written(folder, "".join(printed(field, k, sets=sets) for k, field in enumerate(fields, 1)))
    comm.Barrier()
    found = read_answers(folder / "job.dat", comm)
    node, moved, stress = gathered(comm, found.node, found.displacement.swapaxes(0, 1), found.stress.swapaxes(0, 1))
    assert node.tolist() == list(range(1, 13)) and found.source.startswith("CalculiX, points of elements in .dat")
    for k, (u, sigma) in enumerate(fields):
        assert moved[:, k] == pytest.approx(u, rel=1e-6, abs=1e-9)
        assert stress[:, k] == pytest.approx(sigma(PLACES), rel=1e-5, abs=1e-5)


FIELD = linear_field(4)
GOOD = printed(FIELD, 1)


@pytest.mark.parametrize("text, says", [
    (table(MOVED, [(1, 0, 0, 0)], 1), "found displacements only in step 1, expected displacements and stresses"),
    (GOOD + table(ORDER, [(3, 1, *range(6))], 2), "found stresses only in step 2"),
    (GOOD.replace("stresses (elem", "mechanical strains (elem"), "found no results of a known program"),
    (GOOD.replace("displacements (vx,vy,vz)", "forces (fx,fy,fz)"), r"found 'forces .fx,fy,fz. for set ALL and time"),
    (GOOD[:-1], "found no line break at its end; the file is cut off"),
    ("\n".join(GOOD.splitlines()[:-1]) + "\n", "found stresses at nodes without displacements"),
    ("\n".join(GOOD.splitlines()[:3] + GOOD.splitlines()[4:]) + "\n", "found no stresses of element 7 .hexahedron."),
    (printed(FIELD, 1, [(7, 0.0)]), "found no stresses of element 3 .hexahedron. of job.inp at all its"),
    (printed(FIELD, 1, [(7, 0.0), (3, 1.0), (3, 1.0)]), "found element 3, point 1 twice"),
    (printed(FIELD, 1, [(7, 0.0), (3, 1.0), (5, 1.0)]), "found stresses at 24 integration points, expected 16"),
    (GOOD + table(MOVED, [(4, 0, 0, 0)], 1), "found two displacements of the node 4 in step 1"),
    (GOOD + printed(FIELD, 2) + GOOD, "found tables of the same time apart from each other"),
    (GOOD.replace("E-01", "E-0x", 1), "job.dat, line 4: found .*, expected 8 numbers a line"),
    (GOOD.replace("\n         7   2", "\n       7.5   2"), "expected the number of an element as a whole number"),
    (GOOD.replace("\n         7   2", "\n         7  64"), "expected the number of an integration point as a whole"),
    (GOOD.replace("\n         7   1", "\n         7 nan"), "expected an element, a point and six finite stresses"),
    (GOOD.replace("\n         7   2", " OR\n         7   2"), "expected 8 numbers a line"),
])  # fmt: skip
def test_tables_that_are_not_understood_are_refused(tmp_path, text, says):
    written(tmp_path, text)
    with pytest.raises(InputError, match=says):
        read_answers(tmp_path / "job.dat", MPI.COMM_SELF)


@pytest.mark.mpi
def test_the_input_file_beside_it_is_needed(comm, folder):
    if comm.rank == 0:
        (folder / "other.dat").write_text(GOOD)
    comm.Barrier()
    with pytest.raises(InputError, match="found no input file other.inp beside it, expected that of the run"):
        read_answers(folder / "other.dat", comm)


@pytest.mark.ccx
@pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")
@pytest.mark.parametrize(("type_", "kind"), [(name, kind) for name, kinds in CALCULIX.items() for kind in kinds])
def test_means_at_nodes_are_those_of_the_results_of_the_same_run(tmp_path, type_, kind):
    """To its six digits; by E B u the digits of the .dat. C3D6: CalculiX takes 1.1455 in place of 1.3660."""
    points, elements = mesh(kind, cells=(2, 2, 1), distortion=0.2)
    x, y, z = points.T
    moved = 1e-4 * np.stack([x * y + z, y * y - x * z, 2 * x + y * z], axis=1)
    moved += 1e-6 * np.random.default_rng(8).standard_normal(points.shape)
    lines = [*input_lines(type_, points, elements), "*STEP", "*STATIC", "*BOUNDARY"]
    lines += [f"{n}, {d}, {d}, {u:.12e}" for n, three in enumerate(moved, 1) for d, u in enumerate(three, 1)]
    lines += ["*EL PRINT, ELSET=EALL", "S", "*NODE PRINT, NSET=NALL", "U", "*EL FILE", "S", "*NODE FILE", "U"]
    run_calculix(tmp_path, "a", lines)
    found, means = (read_answers(tmp_path / name, MPI.COMM_SELF) for name in ("a.dat", "a.frd"))
    assert (found.node == means.node).all() and len(found.node) == len(points)
    assert np.abs(found.displacement[0] - moved).max() < 1e-6 * np.abs(moved).max()
    scale = np.abs(means.stress).max()
    if type_ != "C3D6":
        assert np.abs(found.stress - means.stress).max() < 5e-5 * scale
    E = nodal_stress_matrices(kind, rule_of("CalculiX", type_, kind), points[elements], elasticity(2.1e11, 0.3))
    own = E.reshape(len(elements), -1, 3 * elements.shape[1]) @ moved[elements].reshape(len(elements), -1, 1)
    total = np.zeros((len(points), 6))
    np.add.at(total, elements, own.reshape(*elements.shape, 6))
    assert np.abs(total / np.bincount(elements.ravel())[:, None] - found.stress[0]).max() < 3e-6 * scale
