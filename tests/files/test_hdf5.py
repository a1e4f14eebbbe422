"""HDF5 files appear whole or not at all."""

import h5py
import numpy as np
import pytest

from hpcred.files.hdf5 import reading, writing
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


def test_parts_of_other_types_are_of_one_in_the_file(comm, folder):
    """A rank without rows may have an array of any type; else the file takes what holds all."""
    kinds = {"empty": ["f8", "i8", "i8"], "wider": ["i4", "i8", "i4"], "both": ["i4", "f8", "i4"]}
    with writing(folder / "r.h5", comm) as file:
        file.attribute("format", "rows")
        for name, types in kinds.items():
            rows = np.arange(6).reshape(3, 2) + 6 * comm.rank
            if name == "empty" and comm.rank == 0 and comm.size > 1:
                rows = rows[:0]
            file.rows(name, rows.astype(types[comm.rank]))
        file.small("behind", "text")
    with reading(folder / "r.h5", "rows") as checked:
        for name, types in kinds.items():
            found, first = checked[name][...], int(name == "empty" and comm.size > 1)
            assert np.array_equal(found, np.arange(6 * first, 6 * comm.size).reshape(-1, 2))
            assert found.dtype == np.result_type(*types[first : comm.size])
        assert checked["behind"][()] == b"text"
