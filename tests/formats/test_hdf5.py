"""HDF5 files appear whole or not at all."""

import pytest

from hpcred.formats.hdf5 import writing

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
