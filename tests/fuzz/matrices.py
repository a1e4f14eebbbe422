"""Models of a chain of nodes in every text format that hpcred reads, most of them damaged: cases of convert leave."""

import re
from pathlib import Path
from urllib.parse import unquote

import h5py
import numpy as np

from . import readings
from .judge import Case
from .mutations import damaged_text

NODES = 3
HEADING = re.compile(rb"(?m)^[ \t]*(?:LIST ALL SELECTED NODES|NODE[ \t]+X[ \t]+Y[ \t]+Z\b)")
MAPPING = [b"Matrix", b"Eqn", b"Node", b"DOF"]
CREATED, CREATOR = "% Creator: ANSYS Inc", b"% Creator: ANSYS"
# a line of NWRITE: a node, and numbers of 13 digits
WRITTEN = re.compile(rb" *\d+(?:(?: +-?|-)(?=\d+\.)[\d.]{14,15}(?:[ED][+-]\d{2,3})?(?=[ \-\r]|$)){0,6} *\r?")
SIZE = 3 * NODES


def model_numbers(folder: Path) -> dict[str, np.ndarray]:
    """Matrices, inputs and labels of m.h5, by its description alone."""
    found = {}
    with h5py.File(folder / "m.h5") as file:
        indptr, indices = (file[f"matrices/{key}"][...] for key in ("indptr", "indices"))
        row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        for key in ("K", "M", "D"):
            if key in file["matrices"]:
                found[key] = np.zeros((len(indptr) - 1,) * 2)
                found[key][row, indices] = file[f"matrices/{key}"][...]
        if "inputs" in file:
            found["B"] = file["inputs/B"][...]
        for key in ("node", "direction", "position"):
            if "dofs" in file:
                found[key] = file[f"dofs/{key}"][...]
        found |= {f"set {unquote(name)}": part[...] for name, part in file.get("sets", {}).items()}
        found["named"] = np.array("dofs" in file)
    return found


def matrix(rng, symmetric=True):
    """A matrix with a few zeros and numbers of many sizes; a symmetric one is diagonally dominant."""
    root = rng.standard_normal((SIZE, SIZE)) * (rng.random((SIZE, SIZE)) < 0.4)
    root *= 10.0 ** rng.integers(-3, 4)
    if symmetric:
        root = np.tril(root, -1) + np.tril(root, -1).T
        root += np.diag(np.abs(root).sum(axis=0) + 10.0 ** rng.integers(-2, 3))
    return root


def chosen(rng, *options):
    return options[int(rng.integers(len(options)))]


def number(value, rng=None, form=None):
    """A number in one of the forms that programs write; `form`: of all of them in a file."""
    form = form or chosen(rng, "%.17g", "%.16e", "%.9E", "%.15D", "%+.6e")
    return ((form[:-1] + "E") % value).replace("E", "D") if form.endswith("D") else form % value


def entries(matrix, part="all"):
    """Row, column (from 1) and value of what is not zero; part: all, lower or upper triangle with its diagonal."""
    take = {"all": lambda i, j: True, "lower": lambda i, j: i >= j, "upper": lambda i, j: i <= j}[part]
    return [(i + 1, j + 1, matrix[i, j]) for j in range(matrix.shape[1]) for i in range(matrix.shape[0])
            if take(i, j) and (matrix[i, j] or (i == j and part != "all"))]  # fmt: skip


def text(lines, rng=None):
    end = "\n" if rng is None else chosen(rng, "\n", "\n", "\r\n")
    return (end.join(lines) + end).encode()


def remarked(lines, rng, remark="** NODES: a,, b"):
    """The lines, in some cases with remarks behind any of them."""
    share = chosen(rng, 0.0, 0.0, 0.3)
    return [item for line in lines for item in [line, *[remark] * (rng.random() < share)]]


