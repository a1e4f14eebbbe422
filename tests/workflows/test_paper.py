"""`hpcred paper`: tables, figures and data."""

import json

import h5py
import numpy as np
import pytest
import scipy.integrate


@pytest.mark.slow
def test_section_5_in_one_command(hpcred, tmp_path):
    run = hpcred("paper", "-o", "out", "--json", "all.json", ranks=2, timeout=900)
    assert run.returncode == 0, run.stderr
    for figure in (3, 4, 5):
        assert (tmp_path / f"out/figure_{figure}.png").stat().st_size > 20_000
        assert "<svg" in (tmp_path / f"out/figure_{figure}.svg").read_text()
    data = json.loads((tmp_path / "all.json").read_text())
    assert data == json.loads((tmp_path / "out/section5.json").read_text())
    assert [row["size"] for row in data["table_1"]] == [14] * 4
    assert [row["size"] for row in data["table_2"]] == [21] * 4
    assert [row["Q of the paper"] for row in data["table_2"]] == [4.01e-4, 1.2e-3, 1.08e-3, 1.57]
    q = {key: [row["Q"] for row in data[key]] for key in ("table_1", "table_2")}
    assert max(q["table_1"][:2]) < 1e-8
    assert q["table_1"][2:] == pytest.approx([8.91e-2, 8.39], rel=2e-3)
    reduced = data["figure_5"][1:]
    assert [row["size"] for row in data["figure_5"]] == [114, 21, 21, 21, 21]
    deviation = [row["largest |u_y - reference| (m)"] for row in reduced]
    assert max(deviation[:3]) < 2e-5 < deviation[3] < 2e-4  # modes alone are the worst, as in the paper
    assert max(row["constraint drift (m)"] for row in data["figure_5"]) < 1e-7
    assert max(row["energy defect"] for row in data["figure_5"]) < 1e-5
    with h5py.File(tmp_path / "out/section5.h5") as file:
        u_y = file["figure_5/u_y"][...]
        assert np.abs(u_y[1:] - u_y[0]).max(axis=1) == pytest.approx(deviation)
        f, eps = file["frequencies"][...], file["table_2/eps"][...]
        assert eps.shape == (4, len(f))
        assert scipy.integrate.trapezoid(eps, f, axis=1) == pytest.approx(q["table_2"])
