"""Second readings of text formats, in plain Python from the descriptions of the formats: bytes enter, numbers leave.

They share nothing with hpcred and are strict: what has no sense, or two, raises Nonsense. Matrices come as dense
arrays, rows with names as labels (node, direction from 1).
"""

import re

import numpy as np

REAL = re.compile(rb"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?")
BARE = re.compile(rb"([+-]?(?:\d+\.?\d*|\.\d+))([+-]\d+)")  # an exponent without letter
LARGEST_LABEL = 2**31 - 1
HELD = 1e35  # on the diagonal of K it is Abaqus' support
DOFS = (b"UX", b"UY", b"UZ", b"ROTX", b"ROTY", b"ROTZ")


class Nonsense(ValueError):
    """A text that says nothing."""


def require(condition, what="damaged"):
    if not condition:
        raise Nonsense(what)


def real(word: bytes, bare=False) -> float:
    """A finite number; `bare`: also 1.5-3 of Nastran and Fortran."""
    match = BARE.fullmatch(word) if bare else None
    if match:
        word = match[1] + b"e" + match[2]
    require(REAL.fullmatch(word), f"{word!r} is no number")
    value = float(word.lower().replace(b"d", b"e"))
    require(np.isfinite(value), f"{word!r} is too large")
    return value


def whole(word: bytes, low=1, high=2**53) -> int:
    value = real(word)
    require(value == int(value) and low <= value <= high, f"{word!r} is no whole number of {low} to {high}")
    return int(value)


def digits(word: bytes, low=0, high=2**53) -> int:
    """A whole number written as such, perhaps with a +, or -0."""
    word = b"0" if word == b"-0" else re.sub(rb"^\+(?=\d)", b"", word)
    require(word.isdigit() and low <= int(word) <= high, f"{word!r} is no whole number of {low} to {high}")
    return int(word)


def lines_of(text: bytes, remarks=(b"%", b"#", b"**")) -> list[bytes]:
    """Lines without their ends, without remarks and blank ones."""
    text = text.removeprefix(b"\xef\xbb\xbf")
    found = []
    for line in text.split(b"\n"):
        if line.strip() and not line.strip().startswith(remarks):
            found.append(plain(line))
    return found


def plain(line: bytes) -> bytes:
    """A line with blanks for what C takes for blanks, its end off; other control characters are refused."""
    line = re.sub(rb"[\x0b\x0c\r]", b" ", line.rstrip(b"\r"))
    require(not re.search(rb"[\x00-\x08\x0e-\x1f\x7f]", line), "a character that is no text")
    return line


def words_of(line: bytes, commas=True) -> list[bytes]:
    """Words between blanks, or commas where allowed, of which one may end the line; between two commas is a word."""
    if commas and b"," in line:
        parts = line.strip().removesuffix(b",").split(b",")
        require(all(part.strip() for part in parts), "an empty field")
        return [word for part in parts for word in part.split()]
    return line.split()


def dense(shape, entries):
    """Entries (row, column, value) from 1; those of one place are summed."""
    require(0 < shape[0] < 10**4 and 0 < shape[1] < 10**4, "a size that no file of a test has")
    matrix = np.zeros(shape)
    for i, j, value in entries:
        require(1 <= i <= shape[0] and 1 <= j <= shape[1], "an entry outside")
        matrix[i - 1, j - 1] += value
    return matrix


def one_triangle(entries, sign=1.0):
    """Both triangles from one; entries of both are refused."""
    require(not (any(i > j for i, j, _ in entries) and any(i < j for i, j, _ in entries)), "both triangles")
    return entries + [(j, i, sign * value) for i, j, value in entries if i != j]


