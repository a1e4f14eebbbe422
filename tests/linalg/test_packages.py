"""Direct solvers by their packages: the same results, the second proof where pivots tell nothing, and refusals."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from helpers import dense_model, few_on_ranks, refused

import hpcred
import hpcred as package
from hpcred import Buckens, Factoring, Krylov, LinearSolver, Modes, StaticCorrection
from hpcred.analysis.summary import inspect
from hpcred.cli.main import run
from hpcred.linalg.solvers import settings
from hpcred.linalg.solvers.base import Factorisation, SingularMatrix
from hpcred.linalg.solvers.mumps import Mumps
from hpcred.linalg.solvers.petsc import PetscOwn, SuperluDist
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.failures import ComputationError, InputError
from hpcred.parallel.petsc import MPI, PETSc, is_complex

CASES = {"solid": (30000.0, None), "linkage": (300.0, Buckens())}
OTHERS = ("superlu_dist", "petsc")


def by(package, **more):
    return Factoring(solver=LinearSolver(package=package), **more)


def case(name, comm):
    return hpcred.solid((6, 3, 3), inputs=2, comm=comm) if name == "solid" else hpcred.linkage(comm)


def require(package, comm):
    """Skip where the PETSc at hand, or the number of ranks, is not for a package."""
    try:
        settings.Factoring(solver=LinearSolver(package=package)).package.check_build(comm)
    except InputError as error:
        pytest.skip(str(error))


def reduced(model, name, package, kind):
    top, frame = CASES[name]
    given = {
        "tolerance": {"tolerance": 1e-6, "band": (0.0, top)},
        "basis": {"basis": [Krylov(frequency=top / 3, order=1), Modes(band=(0.0, top / 2)), StaticCorrection()]},
        "complex": {"basis": [Krylov(frequency=top / 3, decay=top, order=1)]},
    }[kind]
    return hpcred.reduce(model, frame=frame, factoring=by(package), **given)


def response_by(comm, package, name, kind):
    """The response of the reduced model over the band, and its record."""
    with case(name, comm) as model, reduced(model, name, package, kind) as rom:
        return hpcred.frequency_response(rom, CASES[name][0] * np.linspace(0.02, 1, 20)), rom.record


@cache
def response_by_mumps(name, kind):
    """The same for all packages."""
    return response_by(MPI.COMM_WORLD, "mumps", name, kind)[0]


@pytest.mark.mpi
@pytest.mark.parametrize("name, kind", few_on_ranks(
    [("solid", "tolerance"), ("linkage", "basis"), ("linkage", "tolerance"), ("solid", "basis"), ("solid", "complex"),
     ("linkage", "complex")], 2))  # fmt: skip
@pytest.mark.parametrize("package", OTHERS)
def test_models_are_those_of_mumps(comm, package, name, kind):
    require(package, comm)
    expected, (found, record) = response_by_mumps(name, kind), response_by(comm, package, name, kind)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
    assert {item.package for item in record.factorisations} == {package}
    assert {item.kind for item in record.factorisations} == {"LU" if package == "superlu_dist" else "LDL^T"}
    assert max(item.residual for item in record.factorisations) < 1e-9
    if kind == "tolerance":
        counts = package == "petsc" and not is_complex()
        accuracy = record.accuracy
        assert accuracy.reached and len(accuracy.proofs) == (1 if counts else 2)
        assert (accuracy.points[0].modes_below is not None) == counts
        assert ("a second verification replaces the count" in accuracy.measured) == (not counts)


@pytest.mark.mpi
@pytest.mark.parametrize("package", ["mumps", *OTHERS])
def test_inertia_and_singular_matrices(comm, package):
    """A factor that failed does not spoil the next one."""
    require(package, comm)
    with hpcred.solid((3, 2, 2), inputs=3, comm=comm) as model:
        K, M, _ = dense_model(model)
        values = np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)
        solver = ShiftedSolver(model, inertia=True, factoring=by(package))
        for mass in (-(values[3] + values[4]) / 2, -values[0] / 2):
            with pytest.raises(SingularMatrix):
                solver.factor(-values[7])
            solver.factor(mass)
            known = package != "superlu_dist" and not is_complex()
            assert solver.inertia == (int((values < -mass).sum()) if known else None)
        solver.close()
        empty = model.K.copy()
        empty.zeroRowsColumns([3], diag=0.0)
        factors = by(package).package(empty, True, "empty_", by(package))
        with pytest.raises(SingularMatrix):
            factors.factor(mass="0", damping="0", inertia_relief=False)
        model.K.copy(empty, structure=True)
        factors.factor(mass="0", damping="0", inertia_relief=False)
        factors.close()
        empty.destroy()


@pytest.mark.mpi
def test_blocks_of_changing_widths_are_solved_for(comm):
    """SuperLU_DIST keeps what it made for the width before on several ranks."""
    require("superlu_dist", comm)
    from hpcred.linalg.blocks import create_block, random_block

    with hpcred.solid((5, 3, 3), inputs=1, comm=comm) as model:
        solver = ShiftedSolver(model, factoring=by("superlu_dist"))
        for mass in (0.0, -1e6):
            solver.factor(mass)
            for width in (1, 5, 2, 17, 1):
                load, solution = random_block(model.K, width), create_block(model.K, width)
                solver.solve(load, solution)
                assert solver.records[-1].residual < 1e-9
                load.destroy()
                solution.destroy()
        assert [record.columns_solved > 25 for record in solver.records] == [True, True]
        solver.close()


def test_what_a_model_is_without_inertia():
    with hpcred.linkage() as model:
        for package in OTHERS:
            require(package, model.comm)
            found = inspect(model, [100.0], verify=True, factoring=by(package))
            known = package == "petsc" and not is_complex()
            assert found["elastic_modes_below_hz"] == [[100.0, 4 if known else None]]
            assert found["mass_matrix"].startswith("positive definite" if known else "not known (")


@pytest.mark.mpi
def test_on_several_ranks_petsc_itself_is_refused(comm):
    with hpcred.linkage(comm) as model:
        if comm.size == 1:
            hpcred.reduce(model, [Krylov(frequency=50.0)], factoring=by("petsc")).close()
            return
        with pytest.raises(InputError, match=f"'petsc' factors on one rank, found {comm.size} ranks .* 'superlu_dist'"):
            hpcred.reduce(model, [Krylov(frequency=50.0)], factoring=by("petsc"))


@pytest.mark.mpi(build="real")
def test_groups_of_ranks_where_nothing_is_estimated(comm):
    require("superlu_dist", comm)
    with hpcred.linkage(comm) as model:
        points = [Krylov(frequency=50.0), Krylov(frequency=150.0)]
        with hpcred.reduce(model, points, Buckens(), groups="auto", factoring=by("superlu_dist")) as rom:
            assert rom.record.groups == 1 and rom.size == 2


@pytest.mark.parametrize("key, value", [("out_of_core", "/tmp"), ("low_rank", 1e-8), ("memory_mb", 100.0)])
@pytest.mark.parametrize("package", OTHERS)
def test_what_only_mumps_has(package, key, value):
    with pytest.raises(InputError, match=rf"{key}: solver.package '{package}' does not have it; .* take 'mumps'"):
        by(package, **{key: value})


def test_a_package_that_nobody_knows():
    words = "package: found 'pardiso', expected 'auto', 'mumps', 'cudss', 'superlu_dist' or 'petsc'"
    with pytest.raises(InputError, match=words):
        LinearSolver(package="pardiso")


@pytest.mark.parametrize("kind", [Mumps, SuperluDist])
def test_a_petsc_without_a_package(kind, monkeypatch):
    monkeypatch.setattr(kind, "name", "nothing")
    monkeypatch.setitem(settings.PACKAGES, "nothing", kind)
    with hpcred.linkage() as model, pytest.raises(InputError, match="this PETSc was built without 'nothing'"):
        ShiftedSolver(model, factoring=by("nothing"))


def test_a_failure_that_is_not_a_pivot(monkeypatch):
    def fail(self):
        raise PETSc.Error(56)

    monkeypatch.setattr(PetscOwn, "_set_up", fail)
    with hpcred.linkage() as model:
        solver = ShiftedSolver(model, factoring=by("petsc"))
        with pytest.raises(ComputationError, match="petsc failed to factor: "):
            solver.factor(-1e4)
        solver.close()


# --8<-- [start:package]
class Dense(Factorisation):
    """A solver of a program of its own: NumPy's, on one rank."""

    name = "dense"
    tells_inertia = True

    def _factor(self):
        size = self.matrix.getSize()[0]
        values = self.matrix.getValues(range(size), range(size))
        self._inverse = np.linalg.inv(values)
        return {"factor_entries": size**2, "negative_pivots": int((np.linalg.eigvalsh(values) < 0).sum())}

    def _solve(self, right, solution):
        solution.getDenseArray()[...] = self._inverse @ right.getDenseArray()
        solution.assemble()

    def release(self):
        self._inverse = None
