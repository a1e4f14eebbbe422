"""Damage to the HDF5 files of hpcred: cases of every command that reads them leave, judged by what the good file gives.
"""

import functools
import io
import json
import re
import tempfile
from pathlib import Path

import h5py
import numpy as np

from .judge import Case, inside, run_good, write
from .mutations import bytes_changed
from .tables import good_files

BEAM = 'model = "model.h5"\noutput = "new.h5"\ninputs = [[20, "z"]]\n[frame]\nkind = "buckens"\n' \
       '[[basis]]\nkind = "modes"\nindex = [7, 8]\n[[basis]]\nkind = "krylov"\nfrequency = 10.0\n'  # fmt: skip
MOTION = 'body = "result.h5"\nend = 0.01\nsteps = 2\nobserve = [20]\ngravity = [0.0, 0.0, -9.81]\n'
COMMANDS = {
    "model.h5": ["reduce beam.toml", "reduce beam.toml", "info model.h5 --json out.json",
                 "response model.h5 --frame buckens --frequencies 10,20 --inputs 20:z -o out.csv"],
    "result.h5": ["info result.h5 --json out.json", "export result.h5 --format npz -o out.npz",
                  "export result.h5 --format sid -o out.SID_FEM", "evaluate result.h5 --frequencies 10,20 -o out.csv",
                  "simulate motion.toml"],
    "responses.h5": ["info responses.h5 --json out.json"], "motion.h5": ["info motion.h5 --json out.json"],
}  # fmt: skip

SEAL_END = 28  # bytes: the length of the seal in 8, its CRC-32 in 4, and 16 that say that it is one


def outcome(folder: Path) -> dict[str, np.ndarray]:
    """All numbers that a command wrote, by the name of the file and the place in it."""
    found = {}
    for path in sorted(folder.glob("*")):
        if path.name in ("new.h5", "simulation.h5"):
            with h5py.File(path) as file:
                found |= {name: file[name][...] for name in datasets(file) if file[name].dtype.kind in "fiu"
                          and not name.startswith("checksums/")}  # of the record, which has the date  # fmt: skip
        elif path.suffix == ".npz" and path.name == "out.npz":
            with np.load(path) as arrays:
                found |= {name: arrays[name] for name in arrays.files if arrays[name].dtype.kind in "fiu"}
        elif path.suffix == ".json":
            text = re.sub(r'"(?:date|seconds|timing|memory\w*)": [^,}]*', "", json.dumps(json.loads(path.read_bytes())))
            found["json"] = np.array(text)
        elif path.name in ("out.csv", "out.SID_FEM"):
            words = re.findall(r"-?\d+\.\d+(?:[eE][+-]?\d+)?", path.read_text().replace("D", "E"))
            found[path.name] = np.array([float(word) for word in words])
    return found


def datasets(file) -> list[str]:
    names = []
    file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    return names


@functools.cache
def expected(command: str) -> dict[str, np.ndarray]:
    """What the command gives for the good files."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        write(Case("", files(), [], None, outcome), Path(name))
        run_good(command.split())
        found = outcome(Path(name))
    assert found, command
    return found


def files():
    return {**good_files(), "beam.toml": BEAM.encode(), "motion.toml": MOTION.encode(), **outputs()}


@functools.cache
def outputs() -> dict[str, bytes]:
    """A file of responses and one of a motion."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        write(Case("", {**good_files(), "motion.toml": MOTION.encode()}, [], None, outcome), Path(name))
        run_good(["evaluate", "result.h5", "--frequencies", "10,20", "-o", "responses.h5"])
        run_good(["simulate", "motion.toml"])
        made = {"responses.h5": "responses.h5", "motion.h5": "simulation.h5"}
        return {name: Path(path).read_bytes() for name, path in made.items()}


