"""How factors are made and kept: workspace, memory limits, out of core, low rank."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from launch import TWO_BUILDS

import hpcred
import hpcred as package
from hpcred import Krylov, Modes
from hpcred.cli.main import run
from hpcred.linalg.blocks import apply, create_block, from_dense, local_rows, random_block
from hpcred.linalg.options import temporary_options
from hpcred.linalg.solvers import base, mumps
from hpcred.linalg.solvers.settings import Factoring
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.failures import ComputationError, InputError
from hpcred.parallel.petsc import PETSc, SLEPc

FREQUENCIES = np.linspace(5, 295, 30)
JOB = (
    'model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n[[basis]]\nkind = "krylov"\nfrequency = 900.0\n'
)


@pytest.fixture
def model(comm):
    with hpcred.solid((3, 2, 2), inputs=3, comm=comm) as model:
        yield model


@pytest.mark.mpi
def test_a_workspace_that_is_too_small_is_enlarged(comm):
    """MUMPS' factor is unusable after INFOG(1) = -9; the shift after it must be right as well."""
    with hpcred.solid((8, 8, 8), inputs=1, comm=comm) as model:
        options = PETSc.Options("shift_")
        options["mat_mumps_icntl_14"] = -60
        options["mat_mumps_icntl_23"] = 0  # with the memory known, MUMPS takes what it needs at once
        loads, solution = from_dense(model.B), create_block(model.K, 1)
        solver = ShiftedSolver(model)
        for frequency in (0.0, 500.0):
            solver.factor(-((2 * np.pi * frequency) ** 2))
            solver.solve(loads, solution)
            assert solver.records[-1].residual < 1e-9
        options.delValue("mat_mumps_icntl_14")
        options.delValue("mat_mumps_icntl_23")
        if comm.size == 1:
            assert solver.records[0].workspace_retries > 0
        solver.close()


def block_of_slepc(mat, columns):
    """A block as SLEPc makes it by itself, with columns that are padded to an even length since 3.20."""
    block = SLEPc.BV().create(comm=mat.comm)
    block.setSizes((mat.getLocalSize()[0], mat.getSize()[0]), columns)
    block.setType(SLEPc.BV.Type.MAT)
    return block


@pytest.mark.mpi
@pytest.mark.parametrize("create", [create_block, block_of_slepc])
@pytest.mark.parametrize("columns", [1, 2, 5])
@pytest.mark.parametrize("last", [0, 101, 1000])
def test_columns_with_an_odd_number_of_rows_on_each_rank(comm, create, columns, last):
    """PETSc's solves by MUMPS ignore that columns may be padded; `last`: rows of the last rank."""
    local = 101 if comm.rank < comm.size - 1 or comm.size == 1 else last
    rows = comm.allreduce(local)
    mat = PETSc.Mat().createAIJ(((local, rows), (local, rows)), nnz=(3, 2), comm=comm)
    for row in range(*mat.getOwnershipRange()):
        for column in range(max(row - 1, 0), min(row + 2, rows)):
            mat.setValue(row, column, 3.0 + row if row == column else -1.0)
    mat.assemble()
    expected, load, solution = random_block(mat, columns), create(mat, columns), create(mat, columns)
    apply(mat, expected, load)
    factorisation = mumps.Mumps(mat, False, "odd_")
    factorisation.factor(mass="0", damping="0", inertia_relief=False)
    factorisation.back_substitute(load, solution)
    with local_rows(expected) as x, local_rows(solution) as y:
        assert np.allclose(x, y, rtol=0, atol=1e-12)
    factorisation.close()


@pytest.mark.mpi
def test_factors_on_disk_are_the_same(comm, folder):
    with package.solid((8, 6, 6), inputs=3, comm=comm) as model:
        basis = [Krylov(frequency=100.0, order=1), Krylov(frequency=2000.0)]
        found = []
        for options in (None, Factoring(out_of_core=str(folder))):
            with package.reduce(model, basis, factoring=options) as rom:
                found.append(package.frequency_response(rom, FREQUENCIES))
        comm.Barrier()
        assert not os.listdir(folder)  # MUMPS has removed its files
        if comm.size == 1:  # where they were, while the solver was there
            solver = ShiftedSolver(model, factoring=Factoring(out_of_core=str(folder)))
            solver.factor(-1e4)
            assert os.listdir(folder)
            solver.close()
    assert np.abs(found[1] - found[0]).max() < 1e-12 * np.abs(found[0]).max()


