"""Factors on a GPU, which a stand-in on the processor takes the place of; those marked `cuda` need a real one."""

import sys
from pathlib import Path

import numpy as np
import pytest
from cudss_stand_in import Factor, Gpu
from helpers import block_from, damped, dense_model, few_on_ranks, gather

import hpcred
from hpcred import Buckens, Factoring, Krylov, LinearSolver, Modes
from hpcred.linalg.blocks import create_block
from hpcred.linalg.solvers import auto, cudss
from hpcred.linalg.solvers.base import DoesNotFit, SingularMatrix
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel import startup
from hpcred.parallel.failures import ComputationError, InputError
from hpcred.parallel.petsc import is_complex
from hpcred.parallel.progress import Progress
from hpcred.report.tables import show_timing

TOP = 30000.0  # Hz, of the solid
FULL = RuntimeError("cuDSS error (2): CUDSS_STATUS_ALLOC_FAILED")


def by(package="cudss", **more):
    return Factoring(solver=LinearSolver(package=package, **more))


@pytest.fixture
def small(monkeypatch):
    """Models of tests are large enough for a GPU."""
    monkeypatch.setattr(auto, "SMALL", 0)


@pytest.fixture(params=["stand-in", pytest.param("real", marks=pytest.mark.cuda)])
def gpu(request, monkeypatch):
    """The stand-in; None for a real one."""
    return Gpu().used_by(monkeypatch) if request.param == "stand-in" else None


def near(gpu, stand_in=1e-8) -> float:
    """How near solutions are to those of others: a real one is refined to a residual of 1e-10."""
    return 1e-6 if gpu is None else stand_in


def solved(model, solver, loads):
    """A^-1 of dense columns (n, columns), on all ranks."""
    right, solution = block_from(model.K, loads), create_block(model.K, loads.shape[1])
    solver.solve(right, solution)
    return gather(solution)


@pytest.mark.mpi
@pytest.mark.parametrize("unsymmetric", [False, True])
def test_solutions_and_inertia_are_those_of_dense_matrices(comm, solid, gpu, unsymmetric):
    """The pattern is analysed once for all shifts, and blocks of any width are solved for."""
    model = damped(solid, unsymmetric=True)[0] if unsymmetric else solid
    K, M, _ = dense_model(solid)
    random = np.random.default_rng(3)
    values = np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)
    solver = ShiftedSolver(model, inertia=True, factoring=by())
    for mass in (0.0, -(values[3] + values[4]) / 2, values[2]):
        solver.factor(mass)
        for width in (1, cudss.WIDTH, 2 * cudss.WIDTH + 1):
            loads = random.standard_normal((len(K), width))
            expected = np.linalg.solve(K + mass * M, loads)
            assert np.abs(solved(model, solver, loads) - expected).max() < near(gpu, 1e-9) * np.abs(expected).max()
        assert solver.inertia == (None if unsymmetric or is_complex() else int((values < -mass).sum()))
    records = solver.records
    assert [record.kind for record in records] == 3 * ["LU" if unsymmetric else "LDL^T"]
    assert {record.package for record in records} == {"cudss"} and solver.analyses == 1
    solver.close()
    if gpu is not None:
        assert (gpu.analyses, gpu.factors, gpu.freed) == ((1, 3, 1) if comm.rank == 0 else (0, 0, 0))


@pytest.mark.mpi
@pytest.mark.parametrize("task", few_on_ranks(["tolerance", "basis", "complex", "free"]))
def test_models_are_those_of_mumps(comm, gpu, small, task):
    given, frame, top = {"tolerance": 1e-6, "band": (0.0, TOP)}, None, TOP
    if task == "basis":
        given = {"basis": [Krylov(frequency=TOP / 3, order=1), Modes(band=(0.0, TOP / 2)), Modes(count=3)]}
    elif task == "complex":
        given = {"basis": [Krylov(frequency=TOP / 3, decay=TOP, order=1)]}
    elif task == "free":
        given, frame, top = {"tolerance": 1e-6, "band": (0.0, 300.0)}, Buckens(), 300.0
    responses, factors = [], {}
    with hpcred.linkage(comm) if task == "free" else hpcred.solid((5, 3, 3), inputs=2, comm=comm) as model:
        for package in ("mumps", "cudss", "auto"):
            with hpcred.reduce(model, frame=frame, factoring=by(package), **given) as rom:
                responses.append(hpcred.frequency_response(rom, top * np.linspace(0.02, 1, 20)))
                factors[package] = rom.record.factorisations
                if task in ("tolerance", "free"):
                    assert rom.record.accuracy.reached and len(rom.record.accuracy.proofs) == (2 if is_complex() else 1)
    for response in responses[1:]:
        assert np.abs(response - responses[0]).max() < near(gpu) * np.abs(responses[0]).max()
    assert {item.package for item in factors["mumps"]} == {"mumps"}
    assert {item.package for item in factors["cudss"] + factors["auto"]} == {"cudss"}
    assert {item.package_because for item in factors["auto"]} == {"there is a GPU that the factor fits"}


