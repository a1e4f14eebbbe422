"""Second readings of files of nodes, as in `readings`: bytes enter, places by node number in the order of rows leave.

Of what else such a file says they ask that it can be read where hpcred reads it.
"""

import re

import numpy as np

from .readings import LARGEST_LABEL, bulk_fields, digits, lines_of, nodes, plain, real, require, whole, words_of

UFF_NODES, UFF_ELEMENTS, UFF_GROUPS = {15: (7,), 781: (4, 3), 2411: (4, 3)}, (780, 2412), (2452, 2467, 2477)
BEAMS = (11, 21, 22, 23, 24)


def placed(pairs):
    """A dictionary of (label, place), each label once."""
    found = dict(pairs)
    require(found and len(found) == len(pairs), "a node twice, or none")
    require(all(abs(x) <= 1e15 for place in found.values() for x in place), "a place beyond all units")
    return found


def with_sets(places, sets):
    """Places of nodes, and of sets (name, node numbers) those that have such nodes: names that are there once."""
    names = [name for name, _ in sets]
    nodes = {name: np.array(sorted(places.keys() & set(numbers))) for name, numbers in sets if names.count(name) == 1}
    return {**places, "sets": {f"set {name}": numbers for name, numbers in nodes.items() if len(numbers)}}


def uff(text: bytes):
    """The only dataset of nodes of a universal file, and groups of nodes."""
    lines = [line.rstrip(b"\r") for line in text.removeprefix(b"\xef\xbb\xbf").split(b"\n")]
    inside, sets = None, []
    for line in lines:
        if re.fullmatch(rb" {0,4}-1[ \t]*", line):
            if inside is None:
                inside = []
            else:
                sets.append(inside)
                inside = None
        elif inside is not None:
            inside.append(line)
        else:
            require(not line.strip(), "a line outside of a dataset")
    require(inside is None, "a dataset without end")
    nodes, groups = [], []
    for lines in sets:
        require(lines and re.fullmatch(rb"[ \t]*\d{1,5}[ \t]*", lines[0]), "no number of a dataset")
        number = int(lines[0].split()[0])
        if number in (*UFF_NODES, *UFF_ELEMENTS):
            rows = [plain(line).split() for line in lines_of(b"\n".join(lines[1:]))]
            (nodes.append((number, rows)) if number in UFF_NODES else uff_elements(number, rows))
        elif number in UFF_GROUPS:
            groups += uff_groups(lines[1:])
    require(len(nodes) == 1, "not one dataset of nodes")
    number, rows = nodes[0]
    widths = UFF_NODES[number]
    require(len(rows) % len(widths) == 0, "half a node")
    found = []
    for k in range(0, len(rows), len(widths)):
        node = rows[k : k + len(widths)]
        require([len(row) for row in node] == list(widths), "another number of words")
        words = sum(node, [])
        require((number != 15 or whole(words[1], 0) <= 1) and whole(words[2], 0) <= 1, "a system of its own")
        found.append((whole(words[0], 1, LARGEST_LABEL), tuple(real(word) for word in words[4:])))
        for word in words[1:4]:
            whole(word, 0)
    return with_sets(placed(found), groups)


