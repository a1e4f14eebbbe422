"""What a reduction takes on a cluster, before it is run."""

import json
from pathlib import Path

import pytest

import hpcred
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.failures import InputError
from hpcred.workflows import plan

CELLS = 9  # of an edge
GB, SECONDS, LARGE = "GB of all ranks", "processor seconds", 3_060_300  # of benchmarks/million.py


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """A model file, and the record of its factor."""
    path = tmp_path_factory.mktemp("plan") / "cube.h5"
    with hpcred.solid((CELLS, CELLS, CELLS), (1.0, 1.0, 1.0)) as model:
        hpcred.write_model(path, model)
        solver = ShiftedSolver(model)
        solver.factor(0.0)
        record = solver.records[-1]
        solver.close()
    return path, record


def test_the_factor_of_a_plan_is_the_one_that_is_made(cube):
    path, record = cube
    found = hpcred.plan(path, ranks=1)
    assert found["operations"] == pytest.approx(record.flops, rel=0.2)
    assert found["entries"] == pytest.approx(record.factor_entries, rel=0.2)
    direct = found["rows"][0]
    assert direct["GB in all"] > 8 * record.factor_entries / 1e9 and found["best"] == "direct"


def test_more_ranks_take_more_memory_and_less_of_it_each(cube):
    rows = [hpcred.plan(cube[0], ranks=ranks)["rows"][0] for ranks in (1, 8, 64)]
    assert rows[0]["GB in all"] < rows[1]["GB in all"] < rows[2]["GB in all"]
    assert rows[0]["GB a rank"] > rows[1]["GB a rank"] > rows[2]["GB a rank"]
    assert rows[0]["hours"] > rows[1]["hours"] > rows[2]["hours"]


def test_a_large_model_is_not_read_and_counts_as_a_cube(cube, monkeypatch):
    """The law goes through the largest cube that was analysed, and its way down to this one is long."""
    monkeypatch.setattr(plan, "MOST_ANALYSED", 0)
    monkeypatch.setattr(plan, "model_of_files", None)
    found = hpcred.plan(cube[0], ranks=2)
    assert 0.3 < found["entries"] / cube[1].factor_entries < 3 and "of a cube" in found["source"]


def test_the_script_is_that_of_the_first_way_that_fits(cube, monkeypatch):
    monkeypatch.setattr(plan, "MOST_ANALYSED", 0)
    monkeypatch.setitem(plan.CUBE, "rows", 1000)  # a factor of a model that is far larger
    sizes = {row["way"]: row["GB a node"] for row in hpcred.plan(cube[0], ranks=8, nodes=2)["rows"]}
    between = (sizes["direct"] + sizes["out_of_core"]) / 2
    found = hpcred.plan(cube[0], ranks=8, nodes=2, memory_gb=between)
    assert found["best"] == "out_of_core" and "--ntasks-per-node=4\n" in found["script"]
    assert "--out-of-core" in found["script"]
    found = hpcred.plan(cube[0], ranks=8, nodes=2, memory_gb=2 * sizes["kind = multigrid"])
    assert found["best"] == "kind = multigrid" and "solver.kind=multigrid" in found["script"]
    assert not hpcred.plan(cube[0], ranks=8, nodes=2, memory_gb=0.01)["script"]


JOBS = {
    "two points": ('[[basis]]\nkind = "krylov"\nfrequency = 0.0\n[[basis]]\nkind = "krylov"\nfrequency = 900.0\n'
                   '[[basis]]\nkind = "modes"\ncount = 3\n', 2, "at 0 Hz, 900 Hz", "direct"),
    "a tolerance": ('tolerance = 1e-3\nband = [0.0, 900.0]\nsolver = {kind = "multigrid"}\n', 2, "of a reduction",
                    "kind = multigrid"),
    "low rank": ('low_rank = 1e-6\nbasis = [{kind = "krylov", decay = 10.0}]\n', 1, "at 10 1/s", "low_rank = 1e-6"),
}  # fmt: skip


@pytest.mark.parametrize("key", JOBS)
def test_a_job_says_its_model_points_and_way(cube, tmp_path, key):
    text, factors, points, best = JOBS[key]
    job = tmp_path / "job.toml"
    job.write_text(f'model = "{cube[0]}"\n{text}')
    found = hpcred.plan(job, ranks=4)
    assert found["factors"] == factors and found["points"].startswith(points) and found["best"] == best
    assert found["entries"] == pytest.approx(cube[1].factor_entries, rel=0.2)
    assert f"reduce {job} --store points" in found["script"]
    assert best == "direct" or "--set" not in found["script"]  # the job says it already
    multigrid = [row for row in found["rows"] if row["way"] == "kind = multigrid"]
    assert bool(multigrid) == (key != "two points")  # whose 900 Hz it cannot solve at


def test_groups_of_ranks_have_a_factor_each(cube, tmp_path):
    job = tmp_path / "job.toml"
    job.write_text(f'model = "{cube[0]}"\n{JOBS["two points"][0]}')
    size = plan._as_cube(10**6, 8 * 10**7)
    one, two = (plan._ways(size, 8, 10.0, 2, plan.read_job(job, [f"groups={groups}"])) for groups in (1, 2))
    assert two[0].memory > one[0].memory and two[0].seconds == pytest.approx(one[0].seconds)