@pytest.mark.mpi
def test_groups_have_a_gpu_each(comm, monkeypatch):
    """Which one follows from the place of the first rank of a group on its node."""
    gpu = Gpu().used_by(monkeypatch, count=4)
    chosen = []
    monkeypatch.setattr(cudss, "free_mb", lambda number: chosen.append(number) or gpu.free_mb)
    with hpcred.linkage(comm) as model:
        points = [Krylov(frequency=50.0), Krylov(frequency=150.0)]
        groups = min(comm.size, 2)
        with hpcred.reduce(model, points, Buckens(), groups=groups, factoring=by()) as rom:
            assert rom.record.groups == groups and rom.size == 2
        found = set().union(*comm.allgather(set(chosen)))
        assert found == ({0} if comm.size == 1 else {0, 2})
        with hpcred.reduce(model, points, Buckens(), groups="auto", factoring=by()) as rom:
            assert rom.record.groups == groups


@pytest.mark.mpi
def test_as_many_groups_as_gpus(comm, monkeypatch):
    """Whatever the memory of a GPU would hold; without a fixed number, and one at least."""
    gpu = Gpu(free_mb=1e6).used_by(monkeypatch)
    with hpcred.linkage(comm) as model:
        points = [Krylov(frequency=50.0 * (1 + number)) for number in range(3)]
        for count in (1, 2):
            gpu.used_by(monkeypatch, count)
            with hpcred.reduce(model, points, Buckens(), groups="auto", factoring=by()) as rom:
                assert rom.record.groups == min(count, comm.size)
        # a launcher shows each rank a GPU of its own
        gpu.used_by(monkeypatch, 1)
        monkeypatch.setattr(cudss, "gpus_seen", lambda: {comm.rank})
        with hpcred.reduce(model, points, Buckens(), groups="auto", factoring=by()) as rom:
            assert rom.record.groups == comm.size


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("phase", ["analyse", "factorise", "solve"])
def test_a_gpu_of_one_group_fails(comm, monkeypatch, small, phase):
    """All ranks end by its error, or the group goes on with MUMPS."""
    error = RuntimeError("CUDSS_STATUS_EXECUTION_FAILED")
    last = comm.rank * 2 // comm.size == 1
    Gpu(failing=phase if last else None, error=error).used_by(monkeypatch, count=2)
    with hpcred.linkage(comm) as model:
        points = [Krylov(frequency=50.0), Krylov(frequency=150.0)]
        with pytest.raises(ComputationError, match="cuDSS failed: RuntimeError: CUDSS_STATUS_EXECUTION_FAILED"):
            hpcred.reduce(model, points, Buckens(), groups=2, factoring=by())
        with hpcred.reduce(model, points, Buckens(), groups=2, factoring=by("auto")) as rom:
            found = sorted(item.package for item in rom.record.factorisations)
            assert found == ["cudss"] * (2 if phase == "solve" else 1) + ["mumps"]
            assert "MUMPS made factors, since on the GPU cuDSS failed" in " ".join(rom.record.warnings)


ALONE = """
import sys
sys.path.insert(0, {tests!r})
import pytest
from cudss_stand_in import Gpu
import hpcred
from hpcred import Buckens, Factoring, Krylov, LinearSolver
from hpcred.parallel.parts import Parts
from hpcred.parallel.petsc import MPI
comm = MPI.COMM_WORLD
Gpu().used_by(pytest.MonkeyPatch(), count=2)
call = Parts.{method}
def fault(self, rows):
    if comm.rank == 1:
        raise MemoryError("only here")
    return call(self, rows)
Parts.{method} = fault
with hpcred.linkage() as model:
    by = Factoring(solver=LinearSolver(package="cudss"))
    hpcred.reduce(model, [Krylov(frequency=50.0), Krylov(frequency=150.0)], Buckens(), groups=2, factoring=by)
"""


