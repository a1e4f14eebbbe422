"""What `python -m hpcred` shows: the linkage as SISO system in the chord frame, three rows of the paper's Table 1."""

from __future__ import annotations

from ..examples.linkage import linkage
from ..examples.section5 import SISO, compare, table
from ..formats.result_file import write_result
from ..parallel import startup
from ..parallel.progress import Progress


def run_demo(output="result.h5", *, comm=None, progress: Progress | None = None) -> list[dict]:
    """Reduce the linkage in three ways and write the first model to `output`; returns rows of the paper's Table 1.

    Collective.
    """
    comm = comm or startup.start_mpi()
    progress = progress or Progress(comm, show=False)
    with linkage(comm) as model:

        def keep(row, reduced, loaded):
            if row.number == 1:
                write_result(output, reduced, loaded)

        columns, rows = table(compare(model, SISO, numbers=(1, 3, 4), progress=progress, keep=keep))
    return [dict(zip(columns, row, strict=True)) for row in rows]