def matrix_market(text: bytes) -> np.ndarray:
    """A Matrix Market file; without its first line it is a list of row, column, value."""
    if text.lstrip()[:1].isdigit() or text.startswith(b"% a remark"):
        return coordinates(text)
    head, _, rest = text.removeprefix(b"\xef\xbb\xbf").partition(b"\n")
    words = head.lower().split()
    require(len(words) == 5 and words[:2] == [b"%%matrixmarket", b"matrix"], "no header")
    require(words[2] in (b"coordinate", b"array") and words[3] in (b"real", b"integer"), "another kind")
    symmetry = words[4]
    require(symmetry in (b"general", b"symmetric", b"skew-symmetric"), "another symmetry")
    lines = lines_of(rest)
    require(lines, "no sizes")
    sizes = [digits(word) for word in lines[0].split()]
    if words[2] == b"array":
        require(len(sizes) == 2 and (symmetry == b"general" or sizes[0] == sizes[1]), "sizes")
        first = {b"general": 0, b"symmetric": 1, b"skew-symmetric": 2}[symmetry]
        places = [(i, j) for j in range(sizes[1]) for i in range(j + first - 1 if first else 0, sizes[0])]
        values = [real(line.strip()) for line in lines[1:]]
        require(len(values) == len(places), "another number of values")
        found = np.zeros(sizes)
        for (i, j), value in zip(places, values, strict=True):
            found[i, j] = value
            if first:
                found[j, i] = value if first == 1 or i == j else -value
        return found
    require(len(sizes) == 3 and len(lines) - 1 == sizes[2], "another number of entries")
    entries = []
    for line in lines[1:]:
        words = line.split()
        require(len(words) == 3, "no entry")
        entries.append((whole(words[0]), whole(words[1]), real(words[2])))
    if symmetry == b"symmetric":
        entries = one_triangle(entries)
    elif symmetry == b"skew-symmetric":
        require(not any(i == j and value for i, j, value in entries), "a diagonal")
        entries = one_triangle(entries, -1.0)
    return dense(sizes[:2], entries)


def nodes(text: bytes) -> dict[int, tuple]:
    """Places by node number, in the order of the lines."""
    found = {}
    for line in lines_of(text):
        words = words_of(line)
        require(len(words) == 4, "not four numbers")
        label = whole(words[0], 1, LARGEST_LABEL)
        require(label not in found, "a node twice")
        found[label] = tuple(real(word) for word in words[1:])
    require(found, "no nodes")
    return found


def row_labels(text: bytes) -> list[tuple[int, int]]:
    found = []
    for line in lines_of(text):
        words = words_of(line)
        require(len(words) == 2, "not two numbers")
        found.append((whole(words[0], 1, LARGEST_LABEL), whole(words[1], 1, 6)))
    require(len(set(found)) == len(found), "a row twice")
    return found


def coordinates(text: bytes) -> np.ndarray:
    """Abaqus' FORMAT=COORDINATE: both triangles, the size is the largest number."""
    entries = []
    for line in lines_of(text):
        words = words_of(line)
        require(len(words) == 3, "not three numbers")
        entries.append((whole(words[0]), whole(words[1]), real(words[2])))
    require(any(i > j for i, j, _ in entries) == any(i < j for i, j, _ in entries), "one triangle")
    size = max((max(i, j) for i, j, _ in entries), default=0)
    require(not entries or entries[0] != (size, size, len(entries) - 1), "sizes, and no header above them")
    return dense((size, size), entries)


def matrix_input(text: bytes):
    """Abaqus' FORMAT=MATRIX INPUT: entries by label; of one triangle the other is its mirror image."""
    entries = []
    for line in lines_of(text):
        words = words_of(line)
        require(len(words) == 5, "not five numbers")
        row, column = ((whole(words[k], 1, LARGEST_LABEL), whole(words[k + 1], 1, 6)) for k in (0, 2))
        entries.append((row, column, real(words[4])))
    places = {(i, j) for i, j, _ in entries if i != j}
    if not any((j, i) in places for i, j in places):
        entries += [(j, i, value) for i, j, value in entries if i != j]
    return entries


def triangle(text: bytes) -> np.ndarray:
    """CalculiX' .sti and .mas: the upper triangle with its whole diagonal, column by column."""
    require(text.endswith(b"\n"), "a last line without end")
    entries = []
    for line in lines_of(text):
        words = line.split()
        require(len(words) == 3, "not three numbers")
        entries.append((whole(words[0], 1, LARGEST_LABEL), whole(words[1], 1, LARGEST_LABEL), real(words[2])))
    places = [(j, i) for i, j, _ in entries]
    require(places == sorted(set(places)) and all(i <= j for j, i in places), "another order")
    size = max((j for j, _ in places), default=0)
    require(sum(i == j for i, j in places) == size, "no diagonal")
    return dense((size, size), one_triangle(entries))


def calculix_dofs(text: bytes) -> list[tuple[int, int]]:
    """Labels in ascending order, or such that occur again, where CalculiX made solids of beams and shells."""
    require(text.endswith(b"\n"), "a last line without end")
    found = []
    for line in text.removeprefix(b"\xef\xbb\xbf").split(b"\n")[:-1]:
        words = line.removesuffix(b"\r").split(b".")
        require(len(words) == 2 and len(words[1]) == 1, "no node.direction")
        found.append((digits(words[0], 1, LARGEST_LABEL), digits(words[1], 1, 6)))
    require(len(set(found)) < len(found) or found == sorted(found), "another order")
    return found


