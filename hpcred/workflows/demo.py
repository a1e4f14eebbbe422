"""Show `python -m hpcred`: the linkage in the chord frame, to a tolerance and as in the paper's Table 1."""

from __future__ import annotations

from dataclasses import replace

from ..examples.linkage import linkage
from ..examples.section5 import AUTOMATIC, SISO, compare, table
from ..files.outputs import check_outputs, hdf5_kind
from ..files.result_file import FORMAT, write_result
from ..parallel.progress import Progress
from .workflow import workflow


@workflow
def run_demo(output="demo_result.h5", *, comm=None, progress: Progress | None = None) -> list[dict]:
    """Reduce the linkage in four ways and write the first model, the automatic one. Collective.

    Parameters
    ----------
    output : str or PathLike

    Returns
    -------
    list of dict
        The table.
    """
    check_outputs({output: hdf5_kind(FORMAT)}, comm, progress=progress)
    with linkage(comm) as model:

        def keep(row, reduced, loaded):
            if row.number == 0:
                write_result(output, reduced, loaded)

        setting = replace(SISO, rows=(AUTOMATIC, *SISO.rows))
        columns, rows = table(compare(model, setting, numbers=(0, 1, 3, 4), progress=progress, keep=keep))
    return [dict(zip(columns, row, strict=True)) for row in rows]
