"""HDF5 files appear whole or not at all."""

import h5py
import numpy as np
import pytest

from hpcred.formats.hdf5 import reading, writing
from hpcred.parallel.shares import row_range

pytestmark = pytest.mark.mpi


def test_a_failed_write_leaves_the_old_file(comm, folder):
    if comm.rank == 0:
        (folder / "r.h5").write_text("old")
    comm.Barrier()
    with pytest.raises(RuntimeError), writing(folder / "r.h5", comm) as file:
        file.attribute("format", "half")
        raise RuntimeError
    comm.Barrier()
    assert (folder / "r.h5").read_text() == "old"
    assert [path.name for path in folder.iterdir()] == ["r.h5"]


def test_rows_lie_where_they_belong(comm, folder):
    """Also where ranks have none, between other datasets, and with what HDF5 itself reads."""
    places = [((7,), 0), ((2, 3), 0), ((3, 5), 1), ((2, 4, 3), 1), ((0, 4), 1), ((4, 0), 0)]
    cases = {f"group/{kind}{k}": (shape, axis, kind) for k, (shape, axis) in enumerate(places)
             for kind in ("f8", "c16", "i4", "?")}  # fmt: skip
    whole = {name: (np.arange(np.prod(shape)).reshape(shape) % 5 + 1).astype(kind)
             for name, (shape, _, kind) in cases.items()}  # fmt: skip
    with writing(folder / "r.h5", comm) as file:
        file.attribute("format", "rows")
        for name, (shape, axis, _) in cases.items():
            file.rows(name, np.take(whole[name], np.arange(*row_range(comm, shape[axis])), axis), axis)
            file.small(f"{name} and", ["a", "bc"])
    with h5py.File(folder / "r.h5", "r") as plain, reading(folder / "r.h5", "rows") as checked:
        for name, array in whole.items():
            assert plain[name].dtype == array.dtype and np.array_equal(plain[name][()], array)
            assert np.array_equal(checked[name][...], array) and plain[f"{name} and"][1] == b"bc"