def edited(good: bytes, rng) -> tuple[str, bytes]:
    """A copy in which one dataset or attribute is missing, of another shape or type, or has another number."""
    memory = io.BytesIO(good)
    with h5py.File(memory, "r+") as file:
        names = []
        file.visititems(lambda name, item: names.append(name))
        name = names[int(rng.integers(len(names)))]
        item = file[name]
        how = str(rng.choice(["delete", "attribute", "shape", "type", "number", "number", "nan", "empty", "rename"]))
        if how == "attribute":
            name = list(file.attrs)[int(rng.integers(len(file.attrs)))]
            value = [None, -1, 0, 10**9, "x", np.nan, [1, 2], 1.5][int(rng.integers(8))]
            if value is None:
                del file.attrs[name]
            else:
                file.attrs[name] = value
            return f"attribute {name} = {value!r}", closed(file, memory)
        if how == "rename":
            file.move(name, name + "x")
        elif how == "delete" or not isinstance(item, h5py.Dataset):
            del file[name]
        else:
            values = item[...]
            if how in ("number", "nan") and values.size and values.dtype.kind in "fiu":
                flat = values.reshape(-1)
                at = int(rng.integers(flat.size))
                with np.errstate(invalid="ignore"):
                    flat[at] = np.nan if how == "nan" and values.dtype.kind == "f" else flat[at] * 2 + 1
                item[...] = flat.reshape(values.shape)
                return f"{how} in {name}", closed(file, memory)
            attributes = dict(item.attrs)
            del file[name]
            other = {
                "shape": lambda: np.concatenate([np.atleast_1d(values)] * 2), "empty": lambda: np.zeros(0),
                "type": lambda: values.astype("f4") if values.dtype.kind == "f" else np.array(["text"], "S"),
            }.get(how, lambda: np.atleast_1d(values)[:-1])()  # fmt: skip
            file.create_dataset(name, data=other)
            file[name].attrs.update(attributes)
        return f"{how} {name}", closed(file, memory)


def closed(file, memory):
    file.close()
    return memory.getvalue()


def places(good: bytes) -> list[tuple[int, int]]:
    """Where the datasets of a file stand: first byte, byte behind the last."""
    with h5py.File(io.BytesIO(good), "r") as file:
        found = [(file[name].id.get_offset(), file[name].id.get_storage_size()) for name in datasets(file)]
    return [(first, first + size) for first, size in found if first is not None]


def elsewhere(good: bytes) -> np.ndarray:
    """The places of the bytes that are of no dataset: what HDF5 keeps of its own, and the seal but for its end."""
    own = np.ones(len(good) - SEAL_END, dtype=bool)
    for first, last in places(good):
        own[first:last] = False
    return np.flatnonzero(own)


def is_unsealed(good: bytes, changed: bytes) -> bool:
    """Whether a file that says that it is sealed has other bytes of its own than the good one, and must be refused."""
    if not changed.endswith(good[-SEAL_END:]) or changed == good:
        return False  # as of a file that another program wrote again
    own = elsewhere(good)
    return len(changed) != len(good) or any(changed[k] != good[k] for k in own.tolist())


def own_changed(good: bytes, rng) -> tuple[str, bytes]:
    """A copy with a bit flipped in a byte that is of no dataset."""
    own = elsewhere(good)
    at = int(own[int(rng.integers(len(own)))])
    return f"bit of HDF5 at byte {at}", good[:at] + bytes([good[at] ^ 1 << int(rng.integers(8))]) + good[at + 1 :]


def damaged(kind, command, note, changed) -> Case:
    """A command with one file changed; of what is of no dataset nothing may be, and nothing else may be believed."""
    all_files = files()
    wanted = None if is_unsealed(all_files[kind], changed) else expected(command)
    return Case(f"{kind}: {note}; {command}", {**all_files, kind: changed}, command.split(), wanted, outcome)


def case(rng, kind):
    command = COMMANDS[kind][int(rng.integers(len(COMMANDS[kind])))]
    damage = (bytes_changed, bytes_changed, own_changed, edited, edited)[int(rng.integers(5))]
    return damaged(kind, command, *damage(files()[kind], rng))


KINDS = dict.fromkeys(COMMANDS, case)
