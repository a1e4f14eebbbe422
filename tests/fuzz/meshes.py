"""Nodes in universal files, archives of ANSYS, bulk data of Nastran and assemblies of Abaqus, most of them damaged.

Made by grammar or real ones, beside matrices of their size: cases of convert leave.
"""

import gzip

import numpy as np
from conftest import DATA

from . import node_readings, readings
from .matrices import case, chosen, matrix_market, number, places, remarked, text

REAL = {
    "UFF": ["uff/heat_engine_housing.uff"], "ANSYS .cdb": ["ansys/HexBeam.cdb.gz"],
    "ANSYS list": ["ansys/rotorAnsysNodalCoordinates.txt.gz"],
    "Nastran bulk": ["nastran/test_1/test_case.bdf"], "Abaqus assembly": ["blockC3D8.inp", "blockC3D10.inp"],
}  # fmt: skip


def universal(where, rng):
    """Nodes as dataset 15, 781 or 2411, perhaps elements, and datasets that are not read."""
    kind, form = chosen(rng, 15, 781, 2411, 2411), chosen(rng, "%.16E", "%.5E", "%.16D")
    nodes = []
    for label, place in where.items():
        point = "".join(f"{number(x, form=form):>{25 if kind != 15 else 13}}" for x in np.round(place, 4))
        if kind == 15:
            nodes.append(f"{label:10d}{0:10d}{0:10d}{8:10d} " + " ".join(number(x, form="%.5E") for x in place))
        else:
            nodes += [f"{label:10d}{1:10d}{1:10d}{11:10d}", point]
    sets = [(kind, nodes)]
    labels = list(where)
    if rng.random() < 0.6:
        sets.append((2412, [f"{1:10d}{41:10d}{1:10d}{1:10d}{7:10d}{3:10d}", "".join(f"{k:10d}" for k in labels[:3]),
                            f"{2:10d}{21:10d}{1:10d}{1:10d}{7:10d}{2:10d}", f"{0:10d}{1:10d}{1:10d}",
                            "".join(f"{k:10d}" for k in labels[1:3])]))  # fmt: skip
    if rng.random() < 0.5:
        sets.insert(int(rng.integers(2)), (164, [f"{1:10d}SI units", "  1.0D+00  1.0D+00  1.0D+00", "  2.7315D+02"]))
    if rng.random() < 0.6:
        members = [f"{item:10d}" for k in labels[1:] for item in (7, k, 0, 0)]
        rows = ["".join(members[k : k + 8]) for k in range(0, len(members), 8)]
        group = [f"{1:10d}" + 6 * f"{0:10d}" + f"{len(labels) - 1:10d}", "SOME", *rows]
        sets.append((chosen(rng, 2452, 2467, 2477), group))
    return text([line for kind, lines in sets for line in ("    -1", f"{kind:6d}", *lines, "    -1")], rng)


def archive(where, rng):
    """NBLOCK of nine or of four fields, EBLOCK of SOLID185, and commands around them."""
    short, exponent = rng.random() < 0.3, chosen(rng, "", "e3")
    width, wide, form = chosen(rng, (8, 16, "%16.9E"), (9, 21, "%21.13E"), (10, 25, "%25.17E"))
    count, largest = len(where), max(where)
    lines = ["/PREP7", "/TITLE, a chain", "ET,        1,185", "DOF,DELETE"]
    counts = (f",,{count}", f",,{largest}", "") if short else (f",{largest:10d},{count:10d}", "")
    counts = chosen(rng, *counts)
    lines.append(f"NBLOCK,{3 if short else 6},SOLID" + (counts if not short else counts[1:] and counts))
    lines.append(f"({1 if short else 3}i{width},{3 if short else 6}e{wide}.{form.split('.')[1][:-1]}{exponent})")
    for label, place in where.items():
        reals = list(place)
        while reals and not short and not reals[-1]:
            reals.pop()
        lines.append("".join(f"{item:{width}d}" for item in ((label,) if short else (label, 0, 0)))
                     + "".join(form % x for x in reals))  # fmt: skip
    lines.append("N,R5.3,LOC,       -1,")
    labels = list(where)
    if rng.random() < 0.6:
        lines += [f"EBLOCK,19,SOLID,{1:8d},{1:8d}", f"(19i{width})"]
        item = (1, 1, 1, 1, 0, 0, 0, 0, 8, 0, 1, *(labels * 8)[:8])
        lines += ["".join(f"{k:{width}d}" for k in item), f"{-1:{width}d}"]
    if rng.random() < 0.6:
        lines += [f"CMBLOCK,SOME    ,NODE,{2:8d}  ! a component", "(8i10)", f"{labels[0]:10d}{labels[-1]:10d}",
                  f"CMBLOCK,RANGE,NODE,{2:8d}", "(8i10)", f"{min(labels):10d}{-max(labels):10d}"]  # fmt: skip
    lines.append("MPDATA,R5.0, 1,EX  ,       1, 1,  2.1E+11")
    lines += chosen(rng, [], ["MPDATA,R5.0, 2,NUXY,       1, 1, 0.3, 0.31"], ["MP,PRXY,1,0.3", "TB,BISO,1,1,2,"])
    return text([*lines, *chosen(rng, [], ["KEYOPT,1,2,1"]), "/GO", "FINISH"], rng)