@pytest.mark.parametrize("method", ["gather", pytest.param("scatter", marks=pytest.mark.slow)])
def test_a_rank_that_fails_beside_a_gpu_ends_all(hpcred, tmp_path, method):
    """The first two of three ranks have a GPU, and the second of them fails on the way."""
    (tmp_path / "program.py").write_text(ALONE.format(tests=str(Path(__file__).parents[1]), method=method))
    run = hpcred(program=("program.py",), ranks=3, timeout=100)
    assert run.returncode != 0 and "error (rank 1): out of memory" in run.stderr


@pytest.mark.parametrize("ranks, groups, count, gpus", [
    (16, 1, 1, [0]), (16, 4, 4, [0, 1, 2, 3]), (16, 2, 4, [0, 2]), (16, 3, 2, [0, 0, 1]), (3, 3, 8, [0, 2, 5]),
    (5, 5, 2, [0, 0, 0, 1, 1]), (4, 4, 1, [0, 0, 0, 0]),
])  # fmt: skip
def test_groups_of_a_node_share_its_gpus(monkeypatch, ranks, groups, count, gpus):
    """In turn; a launcher that binds one to each rank shows it no other."""
    monkeypatch.setattr(cudss, "count_of_gpus", lambda: count)
    monkeypatch.setattr(startup, "ranks_on_node", ranks)
    found = []
    for first in (-(-group * ranks // groups) for group in range(groups)):
        monkeypatch.setattr(startup, "rank_on_node", first)
        found.append(cudss.own_gpu())
    assert found == gpus


def test_processors_of_ranks_that_sleep(monkeypatch):
    """Those that the ranks are bound to; of a node that they all may use, the part of their group."""
    monkeypatch.setattr(startup, "ranks_on_node", 4)
    bound, free = [{0, 1}, {2, 3}], 2 * [set(range(8))]
    for rank, its_part in ((0, {0, 1, 2, 3}), (2, {4, 5, 6, 7})):
        monkeypatch.setattr(startup, "rank_on_node", rank)
        assert cudss._processors_of(bound) == {0, 1, 2, 3}
        assert cudss._processors_of(free) == its_part
        assert cudss._processors_of([{5}]) == {5}


@pytest.mark.mpi
def test_an_analysis_that_failed_is_made_again(comm, solid, monkeypatch):
    gpu = Gpu(failing="analyse", error=RuntimeError("CUDSS_STATUS_EXECUTION_FAILED")).used_by(monkeypatch)
    K = dense_model(solid)[0]
    solver = ShiftedSolver(solid, factoring=by())
    with pytest.raises(ComputationError):
        solver.estimate()
    gpu.failing = None
    solver.factor(0.0)
    loads = np.random.default_rng(7).standard_normal((len(K), 2))
    expected = np.linalg.solve(K, loads)
    assert np.abs(solved(solid, solver, loads) - expected).max() < 1e-9 * np.abs(expected).max()
    assert gpu.analyses == (comm.rank == 0)
    solver.close()


@pytest.mark.mpi
@pytest.mark.parametrize("phase", ["analyse", "factorise"])
@pytest.mark.parametrize("error", [FULL, RuntimeError("CUDSS_STATUS_EXECUTION_FAILED")])
def test_a_gpu_that_fails_leaves_the_factor_to_mumps_if_it_may(comm, solid, monkeypatch, small, phase, error):
    Gpu(failing=phase, error=error).used_by(monkeypatch)
    full = error is FULL
    with pytest.raises(DoesNotFit if full else ComputationError, match="no more memory" if full else "cuDSS failed"):
        hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by())
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto")) as rom:
        record = rom.record.factorisations[0]
        assert record.package == "mumps"
        assert record.package_because.startswith("on the GPU " + ("the factorisation" if full else "cuDSS failed"))


@pytest.mark.mpi
def test_a_gpu_that_fails_in_a_solve(comm, solid, monkeypatch, small):
    Gpu(failing="solve", error=RuntimeError("CUDSS_STATUS_EXECUTION_FAILED")).used_by(monkeypatch)
    with pytest.raises(ComputationError, match="cuDSS failed: RuntimeError: CUDSS_STATUS_EXECUTION_FAILED"):
        hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by())
    frequencies, responses = np.linspace(10.0, 200.0, 5), []
    for package in ("mumps", "auto"):
        with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by(package)) as rom:
            responses.append(hpcred.frequency_response(rom, frequencies))
            found = rom.record.factorisations
    assert [item.package for item in found] == ["cudss", "mumps"]
    assert found[1].package_because.startswith("on the GPU cuDSS failed") and found[1].columns_solved
    assert np.abs(responses[1] - responses[0]).max() < 1e-9 * np.abs(responses[0]).max()


