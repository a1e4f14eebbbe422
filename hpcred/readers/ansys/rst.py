"""Read nodes and the angles of their axes from ANSYS' result file (.rst); each rank reads a share."""

import numpy as np

from ...files.text import LARGEST_LABEL
from ...parallel.failures import InputError, agreed
from .records import STANDARD, RecordFile, file_number, short_records
from .records import begins as begins_binary

FILE = 12  # the number of result files
GEOMETRY, GEOMETRY_HIGH = 15, 46  # where the header says where the geometry is
NODES, NODES_OLD, NODES_LOW, NODES_HIGH = 3, 8, 26, 27  # number of nodes, and where they are
ITEMS = 7  # of a node: number, x, y, z, three angles in degrees


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a result file."""
    return begins_binary(start) and FILE in (file_number(start), int.from_bytes(start[8:12], "big"))


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return node numbers (share,), coordinates (share, 3), angles (share, 3) in degrees. Collective."""
    with agreed(comm):
        file = RecordFile(path, FILE)
        header, _ = file.integers(STANDARD + 3, file.frame(STANDARD + 3)[0], "the header")
        if len(header) <= GEOMETRY:
            raise file.damaged(STANDARD + 3, f"a header of {len(header)} words")
        place, geometry = geometry_of(file, header)
        if len(geometry) <= NODES_HIGH or geometry[NODES] < 1:
            raise file.damaged(place, "a geometry without nodes")
        start = _wide(geometry, NODES_LOW, NODES_HIGH) or int(geometry[NODES_OLD])
        table = short_records(file, start, int(geometry[NODES]), ITEMS, comm.rank, comm.size)
        label = table[:, 0]
        if len(label) and not ((label == np.floor(label)) & (label >= 1) & (label <= LARGEST_LABEL)).all():
            raise file.damaged(start, "a node number that is no whole number")
    return label.astype(np.int64), table[:, 1:4], table[:, 4:]


def geometry_of(file: RecordFile, header) -> tuple[int, np.ndarray]:
    """Return the place and the header of the geometry. Raises InputError."""
    place = _wide(header, GEOMETRY, GEOMETRY_HIGH)
    if not place:
        raise InputError(f"{file.path}: found no geometry in the result file; write the nodes by CDWRITE,DB")
    return place, file.integers(place, file.frame(place)[0], "the header of the geometry")[0]


def _wide(header, low, high):
    """Return a place of two words."""
    upper = int(header[high]) if len(header) > high else 0
    return (upper << 32) | (int(header[low]) & 0xFFFFFFFF)
