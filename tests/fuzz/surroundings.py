"""What others may do around a run: seals that somebody made up, odd names of files, and files in the way of outputs."""

import json
import struct
import zlib

from hpcred.files.seal import MARK, TAIL

from .containers import files, outcome
from .judge import Case
from .matrices import chosen

SIGNS = ("a", "b c", "é", "\udcff", "\x01", "\n", "'", '"', ";", "$(id)", "#", "%", "*", "[1]", "..", "&lt;", "<b>",
         "\\", "\u202e", "x" * 150, "、" * 50)  # fmt: skip
LAID = ("thesis\n", "process 1 on here\nand more", "{")


def sealed(rng, kind):
    """A file with a made-up seal of the right sum behind it."""
    which = chosen(rng, "model.h5", "result.h5", "responses.h5", "motion.h5")
    good = files()
    depth, number = int(10 ** rng.uniform(0, 5.5)), int(rng.integers(-(2**40), 2**40))
    said = chosen(
        rng, "[" * depth + "]" * depth, '{"data":' * depth + "1" + "}" * depth, "9" * depth, '"' + "a" * depth + '"',
        json.dumps({"data": [[number, number]], "end": len(good[which]), "crc": number}),
        json.dumps({"data": chosen(rng, None, "ab", [1], [[1, 2, 3]], [["a", 1]], [[0.5, 1]], {}), "end": number}),
        json.dumps({"data": [], "end": len(good[which]), "crc": chosen(rng, "x", None, -1, 1e300)}),
        f'{{"data": [[1e999, 1]], "end": {len(good[which])}}}', "NaN", "", "\udcff",
    ).encode(errors="surrogateescape")  # fmt: skip
    tail = TAIL.pack(len(said), zlib.crc32(said), MARK)
    if rng.random() < 0.2:
        tail = struct.pack("<QI16s", int(rng.integers(0, 2**63)), zlib.crc32(said), MARK)
    command = ["info", which, "--json", "out.json"]
    return Case(f"{which}: {said[:60]}", {**good, which: good[which] + said + tail}, command, None, outcome)


def named(rng, kind):
    """A result and outputs of odd names give what they give under plain ones, or are refused."""
    result, output = ("./" + "".join(chosen(rng, *SIGNS) for _ in range(rng.integers(1, 4))) for _ in range(2))
    good = files()
    command = chosen(
        rng, ["info", f"{result}.h5", "--json", f"{output}.json"],
        ["export", f"{result}.h5", "--format", "npz", "-o", f"{output}.npz"],
        ["export", f"{result}.h5", "--format", "sid", "-o", f"{output}.SID_FEM"],
        ["evaluate", f"{result}.h5", "--frequencies", "10,20", "-o", f"{output}.csv"],
        ["report", f"{result}.h5", "result.h5", "-o", f"{output}.html", "--csv", output],
        ["recover", f"{result}.h5", "motion.h5", "-o", f"{output}.pvd"],
    )  # fmt: skip
    return Case(str(command), {**good, f"{result}.h5": good["result.h5"]}, command, {}, lambda folder: {})


def in_the_way(rng, kind):
    """Files of the user with the names of locks, outputs and folders of hpcred are refused, and stay."""
    command, places = chosen(rng, *(
        (["export", "result.h5", "--format", "npz", "-o", "a.npz"], [".a.npz.lock", "a.npz"]),
        (["evaluate", "result.h5", "--frequencies", "10", "-o", "a.csv"], [".a.csv.lock", "a.csv"]),
        (["recover", "result.h5", "motion.h5", "-o", "a.pvd"],
         [".a.pvd.lock", "a.pvd", ".a_vtu.lock", "a_vtu", "a_vtu/b.txt", "a_vtu/a_vtu_0.vtu", "a_vtu/deep/q"]),
        (["simulate", "motion.toml", "--set", "paraview=true"],
         [".simulation.h5.lock", "simulation_vtu/q", "simulation.csv", "simulation.pvd", ".simulation.csv.lock"]),
    ))  # fmt: skip
    place, laid = chosen(rng, *places), chosen(rng, *LAID)
    return Case(f"{command}: {place}", {**files(), place: laid.encode()}, command, None, lambda folder: {})


KINDS = {"seal": sealed, "odd names": named, "in the way": in_the_way}
