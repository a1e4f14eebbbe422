"""How factors are kept and shared: groups of ranks, memory limits, out of core, low rank; and what bench reports."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

import hpcred as package
from hpcred import Buckens, Krylov, Modes, Rayleigh, SecondOrderKrylov, StaticCorrection
from hpcred.linalg.factorisation import SolverOptions
from hpcred.linalg.solvers import ShiftedSolver
from hpcred.parallel import memory
from hpcred.parallel import startup as runtime
from hpcred.parallel.failures import ComputationError, InputError

FREQUENCIES = np.linspace(5, 295, 30)
JOB = (
    'model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n[[basis]]\nkind = "krylov"\nfrequency = 900.0\n'
)


def responses(model, basis, damping=None, **options):
    with package.reduce(model, basis, Buckens(), damping, **options) as rom:
        return package.frequency_response(rom, FREQUENCIES), rom


@pytest.mark.mpi
@pytest.mark.parametrize("groups", ["all", "auto"])
def test_groups_give_the_same_model(comm, groups):
    """Every kind of point, more points than groups, modes between; with one rank there is one group."""
    basis = [
        Krylov(frequency=40.0, order=1), Modes(index=(7, 8)), SecondOrderKrylov(frequency=150.0),
        Krylov(frequency=90.0, decay=3.0), StaticCorrection(), SecondOrderKrylov(frequency=260.0, order=1),
    ]  # fmt: skip
    damping = Rayleigh(2.0, 1e-5)
    with package.linkage(comm) as model:
        alone, one = responses(model, basis, damping)
        wanted = comm.size if groups == "all" else groups
        shared, many = responses(model, basis, damping, groups=wanted)
    assert np.abs(shared - alone).max() < 1e-8 * np.abs(alone).max()
    assert one.size == many.size
    where = [[item["where"] for item in rom.provenance["ingredients"]] for rom in (one, many)]
    assert where[0] == where[1]
    if groups == "all":
        factors = [len(rom.provenance["factorisations"]) for rom in (one, many)]
        assert factors[0] <= factors[1] <= factors[0] + 1  # the modes have one of their own
    with pytest.raises(InputError, match=f"groups: found {comm.size + 1}, expected 1 to {comm.size}"):
        package.reduce(model_of(comm), basis, groups=comm.size + 1)


def model_of(comm):
    return package.solid((3, 2, 2), inputs=2, comm=comm)


def test_a_refusal_in_one_group_ends_all(hpcred, tmp_path):
    """The second point is an eigenfrequency; the first group has nothing against its own."""
    assert hpcred("example", "linkage").returncode == 0
    buckens = '[frame]\nkind = "buckens"\n'
    head, points = JOB.split("\n", 1)
    (tmp_path / "modes.toml").write_text(f'{head}\n{buckens}[[basis]]\nkind = "modes"\nindex = [7]\n')
    (tmp_path / "job.toml").write_text(f"{head}\n{buckens}{points}")
    assert hpcred("reduce", "modes.toml", "--json", "modes.json").returncode == 0
    (frequency,) = json.loads((tmp_path / "modes.json").read_text())["frequencies_hz"]
    run = hpcred("reduce", "job.toml", "--groups", 2, "--set", f"basis.1.frequency={frequency!r}", ranks=2, timeout=60)
    assert run.returncode == 2
    assert run.stderr.count("hpcred: error: ") == 1 and "is an eigenfrequency of the undamped model" in run.stderr


@pytest.mark.mpi
def test_groups_of_a_two_sided_projection(comm):
    with package.solid((6, 3, 3), inputs=2, comm=comm) as model:
        model.set_outputs([(96, "z"), (40, "y")])
        basis = [Krylov(frequency=500.0), Krylov(frequency=3000.0)]
        results = [
            package.reduce(model, basis, projection="two_sided", allow_unstable=True, groups=groups)
            for groups in (1, comm.size)
        ]
        alone, shared = (package.frequency_response(rom, FREQUENCIES) for rom in results)
        for rom in results:
            rom.close()
    assert np.abs(shared - alone).max() < 1e-9 * np.abs(alone).max()


@pytest.mark.mpi
def test_factors_on_disk_are_the_same(comm, folder):
    with package.solid((8, 6, 6), inputs=3, comm=comm) as model:
        basis = [Krylov(frequency=100.0, order=1), Krylov(frequency=2000.0)]
        found = []
        for options in (None, SolverOptions(out_of_core=str(folder))):
            with package.reduce(model, basis, options=options) as rom:
                found.append(package.frequency_response(rom, FREQUENCIES))
        comm.Barrier()
        assert not os.listdir(folder)  # MUMPS has removed its files
        if comm.size == 1:  # where they were, while the solver was there
            solver = ShiftedSolver(model, options=SolverOptions(out_of_core=str(folder)))
            solver.factor(-1e4)
            assert os.listdir(folder)
            solver.close()
    assert np.abs(found[1] - found[0]).max() < 1e-12 * np.abs(found[0]).max()


def test_low_rank_factors_reach_the_same_residual(hpcred, tmp_path):
    """In a program of its own, since MUMPS must be without Scotch there."""
    assert hpcred("example", "solid", "--cells", 16, 8, 8).returncode == 0
    (tmp_path / "job.toml").write_text(JOB)
    found = []
    for more in ([], ["--low-rank", "1e-5"]):
        run = hpcred("reduce", "job.toml", "--json", "run.json", *more, ranks=2)
        assert run.returncode == 0, run.stderr
        found.append(json.loads((tmp_path / "run.json").read_text()))
    for record in found:
        assert max(item["residual"] for item in record["factorisations"]) < 1e-10
    assert found[1]["frequencies_hz"][:6] == pytest.approx(found[0]["frequencies_hz"][:6], rel=1e-9)
    assert found[1]["job"]["low_rank"] == 1e-5


@pytest.mark.mpi
def test_a_factor_that_does_not_fit_is_refused_before_it_is_made(comm, monkeypatch):
    with package.solid((10, 8, 8), inputs=1, comm=comm) as model:
        monkeypatch.setenv("HPCRED_MEMORY_MB", "3")
        with pytest.raises(ComputationError, match=r"about \d+ MB on one rank .* a rank has 3 MB.*--out-of-core DIR"):
            package.reduce(model, [Krylov(frequency=100.0)])
        with pytest.raises(ComputationError, match=r"does not fit"):
            package.reduce(model, [Modes(band=(0.0, 3000.0))])
        monkeypatch.delenv("HPCRED_MEMORY_MB")
        solver = ShiftedSolver(model)
        need, have = solver.estimate()
        solver.factor(-1e4)
        record = solver.records[-1]
        assert need == pytest.approx(record["memory_mb_estimated_total"], rel=0.1)
        assert need > 0.9 * record["memory_mb_used_total"] > 0
        assert have > 100 * comm.size
        solver.close()


def test_limits_of_memory(monkeypatch, comm, tmp_path):
    free = memory.available_mb(comm)
    assert 10 < free < 1e7
    monkeypatch.setenv("SLURM_MEM_PER_NODE", "500")
    assert memory.available_mb(comm) == pytest.approx(0.9 * 500 / runtime.ranks_on_node)
    monkeypatch.setenv("SLURM_MEM_PER_CPU", "100")
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "2")
    assert memory.available_mb(comm) == pytest.approx(0.9 * 200)
    monkeypatch.setenv("HPCRED_MEMORY_MB", "77")
    assert memory.available_mb(comm) == 77


def test_a_control_group_limits_memory(monkeypatch, tmp_path):
    """A container with 1000 MB of which 400 are taken, 100 of them by file cache."""
    group = tmp_path / "job"
    group.mkdir()
    (group / "memory.max").write_text(str(1000 * 2**20))
    (group / "memory.current").write_text(str(400 * 2**20))
    (group / "memory.stat").write_text(f"anon 1\ninactive_file {100 * 2**20}\n")
    monkeypatch.setattr(memory, "GROUPS", tmp_path)
    monkeypatch.setattr(memory, "_groups_of_process", lambda: ["0::/job"])
    assert memory._cgroup() == pytest.approx(700)
    (group / "memory.max").write_text("max")
    assert memory._cgroup() is None


@pytest.mark.parametrize(
    "options, says",
    [
        ({"low_rank": 0.5}, "low_rank: found 0.5"),
        ({"low_rank": -1e-8}, "low_rank: found -1e-08"),
        ({"out_of_core": "/nowhere/at/all"}, "the folder /nowhere/at/all cannot be written"),
    ],
)
def test_options_that_make_no_sense(options, says):
    with pytest.raises(InputError, match=says):
        replace(SolverOptions(), **options)


def test_low_rank_with_scotch_is_refused(monkeypatch):
    monkeypatch.setattr(runtime, "ordering", 3)
    with pytest.raises(InputError, match="HPCRED_SCOTCH=0"):
        SolverOptions(low_rank=1e-8)


def test_one_factor_at_a_time(comm):
    """A mixture of real and complex points frees the factor of the one before the other is made."""
    from hpcred.parallel.stages import Progress
    from hpcred.reduction.context import Context

    from hpcred.model.frames import apply_frame

    with package.linkage(comm) as model:
        framed = apply_frame(model, Buckens(), Rayleigh(2.0, 1e-5))
        context = Context(framed, Progress(comm, show=False), 1e-12)
        context.solver.factor(-1e4)
        assert context.solver._factored is not None
        solver = context._solver
        context.damped_solver.factor(100j)
        assert solver._factored is None and context._damped_solver._factored is not None
        context.close()
        framed.close()


def test_bench_and_profile(hpcred, tmp_path):
    run = hpcred("bench", "--cells", 10, 5, 5, "--json", "bench.json", ranks=2)
    assert run.returncode == 0, run.stderr
    report = json.loads((tmp_path / "bench.json").read_text())
    assert report["dofs"] == 1080 and report["orthogonality_loss"] < 1e-12 and report["residual"] < 1e-10
    assert all(report[key] > 0 for key in ("factor_gflops", "solve_gflops_of_32", "multiply_gflops",
                                           "write_mb_per_second", "read_mb_per_second"))  # fmt: skip
    assert ("hint: MUMPS ordered by" in run.stdout) == (report["ordering"] not in ("METIS", "SCOTCH"))
    assert hpcred("bench", "--folder", "nowhere").returncode == 2
    assert hpcred("example", "solid", "--cells", 10, 5, 5).returncode == 0
    (tmp_path / "job.toml").write_text(JOB)
    run = hpcred("reduce", "job.toml", "--profile", "--groups", 2, ranks=2)
    assert run.returncode == 0, run.stderr
    assert "PETSc events by stage" in run.stdout and "MatCholFctrNum" in run.stdout