def test_low_rank_factors_reach_the_same_residual(hpcred, tmp_path, monkeypatch):
    """In a program of its own, since MUMPS must be without Scotch there."""
    monkeypatch.chdir(tmp_path)
    package.write_model("model.h5", package.solid((8, 4, 4)))
    (tmp_path / "job.toml").write_text(JOB)
    low_rank = hpcred("reduce", "job.toml", "--json", "low_rank.json", "--low-rank", "1e-5", ranks=2)
    if not TWO_BUILDS and "with Scotch crashes there" in low_rank.stderr:
        pytest.skip("the MUMPS of this PETSc cannot do it")
    assert low_rank.returncode == 0, low_rank.stderr
    assert run(["reduce", "job.toml", "--json", "full.json"]) == 0
    full, found = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("full", "low_rank"))
    for record in (full, found):
        assert max(item["residual"] for item in record["factorisations"]) < 1e-10
    assert found["frequencies_hz"][:6] == pytest.approx(full["frequencies_hz"][:6], rel=1e-9)
    assert found["job"]["low_rank"] == 1e-5


@pytest.mark.mpi
def test_a_factor_that_does_not_fit_is_refused_before_it_is_made(comm, monkeypatch):
    with package.solid((10, 8, 8), inputs=1, comm=comm) as model:
        monkeypatch.setenv("HPCRED_MEMORY_MB", "3")
        with pytest.raises(ComputationError, match=r"about \d+ MB on one rank .* a rank has 3 MB.*out_of_core"):
            package.reduce(model, [Krylov(frequency=100.0)])
        with pytest.raises(ComputationError, match=r"does not fit"):
            package.reduce(model, [Modes(band=(0.0, 3000.0))])
        monkeypatch.delenv("HPCRED_MEMORY_MB")
        solver = ShiftedSolver(model)
        need, have = solver.estimate()
        solver.factor(-1e4)
        record = solver.records[-1]
        assert need == pytest.approx(record.memory_mb_estimated_total, rel=0.1)
        assert need > 0.9 * record.memory_mb_used_total > 0
        assert have > 100 * comm.size
        solver.close()


@pytest.mark.parametrize(
    "options, says",
    [
        ({"low_rank": 0.5}, "low_rank: found 0.5"),
        ({"low_rank": -1e-8}, "low_rank: found -1e-08"),
        ({"out_of_core": "/dev/null/at"}, "the folder /dev/null/at cannot be made or written"),
    ],
)
def test_options_that_make_no_sense(options, says):
    with pytest.raises(InputError, match=says):
        replace(Factoring(), **options)


def test_the_folder_for_factors_is_made_with_the_first_one(tmp_path):
    factoring = Factoring(out_of_core=str(tmp_path / "new" / "folder"))
    assert not (tmp_path / "new").exists()
    with hpcred.solid((3, 2, 2)) as model:
        solver = ShiftedSolver(model, factoring=factoring)
        solver.factor(0.0)
        assert (tmp_path / "new" / "folder").is_dir()
        solver.close()
    program = tmp_path / "program"
    program.touch(0o700)  # which may be written and executed, as a folder
    with pytest.raises(InputError, match="program/at cannot be made or written"):
        Factoring(out_of_core=str(program / "at"))


@pytest.mark.mpi(ranks=(2,))
def test_a_folder_that_one_node_cannot_make_is_refused_on_all_ranks(comm, tmp_path, monkeypatch):
    factoring = Factoring(out_of_core=str(comm.bcast(tmp_path)))
    if comm.rank == 1:
        monkeypatch.setattr(os, "access", lambda *_: False)
    with hpcred.solid((3, 2, 2), comm=comm) as model, pytest.raises(InputError, match="cannot be made or written"):
        ShiftedSolver(model, factoring=factoring).factor(0.0)


def test_a_full_response_does_not_name_what_only_reductions_can_do(monkeypatch):
    monkeypatch.setenv("HPCRED_MEMORY_MB", "2")
    with hpcred.solid((8, 6, 6), inputs=1) as model:
        with pytest.raises(ComputationError, match="does not fit.*out_of_core: about [0-9]+ MB a rank[)]$"):
            hpcred.frequency_response(model, [10.0])
        with pytest.raises(ComputationError, match="does not fit.*out_of_core: about [0-9]+ MB a rank[)]$"):
            hpcred.full_response(model, [10.0, 9000.0])
        for asked in ({"basis": [hpcred.Krylov(frequency=0.0)]}, {"tolerance": 1e-3, "band": (0.0, 9000.0)}):
            with pytest.raises(ComputationError, match="out_of_core.*solver.unfit = 'multigrid'"):
                hpcred.reduce(model, **asked)