@pytest.mark.mpi
def test_a_gpu_that_frees_nothing_any_more(comm, solid, monkeypatch):
    Gpu(failing="free", error=RuntimeError("cudaFree: an illegal memory access was encountered")).used_by(monkeypatch)
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by()) as rom:
        assert rom.size == 3


@pytest.mark.mpi
def test_memory_is_looked_at_before_the_factor(comm, solid, monkeypatch, small):
    """In the memory of the host if that of the GPU is too small; refused if both are."""
    gpu = Gpu(free_mb=900.0, need_mb=800, least_mb=50).used_by(monkeypatch)
    monkeypatch.setenv("HPCRED_MEMORY_MB", "1000")
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto")) as rom:
        record = rom.record.factorisations[0]
        assert record.package == "cudss"
        assert record.package_because == "the host has the factor of 800 MB, since the GPU has 900 MB free"
    if comm.rank == 0:
        columns = cudss.COPIES * cudss.WIDTH * solid.size * np.dtype(solid.K.getValuesCSR()[2].dtype).itemsize // 2**20
        assert gpu.limit == (900 - columns - cudss.SPARE_MB) * 2**20 and gpu.factors == 1
    gpu.need_mb = 300
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto")) as rom:
        assert rom.record.factorisations[0].package_because == "there is a GPU that the factor fits"
    assert comm.rank or gpu.limit == 0
    gpu.need_mb = 5000
    factors = gpu.factors
    words = "it needs about 5000 MB on the GPU, which has 900 MB free, or 50 MB there and 5000 MB on the host, which"
    with pytest.raises(DoesNotFit, match=words):
        hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by())
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto")) as rom:
        assert "5000 MB on the GPU" in rom.record.factorisations[0].package_because
    assert gpu.factors == factors


def test_what_a_run_tells_of_its_gpu(solid, monkeypatch, capsys, small):
    """In the log, and among its times."""
    gpu = Gpu(free_mb=900.0, need_mb=800, least_mb=50).used_by(monkeypatch)
    monkeypatch.setenv("HPCRED_MEMORY_MB", "1000")
    for need, where, logged in (
        (100, "100 MB of the GPU (there is a GPU that the factor fits)", "by cuDSS on GPU 0, 100 MB"),
        (800, "800 MB of the GPU and the host (the host has the factor of 800 MB, since the GPU has 900 MB free)",
         "by cuDSS on GPU 0; the host has the factor of 800 MB, since the GPU has 900 MB free"),
    ):  # fmt: skip
        gpu.need_mb = need
        progress = Progress(solid.comm, show=True)
        with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto"), progress=progress) as rom:
            show_timing(rom.record.timing, rom.record.factorisations)
        said = capsys.readouterr()
        assert where in " ".join(said.out.split())
        assert f"factor, 100 Hz: {logged}" in said.err


@pytest.mark.mpi
def test_singular_and_inaccurate_factors(comm, solid, monkeypatch):
    gpu = Gpu().used_by(monkeypatch)
    K, M, _ = dense_model(solid)
    value = np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)[2]
    solver = ShiftedSolver(solid, factoring=by())
    with pytest.raises(SingularMatrix):
        solver.factor(-value)
    solver.factor(-value / 2)
    loads = np.random.default_rng(2).standard_normal((len(K), 3))
    expected = np.linalg.solve(K - value / 2 * M, loads)
    gpu.spoil = 1e-4  # refined
    assert np.abs(solved(solid, solver, loads) - expected).max() < 1e-8 * np.abs(expected).max()
    gpu.spoil = 1.0
    with pytest.raises(ComputationError, match="solver.package: the residual stays at .* take 'mumps'"):
        solved(solid, solver, loads)
    solver.close()


@pytest.mark.mpi
def test_single_precision_is_refined(comm, solid, gpu):
    K, M, _ = dense_model(solid)
    solver = ShiftedSolver(solid, inertia=True, factoring=by(precision="single"))
    solver.factor(-1e6)
    loads = 1e-30 * np.random.default_rng(4).standard_normal((len(K), 2))  # below the numbers of single precision
    expected = np.linalg.solve(K - 1e6 * M, loads)
    assert np.abs(solved(solid, solver, loads) - expected).max() < near(gpu) * np.abs(expected).max()
    assert solver.inertia is None and solver.records[-1].precision == "single"
    solver.close()


