"""What `info` says of node sets, and of everything that hpcred writes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import block_with_ends, refused
from mpi4py import MPI

import hpcred as package
from hpcred.cli import run
from hpcred.report import mode_pictures
from hpcred.workflows.export import EXPORTS, export_result
from hpcred.workflows.info_of_export import description_of


def said(capsys, *arguments):
    capsys.readouterr()
    assert run(list(arguments)) == 0
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.mpi
def test_node_sets_are_counted_over_all_ranks(comm, folder):
    with package.crank(1000, comm) as model:
        sizes = {name: comm.allreduce(len(part)) for name, part in model.sets.items()}
        package.write_model(folder / "model.h5", model)
    assert package.describe_file(folder / "model.h5", comm=comm)["sets"] == sizes and min(sizes.values()) > 10


def test_many_node_sets_are_cut_off_with_a_word(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with package.crank(500) as model:
        for count in (20, 23):
            sets = {f"S{k:02d}": np.arange(1, k + 2) for k in range(count)}
            with replace(model.shared(), sets=sets) as marked:
                package.write_model("model.h5", marked)
            text = said(capsys, "info", "model.h5", "--json", "i.json")
            assert "S00 1 S01 2" in text and "S19 20" in text and "S20" not in text
            assert ("and 3 more node sets" in text) == (count == 23)
            assert json.loads(Path("i.json").read_text())["sets"] == {name: len(part) for name, part in sets.items()}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder with a result of a body with two interfaces, in both coordinates, in every format, and more."""
    folder = tmp_path_factory.mktemp("info")
    with pytest.MonkeyPatch.context() as patch, block_with_ends(MPI.COMM_SELF) as model:
        patch.setattr(mode_pictures, "MOVING_DOTS", 30)
        patch.setattr(mode_pictures, "DOTS", 40)
        package.write_model(folder / "model.h5", model)
        for name, coordinates in (("body", "modal"), ("arm", "interface")):
            with package.reduce(model, [package.CraigBampton(count=3)], package.Buckens(),
                                coordinates=coordinates) as rom:  # fmt: skip
                package.write_result(folder / f"{name}.h5", rom, model)
        for kind, export in EXPORTS.items():
            export_result(folder / ("arm.h5" if export.takes == "superelement" else "body.h5"), kind)
    return folder
