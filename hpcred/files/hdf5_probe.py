"""Read all that HDF5 keeps in a file, as a script of its own: HDF5 may crash, or not end, on a damaged file.

Nothing else of hpcred is loaded, nor MPI started.
"""

import contextlib
import sys
from math import prod

MOST = 2**26  # bytes of a dataset that is read as a whole
ROWS = 2**12  # at the ends of a larger one
PACKED = 1100  # as in opened_hdf5


def read(group, h5py, seen):
    """Read attributes and numbers of all objects of a group, each once, without following links."""
    for name in group:
        with contextlib.suppress(Exception):
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            member = group[name]
            dict(member.attrs)
            place = h5py.h5o.get_info(member.id).addr
            if place in seen:
                continue
            seen.add(place)
            if isinstance(member, h5py.Group):
                read(member, h5py, seen)
            elif isinstance(member, h5py.Dataset) and member.shape and not (member.external or member.is_virtual):
                size = member.dtype.itemsize * prod(member.shape)
                if size <= member.id.get_storage_size() * PACKED:
                    rows = member.shape[0] if size <= MOST else ROWS
                    member[:rows], member[-rows:]


def main(path):
    """Read a file as far as it can be read."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(ImportError):
        import mpi4py

        mpi4py.rc.initialize = False  # which h5py for MPI loads
    import h5py

    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        dict(file.attrs)
        read(file, h5py, set())


if __name__ == "__main__":
    main(sys.argv[1])
