"""Stresses of solids in OUTPUT2: those of real runs against their F06 and E B u, and of files written by rule."""

import gzip
import re

import numpy as np
import pytest
from conftest import DATA
from foreign import everywhere
from op2_files import displaced, op2, stressed
from shared_data import unpacked

from hpcred.fe.element_rules import FULL
from hpcred.fe.strain_matrices import elasticity, nodal_stress_matrices
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import MPI
from hpcred.readers.nastran.op2 import walk
from hpcred.readers.stresses.source import read_answers


@pytest.mark.mpi
def test_tetrahedra_have_e_b_u_of_the_displacements_in_the_same_file(comm, folder):
    """186 of MSC Nastran, to single precision."""
    path = unpacked(comm, folder, "nastran/solids/solid_bending.op2")
    found = read_answers(path, comm)
    node, moved, stress = everywhere(comm, found)
    assert found.source == "Nastran, means at corner nodes in OUTPUT2" and node.tolist() == list(range(1, 73))
    text = gzip.decompress((DATA / "nastran/solids/solid_bending.bdf.gz").read_bytes()).decode()
    cards = {name: [[line[k : k + 8].strip() for k in range(8, 64, 8)] for line in text.splitlines()
                    if line.startswith(name)] for name in ("GRID", "CTETRA")}  # fmt: skip
    places = {int(row[0]): [float(item or 0) for item in row[2:5]] for row in cards["GRID"]}
    elements = np.array([[int(item) for item in row[2:6]] for row in cards["CTETRA"]])
    assert len(elements) == 186 and re.search(r"MAT1     1      3.\+7            .3 ", text)
    corners = np.array([[places[n] for n in row] for row in elements])
    E = nodal_stress_matrices("tetra", FULL, corners, elasticity(3e7, 0.3))
    own = (E.reshape(len(elements), -1, 12) @ moved[0][elements - 1].reshape(-1, 12, 1)).reshape(-1, 4, 6)
    total = np.zeros((len(node), 6))
    np.add.at(total, elements - 1, own)
    mean = total / np.bincount(elements.ravel() - 1)[:, None]
    assert np.abs(mean - stress[0]).max() < 1e-5 * np.abs(mean).max()


def printed(text):
    """Displacements by grid, and stresses by grid of each solid, of the pages of an F06."""
    moved, stresses, grid = {}, {}, None
    for line in text.splitlines():
        if match := re.match(r" +(\d+) +G +(\S+) +(\S+) +(\S+) ", line):
            moved[int(match[1])] = [float(match[k]) for k in (2, 3, 4)]
        if re.search(r" X +\S+  XY ", line):
            grid = 0 if "CENTER" in line else int(line.split()[1])
            row = [0.0] * 6
            if grid:
                stresses.setdefault(grid, []).append(row)
        for k, axis in enumerate(("X ", "Y ", "Z ")):
            if match := re.search(rf" {axis} +(\S+)  (?:XY|YZ|ZX) +(\S+) ", line):
                row[k], row[3 + k] = float(match[1]), float(match[2])
    return moved, stresses


def solids_only(path):
    """The bytes of a file with the tables of displacements and of stresses of solids of another."""
    tables = []
    for block in walk(path):
        records = [block.bytes(k, 0, block.length(k)).tobytes() for k in range(len(block.records))]
        if block.name == "OES1X1":
            pairs = [(k, block.integers(k)[2]) for k in range(0, len(records), 2)]
            records = [records[k + j] for k, type_ in pairs if type_ in (39, 67, 68) for j in (0, 1)]
        if block.name in ("OUGV1", "OES1X1"):
            tables.append((block.name, records))
    return op2(tables)


@pytest.mark.mpi
def test_stresses_of_a_brick_wedges_and_tetrahedra_are_those_that_the_program_prints(comm, folder):
    path = unpacked(comm, folder, "nastran/solids/static_solid_shell_bar.op2")
    with pytest.raises(InputError, match="stresses of the element type 95 in the table OES1C, expected solids"):
        read_answers(path, comm)
    if comm.rank == 0:
        (folder / "solids.op2").write_bytes(solids_only(path))
    comm.Barrier()
    node, moved, stress = everywhere(comm, read_answers(folder / "solids.op2", comm))
    text = gzip.decompress((DATA / "nastran/solids/static_solid_shell_bar.f06.gz").read_bytes()).decode()
    u, sigma = printed(text)
    assert sorted(sigma) == node.tolist() == list(range(1, 14)) and len(sigma[6]) == 3 and len(sigma[10]) == 4
    for k, grid in enumerate(node.tolist()):
        assert moved[0, k] == pytest.approx(u[grid], rel=1e-6)
        assert stress[0, k] == pytest.approx(np.mean(sigma[grid], axis=0), rel=1e-6, abs=5e-3)