def bulk(where, rng):
    """GRID cards in small, large or free fields, some in a system of their own."""
    low, *_, high = sorted(where)
    sets = [f"SET 5 = {low} THRU {high} EXCEPT {high}", f"SET 6 = {high},", f"  {low}"] * (rng.random() < 0.6)
    lines = chosen(rng, [], ["SOL 103", "CEND", *sets, "SPC = 1", "BEGIN BULK"], ["$ a remark", "BEGIN BULK"])
    lines, ended = list(lines), bool(lines) or rng.random() < 0.5
    system = chosen(rng, 0, 0, 5)
    if system:
        kind = chosen(rng, "R", "C", "S")
        lines += [f"CORD2{kind},5,0,0.5,0.,0.,0.5,0.,1.,+A", "+A,1.5,1.,0."]
    for label, place in where.items():
        form, held = chosen(rng, "small", "large", "free"), chosen(rng, "", "", "456")
        if form == "small":
            fields = ("GRID", label, chosen(rng, "", "0", system), *(f"{x:.4f}" for x in place), "", held)
            lines.append("".join(f"{item:<8}" for item in fields).rstrip())
        elif form == "large":
            x, y, z = (number(item, form="%.9E") for item in place)
            lines.append(f"{'GRID*':<8}{label:>16}{system:>16}{x:>16}{y:>16}")
            lines.append(f"{'*':<8}{z:>16}{'':>16}{held:>16}".rstrip())
        else:
            fields = ("GRID", label, system, *(number(x, form="%.10E") for x in place), "", held)
            lines.append(",".join(map(str, fields)))
    lines += chosen(rng, [], [f"SET1,4,{low},{high}"], [f"{'SET1':<8}{4:<8}{low:<8}{'THRU':<8}{high:<8}"])
    lines += ["CTRIA3,1,1," + ",".join(map(str, list(where)[:3])), "PARAM,POST,-1"]
    lines += chosen(rng, [], ["SPOINT,7001"], ["PSOLID,1,2", "MAT1,2,2.1+11,,0.3,7850.", "MATS1,2,,PLASTIC"])
    return text([*remarked(lines, rng, "$ a remark, 1"), *["ENDDATA"] * ended], rng)


def listed(where, rng):
    """What Workbench exports, perhaps with decimal commas."""
    comma = chosen(rng, ".", ",")
    lines = [f"{label}\t" + "\t".join(f"{x:.6f}".replace(".", comma) for x in place) for label, place in where.items()]
    return text(["Node Number\tX Location (m)\tY Location (m)\tZ Location (m)", *lines], rng)


def assembly(where, rng):
    """Nodes in a part or in its instance, perhaps moved, with sets of both."""
    labels = list(where)
    nodes = ["*Node", *(", ".join((str(label), *(f"{x:.6g}" for x in place))) for label, place in where.items()),
             "*Element, type=T3D2", *(f"{k + 1}, {labels[k]}, {labels[k + 1]}" for k in range(len(labels) - 1)),
             "*Nset, nset=END", f" {labels[0]}, {labels[-1]}", "*Elset, elset=ALL, generate",
             f" 1, {len(labels) - 1}, 1", *chosen(rng, [], ["*Solid Section, elset=ALL, material=Steel", "0.01"])]
    nodes[:0] = chosen(rng, [], [], ["*System"], ["*System", "1., 2., 3."], ["*System", "0., 1., 0., 3., 4., 9."],
                       ["*System", "1., 0., 2., 1., 0., 5.", "1., 2., 7."])  # fmt: skip
    move = chosen(rng, [], ["1., 2., -0.5"], ["0.5, 0., 0.", "0., 0., 0., 0., 0., 1., 90."])
    inside = rng.random() < 0.5
    sets = ["*Nset, nset=Some, instance=bar-1", f" {labels[1]},", "*Nset, nset=Both", " Some, bar-1.END"]
    lines = ["*Heading", "** a remark", "*Part, name=bar", *nodes * (not inside), "*End Part", "*Assembly, name=A",
             "*Instance, name=bar-1, part=bar", *move, *nodes * inside, "*End Instance", *sets, "*End Assembly",
             "*Material, name=steel", "*Elastic", "2.1e11, 0.3", *chosen(rng, [], ["1e11, 0.3, 500."]),
             *chosen(rng, [], ["*Density", "7850.,"], ["*Plastic", "2e8, 0."])]  # fmt: skip
    return text(remarked(lines, rng), rng)


def grounded(size):
    """A diagonal matrix as Matrix Market."""
    return matrix_market(np.diag(1.0 + np.arange(size)), np.random.default_rng(1))


def meshed(rng, kind):
    write, read = GRAMMAR[kind]
    if rng.random() < 0.3:
        path = DATA / chosen(rng, *REAL[kind])
        content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        count = len(set(read(content)) - {"sets"})
    else:
        where = places(rng)
        content, count = write(where, rng), len(where)
    if kind in REMARKS and rng.random() < 0.1:  # a head that is longer than what formats are told by
        content = REMARKS[kind] + content
    matrix = grounded(3 * count)
    files = {"K.mtx": matrix, "M.mtx": matrix, "nodes": content}
    command = ["convert", "-K", "K.mtx", "-M", "M.mtx", "--nodes", "nodes", "-o", "m.h5"]

    def second(files):
        found = read(files["nodes"])
        sets = found.pop("sets", {})
        return readings.model({key: np.diag(1.0 + np.arange(3 * count)) for key in "KM"}, None, found) | sets

    return case(rng, kind, files, "nodes", command, second)


REMARKS = {kind: (mark + 70 * b"x" + b"\n") * 99
           for kind, mark in (("ANSYS .cdb", b"! "), ("Nastran bulk", b"$ "), ("Abaqus assembly", b"** "))}  # fmt: skip
GRAMMAR = {
    "UFF": (universal, node_readings.uff), "ANSYS .cdb": (archive, node_readings.cdb),
    "ANSYS list": (listed, node_readings.listed), "Nastran bulk": (bulk, node_readings.bulk),
    "Abaqus assembly": (assembly, node_readings.assembly),
}  # fmt: skip
KINDS = dict.fromkeys(GRAMMAR, meshed)