# --8<-- [end:package]


@pytest.mark.parametrize("counts", [True, False])
def test_a_solver_of_a_program_of_its_own(counts, monkeypatch):
    monkeypatch.setitem(settings.PACKAGES, "dense", Dense)
    monkeypatch.setattr(Dense, "tells_inertia", counts)
    found = []
    with hpcred.linkage() as model:
        for package in ("mumps", "dense"):
            with reduced(model, "linkage", package, "tolerance") as rom:
                found.append(hpcred.frequency_response(rom, np.linspace(6, 300, 20)))
                accuracy, factors = rom.record.accuracy, rom.record.factorisations
    assert np.abs(found[1] - found[0]).max() < 1e-9 * np.abs(found[0]).max()
    assert {item.package for item in factors} == {"dense"} and {item.factor_entries for item in factors} == {120**2}
    assert accuracy.reached and len(accuracy.proofs) == (1 if counts and not is_complex() else 2)


def test_in_a_job_and_in_commands(hpcred, tmp_path, monkeypatch, capsys):
    """Full responses of a result take the package that it was reduced by, or that of the command."""
    monkeypatch.chdir(tmp_path)
    package.write_model("model.h5", package.solid((4, 2, 2)))
    (tmp_path / "job.toml").write_text(
        'model = "model.h5"\n[solver]\npackage = "petsc"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n'
    )
    assert run(["reduce", "job.toml", "--details"]) == 0
    told = capsys.readouterr().out
    assert "\nPETSc " in told and "MUMPS" not in told
    evaluate = ["evaluate", "result.h5", "--full", "model.h5", "--frequencies", "10,50"]
    assert run(evaluate) == 0
    assert hpcred(*evaluate, ranks=2).returncode == 0  # a frequency a rank
    message = refused(capsys, "reduce", "job.toml", "--set", "solver.package=nix")
    assert "solver.package: found 'nix', expected 'auto', 'mumps'" in message
    require("superlu_dist", MPI.COMM_WORLD)
    assert run([*evaluate, "--package", "superlu_dist"]) == 0


def test_records_of_earlier_versions_are_of_mumps():
    from hpcred.linalg.solvers.base import FactorRecord

    told = {item.name: item.default for item in dataclasses.fields(FactorRecord)}
    assert told["package"] == "mumps" and told["negative_pivots"] is None
