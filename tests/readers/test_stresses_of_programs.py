"""Stresses that ANSYS and Nastran computed, at nodes, against E B u of the displacements in the same file."""

import numpy as np
import pytest
from foreign import everywhere
from shared_data import shared

from hpcred.fe.element_rules import rule_of
from hpcred.fe.strain_matrices import elasticity, nodal_stress_matrices
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import MPI
from hpcred.readers.ansys import rst
from hpcred.readers.ansys.records import STANDARD, RecordFile
from hpcred.readers.stresses import ansys_rst
from hpcred.readers.stresses.source import read_answers


@pytest.mark.mpi
def test_stresses_of_solid186_are_those_of_the_displacements_in_the_same_file(comm):
    """Six modes of a block (E = 16.9e6, nu = 0.31), means at the corners of 40 elements, to single precision."""
    path = shared("ansys/file.rst")
    found = read_answers(path, comm)
    node, moved, stress = everywhere(comm, found)
    assert found.source == "ANSYS, means at corner nodes in .rst" and stress.shape == (6, 99, 6)
    file = RecordFile(path, 12)
    header, _ = file.record(STANDARD + 3)
    elements = ansys_rst._nodes(file, header, slice(0, 40))
    label, place, _ = rst.read(path, MPI.COMM_SELF)
    order = np.argsort(label)
    every, _ = file.record(int(header[ansys_rst.NODES]))
    rule, places = rule_of("ANSYS", "SOLID186", "hexahedron20"), place[order][np.searchsorted(label[order], elements)]
    E = nodal_stress_matrices("hexahedron20", rule, places, elasticity(16.9e6, 0.31))
    at = np.searchsorted(node, elements[:, :8])
    for k, start in enumerate(file.record(int(header[ansys_rst.INDEX]))[0][:6].tolist()):
        u = ansys_rst._displacements(file, start, file.record(start)[0], np.argsort(every), len(every))
        own = E.reshape(40, 20 * 6, 60) @ u[np.searchsorted(np.sort(every), elements)].reshape(40, 60, 1)
        own = own.reshape(40, 20, 6)[:, :8]
        total = np.zeros((len(node), 6))
        np.add.at(total, at, own)
        mean = total / np.bincount(at.ravel(), minlength=len(node))[:, None]
        assert np.abs(mean - stress[k]).max() < 2e-7 * np.abs(mean).max()
        assert (moved[k] == u[np.searchsorted(np.sort(every), node)]).all()


def punch(cases, kind="67", system=0):
    """The text of a punch file: subcases of displacements by grid, and of elements with stresses (6,) by corner."""
    lines = []

    def add(text, *numbers):
        words = (f"{item:18d}" if isinstance(item, int) else f"{item:18.6E}" for item in numbers)
        lines.append(text.ljust(18) + "".join(words))

    for number, (moved, elements) in enumerate(cases, 1):
        lines.extend(["$TITLE   =", "$DISPLACEMENTS", "$REAL OUTPUT", f"$SUBCASE ID = {number:11d}"])
        for grid, u in moved.items():
            add(f"{grid:10d}       G", *map(float, u))
            add("-CONT-", 0.0, 0.0, 0.0)
        lines.extend(["$TITLE   =", "$ELEMENT STRESSES", "$REAL OUTPUT", f"$SUBCASE ID = {number:11d}",
                      f"$ELEMENT TYPE = {kind:>11}"])  # fmt: skip
        for element, corners in elements.items():
            lines.append(f"{element:10d}{system:12d}GRID CS {len(corners)} GP")
            for grid, s in [(0, [0.0] * 6), *corners.items()]:
                xx, yy, zz, xy, yz, zx = map(float, s)
                other = (1.0, 1.0, 1.0)
                for three in ((grid, xx, xy), other, other, (yy, yz, 1.0), other, (zz, zx, 1.0), other):
                    add("-CONT-", *three)
    return "".join(f"{line:72}{k:8d}\n" for k, line in enumerate(lines, 1))


def two_bricks(rng):
    """Displacements of 12 grids, and stresses at the corners of two bricks that share four."""
    moved = {grid: rng.standard_normal(3).round(4) for grid in range(1, 13)}
    return moved, {7: {grid: rng.standard_normal(6).round(4) for grid in range(1, 9)},
                   9: {grid: rng.standard_normal(6).round(4) for grid in range(5, 13)}}  # fmt: skip