def test_the_script_starts_its_ranks_as_the_one_in_jobs(cube):
    text = hpcred.plan(cube[0], ranks=2)["script"]
    jobs = (Path(__file__).parents[2] / "jobs/reduce.slurm").read_text()
    assert set(plan.LAUNCHER) <= set(map(str.strip, jobs.splitlines()))
    assert "\n".join([*plan.LAUNCHER, "$launcher hpcred reduce"]) in text and "\nsrun" not in text


def test_the_script_asks_for_the_memory_of_the_fullest_node_and_for_a_gpu(tmp_path):
    """Ten ranks on three nodes: four, three and three."""
    size = plan._as_cube(10**6, 8 * 10**7)
    direct, *_, card = plan._ways(size, 10, 10.0, 2, None)
    text = plan._script(direct, "model.h5", None, 10, 3)
    given = int(text.partition("--mem=")[2].partition("G")[0]) * 1e9
    assert "--ntasks-per-node=4" in text and given >= plan.SPARE * direct.memory * 4 / 10 and "gpus" not in text
    assert "#SBATCH --gpus-per-node=1" in plan._script(card, "model.h5", None, 10, 3)


def measured(name, dofs, key):
    """A number of the saved results of a benchmark on a cube."""
    files = sorted((Path(__file__).parents[2] / "benchmarks/outcomes").glob(f"{name}.*json"))
    rows = [row for file in files for row in json.loads(file.read_text())["rows"]]
    return next(row[key] for row in rows if row["dofs"] == dofs)


MEASURED = (  # cells of a cube an edge, ranks, their GFlop/s, factors, way; GB in all and seconds
    (69, 16, 188, 1, "direct", 61, 142),  # one point, 24 columns, of which 123 s are the factor
    (40, 2, 20, 2, "direct", 5.0, None),
    (69, 2, 20, 2, "kind = multigrid", measured("million", 1_014_300, GB), None),  # on a machine of other GFlop/s
    (100, 2, 20, 2, "kind = multigrid", measured("million", LARGE, GB), measured("million", LARGE, SECONDS) / 2),
    (69, 16, 160, 2, "package = cudss", None, measured("gpu", 1_014_300, "reduce (s)")),
    (100, 16, 160, 2, "package = cudss", None, measured("gpu", 3_060_300, "reduce (s)")),
)


@pytest.mark.parametrize("cells, ranks, gflops, factors, way, gigabytes, seconds", MEASURED)
def test_plans_against_what_was_measured(cells, ranks, gflops, factors, way, gigabytes, seconds):
    """By the law of cubes: memory has room, since MUMPS uses less than it estimates; GB there are of 2^30 bytes."""
    size = plan._as_cube(3 * cells * (cells + 1) ** 2, 9 * (3 * cells - 2) * (3 * cells + 1) ** 2)
    found = next(item for item in plan._ways(size, ranks, gflops / ranks, factors, None) if item.name == way)
    assert gigabytes is None or 0.95 < found.memory / 2**30 / gigabytes < 1.6
    assert seconds is None or 0.85 < found.seconds / seconds < 1.15


def test_the_table_of_a_cube_of_1e7_dofs_is_that_of_the_law():
    page = (Path(__file__).parents[2] / "docs/cluster.md").read_text()
    ways = {way.name: way for way in plan._ways(plan._as_cube(10**7, 79 * 10**7), 64, 10.0, 2, None)}
    for name, gigabytes, hours, nodes in (("direct", 1500, 2, 512), ("out_of_core", 840, 3, 256)):
        assert f"| {gigabytes:,} GB | {hours} h | 4 nodes of {nodes} GB" in page
        assert plan._two(ways[name].memory / 1e9) == gigabytes and round(ways[name].seconds / 3600) == hours
        assert nodes / 2 < plan.SPARE * ways[name].memory / 4e9 < nodes
    assert plan._two(ways["kind = multigrid"].memory / 1e9) == 69 and "| 70 GB |" in page


def test_nonzeros_of_cubes_are_those_of_the_law(cube):
    """Neighbours along an edge of m nodes: 3 m - 2, three dofs each, one layer of nodes held."""
    assert hpcred.plan(cube[0], ranks=1)["nonzeros"] == 9 * (3 * CELLS - 2) * (3 * CELLS + 1) ** 2


def test_plans_that_make_no_sense(cube):
    for wrong, says in (({"ranks": 0}, "--ranks"), ({"nodes": 4}, "--nodes: found 4 for 2 ranks"),
                        ({"memory_gb": -1.0}, "--memory"), ({"gflops": 0.0}, "--gflops"),
                        ({"gflops": 1e-320}, "--gflops"), ({"memory_gb": 1e-320}, "--memory")):  # fmt: skip
        with pytest.raises(InputError, match=says):
            hpcred.plan(cube[0], **{"ranks": 2, **wrong})
    with pytest.raises(InputError, match="no such file"):
        hpcred.plan("nothing.h5", ranks=1)