def test_without_the_library_one_sentence_says_what_helps(solid, small, monkeypatch):
    """And nothing is imported."""
    for name in ("nvmath", "cuda"):
        monkeypatch.setitem(sys.modules, name, None)  # an import would fail
    monkeypatch.setattr(cudss, "find_spec", lambda name: None)
    cudss.unusable.cache_clear()
    words = r"solver.package: 'cudss' needs nvmath-python, which is not installed; `pip install 'hpcred\[cuda13\]'`"
    with pytest.raises(InputError, match=words):
        hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by())
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto")) as rom:
        record = rom.record.factorisations[0]
        assert (record.package, record.package_because) == (
            "mumps", "cuDSS needs nvmath-python, which is not installed"
        )  # fmt: skip
    assert cudss.gpus_in_words() == "not used: cuDSS needs nvmath-python, which is not installed"
    assert cudss.gpus_seen() == set()
    cudss.unusable.cache_clear()


@pytest.mark.parametrize("count, error, words", [
    (0, None, "found no GPU of NVIDIA with its driver, or CUDA_VISIBLE_DEVICES hides it; `nvidia-smi` lists what"),
    (1, RuntimeError("nvmath-python requires cuDSS version 0.8, while you\nhave cuDSS version 1.0."),
     r"cannot be used here \(RuntimeError: nvmath-python requires cuDSS version 0.8, while you have cuDSS"),
    (1, ImportError("libcudss.so.0: cannot open shared object file"), r"cannot be used here \(ImportError: libcudss"),
])  # fmt: skip
def test_a_gpu_or_a_library_that_cannot_be_used(solid, monkeypatch, small, count, error, words):
    Gpu(failing="analyse", error=error).used_by(monkeypatch, count=count)
    monkeypatch.setattr(cudss, "find_spec", lambda name: object())
    monkeypatch.setattr(cudss, "unusable", REAL_UNUSABLE)
    with pytest.raises(InputError, match=f"solver.package: 'cudss' {words}"):
        hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by())
    monkeypatch.setattr(auto, "SMALL", 0)
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=by("auto")) as rom:
        assert rom.record.factorisations[0].package_because.startswith("cuDSS ")


def test_what_a_gpu_failed_at_is_told_though_it_frees_nothing(monkeypatch):
    def refuse(words):
        raise RuntimeError(words)

    Gpu(failing="free", error=RuntimeError("cudaFree")).used_by(monkeypatch)
    monkeypatch.setattr(cudss, "find_spec", lambda name: object())
    monkeypatch.setattr(Factor, "analyse", lambda self: refuse("an illegal memory access"))
    assert REAL_UNUSABLE() == "cannot be used here (RuntimeError: an illegal memory access)"


REAL_UNUSABLE = cudss.unusable.__wrapped__


@pytest.mark.parametrize("key, value", [("out_of_core", "/tmp"), ("low_rank", 1e-8), ("memory_mb", 100.0)])
def test_what_only_mumps_has(solid, monkeypatch, small, key, value):
    Gpu().used_by(monkeypatch)
    with pytest.raises(InputError, match=rf"{key}: solver.package 'cudss' does not have it; .* take 'mumps'"):
        Factoring(solver=LinearSolver(package="cudss"), **{key: value})
    if key != "memory_mb":
        return
    factoring = Factoring(solver=LinearSolver(package="auto"), **{key: value})
    with hpcred.reduce(solid, [Krylov(frequency=100.0)], factoring=factoring) as rom:
        assert rom.record.factorisations[0].package_because == f"{key} is for MUMPS"


def test_small_models_are_done_before_a_gpu_is_started(solid, monkeypatch):
    gpu = Gpu().used_by(monkeypatch)
    with hpcred.reduce(solid, [Krylov(frequency=100.0)]) as rom:
        record = rom.record.factorisations[0]
    assert record.package == "mumps" and gpu.analyses == 0
    assert record.package_because == f"{solid.size} rows are done before a GPU is started"


@pytest.mark.cuda
@pytest.mark.mpi
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_real_gpu(comm, precision):
    """Proven by solves of MUMPS at other frequencies; in single precision modes are not counted."""
    cudss.Cudss.check_build(comm)
    with hpcred.solid((14, 14, 14), comm=comm) as model:
        band = (0.0, TOP / 3)
        found = []
        for package, more in (("mumps", {}), ("cudss", {"precision": precision})):
            with hpcred.reduce(model, tolerance=1e-4, band=band, factoring=by(package, **more)) as rom:
                found.append((rom.size, hpcred.frequency_response(rom, np.linspace(0.01, 1, 50) * band[1])))
                record = rom.record
        assert record.accuracy.reached and {item.package for item in record.factorisations} == {"cudss"}
        assert np.linalg.norm(found[1][1] - found[0][1]) < 1e-3 * np.linalg.norm(found[0][1])
