"""What the tests of the readers share: files written once for all ranks, and matrices gathered from all ranks."""

import gzip

import numpy as np
from conftest import DATA

from hpcred.readers.matrix_formats import read_entries


def write(path, content, comm):
    """Write a text or bytes on rank 0; all ranks may read it afterwards."""
    comm.Barrier()  # what is written over may still be read elsewhere
    if comm.rank == 0:
        path.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    comm.Barrier()
    return path


def unpack(folder, comm, name):
    """A copy of tests/data/<name>, with gzip files unpacked, made once for all ranks."""
    if comm.rank == 0:
        for file in (DATA / name).iterdir():
            packed = file.suffix == ".gz"
            content = gzip.decompress(file.read_bytes()) if packed else file.read_bytes()
            (folder / (file.stem if packed else file.name)).write_bytes(content)
    comm.Barrier()
    return folder


def assembled(path, comm):
    """A file as dense matrix on all ranks."""
    entries = read_entries(path, comm)
    local = np.zeros(entries.shape)
    np.add.at(local, (entries.rows, entries.columns), entries.values)
    return comm.allreduce(local)


def gathered(comm, *arrays):
    """Arrays of all ranks end to end."""
    return [np.concatenate(parts) for parts in zip(*comm.allgather(arrays), strict=True)]


def everywhere(comm, found):
    """Nodes, displacements and stresses of all ranks, ascending."""
    node, *steps = gathered(comm, found.node, found.displacement.swapaxes(0, 1), found.stress.swapaxes(0, 1))
    return node, *(item.swapaxes(0, 1) for item in steps)