def matrix_market(matrix, rng):
    symmetric = matrix.shape[0] == matrix.shape[1] and (matrix == matrix.T).all()
    form = chosen(rng, "%.17g", "%.16e", "%.9E", "%.15D", "%+.6e")
    remarks = ["% a remark"] * int(rng.integers(3))
    if rng.random() < 0.2:
        return text(["%%MatrixMarket matrix array real general", *remarks, f"{matrix.shape[0]} {matrix.shape[1]}",
                     *(number(value, form=form) for value in matrix.T.ravel())], rng)  # fmt: skip
    part = chosen(rng, "lower", "upper", "all") if symmetric else "all"
    kind = "general" if part == "all" else "symmetric"
    found = entries(matrix, part)
    rng.shuffle(found)
    blank = chosen(rng, " ", "  ", "\t")
    lines = [blank.join((f"{int(i)}", f"{int(j)}", number(value, form=form))) for i, j, value in found]
    return text([f"%%MatrixMarket matrix coordinate real {kind}", *remarks,
                 f"{matrix.shape[0]} {matrix.shape[1]} {len(lines)}", *lines], rng)  # fmt: skip


def coordinates(matrix, rng):
    comma, form = chosen(rng, " ", ", ", ","), chosen(rng, "%.16e", "%.15D", "%.17g")
    return text([comma.join((str(i), str(j), number(value, form=form))) for i, j, value in entries(matrix)], rng)


def labelled(matrix, labels, rng):
    part, comma = chosen(rng, "lower", "upper", "all"), chosen(rng, ", ", ",", " ")
    return text([comma.join(f"{item}" for item in (*labels[i - 1], *labels[j - 1], number(value, form="%.15e")))
                 for i, j, value in entries(matrix, part)], rng)  # fmt: skip


def triangle(matrix, rng=None):
    return text([f"{i} {j} {value:20.13e}" for i, j, value in entries(matrix, "upper")])


def dmig(name, matrix, labels, rng):
    """Small, large or free fields; square, or the upper or lower half."""
    part = chosen(rng, "lower", "upper", "all")
    form = chosen(rng, "large", "large", "small", "free")
    head = ("DMIG", name, "0", "1" if part == "all" else "6", "2", "0", "", "", str(len(matrix)))
    lines = ["".join(f"{item:<8}" for item in head) if form != "free" else ",".join(head)]
    for k in range(len(matrix)):
        found = [(labels[i - 1], value) for i, j, value in entries(matrix, part) if j == k + 1]
        node, direction = labels[k]
        if form == "large":
            lines.append(f"{'DMIG*':<8}{name:<16}{node:>16}{direction:>16}")
            lines += [f"{'*':<8}{i:>16}{d:>16}{number(value, form='%16.8D' if value > 0 else '%16.8E'):>16}"
                      for (i, d), value in found]  # fmt: skip
        elif form == "small":
            fields = [item for (i, d), value in found for item in (str(i), str(d), short(value), "")]
            lines.append("".join(f"{item:<8}" for item in ("DMIG", name, node, direction, "", *fields[:4])))
            lines += ["".join(f"{item:<8}" for item in ("", *fields[at : at + 8])) for at in range(4, len(fields), 8)]
        else:
            fields = [item for (i, d), value in found for item in (str(i), str(d), f"{value:.10E}", "")]
            lines.append(",".join(("DMIG", name, str(node), str(direction), "", *fields[:4])))
            lines += [",".join(("", *fields[at : at + 8])) for at in range(4, len(fields), 8)]
    return text([*lines, *["ENDDATA"] * int(rng.integers(2))], rng)


def short(value):
    """A number in eight characters, its exponent without letter."""
    mantissa, exponent = f"{value:.2E}".split("E")
    return f"{mantissa}{int(exponent):+d}"


