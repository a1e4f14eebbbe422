"""`hpcred bench`: its measurements and hints."""

import json

import pytest

import hpcred as package

JOB = (
    'model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n[[basis]]\nkind = "krylov"\nfrequency = 900.0\n'
)


@pytest.mark.slow
def test_bench_and_profile(hpcred, tmp_path):
    run = hpcred("bench", "--cells", 10, 5, 5, "--json", "bench.json", ranks=2)
    assert run.returncode == 0, run.stderr
    report = json.loads((tmp_path / "bench.json").read_text())
    assert report["dofs"] == 1080 and report["orthogonality_loss"] < 1e-12 and report["residual"] < 1e-10
    assert all(report[key] > 0 for key in ("factor_gflops", "solve_gflops_of_32", "multiply_gflops",
                                           "write_mb_per_second", "read_mb_per_second"))  # fmt: skip
    assert report["gflop_by_ordering"]["PORD"] > 0
    widths = report["solve_ms_per_column_of_128_by_width"]
    assert list(widths) == ["16", "32", "64", "96", "128"] and min(widths.values()) > 0
    assert ("icntl_27" in run.stdout) == (min(widths.values()) < 0.9 * widths["96"])
    assert ("hint: MUMPS ordered by" in run.stdout) == (report["ordering"] not in ("METIS", "SCOTCH"))
    assert hpcred("bench", "--folder", "nowhere").returncode == 2
    package.write_model(tmp_path / "model.h5", package.solid((10, 5, 5)))
    (tmp_path / "job.toml").write_text(JOB)
    run = hpcred("reduce", "job.toml", "--profile", "--groups", 2, ranks=2)
    assert run.returncode == 0, run.stderr
    assert "PETSc events by stage" in run.stdout and "MatCholFctrNum" in run.stdout
