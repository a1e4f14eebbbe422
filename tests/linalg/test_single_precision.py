"""Factors in single precision, refined to the residual of full ones; they need a newer PETSc than Debian's 3.18."""

import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred import Buckens, Factoring, Krylov, LinearSolver, Modes
from hpcred.linalg.blocks import create_block, local_rows, random_block
from hpcred.linalg.solvers import mumps
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.model.frames import apply_frame
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import PETSc

SINGLE, DOUBLE = (Factoring(solver=LinearSolver(precision=word)) for word in ("single", "double"))


def require_single():
    try:
        mumps._check_single()
    except InputError as error:
        pytest.skip(str(error))


def test_an_older_petsc_is_refused(monkeypatch):
    monkeypatch.setattr(mumps, "SINGLE_SINCE", (99, 0))
    found = ".".join(map(str, PETSc.Sys.getVersion()))
    with (
        hpcred.solid((2, 1, 1), inputs=1) as model,
        pytest.raises(InputError, match=f"^solver.precision: 'single' needs PETSc 99.0 or later, found {found}; leave"),
    ):
        hpcred.reduce(model, [Krylov(frequency=100.0)], factoring=SINGLE)


def test_a_mumps_without_it_is_refused(monkeypatch):
    monkeypatch.setattr(mumps, "SINGLE_SINCE", (3, 0))
    monkeypatch.setattr(mumps, "_function", lambda name: None)
    with hpcred.solid((2, 1, 1), inputs=1) as model, pytest.raises(InputError, match="a MUMPS without single prec"):
        ShiftedSolver(model, factoring=SINGLE)


@pytest.mark.parametrize("package", ["petsc", "superlu_dist"])
def test_other_packages_have_none(package):
    with pytest.raises(InputError, match=f"solver.precision: solver.package '{package}' has no 'single'; leave it out"):
        Factoring(solver=LinearSolver(package=package, precision="single"))
    with pytest.raises(InputError, match="solver.precision: found 'half', expected 'double' or 'single'"):
        LinearSolver(precision="half")


def test_pivots_of_single_precision_count_nothing():
    assert not SINGLE.counts()


@pytest.mark.mpi
@pytest.mark.parametrize("basis", [[Krylov(frequency=3000.0, order=2)], [Krylov(frequency=2000.0, decay=900.0)],
                                   [Modes(count=4)], None])  # fmt: skip
def test_models_are_those_of_full_factors(comm, basis):
    require_single()
    given = {"basis": basis} if basis else {"tolerance": 1e-6, "band": (0.0, 30000.0)}
    found = []
    with hpcred.solid((8, 4, 4), inputs=2, comm=comm) as model:
        for factoring in (DOUBLE, SINGLE):
            with hpcred.reduce(model, factoring=factoring, **given) as rom:
                found.append(hpcred.frequency_response(rom, np.linspace(100.0, 3000.0, 10)))
                record = rom.record
    assert np.abs(found[1] - found[0]).max() < 1e-8 * np.abs(found[0]).max()
    assert {item.precision for item in record.factorisations} <= {"single"}
    assert max((item.residual for item in record.factorisations), default=0.0) < 1e-10
    if record.accuracy is not None:
        assert record.accuracy.reached and "a second verification replaces the count" in record.accuracy.measured


@pytest.mark.mpi
def test_a_factor_takes_about_half_the_memory(comm):
    require_single()
    used = []
    with hpcred.solid((16, 10, 10), inputs=2, comm=comm) as model:
        for factoring in (DOUBLE, SINGLE):
            solver = ShiftedSolver(model, factoring=factoring)
            solver.factor(-1e6)
            used.append(solver.records[-1].memory_mb_used_total)
            solver.close()
    assert used[1] < 0.75 * used[0]


@pytest.mark.mpi
def test_loads_of_any_size(comm):
    """Of 1e-60 N, which is no number of single precision; a free body."""
    require_single()
    sizes = np.array([1.0, 1e-60, 1e30])
    with hpcred.linkage(comm) as model:
        framed = apply_frame(model, Buckens())
        solver = ShiftedSolver(framed.model, framed.rigid, factoring=SINGLE)
        solver.factor(-1e4)
        load, solution = random_block(framed.model.K, 3), create_block(framed.model.K, 3)
        solver.solve(load, solution)
        expected = gather(solution) * sizes
        with local_rows(load) as rows:
            rows *= sizes
            before = rows.copy()
        solver.solve(load, solution)
        with local_rows(load) as rows:
            assert (rows == before).all(), "the load is what it was"
        found = gather(solution)
        solver.close()
    assert (np.abs(found - expected).max(axis=0) < 1e-9 * np.abs(expected).max(axis=0)).all()
