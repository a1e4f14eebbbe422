"""Seal a file at its end, so that what HDF5 keeps of its own is checked before HDF5 sees it.

HDF5 crashes, or runs for ever, on some files whose own bytes are damaged. The seal follows what HDF5 takes for the end
of the file: JSON with `data`, the places (first byte, bytes) of datasets, which have checksums of their own (see
files.checked), `end` of the file but for the seal, and `crc`, the CRC-32 of all other bytes; then its length in 8
bytes, its CRC-32 in 4, and MARK. A program that changes the file with HDF5 takes the seal off.
"""

import json
import struct
import zlib
from pathlib import Path

import h5py

from ..parallel.failures import InputError
from .system_errors import open_input

MARK = b"sealed by hpcred"
TAIL = struct.Struct(f"<QI{len(MARK)}s")


def seal(path):
    """Seal a file that is written, on one rank."""
    data = []

    def note(_, dataset):
        if isinstance(dataset, h5py.Dataset) and dataset.id.get_offset() is not None and dataset.id.get_storage_size():
            data.append((dataset.id.get_offset(), dataset.id.get_storage_size()))

    with h5py.File(path, "r") as file:
        file.visititems(note)
    end, data = Path(path).stat().st_size, sorted(data)
    text = json.dumps({"data": data, "end": end, "crc": _crc(path, data, end)}).encode()
    with open(path, "ab") as file:
        file.write(text + TAIL.pack(len(text), zlib.crc32(text), MARK))


def is_sealed(path) -> bool:
    """Whether a file ends as a sealed one does."""
    with open_input(path) as file:
        file.seek(max(file.seek(0, 2) - len(MARK), 0))
        return file.read() == MARK


def is_broken(path) -> bool:
    """Whether a file is sealed, and other bytes than those of datasets are not what they were."""
    size = Path(path).stat().st_size
    with open_input(path) as file:
        if size < TAIL.size:
            return False
        file.seek(size - TAIL.size)
        length, crc, mark = TAIL.unpack(file.read())
        if mark != MARK or length > size - TAIL.size:
            return mark == MARK
        file.seek(size - TAIL.size - length)
        text = file.read(length)
    if zlib.crc32(text) != crc:
        return True
    try:
        tail = json.loads(text)
        return tail["end"] != size - TAIL.size - length or tail["crc"] != _crc(path, tail["data"], tail["end"])
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError):  # OSError: for no place in a file
        return True


def _crc(path, data, end) -> int:
    """The CRC-32 of the bytes of a file that belong to no dataset."""
    crc = at = 0
    with open_input(path) as file:
        for first, count in [*data, (end, 0)]:
            file.seek(at)
            while at < first:
                chunk = file.read(min(first - at, 2**20))
                if not chunk:
                    return -1
                crc, at = zlib.crc32(chunk, crc), at + len(chunk)
            at = max(at, first + count)
    return crc
