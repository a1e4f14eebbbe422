"""The demo prints its table."""

import re

import h5py
import pytest


def test_the_demo_prints_its_table(hpcred, tmp_path):
    (tmp_path / "result.h5").write_text("mine")
    result = hpcred(ranks=2)
    assert result.returncode == 0, result.stderr
    rows = re.findall(r"^ +(\d) .* 14 +\S+ +(\S+) +(\S+) *$", result.stdout, re.M)
    found = {int(row): float(q) for row, q, _ in rows}
    assert found[1] < 1e-8
    assert found[3] == pytest.approx(8.91e-2, rel=2e-3)
    assert found[4] == pytest.approx(8.39, rel=2e-3)
    (automatic,) = re.findall(r"^ +0 +automatic.* (\d+) +(\S+) +(\S+) *$", result.stdout, re.M)
    assert int(automatic[0]) <= 7 and float(automatic[2]) <= 1e-4
    assert "demo_result.h5" in result.stdout
    assert (tmp_path / "result.h5").read_text() == "mine"
    with h5py.File(tmp_path / "demo_result.h5") as file:
        assert file["basis/V"].shape == (int(automatic[0]), 120)
