"""Good files enter; copies with damage leave, each with a note of what was done."""

import re
import struct

import numpy as np

FLOAT = re.compile(rb"[-+]?\d*\.\d*(?:[EeDd][-+]?\d+)?,?")
LETTERS = b"0123456789+-.eEdDnN ,;:\t\r\n%$#*/\"'_xX\0\x0b\x0c\xc3\xa9\xff"
WORDS = (
    b"nan inf -inf infinity NaN(1) 0 -0 -1 +1 1 2 1.0 1e0 1.5 1e400 -1e400 1e-400 1e36 1e61 1.5D+02 1.5d2 1.5+02 "
    b"1.5-300 1.5e 1.5e+ e5 . - + .5 5. 1.2.3 --1 0x10 0b1 1_0 1,5 1;5 1j 1.5f 1e5 99999999999999999999"
    b" 9223372036854775807 2147483647 2147483648 4294967297 -2147483649 1/2 1*2 2*1.0 $1 % # **"
    b" '1' \xd9\xa3 True null 00012 1e1.5"
).split(b" ")


def damaged_text(good: bytes, rng) -> tuple[str, bytes]:
    """A copy of a text with one to three damages of the kinds below."""
    notes, text = [], good
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        note, text = _one_damage(text, rng)
        notes.append(note)
    return ", ".join(notes), text


def _one_damage(text, rng):
    kind = str(rng.choice(["flip", "put", "insert", "drop", "word", "word", "word", "count", "count", "line", "line",
                           "line", "cut", "cut", "blanks", "ends", "add", "add", "run"]))  # fmt: skip
    lines = text.splitlines(keepends=True)
    if not text:
        return "add", b"1 1 1.0\n"
    at, row = int(rng.integers(len(text))), int(rng.integers(len(lines)))
    where = f"{kind} at byte {at}"
    letter = LETTERS[int(rng.integers(len(LETTERS)))]
    if kind == "flip":
        return where, text[:at] + bytes([text[at] ^ 1 << int(rng.integers(8))]) + text[at + 1 :]
    if kind == "put":
        return where, text[:at] + bytes([letter]) + text[at + 1 :]
    if kind == "run":  # patterns that go back and try again take for ever
        return where, text[:at] + int(rng.integers(300, 4000)) * bytes([letter]) + text[at:]
    if kind == "insert":
        return where, text[:at] + bytes([letter]) + text[at:]
    if kind == "drop":
        return where, text[:at] + text[at + int(rng.integers(1, 4)) :]
    if kind in ("word", "count"):
        words = [m.span() for m in re.finditer(rb"[^\s,]+" if kind == "word" else rb"(?<![\w.])\d+(?![\w.])", text)]
        if not words:
            return "nothing", text
        low, high = words[int(rng.integers(len(words)))]
        if kind == "word":
            new = WORDS[int(rng.integers(len(WORDS)))]
            if rng.random() < 0.5:
                new = new.rjust(high - low)  # as fields of fixed width need it
        else:
            new = b"%d" % max(int(text[low:high]) + int(rng.choice([-1, 1, 1, 10, 65536])), 0)
            new = new.rjust(high - low)
        return f"{kind} {text[low:high]!r} to {new!r} at byte {low}", text[:low] + new + text[high:]
    if kind == "line":
        other = int(rng.integers(len(lines)))
        how = str(rng.choice(["lose", "double", "exchange", "move", "join", "split"]))
        if how == "lose":
            del lines[row]
        elif how == "double":
            lines.insert(other, lines[row])
        elif how == "exchange":
            lines[row], lines[other] = lines[other], lines[row]
        elif how == "move":
            lines.insert(other, lines.pop(row))
        elif how == "join":
            lines[row] = lines[row].rstrip(b"\r\n") + b" " * int(rng.integers(2))
        else:
            lines[row] = lines[row].replace(b" ", b"\n", 1)
        return f"{how} line {row + 1} ({other + 1})", b"".join(lines)
    if kind == "cut":
        return where, text[:at] if rng.random() < 0.7 else text[at:]
    if kind == "blanks":
        new = [b"\t", b"  ", b" , ", b"\xc2\xa0", b"\x0c"][int(rng.integers(5))]
        lines[row] = lines[row].replace(b" ", new, int(rng.integers(1, 9)))
        return f"blanks {new!r} in line {row + 1}", b"".join(lines)
    if kind == "ends":
        how = str(rng.choice(["crlf", "cr", "bom", "no end", "blank lines", "utf-16", "gap"]))
        changed = {
            "crlf": text.replace(b"\n", b"\r\n"), "cr": text.replace(b"\n", b"\r"), "bom": b"\xef\xbb\xbf" + text,
            "no end": text.rstrip(b"\n"), "blank lines": text + b"\n \n\n", "gap": text[:at] + b"\0" * 64 + text[at:],
            "utf-16": text.decode("latin-1").encode("utf-16"),
        }  # fmt: skip
        return how, changed[how]
    new = [WORDS[int(rng.integers(len(WORDS)))] + b"\n", b"\n", b"% remark\n", b"# 1\n", b"** 1\n", b"1 1 1.0\n",
           b"1 1 1 1 1\n", b"$ remark\n", b"*REMARK\n", b"\x1a", lines[-1]][int(rng.integers(11))]  # fmt: skip
    lines.insert(int(rng.choice([row, len(lines)])), new)
    return f"add {new!r}", b"".join(lines)