def input_file(text: bytes, of_calculix=False) -> dict[int, tuple]:
    """Places by node number, ascending, of the *Node blocks of an input file without parts; elements have nodes.

    CalculiX knows no keywords of several lines, leaves out those that it does not know, also one without a name, and
    takes a node without coordinates.
    """
    found, used, keyword = {}, set(), None
    if not of_calculix:
        text = re.sub(rb"(?m)^([ \t]*\*[^\n]*,)[ \t]*\r?\n(?![ \t]*\*)", rb"\1", text)  # keywords that go on
    for line in text.removeprefix(b"\xef\xbb\xbf").split(b"\n"):
        if not line.strip() or line.strip().startswith((b"**", b"%", b"#")):
            continue
        if line.strip().startswith(b"*"):
            words = [word.strip().lower() for word in line.strip()[1:].split(b",")]
            keyword = b"".join(words[0].split())
            require(keyword or of_calculix, "no keyword")
        elif keyword == b"":
            raise Nonsense("data without a keyword")
        elif keyword == b"node":
            words = [word.strip() for word in plain(line).strip().removesuffix(b",").split(b",")]
            words = [word or b"0" for word in words]
            words = [word for item in words for word in item.split()]
            require((1 if of_calculix else 2) <= len(words) <= 7, "not two to seven numbers")
            label = whole(words[0], 1, LARGEST_LABEL)
            place = (tuple(real(word) for word in words[1:]) + (0.0,) * (4 - len(words)))[:3]
            require(found.setdefault(label, place) == place, "a node at two places")
        elif keyword == b"element":
            used |= {whole(word) for word in words_of(plain(line))[1:]}
        elif keyword is None:
            raise Nonsense("data before the first keyword")
    require(found and used <= found.keys(), "nodes of elements that are not there")
    return dict(sorted(found.items()))