@pytest.mark.mpi
def test_a_punch_file_of_nastran_has_means_of_corners(comm, folder):
    cases = [two_bricks(np.random.default_rng(seed)) for seed in (1, 2)]
    if comm.rank == 0:
        (folder / "job.pch").write_text(punch(cases))
    comm.Barrier()
    found = read_answers(folder / "job.pch", comm)
    node, moved, stress = everywhere(comm, found)
    assert node.tolist() == list(range(1, 13))
    for k, (u, elements) in enumerate(cases):
        for i, grid in enumerate(node.tolist()):
            given = [corners[grid] for corners in elements.values() if grid in corners]
            assert moved[k, i] == pytest.approx(u[grid]) and stress[k, i] == pytest.approx(np.mean(given, axis=0))


@pytest.mark.parametrize("text, says", [
    (lambda cases: punch(cases, "33"), "stresses of the element type 33, expected solids"),
    (lambda cases: punch(cases, system=5), "stresses in the basic coordinate system"),
    (lambda cases: punch(cases).replace("$REAL OUTPUT", "$REAL-IMAGINARY"), "without .REAL OUTPUT"),
    (lambda cases: punch(cases)[:-81], "records of 64 lines"),
    (lambda cases: punch(cases).replace("$DISPLACEMENTS", "$EIGENVECTOR  "), "found displacements of 0 subcases"),
    (lambda cases: punch(cases).replace("E+00", "X+00", 1), "numbers in fields of 18 characters"),
])  # fmt: skip
def test_punch_files_that_are_not_understood_are_refused(tmp_path, text, says):
    (tmp_path / "job.pch").write_text(text([two_bricks(np.random.default_rng(3))]))
    with pytest.raises(InputError, match=says):
        read_answers(tmp_path / "job.pch", MPI.COMM_SELF)


def exchanged(text, first, second):
    lines = text.splitlines(keepends=True)
    lines[first], lines[second] = lines[second], lines[first]
    return "".join(lines)


def without_numbers(text):
    return "".join(f"{line[:72].rstrip() if line.startswith('$') else line[:72]}\n" for line in text.splitlines())


@pytest.mark.parametrize("text, says", [
    (lambda good: exchanged(good, 35, 36), "lines are missing or exchanged"),
    (lambda good: exchanged(good, 44, 45), "expected the line that follows by the numbers at the ends; lines are"),
    (lambda good: exchanged(good, 43, 51), "lines are missing or exchanged"),
    (lambda good: exchanged(without_numbers(good), 4, 5), "records of 2 lines, -CONT- in all but"),
    (lambda good: good.replace("      40\n", "      4x\n"), "expected the number of the line at its end"),
    (lambda good: good[: 4 * 81 + 18] + f"{'nan':>18}" + good[4 * 81 + 36 :], "line 5: .* expected finite numbers"),
    (lambda good: good[:20], "found displacements of 0 subcases"),
    (lambda good: good[:20] + "\n", "found displacements of 0 subcases"),
])  # fmt: skip
def test_damaged_punch_files_are_refused(tmp_path, text, says):
    good = punch([two_bricks(np.random.default_rng(3))])
    (tmp_path / "job.pch").write_text(without_numbers(good))
    read_answers(tmp_path / "job.pch", MPI.COMM_SELF)
    (tmp_path / "job.pch").write_text(text(good))
    with pytest.raises(InputError, match=says):
        read_answers(tmp_path / "job.pch", MPI.COMM_SELF)


@pytest.mark.parametrize("seed", range(3))
def test_damaged_results_of_ansys_are_refused_or_whole(tmp_path, seed):
    """Words of lengths, places and counts, of which the file has no checksum: a sentence, or finite numbers."""
    good = np.fromfile(shared("ansys/file.rst"), "<i4")
    small = np.flatnonzero((np.abs(good) < 200_000) & (good != 0))
    rng, refused = np.random.default_rng(seed), 0
    for _ in range(80):
        damaged, k = good.copy(), int(rng.choice(small))
        damaged[k] = rng.choice([0, -1, 1, 2**31 - 1, -(2**31), int(rng.integers(2000)), good[k] ^ 4])
        damaged.tofile(tmp_path / "a.rst")
        try:
            found = read_answers(tmp_path / "a.rst", MPI.COMM_SELF)
        except InputError:
            refused += 1
            continue
        assert np.isfinite(found.stress).all() and np.isfinite(found.displacement).all()
    assert refused > 5


def test_an_element_without_its_pointer_to_stresses_is_refused(tmp_path, monkeypatch):
    """The table of pointers of an element, cut to none."""
    plain = ansys_rst._alike

    def without(file, places):
        for which, numbers in plain(file, places):
            yield which, numbers[:, :2] if numbers.shape[1] > 20 and numbers.dtype.kind == "i" else numbers

    path = shared("ansys/file.rst")
    monkeypatch.setattr(ansys_rst, "_alike", without)
    with pytest.raises(InputError, match="the file is damaged"):
        read_answers(path, MPI.COMM_SELF)
