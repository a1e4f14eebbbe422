"""The demo prints its table."""

import re

import h5py
import pytest

from hpcred.cli.main import run


def test_the_demo_prints_its_table(tmp_path, monkeypatch, capsys):
    """On one rank; `make demo` and `make test-pip` run it on two."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "result.h5").write_text("mine")
    assert run([]) == 0
    printed = capsys.readouterr().out
    rows = re.findall(r"^ +(\d) .* 14 +\S+ +(\S+) +(\S+) *$", printed, re.M)
    found = {int(row): float(q) for row, q, _ in rows}
    assert found[1] < 1e-8
    assert found[3] == pytest.approx(8.91e-2, rel=2e-3)
    assert found[4] == pytest.approx(8.39, rel=2e-3)
    (automatic,) = re.findall(r"^ +0 +automatic.* (\d+) +(\S+) +(\S+) *$", printed, re.M)
    assert int(automatic[0]) <= 7 and float(automatic[2]) <= 1e-4
    assert "demo_result.h5" in printed
    assert (tmp_path / "result.h5").read_text() == "mine"
    with h5py.File(tmp_path / "demo_result.h5") as file:
        assert file["basis/V"].shape == (int(automatic[0]), 120)