def bulk_fields(line: bytes, strict=True) -> tuple[bytes, list[bytes]]:
    """What begins a line of bulk data, and its data fields; `strict`: with nothing behind the 80th column."""
    if b"," in line:
        head, *fields = (field.strip() for field in line.split(b","))
        count = 4 if b"*" in head else 8
        require(not any(fields[count + 1 :]), "too many fields")
        return head.strip(b"*").strip(), (fields + [b""] * 8)[:count]
    line = line.expandtabs(8)
    require(not strict or not line[80:].strip(), "more than 80 columns")
    head, width = line[:8], 16 if b"*" in line[:8] else 8
    fields = [line[8 + width * k : 8 + width * (k + 1)].strip() for k in range(64 // width)]
    return head.split(b"*")[0].strip(), fields


def dmig(text: bytes, name: bytes):
    """Entries by label of one matrix on DMIG cards; direction 0 of a scalar point is 7."""
    ended = re.search(rb"(?mi)^[ \t]*ENDDATA[\s,]*(?:\s[0-9a-f]{8})?[ \t\r]*(?:\$.*)?$", text)
    require(text.endswith(b"\n") or ended, "a last line without end")
    cards = []
    for line in text.upper().split(b"\n"):
        line = plain(line)
        if not line.strip() or line.startswith(b"$"):
            continue
        require(b"$" not in line, "a remark behind a card")
        begins = b"A" <= line[:1] <= b"Z"
        head, fields = bulk_fields(line, strict=not begins or line.startswith(b"DMIG"))
        if begins:
            cards.append((re.split(rb"[ *,]", line[:8])[0], []))
        else:
            require(cards and line[:1] in b" +*,", "a line that continues nothing")
        cards[-1][1].append(fields)
    header, column_labels, entries, places = None, set(), [], set()
    require(b"ENDDATA" not in [kind for kind, _ in cards[:-1]], "cards below the end")
    require(not cards or cards[-1][0] != b"ENDDATA" or len(cards[-1][1]) == 1, "lines below the end")
    for kind, lines in cards:
        if kind != b"DMIG":
            continue
        own = lines[0]
        whole_card = [field for fields in lines for field in fields]
        if own[0] != name:
            continue
        if own[1] == b"0":
            require(header is None and not any(whole_card[8:]), "two headers")
            header = [digits(whole_card[k] or b"0") for k in (2, 3, 7)]
            continue
        require(not own[3], "no column")
        column = label_of(own[1], own[2])
        column_labels.add(column)
        fours = [whole_card[k : k + 4] for k in range(4, len(whole_card), 4)]
        for node, direction, value, imaginary in fours:
            if not (node or direction or value or imaginary):
                continue
            require(value and not imaginary, "no real value")
            row = label_of(node, direction)
            require((row, column) not in places, "an entry twice")
            places.add((row, column))
            entries.append((row, column, real(value, bare=True)))
    require(header is not None and header[0] in (1, 6) and header[1] in (1, 2, 3, 4), "no square matrix")
    if header[0] == 6:
        require(not any((j, i) in places for i, j in places if i != j), "both halves")
        entries += [(j, i, value) for i, j, value in entries if i != j]
    return entries


def label_of(node: bytes, direction: bytes):
    return digits(node, 1, LARGEST_LABEL), digits(direction or b"0", 0, 6) or 7


def op4(text: bytes) -> np.ndarray:
    """The only real matrix of an OUTPUT4 text; three words alone are an entry: row, column, value."""
    if len(text.split()) == 3:
        return coordinates(text)
    lines = [plain(line) for line in text.removeprefix(b"\xef\xbb\xbf").split(b"\n")]
    lines = [line for line in lines if line.strip()]
    require(lines, "nothing")
    head, at = lines[0], 1
    columns, rows, form, kind = (int(head[8 * k : 8 * k + 8]) if re.fullmatch(rb" *-?\d+", head[8 * k : 8 * k + 8])
                                 else require(False, "no header") for k in range(4))  # fmt: skip
    match = re.search(rb"(\d+)[EeDd](\d+)\.\d+ *$", head[40:])
    require(match and columns > 0 and form in (1, 2, 6) and kind in (1, 2), "no header of a real matrix")
    width, big, words = int(match[2]), rows < 0 or rows >= 65536, kind
    shape, matrix, last = (abs(rows), columns), {}, 0
    require(width > 7, "a format that nobody writes")

    def numbers(count):
        nonlocal at
        found = []
        while len(found) < count:
            require(at < len(lines) and b"." in lines[at], "the end of the numbers")
            line = lines[at].rstrip(b" ") if len(lines[at]) % width else lines[at]
            require(len(line) % width == 0 and line, "a number that is cut")
            found += [real(line[k : k + width].strip(), bare=True) for k in range(0, len(line), width)]
            at += 1
        require(len(found) == count, "more numbers than announced")
        return found

    def wholes(count):
        nonlocal at
        require(at < len(lines) and len(lines[at]) <= 8 * count, "the end of the file")
        fields = [lines[at][8 * k : 8 * k + 8].strip() for k in range(count)]
        at += 1
        return [digits(field) for field in fields]

    styles = set()
    while True:
        column, first, count = wholes(3)
        require(last < column <= columns + 1, "columns that do not ascend")
        last = column
        if column == columns + 1:
            numbers(count if first else 1)
            break
        styles.add(first > 0)
        if first:
            strings = [(first, numbers(count))]
        else:
            strings, lowest = [], 1
            while count > 0:
                if big:
                    length, row = wholes(2)
                else:
                    require(at < len(lines) and len(lines[at]) <= 16, "no string")
                    length, row = divmod(digits(lines[at].strip()), 65536)
                    at += 1
                require(length > 1 and (length - 1) % words == 0 and row >= lowest, "a string that does not fit")
                strings.append((row, numbers((length - 1) // words)))
                lowest = row + len(strings[-1][1])
                count -= length - 1 + (2 if big else 1)
            require(count == 0, "more words than announced")
        for row, values in strings:
            for k, value in enumerate(values):
                matrix[row + k, column] = value
    require(at == len(lines), "lines behind the end")
    require(len(styles) < 2, "two styles of columns")
    found = [(i, j, value) for (i, j), value in matrix.items() if value]
    if form == 6 and any(i > j for i, j, _ in found) != any(i < j for i, j, _ in found):
        found = one_triangle(found)
    return dense(shape, found)


def harwell_boeing(text: bytes) -> np.ndarray:
    """A real assembled matrix in fields of fixed width, formats such as (16I5), (5E16.8), (1P,5D16.9)."""
    lines = [line.rstrip(b"\r") if k < 4 else plain(line) for k, line in enumerate(text.split(b"\n"))]
    require(len(lines) > 5, "no header")
    cards = [digits(word) for word in lines[1].split()]
    require(len(cards) in (4, 5), "no counts of lines")
    right = cards[4] if len(cards) == 5 else 0
    kind, sizes = lines[2][:3].upper(), [digits(word) for word in lines[2][3:].split()]
    require(len(sizes) in (3, 4) and kind[:1] == b"R" and kind[1:2] in (b"U", b"S", b"Z", b"R") and kind[2:] == b"A",
            "another kind")  # fmt: skip
    require(lines[2][3:4].isspace() and not right, "right-hand sides")
    formats = re.findall(rb"\(\s*(?:(\d+)P\s*,?\s*)?(\d*)\s*([IEDF])\s*(\d+)(?:\.\d+)?\s*\)", lines[3].upper())
    require(len(formats) >= 3 and formats[0][2] == formats[1][2] == b"I" and formats[2][2] in b"EDF", "no formats")
    rows, columns, entries = sizes[:3]
    at, found = 4, []
    counts = columns + 1, entries, entries
    for (_, repeat, letter, width), count, card in zip(formats, counts, cards[1:], strict=False):
        repeat, width = int(repeat or 1), int(width)
        require(card == -(-count // repeat), "another number of lines")
        section = []
        for line in lines[at : at + card]:
            fields = [line[width * k : width * (k + 1)] for k in range(min(repeat, count - len(section)))]
            fields = [field.strip() for field in fields]
            fields = [item.replace(b"E ", b"E+") for item in fields]
            section += [digits(item, 1) if letter == b"I" else real(item, True) for item in fields]
        require(len(section) == count and len(lines[at : at + card]) == card, "too few numbers")
        at += card
        found.append(section)
    require(not b"".join(lines[at:]).strip(), "lines behind the end")
    starts, row, values = found
    require(starts[0] == 1 and starts[-1] == entries + 1 and starts == sorted(starts), "pointers")
    column = [j + 1 for j in range(columns) for _ in range(starts[j + 1] - starts[j])]
    require(len(set(zip(row, column, strict=True))) == len(row), "an entry twice")
    items = list(zip(row, column, values, strict=True))
    if kind[1:2] in (b"S", b"Z"):
        require(rows == columns, "not square")
        require(kind[1:2] == b"S" or not any(i == j and value for i, j, value in items), "a diagonal")
        items = one_triangle(items, 1.0 if kind[1:2] == b"S" else -1.0)
    return dense((rows, columns), items)


def mapping(text: bytes) -> list[tuple[int, int]]:
    """Labels in the order of the equations from HBMAT's list."""
    first, *rest = text.removeprefix(b"\xef\xbb\xbf").split(b"\n")
    require(first.split() == [b"Matrix", b"Eqn", b"Node", b"DOF"], "no heading")
    found = {}
    for line in rest:
        words = plain(line).split()
        if not words or words == first.split():  # a heading may stand on every page
            continue
        require(len(words) == 3 and words[2] in DOFS, "no row")
        equation = digits(words[0], 1)
        require(equation not in found, "an equation twice")
        found[equation] = digits(words[1], 1, LARGEST_LABEL), DOFS.index(words[2]) + 1
    require(sorted(found) == list(range(1, len(found) + 1)), "equations missing")
    require(len(set(found.values())) == len(found), "a row twice")
    return [found[k] for k in sorted(found)]


def model(matrices: dict, labels=None, places=None, held=HELD) -> dict[str, np.ndarray]:
    """What a model of these has: rows as numbered or in the order of labels, without those that Abaqus holds by 1e36.

    `matrices`: arrays by K, M, D, or all of them entries by label; `labels`: of the rows; `places`: by node; `held`:
    from which size on a number does that.
    """
    if isinstance(next(iter(matrices.values())), list):
        labels = sorted({label for entries in matrices.values() for i, j, _ in entries for label in (i, j)})
        number = {label: k for k, label in enumerate(labels, 1)}
        shape = (len(labels), len(labels))
        matrices = {key: dense(shape, [(number[i], number[j], value) for i, j, value in entries])
                    for key, entries in matrices.items()}  # fmt: skip
    size = len(matrices["K"])
    require(all(matrix.shape == (size, size) for key, matrix in matrices.items() if key in "KMD"), "other sizes")
    if labels is None and places is not None:
        count = size // len(places)
        require(count * len(places) == size and count in (1, 2, 3, 6), "other nodes")
        labels = [(node, direction) for node in places for direction in range(1, count + 1)]
    if labels is not None:
        require(len(labels) == size, "another number of rows")
    order = np.flatnonzero(np.abs(np.diag(matrices["K"])) < held)
    require(len(order), "no free row")
    found = {key: matrix[np.ix_(order, order)] for key, matrix in matrices.items() if key in "KMD"}
    require(all(np.abs(matrix).max() <= 1e60 for matrix in matrices.values()), "beyond all units")
    for key in ("K", "M"):
        require(matrices[key].any(), "zero")
    if "B" in matrices:
        require(len(order) == size == len(matrices["B"]), "other rows")
        found["B"] = matrices["B"].T
    if labels is not None and places is not None:
        found["node"] = np.array([labels[k][0] for k in order])
        found["direction"] = np.array([labels[k][1] - 1 for k in order])
        require(all(label[0] in places for label in labels), "a node without place")
        found["position"] = np.array([places[labels[k][0]] for k in order])
    return found