def op4(name, matrix, rng):
    """Dense columns, or strings with headers of one word or of two; single or double precision."""
    style, double = chosen(rng, "dense", "bigmat", "nonbigmat"), rng.random() < 0.6
    per, wide, form = (3, 24, "%24.16E") if double else (5, 16, "%16.9E")
    sign, words = -1 if style == "bigmat" else 1, 2 if double else 1
    lines = [f"{len(matrix):8d}{sign * len(matrix):8d}{chosen(rng, 1, 6):8d}{words:8d}{name:<8}1P,{per}E{wide}"
             f".{16 if double else 9}"]  # fmt: skip

    def numbers(values):
        return ["".join(form % value for value in values[at : at + per]) for at in range(0, len(values), per)]

    for j, column in enumerate(matrix.T, 1):
        used = np.flatnonzero(column)
        if not used.size:
            continue
        if style == "dense":
            part = column[used[0] : used[-1] + 1]
            lines += [f"{j:8d}{used[0] + 1:8d}{len(part):8d}", *numbers(part)]
            continue
        strings = np.split(used, np.flatnonzero(np.diff(used) > 1) + 1)
        lengths = [words * len(item) + 1 for item in strings]
        lines.append(f"{j:8d}{0:8d}{sum(lengths) + (len(lengths) if style == 'bigmat' else 0):8d}")
        for item, length in zip(strings, lengths, strict=True):
            row = item[0] + 1
            lines.append(f"{length:8d}{row:8d}" if style == "bigmat" else f"{65536 * length + row:8d}")
            lines += numbers(column[item])
    return text([*lines, f"{len(matrix) + 1:8d}{1:8d}{1:8d}", form % 1.4142135], rng)


def harwell_boeing(matrix, rng, title="A matrix"):
    symmetric = (matrix == matrix.T).all() and rng.random() < 0.7
    found = entries(matrix, "lower" if symmetric else "all")
    starts = np.cumsum([1] + [sum(j == k + 1 for _, j, _ in found) for k in range(len(matrix))])
    per, wide = chosen(rng, (10, 8), (1, 14), (16, 5))
    real_format, *layout = chosen(rng, ("5E16.8", 5, "%16.8E"), ("D25.15", 1, "%25.15D"),
                                  ("1P,3E24.16", 3, "%24.16E"), ("4D20.12", 4, "%20.12D"))  # fmt: skip

    def numbers(values, count, form):
        return ["".join(number(value, form=form) for value in values[at : at + count])
                for at in range(0, len(values), count)]  # fmt: skip

    sections = [numbers(starts, per, f"%{wide}d"), numbers([i for i, _, _ in found], per, f"%{wide}d"),
                numbers([value for _, _, value in found], *layout)]  # fmt: skip
    cards = [len(section) for section in sections]
    pointer = f"({per}I{wide})"
    old = rng.random() < 0.5
    lines = [
        f"{title:<72}{'KEY':<8}", "".join(f"{item:14d}" for item in (sum(cards), *cards, *[0] * old)),
        f"{'RSA' if symmetric else 'RUA':<14}" + "".join(f"{item:14d}" for item in (*matrix.shape, len(found), 0)),
        f"{pointer:<16}{pointer:<16}{'(' + real_format + ')':<20}{'':<20}",
    ]  # fmt: skip
    return text([*lines, *(line for section in sections for line in section)], rng)


def node_table(places, rng):
    comma = chosen(rng, " ", ", ", "\t", ",")
    return text([comma.join((str(node), *(number(x, form=chosen(rng, "%.17g", "%.6f")) for x in place)))
                 for node, place in places.items()], rng)  # fmt: skip


def row_table(labels, rng):
    comma = chosen(rng, " ", ", ", "\t")
    return text([f"{node}{comma}{direction}" for node, direction in labels], rng)


