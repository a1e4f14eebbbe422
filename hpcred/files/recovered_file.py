"""Write the recovered motion of nodes as HDF5 or .csv.

HDF5, with nt instants, k nodes, s of them with stresses (attributes: format "hpcred-recovery", version 1):
t (nt) in s
nodes/number (k), nodes/position (k, 3) in m: without displacement, in the axes of the displacements
interfaces/number, name: of the interface nodes among the nodes
displacement, velocity, acceleration (nt, k, 3) in m and s, those that were asked for
stress (nt, s, 6): xx, yy, zz, xy, yz, zx in Pa, in the axes of the body; von_mises (nt, s); stress_node (s): numbers
record: JSON with the files that were read, the axes ("body" or "inertial"), remarks and versions
The .csv has one line an instant: t, then displacement_20_x and so on, stress_20_xx, von_mises_20.
"""

from contextlib import ExitStack, contextmanager

import numpy as np

from ..parallel.failures import ComputationError, InputError, agreed
from .checked import Array
from .hdf5 import atomic_output, writing
from .result_points import Points

FORMAT, VERSION = "hpcred-recovery", 1
FIELDS = ("displacement", "velocity", "acceleration", "stress", "von_mises")
SCHEMA = {
    "t": Array("real", ("t",), needed=True), "nodes/number": Array("integer", ("k",), needed=True),
    "nodes/position": Array("real", ("k", 3), needed=True), "record": Array("text", (), needed=True),
    "interfaces/number": Array("integer", ("i",)), "interfaces/name": Array("text", ("i",)),
    **{key: Array("real", ("t", "k", 3)) for key in FIELDS[:3]},
    "stress": Array("real", ("t", "s", 6)), "von_mises": Array("real", ("t", "s")),
    "stress_node": Array("integer", ("s",)),
}  # fmt: skip
COMPONENTS = {"stress": ("_xx", "_yy", "_zz", "_xy", "_yz", "_zx"), "von_mises": ("",)}
LETTERS = 18  # of a number in a .csv
LARGEST_TABLE = 10**9  # bytes of a .csv


def tails(points: Points, key: str) -> tuple[int, ...]:
    """Return the shape of a field of one instant on this rank."""
    stressed = len(points.stressed)
    return {"stress": (stressed, 6), "von_mises": (stressed,)}.get(key, (len(points.node), 3))


@contextmanager
def recovered_file(path, points: Points, start, t, keys, record: dict, comm, dtype):
    """Write HDF5. The block gets a function that takes the fields of the next instants by their names; collective.

    `start` (k, 3): places without displacement; `record` may change until the block ends.
    """
    with writing(path, comm, FORMAT, VERSION) as file, ExitStack() as stack:
        file.small("t", t)
        file.rows("nodes/number", points.node)
        file.rows("nodes/position", start)
        if points.names:
            file.small("interfaces/number", np.array(list(points.names), np.int64))
            file.small("interfaces/name", list(points.names.values()))
        if "stress" in keys:
            file.rows("stress_node", points.node[points.stressed])
        puts = {key: stack.enter_context(file.steps(key, len(t), tails(points, key), dtype)) for key in keys}

        def put(fields):
            for key, values in fields.items():
                puts[key](values)

        yield put
        stack.close()
        file.small("record", record)


@contextmanager
def recovered_table(path, points: Points, t, keys, comm):
    """Write a .csv. The block gets a function that takes the fields of the next instants by their names; collective.

    Raises InputError for a table that is too large for its purpose.
    """
    # a table of too many numbers is of no use to a reader of text
    width = comm.allreduce(sum(int(np.prod(tails(points, key))) for key in keys))
    size = len(t) * (width + 1) * LETTERS
    if size > LARGEST_TABLE:
        raise InputError(
            f"output {path}: {len(t)} instants of {width} numbers, about {size / 1e9:.3g} GB of text; expected at most "
            f"{LARGEST_TABLE / 1e9:g} GB: choose nodes or fewer instants (--nodes, --every), or write .h5"
        )
    # columns of all ranks, quantity by quantity
    columns = [name for of_ranks in zip(*comm.allgather([_names(points, key) for key in keys]), strict=True)
               for names in of_ranks for name in names]  # fmt: skip
    done = 0
    with atomic_output(path, comm) as temporary:
        file = None
        with agreed(comm):
            if comm.rank == 0:
                file = open(temporary, "w", encoding="utf-8")  # noqa: SIM115
                file.write(",".join(["t", *columns]) + "\n")

        def put(fields):
            nonlocal done
            flat = [values.reshape(len(values), -1) for values in fields.values()]
            gathered = [comm.gather(values) for values in flat]
            with agreed(comm):
                if comm.rank == 0:
                    times = t[done : done + len(flat[0])]
                    table = np.concatenate([times[:, None], *(rows for rank in gathered for rows in rank)], axis=1)
                    if not np.isfinite(table).all():
                        raise ComputationError("the recovered motion overflows, and is not written")
                    np.savetxt(file, table, "%.10e", ",")
            done += len(flat[0])

        try:
            yield put
        finally:
            if file is not None:
                file.close()


def _names(points, key) -> list[str]:
    """Return the names of the columns of a field, of this rank."""
    node = points.node[points.stressed] if key in COMPONENTS else points.node
    labels = [points.names.get(number, str(number)) for number in node.tolist()]
    return [f"{key}_{label}{tail}" for label in labels for tail in COMPONENTS.get(key, ("_x", "_y", "_z"))]