def uff_groups(lines):
    """Name and node numbers of the groups of a dataset of which all members are nodes."""
    found = []
    while lines:
        head, *lines = lines
        words = head.split()
        require(len(words) in (7, 8) and all(re.fullmatch(rb"-?\d{1,10}", word) for word in words), "no group")
        count = whole(words[-1], 0)
        require(lines, "no name")
        name, *lines = lines
        rows, lines = lines[: -(-4 * count // 8)], lines[-(-4 * count // 8) :]
        words = [whole(word, 0) for row in rows for word in plain(row).split()]
        require(len(words) == 4 * count, "another number of members")
        if re.fullmatch(rb"\w+", name) and all(kind == 7 for kind in words[::4]):
            found.append((name.decode(), words[1::4]))
    return found


def uff_elements(number, rows):
    at = 0
    while at < len(rows):
        head = [whole(word, -LARGEST_LABEL, LARGEST_LABEL) for word in rows[at]]
        require(len(head) == (8 if number == 780 else 6), "no element")
        at += 1
        if head[1] in BEAMS:
            require(at < len(rows), "no line of the section")
            for word in rows[at]:
                whole(word, -LARGEST_LABEL, LARGEST_LABEL)
            at += 1
        count, nodes = head[-1], []
        require(1 <= count <= 1000, "no nodes")
        for _ in range(-(-count // 8)):
            require(at < len(rows), "no nodes")
            nodes += [whole(word, 1, LARGEST_LABEL) for word in rows[at]]
            at += 1
        require(len(nodes) == count, "another number of nodes")


def cdb(text: bytes):
    """The blocks of nodes of an archive of ANSYS: fields of the widths that its format says, zero where left out; and
    components of nodes."""
    lines, found, sets, at = text.split(b"\n"), [], [], 0
    while at < len(lines):
        words = [word.strip() for word in lines[at].split(b",")]
        name = words[0].upper()
        at += 1
        if name == b"CMBLOCK":
            sets += component(words, lines[at : at + 1], lines[at + 1 :])
        if name not in (b"NBLOCK", b"EBLOCK") or (name == b"EBLOCK" and words[1:3] != [b"19", b"SOLID"]):
            words = b",".join(words).upper()
            require(not re.match(rb"N,(?:R5\.\d,LOC,(?!-1)|\d)", words), "nodes one by one")
            continue
        require(at < len(lines), "no format")
        form = lines[at].replace(b" ", b"").strip()
        match = re.fullmatch(rb"\((\d*)[iI](\d+)(?:,(\d*)[eEdDfFgG](\d+)\.(\d+)(?:[eE]\d+)?)?\)", form)
        require(match, "no format")
        wholes, width, reals, wide = (int(item or 1) for item in match.group(1, 2, 3, 4))
        form = words[1], wholes, reals if match[4] else 0
        of_nodes = form[:2] in ((b"6", 3), (b"3", 1)) and 3 <= form[2] <= 6
        require(of_nodes or form == (b"19", 19, 0), "no block of nodes or elements")
        widths = [width] * wholes + [wide] * form[2]
        block, at = [], at + 1
        while at < len(lines) and not re.match(rb"-1$|N,(R5\.\d|UNBL),LOC,-1", re.sub(rb"\s", b"", lines[at]).upper()):
            line = plain(lines[at])
            at += 1
            if line.strip():
                block.append(fields(line, widths, wholes, name == b"NBLOCK"))
        require(at < len(lines), "no end of the block")
        counts = [word for word in words[3:] if word]
        require(all(word.isdigit() for word in counts), "a count that is none")
        if name == b"NBLOCK":
            if len(counts) == 2:
                require(int(counts[-1]) == len(block), "another number of nodes")
            for row in block:
                require(not any(row[wholes + 3 :]), "axes of their own")
                place = row[wholes : wholes + 3]
                require(1 <= row[0] <= LARGEST_LABEL, "no node number")
                found.append((int(row[0]), tuple(place)))
    return with_sets(placed(sorted(found)), sets)


def component(words, form, lines):
    """Name and numbers of a component of nodes, where each is a field of its own as the format says."""
    count = words[3].split(b"!")[0].strip() if len(words) > 3 else b""
    require(words[1] and words[2].upper() in (b"NODE", b"ELEM") and count.isdigit(), "no component")
    match = re.fullmatch(rb"\((\d+)[iI](\d+)\)", b"".join(form).strip())
    require(match, "no format")
    width, numbers = int(match[2]), []
    for line in lines:
        line = line.rstrip(b"\r")
        if not re.fullmatch(rb"[ \t\d-]*", line):
            break
        fields = [line[k : k + width].strip() for k in range(0, len(line), width)]
        if len(fields) > int(match[1]) or not all(re.fullmatch(rb"-?\d+", field) for field in fields):
            return []
        numbers += map(int, fields)
    require(len(numbers) == int(count), "another number of nodes")
    nodes, last = set(), 0
    for number in numbers:
        require(number > 0 or -number >= last > 0, "no range")
        nodes |= {number} if number > 0 else set(range(last, min(-number, last + 10**6) + 1))
        last = max(number, 0)
    return [(words[1].decode(), nodes)] if re.fullmatch(rb"\w+", words[1]) and words[2].upper() == b"NODE" else []


def listed(text: bytes):
    """A list of nodes of Workbench: lines of node, x, y, z below a heading, perhaps with decimal commas."""
    text = text.removeprefix(b"\xef\xbb\xbf")
    if not re.match(rb"[^\d\s%#/*!,;][^\t\r\n]*\t", text):
        return nodes(text)
    lines, found = lines_of(text.partition(b"\n")[2]), []
    require(b"," not in b"".join(lines) or b"." not in b"".join(lines), "commas and points")
    for line in lines:
        words = line.replace(b",", b".").split()
        require(len(words) in (4, 7), "no node")
        values = [real(word) for word in words[1:]]
        require(not any(values[3:]), "axes of their own")
        found.append((whole(words[0], 1, LARGEST_LABEL), tuple(values[:3])))
    return placed(sorted(found))


def fields(line, widths, wholes, zeros):
    """The numbers of a line of fields; the first `wholes` are whole."""
    require(not line[sum(widths) :].strip(), "more than the fields")
    found, at = [], 0
    for k, width in enumerate(widths):
        word = line[at : at + width].strip()
        at += width
        if not word and not zeros:
            require(not line[at:].strip(), "an empty field")
            break
        if k < wholes:
            found.append(digits(word or b"0", 0, LARGEST_LABEL))
        else:
            require(not word.strip(b"0+-") or b"." in word, "a number without its point")
            found.append(real(word or b"0", bare=True))
    return found


def bulk(text: bytes):
    """GRID cards, in systems that CORD2 cards define; scalar points and elements are not nodes. Sets of nodes."""
    text, case = text.removeprefix(b"\xef\xbb\xbf").upper(), b""
    if re.search(rb"(?m)^[ \t]*BEGIN\b", text):
        require(len(re.findall(rb"(?m)^[ \t]*BEGIN\b", text)) == 1, "two sections")
        begin = re.search(rb"(?m)^[ \t]*BEGIN\b[^\n$]*", text)
        require(b"BULK" not in begin[0] or re.search(rb"(?m)^[ \t]*ENDDATA\b", text), "no end")
        case = re.split(rb"(?m)^[ \t]*CEND\b", text[: begin.start()])[-1]
        text = text[begin.end() :]
    else:
        require(not re.search(rb"(?m)^[ \t]*CEND\b", text), "no bulk data")
    text = re.split(rb"(?m)^[ \t]*ENDDATA\b", text)[0]
    cards = []
    for line in text.split(b"\n"):
        line = line.split(b"$")[0].replace(b"\r", b" ")
        if not line.strip():
            continue
        if b"A" <= line[:1] <= b"Z":
            name = re.split(rb"[ *,\t]", line.expandtabs(8)[:8])[0]
            cards.append((name, []))
        else:
            require(cards and line[:1] in b" +*,\t", "a line that continues nothing")
        if cards[-1][0] in (b"GRID", b"GRDSET", b"SPOINT", b"SET1") or cards[-1][0].startswith(b"CORD"):
            cards[-1][1].extend(bulk_fields(plain(line), strict=False)[1])
    require(sum(name == b"GRDSET" for name, _ in cards) < 2, "two defaults")
    defaults = next((words for name, words in cards if name == b"GRDSET"), [])
    defaults = defaults + 8 * [b""]
    frames = systems([(name, words) for name, words in cards if re.match(rb"CORD\d", name)])
    scalars = {digits(word, 1, LARGEST_LABEL) for name, words in cards if name == b"SPOINT" for word in words if word}
    found = []
    for name, words in cards:
        if name != b"GRID":
            continue
        words += 4 * [b""]
        require(not any(words[8:]), "more fields than a point has")
        system, turned = (digits(words[k] or defaults[k] or b"0", 0, LARGEST_LABEL) for k in (1, 5))
        require(not set(words[6]) - set(b"0123456"), "no directions")
        require(system in frames and turned in frames, "a system that is not there")
        require(np.array_equal(frames[turned][2], np.eye(3)) and frames[turned][0] == b"R", "axes of their own")
        place = in_basic(frames[system], [real(word or b"0", bare=True) for word in words[2:5]])
        found.append((digits(words[0], 1, LARGEST_LABEL), place))
    require(not scalars & {label for label, _ in found}, "a scalar point that is a node")
    places = placed(sorted(found))
    sets = [(f"SET1 {int(words[0])}", words[1:]) for name, words in cards if name == b"SET1" and words[0].isdigit()]
    sets = [(name, set_of(words, places)) for name, words in [*sets_of_case(case), *sets]]
    return with_sets(places, sets)


def sets_of_case(text):
    """Name and words of the sets of a case control of which nothing is asked for."""
    text = re.sub(rb"\$[^\n]*", b"", text)
    asked = re.findall(rb"(?m)^(?![ \t]*SET)[^\n]*=[ \t]*(\d+)", text)
    found = re.findall(rb"(?m)^[ \t]*SET[ \t]+(\d{1,9})[ \t]*=((?:[^\n]*,[ \t\r]*\n)*[^\n]*)", text)
    return [(f"SET {int(number)}", re.split(rb"[,\s]+", words.strip(b", \t\r\n")) if number not in asked else [])
            for number, words in found]  # fmt: skip


def set_of(words, places):
    """The nodes of a list of numbers and ranges; none where it is no such list, or one of its numbers is no node."""
    words, found, excepted, first, last = [word for word in words if word], set(), range(0), 0, 0
    while words:
        number = words.pop(0)
        if number == b"EXCEPT" and not excepted and found:
            excepted = range(first, last + 1)
            continue
        if not re.fullmatch(rb"\d{1,10}", number):
            return []
        first = last = int(number)
        if words[:1] == [b"THRU"]:
            if len(words) < 2 or not re.fullmatch(rb"\d{1,10}", words[1]) or excepted or int(words[1]) <= first:
                return []
            last = int(words[1])
            del words[:2]
        if first in excepted:
            found.discard(first)
            continue
        excepted = range(0)
        if first == last and first not in places:
            return []
        found |= {node for node in places if first <= node <= last}
    return found


def systems(cards):
    """Kind, origin and axes of coordinate systems by number, of cards that name only systems above them."""
    frames = {0: (b"R", np.zeros(3), np.eye(3))}
    for name, words in cards:
        require(re.fullmatch(rb"CORD2[RCS]", name), "another kind of system")
        number, reference = digits(words[0]), digits(words[1] or b"0")
        require(number not in frames and reference in frames, "a system twice, or none")
        values = [real(word or b"0", bare=True) for word in (words + 3 * [b""])[2:11]]
        origin, axis, plane = (np.array(in_basic(frames[reference], values[k : k + 3])) for k in (0, 3, 6))
        z, y = axis - origin, np.cross(axis - origin, plane - origin)
        require(np.linalg.norm(y) > 1e-12 * np.linalg.norm(z) * np.linalg.norm(plane - origin), "no plane")
        z, y = z / np.linalg.norm(z), y / np.linalg.norm(y)
        frames[number] = name[-1:], origin, np.array([np.cross(y, z), y, z]).T
    return frames


def in_basic(frame, values):
    kind, origin, axes = frame
    a, b, c = values
    if kind == b"C":
        a, b = a * np.cos(np.deg2rad(b)), a * np.sin(np.deg2rad(b))
    elif kind == b"S":
        polar, angle = np.deg2rad(b), np.deg2rad(c)
        a, b, c = a * np.sin(polar) * np.cos(angle), a * np.sin(polar) * np.sin(angle), a * np.cos(polar)
    return tuple(origin + axes @ np.array([a, b, c]))


CHANGING = (b"ngen", b"nfill", b"ncopy", b"nmap", b"import", b"imperfection", b"symmetricmodelgeneration", b"transform",
            b"include", b"elgen", b"elcopy")  # fmt: skip
TYPES = {b"t3d2": 3, b"c3d8": 9, b"c3d10": 11}


def keywords_of(text: bytes):
    """Keyword, parameters and data lines of an input file of Abaqus."""
    found = []
    text = re.sub(rb"(?m)^([ \t]*\*[^\n]*,)[ \t]*\r?\n(?![ \t]*\*)", rb"\1", text)  # keywords that go on
    for line in text.removeprefix(b"\xef\xbb\xbf").split(b"\n"):
        if not line.strip() or line.strip().startswith((b"**", b"%", b"#")):
            continue
        if line.strip().startswith(b"*"):
            words = line.strip().lstrip(b"*").split(b",")
            keyword = b"".join(words[0].lower().split())
            require(keyword, "no keyword")
            pairs = (word.partition(b"=") for word in words[1:] if word.strip())
            given = {b"".join(key.lower().split()): value.strip().strip(b"\"'") for key, _, value in pairs}
            found.append((keyword, given, []))
        else:
            require(found, "data before the first keyword")
            found[-1][2].append(line)
    return found


def assembly(text: bytes):
    """Nodes of an input file with parts and instances, or without, ascending; and "sets": arrays by "set NAME"."""
    parts, blocks, instances, scope, own, place, frame = {}, [], {}, "model", None, None, np.array
    for keyword, given, lines in keywords_of(text):
        require(keyword not in CHANGING, "nodes that are made")
        if keyword == b"system":
            frame = local(lines)
        elif keyword in (b"part", b"endpart", b"assembly", b"endassembly", b"instance", b"endinstance"):
            frame = np.array
        if keyword == b"part":
            scope, own = "part", given.get(b"name", b"").lower()
            parts[own] = []
        elif keyword == b"assembly":
            scope = "assembly"
        elif keyword == b"instance":
            scope, own, place = "instance", given.get(b"name", b""), moved(lines)
            part = given.get(b"part", b"").lower()
            require(part in parts and not {b"instance", b"library"} & given.keys(), "no part")
            instances[own.lower()] = own
            blocks += [(own, chained(frame_of, place), own + b".", block) for frame_of, block in parts[part]]
        elif keyword in (b"endpart", b"endassembly", b"endinstance"):
            scope = "assembly" if keyword == b"endinstance" else "model"
        elif keyword in (b"node", b"element", b"nset", b"elset"):
            require(b"input" not in given, "a file that is not there")
            require(keyword != b"node" or not given.keys() - {b"nset", b"system"}, "what is not read of nodes")
            if scope == "part":
                parts[own].append((frame, (keyword, given, lines)))
            elif scope == "instance":
                blocks.append((own, chained(frame, place), own + b".", (keyword, given, lines)))
            else:
                of = instances.get(given.get(b"instance", b"").lower()) if keyword in (b"nset", b"elset") else None
                blocks.append((of if of is not None else scope, frame, b"", (keyword, given, lines)))
    require(instances or not parts, "no instance")
    return nodes_and_sets(blocks)


def chained(first, second):
    return lambda x: second(first(x))


def local(lines):
    """How *System places nodes: x' from a to b, y' in the plane of c, or z' as z; only moved where b is left out."""
    require(len(lines) < 3, "more than a, b and c")
    values = np.array(padded(lines[0], 6)) if lines else np.zeros(6)
    a, b = values[:3], values[3:]
    given = [word.strip() for word in plain(lines[0]).split(b",")][3:] if lines else []
    if len(lines) < 2 and not any(given):
        return lambda x: a + x
    if len(lines) < 2:
        ex, plane = (b - a) * [1, 1, 0], np.array([-(b - a)[1], (b - a)[0], 0])
    else:
        ex, plane = b - a, np.array(padded(lines[1], 3)) - a
    require(np.linalg.norm(np.cross(ex, plane)) > 0, "points on a line")
    ex = ex / np.linalg.norm(ex)
    ey = plane - ex * (ex @ plane)
    ey /= np.linalg.norm(ey)
    return lambda x: a + x[0] * ex + x[1] * ey + x[2] * np.cross(ex, ey)


def padded(line, count):
    """Numbers between commas, zero where left out."""
    words = [word.strip() for word in plain(line).split(b",")]
    while words and not words[-1]:
        words.pop()
    require(len(words) <= count, "too many numbers")
    return [real(word or b"0") for word in words] + [0.0] * (count - len(words))


def moved(lines):
    """How an instance places the nodes of its part: moved, and then turned about an axis from a to b."""
    require(len(lines) < 3, "more than a translation and a rotation")
    shift = np.array(padded(lines[0], 3)) if lines else np.zeros(3)
    if len(lines) < 2:
        return lambda x: x + shift
    values = padded(lines[1], 7)
    a, b, angle = np.array(values[:3]), np.array(values[3:6]), np.deg2rad(values[6])
    require((a != b).any(), "no axis")
    n = (b - a) / np.linalg.norm(b - a)

    def turned(x):
        r = x + shift - a
        return a + np.cos(angle) * r + np.sin(angle) * np.cross(n, r) + (1 - np.cos(angle)) * n * (n @ r)

    return turned


def nodes_and_sets(blocks):
    found, group, elements, sets = {}, {}, {}, {}
    for of, place, prefix, (keyword, given, lines) in blocks:
        if keyword == b"node":
            require(given.get(b"system", b"r").lower() == b"r", "cylindrical coordinates")
            for line in lines:
                label, *point = node_line(line)
                point = tuple(place(np.array(point)))
                require(found.setdefault(label, point) == point and group.setdefault(label, of) == of, "a node twice")
                member(sets, b"nset", given.get(b"nset"), prefix, label)
        elif keyword == b"element" and (width := TYPES.get(given.get(b"type", b"").lower())):
            rows = [[whole(word, 1, LARGEST_LABEL) for word in words_of(plain(line))] for line in lines]
            while rows:
                element = rows.pop(0)
                while len(element) < width:
                    require(rows, "half an element")
                    element += rows.pop(0)
                require(len(element) == width, "no element")
                elements.setdefault((of, element[0]), []).extend(element[1:])
                member(sets, b"elset", given.get(b"elset"), prefix, (of, element[0]))
    for of, _, prefix, (keyword, given, lines) in blocks:
        if keyword in (b"nset", b"elset"):
            require(given.get(keyword), "a set without name")
            if b"internal" not in given and not (keyword == b"nset" and b"elset" in given):
                member(sets, keyword, given[keyword], prefix)
                for item in members_of(lines, b"generate" in given):
                    if isinstance(item, bytes):
                        item = item, prefix.lower() + item
                    elif keyword == b"elset":
                        item = of, item
                    member(sets, keyword, given[keyword], prefix, item)
    require(all(node in found for nodes in elements.values() for node in nodes), "a node that is not there")
    places = placed(sorted(found.items()))
    return {**places, "sets": all_of(sets, elements)}


def node_line(line):
    words = [word.strip() or b"0" for word in plain(line).strip().removesuffix(b",").split(b",")]
    words = [word for item in words for word in item.split()]
    require(2 <= len(words) <= 7, "not two to seven numbers")
    return [whole(words[0], 1, LARGEST_LABEL), *[*(real(word) for word in words[1:]), *[0.0] * (4 - len(words))][:3]]


def member(sets, keyword, name, prefix, *items):
    if name:
        sets.setdefault((keyword, (prefix + name).lower()), (prefix + name, []))[1].extend(items)


def members_of(lines, generate):
    """Numbers and names of other sets."""
    found = []
    for line in lines:
        words = words_of(plain(line))
        if generate:
            numbers = [whole(word, 1, LARGEST_LABEL) for word in words]
            require(2 <= len(numbers) <= 3 and numbers[0] <= numbers[1] <= 10**6, "no range")
            found += range(numbers[0], numbers[1] + 1, (numbers + [1])[2])
            continue
        for word in plain(line).split(b","):
            word = word.strip()
            if re.search(rb"[A-Za-z_]", word):
                word = word.strip(b'"')
                inside = re.fullmatch(rb".+\.(\d+)", word)
                found.append(digits(inside[1], 1, LARGEST_LABEL) if inside else word.lower())
            else:
                found += [whole(number, 1, LARGEST_LABEL) for number in word.split()]
    return found


def all_of(sets, elements):
    """Node numbers of every set, with those of the sets that it names."""
    found = {}
    for (keyword, _), (name, items) in sets.items():
        numbers, open_, seen = set(), list(items), set()
        while open_:
            item = open_.pop()
            if isinstance(item, int) or isinstance(item[1], int):
                numbers.add(item)
                continue
            there = {word for word in item if (keyword, word) in sets}
            require(there or keyword == b"elset", "a set that is not there")
            for word in there - seen:
                seen.add(word)
                open_ += sets[keyword, word][1]
        if keyword == b"elset":
            numbers = {node for key in numbers for node in elements.get(key, [])}
            name = b"elements of " + name
        if numbers:
            found["set " + name.decode("latin-1")] = np.array(sorted(numbers))
    return found
