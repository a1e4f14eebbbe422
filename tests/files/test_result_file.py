"""Result files keep what they are given."""

import h5py
import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred import Buckens, Krylov

pytestmark = pytest.mark.mpi


def test_result_file_keeps_everything(comm, folder):
    with hpcred.linkage(comm) as model, hpcred.reduce(model, [Krylov(50.0, 2)], Buckens()) as rom:
        hpcred.write_result(folder / "r.h5", rom, model)
        V = gather(rom.columns)
        read = hpcred.read_result(folder / "r.h5", comm).reduced
        assert read.record == rom.record
        for key in ("M", "D", "K", "B", "C", "frequencies"):
            assert np.array_equal(getattr(read, key), getattr(rom, key))
        assert read.interfaces == ()
        assert read.record.ranks == comm.size
        assert read.record.factorisations[0].residual < 1e-9
        with h5py.File(folder / "r.h5", "r") as file:
            assert np.array_equal(file["basis/V"][...], V.T)
        hpcred.write_result(folder / "small.h5", rom, basis=False)
        with h5py.File(folder / "small.h5", "r") as file:
            assert "basis" not in file


def test_a_result_is_not_written_with_another_model(solid, folder, comm):
    with (
        hpcred.reduce(solid, hpcred.Krylov(100.0)) as rom,
        hpcred.solid((4, 2, 3), inputs=3, comm=comm, young=1e9) as softer,
        hpcred.solid((4, 2, 2), inputs=3, comm=comm) as smaller,
    ):
        for other in (softer, smaller):
            with pytest.raises(hpcred.InputError, match="^model: found another (M|K) than that which was reduced"):
                hpcred.write_result(folder / "result.h5", rom, other)
        with pytest.raises(hpcred.InputError, match="^reduced: found .* expected ReducedModel"):
            hpcred.write_result(folder / "result.h5", solid, rom)
        with pytest.raises(hpcred.InputError, match="^model: found 3, expected SecondOrderModel"):
            hpcred.write_result(folder / "result.h5", rom, 3)
        with solid.with_outputs([1]) as measured:
            hpcred.write_result(folder / "result.h5", rom, measured)
