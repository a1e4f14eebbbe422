"""Show the report of a file, and the details of a result: directions, basis, points and their checks, time, memory."""

from __future__ import annotations

from dataclasses import asdict

from ..reduction.result.directions import rows_of_directions
from ..report.tables import in_words, say, show_table, show_timing
from . import session
from .options import DIRECTIONS

INTERFACES = "Interfaces, and where their reference nodes are (m)"
MOST_SETS = 20  # node sets that are listed


def show_report(file, report, details=False):
    """Print what is known of a file, in numbers and sentences; interfaces and loads where no details have them."""
    below_it = ("sets", "interfaces", "joints", "bases", "parameters", "terms", "loads", "sentences", "warnings")
    rows = [{"": key.replace("_", " "), file: in_words(value)} for key, value in report.items() if key not in below_it]
    show_table(None, rows)
    if not details:
        show_table(INTERFACES, report.get("interfaces", []))
        show_joints(report.get("joints", []))
        show_table("Bases that move", report.get("bases", []))
        session.show_loads(report.get("loads", []))
    show_table("Parameters", report.get("parameters", []))
    show_table("Terms that the matrices have for them", report.get("terms", []))
    sets = [{"node set": name, "nodes": count} for name, count in report.get("sets", {}).items()]
    show_table(None, sets[:MOST_SETS])
    if len(sets) > MOST_SETS:
        say(f"and {len(sets) - MOST_SETS} more node sets; --json - lists all")
    for sentence in report.get("sentences", []):
        say(sentence)


def show_joints(rows):
    """Print the joints of a machine, and how far apart their ends are."""
    show_table("Joints", [row | {"apart (m)": "" if row["apart (m)"] is None else f"{row['apart (m)']:.3g}"}
                          for row in rows])  # fmt: skip


def show_details(record):
    """Print what the record of a result has beside its verdict."""
    accuracy, stored = record.accuracy, any(row.from_store for row in record.components)
    if accuracy is not None:
        show_table(DIRECTIONS, rows_of_directions(accuracy.directions, accuracy.band))
    show_table("Basis", [
        {"basis": row.where, "columns": row.columns, "new": row.kept, "dropped": row.columns - row.kept,
         **({"from": "store" if row.from_store else ""} if stored else {})} for row in record.components
    ])  # fmt: skip
    show_table(INTERFACES, record.interface_rows)
    show_joints([row.row for row in record.joints])
    session.show_loads([row.row for row in record.loads])
    if accuracy is not None:
        show_table("Expansion points", [
            {"f (Hz)": row.frequency, "columns": row.columns, "modes below": in_words(row.modes_below),
             "estimate after it": in_words(row.estimate), "factor": row.factor_in_words} for row in accuracy.points
        ])  # fmt: skip
        show_table("Each new point checks the model before it", [asdict(row) for row in accuracy.proofs])
        say(f"{accuracy.measured}; {accuracy.modes_in_words}; estimated {accuracy.largest:.1e}, round-off "
              f"{accuracy.noise:.0e}; {accuracy.uncompressed_size} columns before the compression")  # fmt: skip
    residual = max((row.residual for row in record.factorisations), default=0.0)
    say(
        f"max |V^T M V - I| = {record.orthonormality_defect:.1e}; "
        + (f"largest residual {residual:.1e}; " if residual else "")
        + f"{record.effort}; {record.scalar} PETSc {record.versions['petsc']}, {record.ranks} rank(s)"
    )
    show_timing(record.timing, record.factorisations)
