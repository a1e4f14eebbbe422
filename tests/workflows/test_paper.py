"""`hpcred paper`: tables, figures and data."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.integrate
from pictures import undrawn

import hpcred as package
from hpcred import Modes
from hpcred.examples import section5
from hpcred.workflows import paper


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


def test_tables_are_there_before_the_figures(tmp_path, monkeypatch, comm):
    """Whatever becomes of Figure 5; and without it where it is not chosen."""
    for module in (paper, section5):
        monkeypatch.setattr(module, "FREQUENCIES", np.linspace(1.0, 300.0, 4))
        for name in ("SISO", "MIMO"):  # the first and the last of four rows
            setting = getattr(section5, name)
            monkeypatch.setattr(module, name, replace(setting, rows=(setting.rows[0], setting.rows[-1])))
    monkeypatch.setattr(section5, "REFERENCE", replace(section5.REFERENCE, basis=(Modes(index=tuple(range(7, 43))),)))
    undrawn(monkeypatch)
    compared, shown = {}, []

    def compare_once(model, setting):
        if setting not in compared:
            compared[setting] = section5.compare(model, setting)
        return compared[setting]

    def interrupted(model, progress):
        raise KeyboardInterrupt

    monkeypatch.setattr(paper, "compare", compare_once)
    monkeypatch.setattr(section5, "SIMULATION", replace(section5.SIMULATION, end=0.001, steps=2))
    whole = paper.reproduce(tmp_path / "whole", figures=[5])
    assert len(whole["figure_5"]) == 3 and json.loads((tmp_path / "whole/section5.json").read_text()) == whole
    assert (tmp_path / "whole/figure_5.png").exists() and not (tmp_path / "whole/figure_3.png").exists()
    monkeypatch.setattr(paper, "time_response", interrupted)
    with pytest.raises(KeyboardInterrupt):
        paper.reproduce(tmp_path, show=lambda data: shown.append(json.loads((tmp_path / "section5.json").read_text())))
    assert sorted(shown[0]) == ["table_1", "table_2"] and [row["size"] for row in shown[0]["table_2"]] == [21] * 2
    assert sorted(item.name for item in tmp_path.glob("*.png")) == ["figure_3.png", "figure_4.png"]
    assert {key: whole[key] for key in shown[0]} == shown[0]
    with pytest.raises(package.InputError, match="figures: found 2, expected some of 3, 4, 5"):
        paper.reproduce(tmp_path, figures=[2])