def input_file(places, rng, step=False):
    """A tetrahedron, or bars, between the nodes; with a step of CalculiX."""
    labels = list(places)
    return text(remarked([
        "*HEADING", "a chain, 1 2 3", "** a remark", chosen(rng, "*NODE, NSET=ALL", "*Node", "*node,nset=Nall"),
        *(", ".join((str(node), *(number(x, form=chosen(rng, "%.17g", "%.6f")) for x in place)))
          for node, place in places.items()),
        "*ELEMENT, TYPE=T3D2, ELSET=E", *(f"{k + 1}, {labels[k]}, {labels[k + 1]}" for k in range(len(labels) - 1)),
        "*NSET, NSET=END", str(labels[-1]), *(["*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "2", "*END STEP"] * step),
    ], rng))  # fmt: skip


def mapping(labels, rng):
    lines = [f"{k:14d}{node:14d}    {readings.DOFS[direction - 1].decode():<4}"
             for k, (node, direction) in enumerate(labels, 1)]  # fmt: skip
    return text(["    Matrix Eqn          Node    DOF     ", *lines])


def places(rng, count=NODES):
    labels = chosen(rng, [1, 2, 3, 4], [10, 7, 25, 3], [101, 102, 205, 4000])[:count]
    return {label: tuple(np.round(rng.standard_normal(3), 4)) for label in labels}


def labels_of(places, rng=None):
    labels = [(node, direction) for node in places for direction in (1, 2, 3)]
    if rng is not None and rng.random() < 0.3:
        rng.shuffle(labels)
        labels = [(int(node), int(direction)) for node, direction in labels]
    return labels


def case(rng, kind, files, which, command, second) -> Case:
    """A case of convert: one of the files, `which`, is damaged, in one of eight cases none.

    `second(files)` gives what the model of the files has, or raises Nonsense.
    """
    note, good = "good", rng.random() < 0.125
    if not good:
        note, changed = damaged_text(files[which], rng)
        good = changed == files[which]
        files = {**files, which: changed}
    try:
        with np.errstate(all="ignore"):
            expected = second(files)
    except readings.Nonsense:
        expected = None
    except (ValueError, IndexError, KeyError, OverflowError, TypeError) as error:
        raise AssertionError(f"the second reading of {kind} failed") from error
    assert expected is not None or not good, f"the second reading of {kind} does not read a good file"
    return Case(f"{which}: {note}", files, command, expected, model_numbers, good)


def numbered(rng, kind, write, read):
    """A matrix with numbered rows as K, M, D or, of Matrix Market, B, beside good ones of Matrix Market."""
    role = chosen(rng, *("KMDD" if kind != "Matrix Market" else "KMDDB"))
    mats = {key: matrix(rng) for key in "KM"}
    if role == "D":
        mats["D"] = matrix(rng, symmetric=rng.random() < 0.5)
        mats["D"][-1, -1] = 1e-3  # files without a header have as many rows as they have entries in
    if role == "B":
        mats["B"] = rng.standard_normal((SIZE, 2)) * (rng.random((SIZE, 2)) < 0.7)
    files = {f"{key}.mtx": matrix_market(item, rng) for key, item in mats.items()}
    files[f"{role}.mtx"] = write(mats[role], rng)
    command = ["convert", *(word for key in mats for word in (f"-{key}", f"{key}.mtx")), "-o", "m.h5"]

    def second(files):
        read_of = {key: read if key == role else readings.matrix_market for key in mats}
        return readings.model({key: read_of[key](files[f"{key}.mtx"]) for key in mats})

    return case(rng, kind, files, f"{role}.mtx", command, second)


def with_nodes(rng, kind):
    """Matrices with a table of nodes or an input file, perhaps with one of the rows."""
    where = places(rng)
    mats = {key: matrix(rng) for key in "KM"}
    files = {f"{key}.mtx": matrix_market(item, rng) for key, item in mats.items()}
    files["nodes"] = (input_file if kind == "Abaqus .inp" else node_table)(where, rng)
    command = ["convert", "-K", "K.mtx", "-M", "M.mtx", "--nodes", "nodes", "-o", "m.h5"]
    if kind == "rows" or rng.random() < 0.3:
        files["dofs"] = row_table(labels_of(where, rng), rng)
        command += ["--dofs", "dofs"]

    def second(files):
        found = (readings.input_file if kind == "Abaqus .inp" else readings.nodes)(files["nodes"])
        labels = readings.row_labels(files["dofs"]) if "dofs" in files else None
        require_places(found)
        return readings.model({key: readings.matrix_market(files[f"{key}.mtx"]) for key in mats}, labels, found)

    return case(rng, kind, files, "dofs" if kind == "rows" else "nodes", command, second)


def require_places(found):
    readings.require(all(abs(x) <= 1e15 for place in found.values() for x in place), "a place beyond all units")


def named_rows(rng, kind):
    """K and M whose rows have names: Abaqus' MATRIX INPUT, or DMIG."""
    labels = labels_of(places(rng))
    mats = {key: matrix(rng) for key in "KM"}
    command = ["convert", "-K", "K.txt", "-M", "M.txt", "-o", "m.h5"]
    if kind == "Abaqus .mtx":
        files = {f"{key}.txt": labelled(item, labels, rng) for key, item in mats.items()}
    else:
        files = {f"{key}.txt": dmig(f"{key}AAX", item, labels, rng) for key, item in mats.items()}
        command += ["--variables", "K=KAAX,M=MAAX"]

    def second(files):
        if kind == "Abaqus .mtx":
            return readings.model({key: readings.matrix_input(files[f"{key}.txt"]) for key in mats})
        return readings.model({key: readings.dmig(files[f"{key}.txt"], b"%sAAX" % key.encode()) for key in mats})

    return case(rng, kind, files, f"{chosen(rng, 'K', 'M')}.txt", command, second)


def calculix(rng, kind):
    """The four files of a set."""
    where = dict(sorted(places(rng).items()))
    mask = np.ones((SIZE, SIZE))
    files = {"a.sti": triangle(matrix(rng) + mask), "a.mas": triangle(matrix(rng) + mask)}
    files["a.dof"] = text([f"{node}.{direction}" for node, direction in labels_of(where)])
    files["a.inp"] = input_file(where, rng, step=True)

    def second(files):
        mats = {key: readings.triangle(files[f"a.{suffix}"]) for key, suffix in (("K", "sti"), ("M", "mas"))}
        found, labels = readings.input_file(files["a.inp"], True), readings.calculix_dofs(files["a.dof"])
        require_places(found)
        # nodes that CalculiX made, or several rows of one name: the rows have no names, which is said
        if {node for node, _ in labels} - found.keys() or len(set(labels)) < len(labels):
            return readings.model(mats, labels, held=np.inf) | {"named": np.array(False)}
        return readings.model(mats, labels, found, np.inf)

    return case(rng, kind, files, f"a.{chosen(rng, 'sti', 'mas', 'dof', 'inp')}", ["convert", "a.sti", "m.h5"], second)


def ansys(rng, kind):
    """HBMAT or MMF with a mapping or a vector of nodes, and a list of nodes beside it."""
    where = places(rng)
    labels = labels_of(where, rng)
    hbmat = rng.random() < 0.6
    titles = {"K": "Stiffness", "M": "Mass"}
    rows = chosen(rng, "rows.mapping", "nodes.mmf")
    files = {"nodes.lis": chosen(rng, nlist, nwrite)(where)}
    files[rows] = mapping(labels, rng) if rows == "rows.mapping" else vector(where)
    for title in titles.values():
        if hbmat:
            about = f"{title} matrix from ANSYS FULL file dumped into Harwell-Boeing format"
            files[f"{title}.txt"] = harwell_boeing(matrix(rng), rng, about)
        else:
            lines = text(["%%MatrixMarket matrix coordinate real symmetric", CREATED])
            found = entries(matrix(rng), "lower")
            listed = [f"{i} {j} {value:.14e}" for i, j, value in found]
            files[f"{title}.txt"] = lines + text([f"{SIZE} {SIZE} {len(found)}", *listed])
    read = readings.harwell_boeing if hbmat else readings.matrix_market

    def second(files):
        mats = {key: read(files[f"{title}.txt"]) for key, title in titles.items()}
        if not hbmat:
            readings.require(CREATOR in files["Stiffness.txt"], "not of ANSYS")
        unnamed = readings.model(mats, held=np.inf) | {"named": np.array(False)}
        head = files[rows].removeprefix(b"\xef\xbb\xbf").split(b"\n")[0]
        if rows == "nodes.mmf":
            words = [word for word in head.lower().rstrip(b"\r\t ").split(b" ") if word]
            known = words == VECTOR.lower().encode().split() and CREATOR in files[rows]
        else:
            known = head.split() == MAPPING
        if not known or not begins_list(files["nodes.lis"]):
            return unnamed  # what hpcred does not know it leaves alone, and says so
        labels = (readings.mapping if rows == "rows.mapping" else read_vector)(files[rows])
        try:
            found, turned = list_of_nodes(files["nodes.lis"])
            require_places(found)
        except readings.Nonsense:
            return unnamed
        if turned & {node for node, _ in labels}:
            return {"named": np.array(True)}  # damage gave a node axes of its own; the rest is another test's
        return readings.model(mats, labels, found, np.inf)

    which = chosen(rng, rows, "nodes.lis", "Stiffness.txt", "Mass.txt")
    return case(rng, kind, files, which, ["convert", "Stiffness.txt", "m.h5"], second)


VECTOR = "%%MatrixMarket matrix array integer general"


def vector(places):
    """The numbers of nodes in the order of the rows."""
    return text([VECTOR, CREATED, f"{len(places)} 1", *map(str, places)])


def read_vector(content):
    lines = readings.lines_of(content)
    size = lines[0].split() if lines else []
    readings.require(size == [b"%d" % NODES, b"1"] and len(lines) == NODES + 1, "another number of nodes")
    found = [readings.whole(line.strip(), 1, readings.LARGEST_LABEL) for line in lines[1:]]
    readings.require(len(set(found)) == len(found), "a node twice")
    return [(node, direction) for node in found for direction in (1, 2, 3)]


def nwrite(places):
    """Node and coordinates, without the zeros at the end of a line."""
    lines = []
    for node, place in places.items():
        kept = np.trim_zeros(place, "b")
        lines.append(f"{node:8d}" + "".join(f"{x:16.12f}    " for x in kept))
    return text(lines)


def begins_list(content):
    content = content.removeprefix(b"\xef\xbb\xbf")
    lines = content.split(b"\n")
    known = len(lines) > 2 and all(WRITTEN.fullmatch(line) for line in lines[:2])
    return known or bool(HEADING.search(content[:2000]))


def nlist(places):
    lines = [f"{node:9d} {x:17.10g} {y:17.10g} {z:17.10g}" for node, (x, y, z) in places.items()]
    head = ["", " LIST ALL SELECTED NODES.   DSYS=      0", "", "    NODE        X             Y             Z"]
    return text([*head, *lines])


def list_of_nodes(content):
    """Places by node number, and the nodes with angles."""
    headed, found, turned = HEADING.search(content), {}, set()
    lines = [line for line in content.split(b"\n") if b"LIST ALL" not in line and b" X " not in line]
    for line in readings.lines_of(b"\n".join(lines)):
        if headed and line.strip(b" \t") == b"1":  # a new page
            continue
        words = (line if headed else re.sub(rb"(?<=[0-9])-", b" -", line)).split()
        readings.require(len(words) in (4, 7) if headed else 1 <= len(words) <= 7, "no node")
        node, values = readings.whole(words[0], 1, readings.LARGEST_LABEL), [readings.real(word) for word in words[1:]]
        readings.require(node not in found, "a node twice")
        found[node] = tuple([*values[:3], 0.0, 0.0, 0.0][:3])
        turned |= {node} if any(values[3:]) else set()
    readings.require(found, "no nodes")
    return found, turned


KINDS = {
    "Matrix Market": lambda rng, kind: numbered(rng, kind, matrix_market, readings.matrix_market),
    "Harwell-Boeing": lambda rng, kind: numbered(rng, kind, harwell_boeing, readings.harwell_boeing),
    "OP4 text": lambda rng, kind: numbered(rng, kind, lambda item, rng: op4("A", item, rng), readings.op4),
    "Abaqus coordinates": lambda rng, kind: numbered(rng, kind, coordinates, readings.coordinates),
    "Abaqus .mtx": named_rows, "DMIG": named_rows, "node table": with_nodes, "rows": with_nodes,
    "Abaqus .inp": with_nodes, "CalculiX": calculix, "ANSYS text": ansys,
}  # fmt: skip
