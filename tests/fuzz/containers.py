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


def case(rng, kind):
    command = COMMANDS[kind][int(rng.integers(len(COMMANDS[kind])))]
    all_files = files()
    note, changed = (bytes_changed if rng.random() < 0.5 else edited)(all_files[kind], rng)
    content = {**all_files, kind: changed}
    return Case(f"{kind}: {note}; {command}", content, command.split(), expected(command), outcome)


KINDS = dict.fromkeys(COMMANDS, case)
