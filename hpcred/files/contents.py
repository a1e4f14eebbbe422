"""Compute a digest of a file of any kind, the same on any number of ranks."""

from xxhash import xxh3_128, xxh3_128_digest

from ..parallel.failures import agreed
from .system_errors import open_input

BYTES_OF_A_PIECE = 2**25  # bytes; each rank reads every size-th of them


def content_of(path, comm) -> str:
    """The hash XXH3 of the hashes of the chunks of a file, 32 hexadecimal digits. Collective. Raises InputError."""
    own = []
    with agreed(comm), open_input(path) as file:
        end = file.seek(0, 2)
        for start in range(comm.rank * BYTES_OF_A_PIECE, end, comm.size * BYTES_OF_A_PIECE):
            file.seek(start)
            own.append((start, xxh3_128_digest(file.read(BYTES_OF_A_PIECE))))
    chunks = sorted(sum(comm.allgather(own), []))
    return xxh3_128(b"".join(digest for _, digest in chunks)).hexdigest()
