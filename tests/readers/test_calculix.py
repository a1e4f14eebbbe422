"""What CalculiX writes: real files against the program's own frequencies, small ones of our own, damaged copies."""

import gzip
import shutil

import numpy as np
import pytest
from conftest import DATA
from fe_data import FE, needs_fe
from foreign import assembled, gathered, write
from helpers import to_dense

import hpcred
from hpcred import Buckens, InputError, Modes
from hpcred.fe.dofs import SCALAR
from hpcred.parallel.petsc import is_complex
from hpcred.readers.calculix.matrix_storage import begins, files_of
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

RNG = np.random.default_rng(2)
ROOT = RNG.standard_normal((7, 7))
K, M = np.round(ROOT @ ROOT.T + 9 * np.eye(7), 6), np.diag(np.arange(1.0, 8.0))
K[2, 5] = K[5, 2] = 0.0
ROWS = [(1, 1), (1, 2), (1, 3), (2, 1), (2, 3), (8, 1), (8, 3)]  # y of nodes 2 and 8 is held
INPUT = """*NODE, NSET=Nall
1, 0., 0., 0.
2, 1., 0., 0.
8, 0., 2., 0.
9, 0., 0., 3.
*ELEMENT, TYPE=C3D4, ELSET=E
1, 1, 2, 8, 9
*NSET, NSET=two
2, 9
*BOUNDARY
TWO, 2
8, 2,, 0.
9, 1, 3
1, 6
*STEP
*FREQUENCY, SOLVER=MATRIXSTORAGE
2
*END STEP
"""


def triangle(matrix, pattern):
    """The lines of a .sti file."""
    places = [(i, j) for j in range(len(matrix)) for i in range(j + 1) if pattern[i, j]]
    return "".join(f"{i + 1} {j + 1} {matrix[i, j]:20.13e}\n" for i, j in places)


def put(comm, folder, rows=ROWS, text=INPUT, **changed):
    """A set of files of our own; `changed`: other contents by suffix, None for no file."""
    contents = {"sti": triangle(K, K), "mas": triangle(M, K), "inp": text} | changed
    contents.setdefault("dof", "".join(f"{n}.{d}\n" for n, d in rows))
    for suffix, content in contents.items():
        if content is not None:
            write(folder / f"a.{suffix}", content, comm)
    return folder / "a.inp"


@pytest.mark.parametrize("name", ["a.inp", "a.sti", "a.mas", "a.dof"])
def test_any_file_of_the_set_gives_the_model(comm, folder, monkeypatch, name):
    for size in (2**21, 64):
        monkeypatch.setattr("hpcred.files.text.PIECE", size)
        put(comm, folder)
        with load_export(folder / name, comm) as model:
            assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
            node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
            assert list(zip(node, direction + 1, strict=True)) == ROWS
            node, direction = gathered(comm, model.held.node, model.held.direction)
            assert sorted(zip(node, direction + 1, strict=True)) == [(2, 2), (8, 2), (9, 1), (9, 2), (9, 3)]
            assert comm.allreduce(len(model.elements["tetra"])) == 1
            assert sorted(gathered(comm, model.sets["two"])[0]) == [2, 9] and not model.remarks
        comm.Barrier()


def test_single_matrices_and_packed_files(comm, folder):
    put(comm, folder)
    for suffix in ("sti", "mas"):
        write(folder / f"b.{suffix}.gz", gzip.compress((folder / f"a.{suffix}").read_bytes()), comm)
    write(folder / "b.dof", (folder / "a.dof").read_bytes(), comm)
    with load_source(Source(str(folder / "a.sti"), str(folder / "b.mas.gz")), comm) as model:
        assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
    assert files_of(folder / "b.sti.gz") == {
        "K": str(folder / "b.sti.gz"), "M": str(folder / "b.mas.gz"), "dofs": str(folder / "b.dof")}  # fmt: skip
    with load_export(folder / "b.sti.gz", comm) as model:
        assert np.array_equal(to_dense(model.K), K) and model.dofs is None
        assert "found no input file (b.inp) beside it" in model.remarks[0]


def test_other_texts_are_not_taken_for_calculix():
    below = b"1 1  4.2837047252738e+09\n2 1  4.2837047252738e+09\n"
    for text in (b"1 1 2.0\n2 2 3.0\n", below, b"1, 1.0\n", b"2.5 3.5\n", b""):
        assert not begins(text)


