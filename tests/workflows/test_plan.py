"""What a reduction takes on a cluster, before it is run."""

import pytest

import hpcred
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.failures import InputError
from hpcred.workflows import plan


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """A model file, and the record of its factor."""
    path = tmp_path_factory.mktemp("plan") / "cube.h5"
    with hpcred.solid((14, 14, 14), (1.0, 1.0, 1.0)) as model:
        hpcred.write_model(path, model)
        solver = ShiftedSolver(model)
        solver.factor(0.0)
        record = solver.records[-1]
        solver.close()
    return path, record


def test_the_factor_of_a_plan_is_the_one_that_is_made(cube):
    path, record = cube
    found = hpcred.plan_file(path, ranks=1)
    assert found["operations"] == pytest.approx(record.flops, rel=0.2)
    assert found["entries"] == pytest.approx(record.factor_entries, rel=0.2)
    direct = found["rows"][0]
    assert direct["GB in all"] > 8 * record.factor_entries / 1e9 and found["best"] == "direct"


def test_more_ranks_take_more_memory_and_less_of_it_each(cube):
    rows = [hpcred.plan_file(cube[0], ranks=ranks)["rows"][0] for ranks in (1, 8, 64)]
    assert rows[0]["GB in all"] < rows[1]["GB in all"] < rows[2]["GB in all"]
    assert rows[0]["GB a rank"] > rows[1]["GB a rank"] > rows[2]["GB a rank"]
    assert rows[0]["hours"] > rows[1]["hours"] > rows[2]["hours"]


def test_a_large_model_is_not_read_and_counts_as_a_cube(cube, monkeypatch):
    """The law goes through the largest cube that was analysed, and its way down to this one is long."""
    monkeypatch.setattr(plan, "MOST_ANALYSED", 0)
    monkeypatch.setattr(plan, "read_model", None)
    found = hpcred.plan_file(cube[0], ranks=2)
    assert 0.3 < found["entries"] / cube[1].factor_entries < 3 and "of a cube" in found["source"]


def test_the_script_is_that_of_the_first_way_that_fits(cube, monkeypatch):
    monkeypatch.setattr(plan, "MOST_ANALYSED", 0)
    monkeypatch.setitem(plan.CUBE, "rows", 1000)  # a factor of a model that is far larger
    sizes = {row["way"]: row["GB a node"] for row in hpcred.plan_file(cube[0], ranks=8, nodes=2)["rows"]}
    between = (sizes["direct"] + sizes["out_of_core"]) / 2
    found = hpcred.plan_file(cube[0], ranks=8, nodes=2, memory_gb=between)
    assert found["best"] == "out_of_core" and "--ntasks-per-node=4\n" in found["script"]
    assert "--out-of-core" in found["script"]
    found = hpcred.plan_file(cube[0], ranks=8, nodes=2, memory_gb=2 * sizes["kind = multigrid"])
    assert found["best"] == "kind = multigrid" and "solver.kind=multigrid" in found["script"]
    assert not hpcred.plan_file(cube[0], ranks=8, nodes=2, memory_gb=0.01)["script"]


def test_plans_that_make_no_sense(cube):
    for wrong, says in (({"ranks": 0}, "--ranks"), ({"nodes": 4}, "--nodes: found 4 for 2 ranks"),
                        ({"memory_gb": -1.0}, "--memory"), ({"gflops": 0.0}, "--gflops")):  # fmt: skip
        with pytest.raises(InputError, match=says):
            hpcred.plan_file(cube[0], **{"ranks": 2, **wrong})
    with pytest.raises(InputError, match="no such file"):
        hpcred.plan_file("nothing.h5", ranks=1)