def damaged_bytes(good, rng):
    """A copy with a bit flipped, a byte put, bytes left out or put in, or the end cut off."""
    at, kind = int(rng.integers(len(good))), str(rng.choice(["bit", "bit", "bit", "word", "drop", "insert", "cut"]))
    if kind == "bit":
        return f"bit at {at}", good[:at] + bytes([good[at] ^ 1 << int(rng.integers(8))]) + good[at + 1 :]
    at -= at % 4
    if kind == "word":
        new = struct.pack("<i", int(rng.choice([0, 1, -1, 2, 8, 20, 2**31 - 1, -(2**31)])))
        return f"word at {at}", good[:at] + new + good[at + 4 :]
    if kind == "drop":
        return f"drop at {at}", good[:at] + good[at + 4 * int(rng.integers(1, 4)) :]
    if kind == "insert":
        return f"insert at {at}", good[:at] + bytes(4) + good[at:]
    return f"cut at {at}", good[:at]


def words_changed(good, words, rng, count):
    """Copies with a bit of one of the words of 4 bytes flipped, a word left out, or the end cut off."""
    for _ in range(count):
        word = int(rng.choice(words))
        kind = rng.choice(["bit", "bit", "bit", "drop", "cut"])
        copy = bytearray(good)
        if kind == "bit":
            copy[4 * word + int(rng.integers(4))] ^= 1 << int(rng.integers(8))
        elif kind == "drop":
            del copy[4 * word : 4 * word + 4]
        else:
            del copy[4 * word + int(rng.integers(4)) :]
        yield f"{kind} at word {word}", bytes(copy)


def lines_changed(good, rng, count):
    """Copies with a character outside of values changed or left out, lines lost, doubled or exchanged, the end cut."""
    lines = good.splitlines(keepends=True)
    for _ in range(count):
        k, other = (int(number) for number in rng.integers(len(lines), size=2))
        kind = rng.choice(["change", "change", "leave out", "lose", "double", "exchange", "cut"])
        copy = list(lines)
        words = [m.span() for m in re.finditer(rb"\S+", lines[k]) if not FLOAT.fullmatch(m.group())]
        if kind in ("change", "leave out"):
            if not words:
                continue
            at = int(rng.integers(*words[int(rng.integers(len(words)))]))
            new = bytes([lines[k][at] ^ 1 << int(rng.integers(7))]) if kind == "change" else b""
            copy[k] = lines[k][:at] + new + lines[k][at + 1 :]
        elif kind == "lose":
            del copy[k]
        elif kind == "double":
            copy.insert(k, lines[k])
        elif kind == "exchange":
            copy[k], copy[other] = lines[other], lines[k]
        else:
            copy[k:] = [lines[k][: int(rng.integers(len(lines[k])))]]
        yield f"{kind} at line {k + 1}", b"".join(copy)


def bytes_changed(good: bytes, rng) -> tuple[str, bytes]:
    """A copy of a binary file with bits flipped, a run of bytes overwritten, left out or doubled, or the end cut."""
    at = int(rng.integers(len(good)))
    length = int(rng.integers(1, 65))
    kind = str(rng.choice(["bit", "bit", "zeros", "noise", "leave out", "double", "cut", "add"]))
    run = good[at : at + length]
    new = {
        "bit": bytes([good[at] ^ 1 << int(rng.integers(8))]) + run[1:], "zeros": bytes(len(run)), "double": 2 * run,
        "noise": rng.integers(256, size=len(run), dtype=np.uint8).tobytes(), "leave out": b"", "cut": b"",
        "add": run,
    }[kind]  # fmt: skip
    if kind == "add":
        return f"add {length} bytes behind the end", good + run
    return f"{kind} at byte {at} ({len(run)})", good[:at] + new + (b"" if kind == "cut" else good[at + length :])