def test_displacements_of_a_rot_node_are_rotations_of_the_ref_node(comm, folder):
    rows = [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3), (9, 3)]
    rigid = "*RIGID BODY, NSET=two, REF NODE=1, ROT NODE=2\n*BOUNDARY\n9, 1, 2\n*STEP"
    text = INPUT.replace("TWO, 2\n8, 2,, 0.\n9, 1, 3\n1, 6\n", "8, 1, 3\n").replace("*STEP", rigid)
    for ref in (1, 8):
        put(comm, folder, rows, text.replace("REF NODE=1", f"REF NODE={ref}"))
        with load_export(folder / "a.inp", comm) as model:
            node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
            expected = [(1, 0), (1, 1), (1, 2), (ref, 3), (ref, 4), (ref, 5), (9, 2)]
            assert list(zip(node, direction, strict=True)) == expected
        comm.Barrier()
    # without a ROT NODE, CalculiX makes one with a number of its own
    other = [(1, 1), (1, 2), (1, 3), (9, 3), (30, 1), (30, 2), (30, 3)]
    put(comm, folder, other, text.replace(", ROT NODE=2", ""))
    with load_export(folder / "a.inp", comm) as model:
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
        assert list(zip(node, direction, strict=True))[4:] == [(1, 3), (1, 4), (1, 5)]
    put(comm, folder, other[:4] + [(30, 1), (30, 2), (31, 3)], text)
    with load_export(folder / "a.inp", comm) as model:
        assert model.dofs is None and "the node 30 is not in" in model.remarks[0]
    # those that it makes have numbers above all of the input file
    put(comm, folder, [*rows[:5], (5, 3), (9, 3)], text)
    with pytest.raises(InputError, match=r"a.dof: found rows of the node 5, which is not in .*a.inp; expected the inp"):
        load_export(folder / "a.inp", comm)


@pytest.mark.costly
def test_rows_inside_of_elements_and_of_couplings(comm, folder):
    """C3D8I has nine rows of no node; *Kinematic and *Rigid Body have ROT nodes that CalculiX made before those."""
    for suffix in ("inp", "dof", "sti.gz", "mas.gz"):
        write(folder / f"a.{suffix}", (DATA / "calculix" / f"incompatible.{suffix}").read_bytes(), comm)
    inputs = [(40, "rx"), (41, "rz"), (41, "x")]
    with load_export(folder / "a.inp", comm) as model, model.with_inputs(inputs) as loaded:
        report = hpcred.inspect(model)
        assert max(report["rigid_body_residuals"]) < 1e-14 and "27 rows are the incompatible" in report["warnings"][0]
        assert report["nodes"] == 10 or comm.size > 1
        assert report["masses_in_x_y_z_kg"] == pytest.approx([7850 * 0.003] * 3, rel=1e-9)
        assert np.allclose(report["extent_m"], [[0.95, 2, 0], [1.3, 2.1, 0.1]]) and report["units"] == "m, kg, s"
        direction = gathered(comm, model.dofs.direction)[0]
        assert np.count_nonzero(direction == SCALAR) == 27 and np.count_nonzero(direction == 3) == 2
        with hpcred.reduce(loaded, [Modes(count=4)], Buckens()) as rom:
            assert np.allclose(rom.frequencies, [4683.275, 4683.275, 5592.409, 6848.244], rtol=5e-7)  # of CalculiX
    text = (DATA / "calculix" / "incompatible.inp").read_text()
    write(folder / "a.inp", text.replace("REF NODE=41", "REF NODE=40"), comm)
    with load_export(folder / "a.inp", comm) as model:  # rotations of 40 twice
        assert model.dofs is None and "each *Coupling with *Kinematic a REF NODE of its own" in model.remarks[0]


def test_supports_along_axes_of_their_own_hold_no_global_direction(comm, folder):
    local = "*TRANSFORM, NSET=two\n1., 1., 0., -1., 1., 0.\n*BOUNDARY\n"
    put(comm, folder, text=INPUT.replace("*BOUNDARY\n", local))
    with load_export(folder / "a.inp", comm) as model:
        node, direction = gathered(comm, model.held.node, model.held.direction)
        assert sorted(zip(node, direction + 1, strict=True)) == [(8, 2), (9, 1), (9, 2), (9, 3)]
        assert "*Boundary holds 1 nodes along axes of their own" in model.remarks[0]
    put(comm, folder, text=INPUT.replace("SOLVER=MATRIXSTORAGE", "SOLVER=MATRIXSTORAGE, GLOBAL=NO"))
    with pytest.raises(InputError, match="found .Frequency with GLOBAL=NO, expected matrices in global directions"):
        load_export(folder / "a.inp", comm)


def test_rows_of_expanded_elements_have_no_names(comm, folder):
    put(comm, folder, [*ROWS[:6], (1, 2)])
    with load_export(folder / "a.inp", comm) as model:
        assert model.dofs is None and np.array_equal(to_dense(model.K), K)
        assert "found 1:y for several rows, since CalculiX makes solids of beams and shells" in model.remarks[0]


