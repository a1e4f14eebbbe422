"""Results beside each other: the errors that each has alone, and modal assurance in dense numpy."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import block_with_ends, dense_model, gather

import hpcred
from hpcred import Buckens, CraigBampton, Krylov, Modes

pytestmark = pytest.mark.mpi
FREQUENCIES = (500.0, 4000.0, 9000.0)


@pytest.mark.costly
def test_each_result_has_its_own_error_and_the_modes_of_the_model(comm, folder):
    with block_with_ends(comm, cells=(4, 2, 3)) as model:  # no repeated modes
        K, M, _ = dense_model(model)
        hpcred.write_model(folder / "model.h5", model)
        bases = {"modes": [Modes(count=8)], "cb": [CraigBampton(count=6)], "moments": [Krylov(6000.0, 1)]}
        shapes = {}
        for name, basis in bases.items():
            coordinates = "interface" if name == "cb" else "modal"
            with hpcred.reduce(model, basis, Buckens(), coordinates=coordinates) as rom:
                hpcred.write_result(folder / f"{name}.h5", rom, model)
                if name != "cb":
                    shapes[name] = rom.frequencies, gather(rom.columns)
        with hpcred.reduce(model, bases["cb"], Buckens()) as rom:
            shapes["cb"] = rom.frequencies, gather(rom.columns)
        files = [folder / f"{name}.h5" for name in bases]
        report = hpcred.workflows.compare_results(files, folder / "model.h5", frequencies=FREQUENCIES, modes=4,
                                        output=folder / "eps.csv")  # fmt: skip
    for file, row in zip(files, report["rows"], strict=True):
        alone = hpcred.evaluate(file, folder / "model.h5", frequencies=FREQUENCIES)
        assert report["eps"][file.stem] == pytest.approx(alone["eps"], rel=1e-9)
        assert row["Q"] == pytest.approx(alone["Q"], rel=1e-9)
        whole = hpcred.read_result(file, comm).reduced
        assert row["size"] == whole.size and row["elastic"] == whole.size - (6 if file.stem == "cb" else 0)
        assert ("(6 rigid-body, 12 elastic)" in whole.size_in_words) == (file.stem == "cb")
    frequencies, phi = shapes["modes"]
    for i, row in enumerate(report["modes"]):
        assert row["f (Hz)"] == pytest.approx(frequencies[i], rel=1e-9)
        for name, (own, psi) in shapes.items():
            share = (phi[:, i] @ M @ psi) ** 2
            assert row[f"{name} MAC"] == pytest.approx(share.max(), abs=1e-8)
            assert row[f"{name} error"] == pytest.approx(own[share.argmax()] / frequencies[i] - 1, abs=1e-8)
    table = np.loadtxt(folder / "eps.csv", delimiter=",", skiprows=1)
    assert np.allclose(table, np.array([FREQUENCIES, *report["eps"].values()]).T)


@pytest.mark.costly
def test_results_of_other_questions_are_refused(comm, folder):
    with hpcred.solid((4, 2, 2), inputs=2, comm=comm) as one, hpcred.solid((4, 2, 2), inputs=3, comm=comm) as other:
        hpcred.write_model(folder / "model.h5", one)
        for name, model in (("a", one), ("b", other), ("c", one)):
            with hpcred.reduce(model, [Modes(count=3)]) as rom:
                hpcred.write_result(folder / f"{name}.h5", rom, model)
        with pytest.raises(hpcred.InputError, match=r"b\.h5: found the inputs .* but .* in .*a\.h5; compare"):
            hpcred.workflows.compare_results([folder / "a.h5", folder / "b.h5"], folder / "model.h5")
        with pytest.raises(hpcred.InputError, match="ends in .csv, for the errors of several results"):
            hpcred.workflows.compare_results([folder / "a.h5", folder / "c.h5"], folder / "model.h5", output="x.npz")
        with pytest.raises(hpcred.InputError, match="expected two or more, each once"):
            hpcred.workflows.compare_results([folder / "a.h5", folder / "a.h5"], folder / "model.h5")
        # digests of an earlier version, which tell nothing about the model of today
        old = dict.fromkeys(rom.record.digests, "0" * 64)
        rom = replace(rom, record=replace(rom.record, digests=old))
        hpcred.write_result(folder / "old.h5", rom)
        with pytest.raises(hpcred.InputError, match=r"old\.h5: an earlier version wrote it, .*; reduce again"):
            hpcred.evaluate(folder / "old.h5", folder / "model.h5", frequencies=FREQUENCIES)
        with pytest.raises(hpcred.InputError, match=r"old\.h5: an earlier version wrote it, .*; reduce again"):
            hpcred.workflows.compare_results([folder / "a.h5", folder / "old.h5"], folder / "model.h5")
