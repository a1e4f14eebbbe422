"""The example of a new ingredient: what it promises, against a dense solution; and its program."""

from contextlib import closing

import numpy as np
import pytest
from docs_pages import ROOT, load
from helpers import to_dense

import hpcred
from hpcred.model.frames import apply_frame

example = load(ROOT / "examples" / "ingredient.py")
FRAME = hpcred.Chord(nodes=(1, 7, 14), axes="yxz")


@pytest.mark.mpi
def test_static_deflections_under_further_loads_are_exact(linkage):
    """Forces that are no inputs deflect the reduced body as the full one, which the same number of modes does not."""
    loads = ((10, "z"), (4, "x"))
    with closing(apply_frame(linkage, FRAME)) as framed, framed.model.with_inputs(loads) as loaded:
        K, B = to_dense(loaded.K), to_dense(loaded.B)
    exact = np.diag(B.T @ np.linalg.solve(K, B))
    for basis, right in (
        ([hpcred.Modes(count=4), example.FurtherLoads(loads=loads)], True),
        ([hpcred.Modes(count=6)], False),
    ):
        with hpcred.reduce(linkage, basis, FRAME) as rom:
            assert rom.size == 6
            phi = [
                shape.phi[axis]
                for shape, axis in zip(hpcred.node_shapes(linkage, rom.columns, [10, 4]), (2, 0), strict=True)
            ]
            found = np.array([row @ np.linalg.solve(rom.K, row) for row in phi])
        assert np.allclose(found, exact, rtol=1e-9, atol=0) == right


def test_its_program_runs(capsys):
    example.main()
    assert "further loads: 2 vectors" in capsys.readouterr().out


def test_no_loads_are_refused():
    with pytest.raises(hpcred.InputError, match="further_loads.loads: expected at least one"):
        example.FurtherLoads(loads=())