BARS = INPUT.replace("TYPE=C3D4", "TYPE=T3D2").replace("1, 1, 2, 8, 9", "1, 1, 2\n2, 2, 8\n3, 8, 9")


def test_bars_whose_nodes_have_one_row_each_keep_their_names(comm, folder):
    put(comm, folder, text=BARS)
    with load_export(folder / "a.inp", comm) as model:
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
        assert list(zip(node.tolist(), (direction + 1).tolist(), strict=True)) == ROWS


def test_bars_with_several_rows_of_a_name_are_told_by_one_of_the_file(comm, folder):
    put(comm, folder, [*ROWS[:6], (8, 1)], text=BARS)
    with load_export(folder / "a.inp", comm) as model:
        assert model.dofs is None and "a.dof: found 8:x for several rows" in model.remarks[0]


@pytest.mark.parametrize("kind, says", [("CPS4R", "rows of their thickness"), ("CAX4", "a sector of 2 degrees")])
def test_rows_of_plane_elements_have_no_names(comm, folder, kind, says):
    put(comm, folder, text=INPUT.replace("TYPE=C3D4", f"TYPE={kind}"))
    with load_export(folder / "a.inp", comm) as model:
        assert model.dofs is None and says in model.remarks[0] and kind in model.remarks[0]


LINES = triangle(K, K)
SHORT = LINES[: LINES.rindex("7 7 ")]
DOFS = "1.1\n1.2\n1.3\n2.1\n2.3\n8.1\n"


@pytest.mark.parametrize(
    "changed, says",
    [
        ({"sti": LINES[:-1]}, "a.sti: found no line break at its end; the file is cut"),
        ({"sti": SHORT}, "found 6 entries of the diagonal for 7 columns"),
        ({"sti": LINES.replace("\n4 5 ", "\n5 4 ")}, "expected an entry of the upper triangle"),
        ({"sti": LINES.replace("\n4 5 ", "\n3 5 ")}, "expected an entry of the upper triangle"),
        ({"sti": LINES.replace("\n2 6 ", "\n3 6 ")}, "expected an entry of the upper|entries of 7 rows, at other"),
        ({"mas": triangle(M, M)}, "found 7 entries of 7 rows, at other places than the 27 entries of 7 rows"),
        ({"sti": LINES.replace("\n7 7 ", "\n7 9 ")}, "6 entries of the diagonal for 9 columns"),
        ({"sti": LINES.replace("e+0", "e+9", 1)}, "found the value .*e\\+9. in K, more than any units explain"),
        ({"sti": LINES.replace("e+0", "x+0", 1)}, "found a file that begins|expected 3 numbers a line|found '1 1"),
        ({"sti": LINES + "garbage\n"}, "found 'garbage', expected 3 numbers a line"),
        ({"sti": ""}, "found an empty file"),
        ({"dof": DOFS + "8.0\n"}, "found '8.0', expected a displacement .1 to 3.; 0 is a temperature"),
        ({"dof": DOFS + "8.7\n"}, "found '8.7', expected the direction"),
        ({"dof": DOFS + "8,3\n"}, "found '8,3', expected node.direction"),
        ({"dof": DOFS + "8.3"}, "found no line break at its end"),
        ({"dof": DOFS}, "found 6 lines, expected one for each of the 7 rows"),
        ({"sti": None}, "found no matrix K beside it, expected .*a_STIF1.mtx, or a.sti of CalculiX"),
        ({"mas": None}, "found no .*a.mas beside it, expected one of CalculiX, of a step .Frequency"),
        ({"dof": None}, "found no .*a.dof beside it"),
        ({"inp": INPUT.replace("TWO, 2", "three, 2")}, "found .Boundary with 'three, 2', expected a set of nodes"),
        ({"inp": INPUT.replace("8, 2,, 0.", "8, 2, 3, 0., 7")}, "expected node, first direction, last direction"),
    ],
)
def test_damaged_and_incomplete_sets_are_refused(comm, folder, changed, says):
    put(comm, folder, **changed)
    with pytest.raises(InputError, match=says):
        load_export(folder / "a.inp", comm)


def test_an_input_file_without_keywords_is_refused(comm, folder):
    put(comm, folder, inp="\n")
    with pytest.raises(InputError, match="a.inp: found no nodes"):
        load_export(folder / "a.sti", comm)


def test_cyclic_symmetry_is_refused(comm, folder):
    double = np.block([[K, 0 * K], [0 * K, K]])
    text = triangle(double, double)
    put(comm, folder, sti=text, mas=text)
    with pytest.raises(InputError, match="found 14 rows for 7 lines .* with cyclic symmetry CalculiX writes real and"):
        load_export(folder / "a.inp", comm)


