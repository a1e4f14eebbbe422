"""The example of a new component: what it promises, against a dense solution; and its program."""

import subprocess
import sys

import numpy as np
import pytest
from docs_pages import ROOT, load
from helpers import to_dense
from launch import mpi_environment

import hpcred
from hpcred.model.frames import apply_frame

example = load(ROOT / "examples" / "component.py")
FRAME = hpcred.Chord(nodes=(1, 7, 14), axes="yxz")


@pytest.mark.mpi
@pytest.mark.costly
def test_static_deflections_under_further_loads_are_exact(linkage):
    """Forces that are no inputs deflect the reduced body as the full one, which the same number of modes does not."""
    loads = ((10, "z"), (4, "x"))
    framed = apply_frame(linkage, FRAME)
    with framed.model.with_inputs(loads) as loaded:
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


BASIS = (hpcred.Modes(count=4), example.FurtherLoads(loads=((10, "z"), (4, "x"))))


@pytest.mark.mpi
@pytest.mark.costly
def test_its_results_are_read_again(comm, folder, linkage):
    hpcred.reduce(linkage, BASIS, hpcred.Buckens()).save(folder / "a.h5")
    assert hpcred.read_result(folder / "a.h5", comm).reduced.record.basis == BASIS


def test_programs_that_do_not_know_it_use_its_results(tmp_path):
    """Shown, evaluated, exported and reported, in one process that has not seen the class."""
    with hpcred.linkage() as model:
        hpcred.write_model(tmp_path / "model.h5", model)
        hpcred.reduce(model, BASIS, hpcred.Buckens()).save(tmp_path / "a.h5")
    commands = ("info a.h5", "evaluate a.h5 --frequencies 10,20 --full model.h5", "export a.h5 --format sid",
                "report a.h5 -o a.html")  # fmt: skip
    program = f"from hpcred.cli.main import run\nassert not any(run(words.split()) for words in {commands})"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True,
                          env=mpi_environment())  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "further loads (" in (tmp_path / "a.html").read_text()