@pytest.mark.parametrize(
    "version, libraries, refused",
    [("5.5", "scotch", True), ("5.5", "scotch metis_kway", False), ("5.5", "", False), ("5.6.0", "scotch", False)],
)
def test_low_rank_is_refused_where_mumps_crashes(monkeypatch, version, libraries, refused):
    def set_version(text, length):
        text.value = version.ljust(length.value - 1).encode()

    functions = {f"mumps_{name}_": print for name in libraries.split()} | {"mumps_set_version_": set_version}
    monkeypatch.setattr(mumps, "_function", functions.get)
    if refused:
        with pytest.raises(InputError, match="low_rank: MUMPS 5.5 with Scotch crashes"):
            mumps.controls(Factoring(low_rank=1e-8))
    else:
        assert mumps.controls(Factoring(low_rank=1e-8)) == {"icntl_35": 2, "cntl_7": 1e-8}


def test_what_mumps_was_built_with_is_seen():
    """By the ordering that it takes when it is asked for Scotch."""
    with package.solid((3, 2, 2), inputs=1) as model:
        factors = mumps.Mumps(model.K, True, "scotch_", settings={"icntl_7": 3})
        factors.factor(mass=0.0, damping=0.0, inertia_relief=False)
        assert (factors.records[-1].ordering == "SCOTCH") == (mumps._function("mumps_scotch_") is not None)
        factors.close()


@pytest.mark.mpi
def test_of_several_orderings_that_of_the_fewest_operations_is_taken_once(comm, monkeypatch):
    """AMD and PORD here, which every MUMPS has, in place of METIS and Scotch."""
    with package.solid((10, 8, 8), inputs=1, comm=comm) as model:
        solver = ShiftedSolver(model)
        flops = {key: item["flops"] for key, item in solver.factors.expected((0, 4)).items()}
        solver.close()
        best = min(flops, key=flops.get)
        assert flops[0] != flops[4]
        for order in ((0, 4), (4, 0)):
            monkeypatch.setattr(mumps, "orderings", lambda order=order: order)
            monkeypatch.setattr(mumps, "CHOOSE_ABOVE", 1)
            solver = ShiftedSolver(model)
            for mass in (-1e4, -2e4):
                solver.factor(mass)
            assert {record.ordering for record in solver.records} == {mumps.ORDERINGS[best]}
            assert solver.analyses == 3
            solver.close()


@pytest.mark.mpi
@pytest.mark.parametrize("option", ["7", "28"])
def test_a_choice_of_the_user_is_not_compared(comm, monkeypatch, option):
    """Of an ordering (AMD), or of where the analysis runs (1: on one rank; 2 wants PT-Scotch or ParMETIS)."""
    monkeypatch.setattr(mumps, "orderings", lambda: (0, 4))
    monkeypatch.setattr(mumps, "CHOOSE_ABOVE", 1)
    chosen = {f"mat_mumps_icntl_{option}": {"7": 0, "28": 1}[option]}
    with package.solid((4, 3, 3), inputs=1, comm=comm) as model, temporary_options("shift_", {}, chosen):
        solver = ShiftedSolver(model)
        solver.factor(-1e4)
        assert solver.analyses == 1
        solver.close()


def test_folders_that_mumps_cannot_write_to(model, tmp_path):
    """A name that is too long for it, and a folder that is gone when it comes to write."""
    long = tmp_path / ("x" * 200) / ("y" * 100)
    long.mkdir(parents=True)
    with pytest.raises(InputError, match="MUMPS takes 255; name another"):
        Factoring(out_of_core=str(long))
    (tmp_path / "gone").mkdir()
    solver = ShiftedSolver(model, factoring=Factoring(out_of_core=str(tmp_path / "gone")))
    (tmp_path / "gone").rmdir()
    with pytest.raises(ComputationError, match="out_of_core: MUMPS cannot write factors to .*gone; make room there"):
        solver.factor(-1e4)
    solver.close()


@pytest.mark.mpi
def test_solves_for_more_columns_than_32_bits_count_go_by_slices(comm, model, monkeypatch):
    """PETSc counts the numbers of a block by 32 bits: with a limit of two columns seven go by four calls."""
    loads = random_block(model.K, 7)
    solver, solutions = ShiftedSolver(model), []
    solver.factor(0.0)
    calls, solve = [], solver.factors._solve
    monkeypatch.setattr(solver.factors, "_solve", lambda b, x: (calls.append(b.getSize()[1]), solve(b, x)))
    for most in (base.MOST_NUMBERS, 2 * model.size + 1):
        monkeypatch.setattr(base, "MOST_NUMBERS", most)
        solutions.append(create_block(model.K, 7))
        solver.solve(loads, solutions[-1])
        assert solutions[-1].getActiveColumns() == loads.getActiveColumns() == (0, 7)
    assert calls == [7, 2, 2, 2, 1]
    with local_rows(solutions[0]) as one, local_rows(solutions[1]) as other:
        assert np.allclose(one, other, rtol=1e-9, atol=1e-9 * abs(one).max(initial=0.0))
    solver.close()