def test_matrices_of_two_programs_beside_one_input_file_are_refused(comm, folder):
    put(comm, folder)
    write(folder / "a_STIF1.mtx", "1 1 1.0\n", comm)
    with pytest.raises(InputError, match="found matrices of both Abaqus and CalculiX beside it"):
        load_export(folder / "a.inp", comm)


def flipped(content, generator):
    place = int(generator.integers(len(content)))
    return content[:place] + bytes([content[place] ^ (1 << int(generator.integers(8)))]) + content[place + 1 :]


@pytest.mark.mpi
def test_flipped_bits_change_at_most_digits_of_values(comm, folder):
    """A text without checksum cannot tell a digit from another one; but no entry moves, and none is lost."""
    put(comm, folder)
    generator = np.random.default_rng(4)
    whole = (folder / "a.sti").read_bytes()
    comm.Barrier()
    for _ in range(60):
        write(folder / "a.sti", flipped(whole, generator), comm)
        try:
            with load_export(folder / "a.inp", comm) as model:
                found = to_dense(model.K)
        except InputError:
            continue
        assert np.array_equal(found, found.T)
        assert ((found != 0) <= (K != 0)).all() and np.count_nonzero(np.triu(found) != np.triu(K)) <= 1
        comm.Barrier()


REFERENCE = {  # Hz, of CalculiX: SOURCES.md beside the files
    "beamf/beamf": [13096.03, 19319.52, 76839.71, 86955.23],
    "beam8f/beam8f": [13798.13, 19852.05, 81356.76, 88787.12],
    "shellf/shellf": [19246.92, 61882.39, 199076.9, 247603.1],
    "uprofile/uprofile": [12.98034, 32.22938, 81.29162, 198.5287],
    "transition/transition": [15717.63, 21366.3, 93946.12, 94079.46],
    "lever_rbe/rbe_mat": [1548.835, 2196.967, 3683.907, 4410.217],
}


@needs_fe
@pytest.mark.mpi
@pytest.mark.parametrize("name", REFERENCE)
@pytest.mark.costly
def test_frequencies_are_those_of_calculix(comm, name):
    free = name.startswith("lever")
    with load_export(FE / "calculix" / f"{name}.inp", comm) as model, model.with_inputs([1]) as loaded:
        with hpcred.reduce(loaded, [Modes(count=4)], Buckens() if free else None) as rom:
            assert np.allclose(rom.frequencies[:4], REFERENCE[name], rtol=5e-7)
        assert (model.dofs is None) == (name.split("/")[0] in ("shellf", "uprofile"))
        if name.startswith("beamf"):
            assert any("C3D20R have a singular mass matrix" in remark for remark in model.remarks)
        if free:
            report = hpcred.inspect(model)
            assert max(report["rigid_body_residuals"]) < 1e-14  # rotations of the bearings are where they belong
            assert report["masses_in_x_y_z_kg"] == pytest.approx([1.370501] * 3, rel=1e-6)
            assert report["units"] == "m, kg, s"
            named = model.with_inputs([(1077, "rx"), (1079, "rz")])
            assert named.input_names == ("1077:rx", "1079:rz")
        if name.startswith(("beam", "transition")):
            report = hpcred.inspect(model)
            assert report["units"] == "mm, t, s (N, MPa)" and report["held_dofs"] > 0
            assert any("without theirs, too small" in line for line in report["warnings"])


@needs_fe
@pytest.mark.mpi(ranks=(1,))
@pytest.mark.skipif(is_complex(), reason="once is enough")
def test_damaged_copies_of_real_files_are_refused(comm, folder):
    generator = np.random.default_rng(9)
    source = FE / "calculix" / "transition"
    for suffix in ("sti", "mas", "dof", "inp"):
        shutil.copy(source / f"transition.{suffix}", folder / f"a.{suffix}")
    whole = {suffix: (folder / f"a.{suffix}").read_bytes() for suffix in ("sti", "mas", "dof")}
    for suffix, content in whole.items():
        for cut in generator.integers(1, len(content) - 1, 12):
            (folder / f"a.{suffix}").write_bytes(content[:cut])
            with pytest.raises(InputError):
                load_export(folder / "a.sti", comm)
        (folder / f"a.{suffix}").write_bytes(content + b"x")
        with pytest.raises(InputError):
            load_export(folder / "a.sti", comm)
        (folder / f"a.{suffix}").write_bytes(content)
    with load_export(folder / "a.sti", comm) as model:
        assert model.size == 216


def test_texts_are_read_by_all_ranks(comm, folder):
    """The first bytes of every piece lie on the rank that reads it."""
    put(comm, folder)
    assert np.array_equal(assembled(folder / "a.sti", comm), K)
