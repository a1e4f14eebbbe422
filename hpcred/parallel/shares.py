"""The share of a rank in rows that are distributed."""


def row_range(comm, size: int, block: int = 1) -> tuple[int, int]:
    """First and last row of this rank: even shares of whole blocks (the dofs of a node stay together)."""
    count, extra = divmod(size // block, comm.size)
    first = comm.rank * count + min(comm.rank, extra)
    last = first + count + (comm.rank < extra)
    return first * block, last * block
