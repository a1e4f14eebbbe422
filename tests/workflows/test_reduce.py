"""`hpcred reduce`: the same numbers on all ranks and builds; a million dofs."""

import json

import numpy as np
import pytest
from helpers import LINKAGE_JOB
from launch import TWO_BUILDS

import hpcred as package


@pytest.mark.slow  # test_same_numbers.py has the quick ones
@pytest.mark.usefixtures("forked_commands")
def test_the_numbers_are_the_same_on_all_ranks_and_builds(hpcred, tmp_path):
    """Responses to 1e-9."""
    basis = '[[basis]]\nkind = "modes"\ncount = 6\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\norder = 2\n'
    (tmp_path / "job.toml").write_text(LINKAGE_JOB + basis)
    package.write_model(tmp_path / "model.h5", package.linkage())
    responses, cases = [], [(1, ""), (2, ""), (3, ""), (4, ""), *[(1, "complex"), (2, "complex")] * TWO_BUILDS]
    for ranks, build in cases:
        output = f"{ranks}{build}.h5"
        run = hpcred("reduce", "job.toml", "--set", f"output={output}", ranks=ranks, HPCRED_SCALAR=build)
        assert run.returncode == 0, run.stderr
        reduced = package.read_result(tmp_path / output).reduced
        responses.append(package.frequency_response(reduced, np.linspace(5, 300, 40)))
    for response in responses[1:]:
        assert package.relative_error(responses[0], response).max() < 1e-9


@pytest.mark.slow
def test_a_million_dofs(hpcred, tmp_path):
    """The plate of the README on two ranks, and the full response at its points."""
    (tmp_path / "job.toml").write_text(
        'model = "model.h5"\n'
        + "".join(f'[[basis]]\nkind = "krylov"\nfrequency = {f}\norder = 1\n' for f in (10.0, 60.0))
    )
    assert hpcred("example", "solid", "--cells", 420, 400, 1, "-o", "model.h5", ranks=2).returncode == 0
    run = hpcred("reduce", "job.toml", "--json", "run.json", ranks=2, timeout=900)
    assert run.returncode == 0, run.stderr
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["size"] > 1_000_000 and record["reduced_size"] == 24 and record["symbolic_analyses"] == 1
    assert record["orthonormality_defect"] < 1e-12
    run = hpcred("evaluate", "result.h5", "--full", "model.h5", "--frequencies", "10,60", "--json", "eps.json", ranks=2,
                 timeout=900)  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert max(json.loads((tmp_path / "eps.json").read_text())["eps"]) < 1e-5
