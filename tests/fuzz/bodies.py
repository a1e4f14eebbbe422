"""SID files by grammar and real ones, most of them damaged: cases of info leave, judged by a second reading."""

import json
import re
from pathlib import Path

import numpy as np
from conftest import DATA

from .judge import Case
from .matrices import chosen, text
from .mutations import damaged_text
from .readings import Nonsense, digits, plain, real, require

OF_NODE = {"origin": "3 1", "phi": "3 n", "psi": "3 n", "AP": "3 3"}
OF_BODY = {"mdCM": "3 1", "J": "6 1", "Ct": "n 3", "Cr": "n 3", "Me": "n n", "Gr": "3 3n", "Ge": "n 3n", "Oe": "n 6",
           "ksigma": "n 1", "Ke": "n n", "De": "n n"}  # fmt: skip
FIELDS = ("order", "nrow", "ncol", "nq", "nqn", "structure")


def shape_of(words, n):
    return [int(word.rstrip("n") or 1) * (n if "n" in word else 1) for word in words.split()]


def write_object(name, words, n, rng):
    """The lines of an object with numbers of all sizes."""
    rows, columns = shape_of(words, n)
    order, structure = int(rng.integers(2)), chosen(rng, 0, 3, 3, 3, 4 if rows == columns else 3)
    lines = [name, *(f"{key:<10} = {value:4d}" for key, value in zip(
        FIELDS, (order, rows, columns, n, 0, structure), strict=True))]  # fmt: skip
    if structure == 3:
        lines += [f"m0( {i}, {j})  ={value: .11E}".replace("E", "D") for (i, j), value in items(rng, rows, columns)]
    if order:
        lines += [f"m1( {i}, {k}, {j})  ={value: .11E}".replace("E", "D")
                  for (i, k, j), value in items(rng, rows, n, columns)]  # fmt: skip
    return [*lines, f"end {name}"]


def items(rng, *shape):
    """Some places, from 1, with a number each."""
    return [(tuple(int(k) + 1 for k in place), rng.standard_normal() * 10.0 ** rng.integers(-4, 5))
            for place in np.argwhere(rng.random(shape) < 0.6)]  # fmt: skip


def written(rng):
    nodes, n = int(rng.integers(3)), int(rng.integers(1, 4))
    lines = [f"{nodes:5d}{n:4d}    :a comment", "part", "new modal =", "refmod", "mass    = 7.85D-01"]
    lines += [f"nelastq = {n:5d}", *(f"ielastq ({k:4d})    = mode {k}" for k in range(1, n + 1)), "end refmod", "frame"]
    for node in range(nodes):
        lines += [f"new node = {node + 7}", "rframe = body ref"]
        lines += [line for name, words in OF_NODE.items() for line in write_object(name, words, n, rng)] + ["end node"]
    lines += ["end frame", *(line for name, words in OF_BODY.items() for line in write_object(name, words, n, rng))]
    return text([*lines, "end modal", "end part"], rng)


def sid(content: bytes):
    """Mass, names of coordinates, nodes, inertia and damping of a SID file."""
    lines = [plain(line).strip() for line in content.split(b"\n")]
    lines = [line for line in lines if line]

    def marker(words):
        require(lines and lines.pop(0).rstrip(b"= ") == words.encode(), f"no {words}")

    def value(key):
        require(lines, "the end")
        head, equals, rest = lines.pop(0).partition(b"=")
        require(equals and re.sub(rb"\( *", b"(", head.strip()) == key.encode(), f"no {key}")
        return rest.strip()

    def read_object(name, words, n):
        marker(name)
        order, rows, columns, nq, _, structure = (digits(value(key), 0, 10**9 - 1) for key in FIELDS)
        require([rows, columns, nq] == [*shape_of(words, n), n] and order < 2 and structure < 5, "another object")
        found, sizes = {}, {b"m0": (rows, columns), b"m1": (rows, nq, columns)}
        while lines and not lines[0].startswith(b"end"):
            head, equals, rest = lines.pop(0).partition(b"=")
            match = re.fullmatch(rb"(m[01])\(([ \d,]+)\)", head.strip())
            require(match and equals, "no entry")
            require(structure not in (0, 4) if match[1] == b"m0" else order == 1, "an entry of what is not there")
            place = tuple(digits(word.strip(), 1) for word in match[2].split(b","))
            size = sizes[match[1]]
            require(len(place) == len(size) and all(k <= top for k, top in zip(place, size, strict=True)), "outside")
            require(place not in found and (structure != 2 or place[::-1] not in found), "an entry twice")
            found[place] = real(rest.strip())
        marker(f"end {name}")
        return structure, found

    require(lines, "nothing")
    head, colon, comment = lines.pop(0).partition(b":")
    counts = [digits(word, 0, 10**9 - 1) for word in head.split()]
    require(colon and len(counts) == 2, "no numbers of nodes and modes")
    marker("part"), marker("new modal"), marker("refmod")
    mass, n = real(value("mass")), digits(value("nelastq"))
    require(n == counts[1], "another number of modes")
    names = [value(f"ielastq ({k})").decode("latin-1") for k in range(1, n + 1)]
    marker("end refmod"), marker("frame")
    nodes = []
    while lines and lines[0].startswith(b"new node"):
        nodes.append(digits(value("new node")))
        value("rframe")
        for name, words in OF_NODE.items():
            read_object(name, words, n)
        marker("end node")
    require(len(nodes) == counts[0], "another number of nodes")
    marker("end frame")
    objects = {name: read_object(name, words, n) for name, words in OF_BODY.items()}
    marker("end modal"), marker("end part")
    require(not lines, "lines behind the end")
    require(objects["J"][0] != 2, "a column that is symmetric")
    J = [objects["J"][1].get((k, 1), 0.0) for k in range(1, 7)]
    found = {"mass": mass, "names": names, "nodes": nodes, "J": J, "damped": objects["De"][0] != 0,
             "comment": comment.decode("latin-1").strip()}  # fmt: skip
    return {key: np.array(value) for key, value in found.items()}


def told(folder: Path):
    """What info says."""
    found = json.loads((folder / "out.json").read_text())
    return {"mass": found["mass"], "names": found["coordinates"], "nodes": found["interface_nodes"],
            "J": np.array(found["inertia_xx_yy_zz_xy_xz_yz"]), "damped": found["damping"] == "given",
            "comment": found["comment"].strip()}  # fmt: skip


def case(rng, kind):
    real = DATA / "sid" / chosen(rng, "balken1m.SID_FEM", "beam.SID_FEM")
    good = real.read_bytes() if rng.random() < 0.4 else written(rng)
    note, content = ("good", good) if rng.random() < 0.125 else damaged_text(good, rng)
    try:
        expected = sid(content)
    except Nonsense:
        expected = None
    assert expected is not None or note != "good", good
    command = ["info", "a.SID_FEM", "--json", "out.json"]
    return Case(note, {"a.SID_FEM": content}, command, expected, told, note == "good")


KINDS = {"SID": case}