def two_bricks(seed):
    """Displacements of 12 grids, and stresses at the corners of two bricks that share four."""
    rng = np.random.default_rng(seed)
    moved = {grid: rng.standard_normal(3).round(3) for grid in (*range(1, 13), 40)}
    return moved, {7: {grid: rng.standard_normal(6).round(3) for grid in range(1, 9)},
                   9: {grid: rng.standard_normal(6).round(3) for grid in range(5, 13)}}  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize("form", [{"order": "<", "size": 4}, {"order": ">", "size": 4}, {"order": "<", "size": 8}])
def test_subcases_are_steps_in_the_order_of_their_numbers(comm, folder, form):
    """Of words of four and eight bytes, in both orders of bytes."""
    cases = [two_bricks(seed) for seed in (1, 2)]
    if comm.rank == 0:
        moved = [record for k in (1, 0) for record in displaced(k + 3, cases[k][0], **form)]
        stress = [record for k in (1, 0) for record in stressed(k + 3, cases[k][1], **form)]
        (folder / "a.op2").write_bytes(op2([("OUGV1", moved), ("OUGV1PAT", moved), ("OES1X1", stress)], **form))
    comm.Barrier()
    node, moved, stress = everywhere(comm, read_answers(folder / "a.op2", comm))
    assert node.tolist() == list(range(1, 13))
    for k, (u, elements) in enumerate(cases):
        for i, grid in enumerate(node.tolist()):
            given = [corners[grid] for corners in elements.values() if grid in corners]
            assert moved[k, i] == pytest.approx(u[grid], rel=1e-6)
            assert stress[k, i] == pytest.approx(np.mean(given, axis=0), rel=1e-6, abs=1e-6)


MOVED, ELEMENTS = two_bricks(3)
U, S = displaced(1, MOVED), stressed(1, ELEMENTS)
WITHOUT = {7: ELEMENTS[7], 9: ELEMENTS[9] | {12: [np.nan] * 6}}


def both(moved=U, stress=S):
    return op2([("OUGV1", moved), ("OES1", stress)])


@pytest.mark.parametrize("content, says", [
    (op2([("OUGV1", U)]), "found not both displacements .OUG. and stresses of solids .OES. in subcase 1"),
    (op2([("OGPWG", [b"abcd"])]), "found not both displacements .OUG. and stresses of solids .OES., expected both"),
    (both(stress=stressed(2, ELEMENTS)), "found not both .* in subcase 1"),
    (both(stress=[*S, *S]), "found stresses of the element type 67 twice in subcase 1"),
    (both([*U, *U]), "found displacements twice in subcase 1, expected those of one run"),
    (both(stress=stressed(1, ELEMENTS, type_=33)), "stresses of the element type 33 in the table OES1"),
    (both(stress=stressed(1, ELEMENTS, type_=68)), "found 1544 bytes, expected entries of 151 words"),
    (both(stress=stressed(1, ELEMENTS, kind=10)), "found the kind 10 of the table OES1, .* no strains"),
    (both(stress=stressed(1, ELEMENTS, approach=2)), "of the approach 2, code 5 and form 1, expected real"),
    (both(displaced(1, MOVED, form=2)), "approach 1, code 1 and form 2, expected real results"),
    (both(stress=stressed(1, ELEMENTS, system=3)), "element 7 in the coordinate system 3, expected the"),
    (both(stress=stressed(1, ELEMENTS, letters=b"GAUS")), "without stresses at their centre and at"),
    (both(displaced(1, MOVED, point=7)), "found points of the kind 7 in the table OUGV1"),
    (both(displaced(1, {0: MOVED[1]})), "found the number 0 in the table OUGV1, subcase 1"),
    (both(displaced(1, {1: MOVED[1]})), "found stresses at nodes without displacements"),
    (both(U[:1]), "found a record of the table OUGV1 without one of 146 words"),
    (both([U[0][:-4], U[1]]), "found a record of the table OUGV1 without one of 146 words"),
    (both(stress=[S[0], 2 * S[1]]), "found the element 7 twice in the table OES1"),
    (both()[:-40], "the file is damaged or cut off"),
    (both(stress=stressed(1, WITHOUT)), "values that are not finite"),
])  # fmt: skip
def test_tables_that_are_not_understood_are_refused(tmp_path, content, says):
    (tmp_path / "a.op2").write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_answers(tmp_path / "a.op2", MPI.COMM_SELF)
