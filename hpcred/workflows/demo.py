"""What `python -m hpcred` shows: the linkage as SISO system in the chord frame, three rows of the paper's Table 1."""

from ..examples.linkage import linkage
from ..examples.section5 import SISO, compare, table
from ..formats.result_file import write_result
from ..report.tables import show_table, show_timings, write_json


def run_demo(comm, output, progress, json=None):
    """Reduce the linkage in three ways, print the table, write the first model to `output`. Collective."""
    with linkage(comm) as model:

        def keep(row, rom):
            if row.number == 1:
                write_result(output, rom, model.dofs, comm=comm)

        results = compare(model, SISO, numbers=(1, 3, 4), progress=progress, keep=keep)
    columns, rows = table(results)
    show_table(
        comm, f"Stabilisation linkage, Table {SISO.table} of the paper. {SISO.title}, 0 to 300 Hz", columns, rows
    )
    write_json(comm, json, [dict(zip(columns, row, strict=True)) for row in rows])
    print(f"model of row 1 written to {output}")
    show_timings(comm, progress.summary())
