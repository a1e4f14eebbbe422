"""What hpcred leaves for other programs, entries of a store, and lists of node numbers, most of them damaged."""

import functools
import tempfile
from pathlib import Path

import numpy as np

from . import readings
from .containers import is_unsealed, outcome
from .judge import Case, inside, run_good, write
from .matrices import chosen, text
from .mutations import bytes_changed, damaged_text
from .tables import BLOCK, CHORD, good_files

FORMATS = {  # of each export the file that it is told by, of a body in interface coordinates
    "sid": "a.SID_FEM", "npz": "a.npz", "matlab": "a.mat", "exudyn": "a.npy", "mbdyn": "a.fem", "fmu": "a.fmu",
    "statespace-mat": "a.mat", "statespace-npz": "a.npz", "vtk": "a.vtu", "uff": "a.unv", "nastran": "a.bdf",
    "nastran-op4": "a.bdf", "ansys": "a.inp", "abaqus": "a.inp", "mbsim": "a.hdf5",
}  # fmt: skip
HEAD = 'output = "new.h5"\n'
JOINTED = HEAD + 'coordinates = "interface"\n' + BLOCK + '[[basis]]\nkind = "constraint_modes"\n' \
          '[[basis]]\nkind = "fixed_interface_modes"\ncount = 2\n'  # fmt: skip
# of a body without double modes, whose shapes ranks could turn
STORED = HEAD + 'model = "model.h5"\nstore = "points"\ninputs = [[20, "z"]]\n' + CHORD + \
         '[[basis]]\nkind = "krylov"\nfrequency = 100.0\norder = 2\n[[basis]]\nkind = "modes"\ncount = 2\n'  # fmt: skip
NUMBERED = HEAD + 'coordinates = "interface"\nmodel = "block.h5"\n[[interface]]\nname = "end"\nnodes = {}\n' \
           '[[basis]]\nkind = "constraint_modes"\n'  # fmt: skip


@functools.cache
def _of_run(job, *commands) -> dict[str, bytes]:
    """The folder after a job and some commands, by name in it."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        write(Case("", {**good_files(), "new.toml": job.encode()}, [], None, outcome), Path(name))
        run_good(["reduce", "new.toml"])
        for command in commands:
            run_good(list(command))
        return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def exported(rng, kind):
    """A file of an export: what info says of it is not judged, only how it ends."""
    name = chosen(rng, *FORMATS)
    files = _of_run(JOINTED, ("export", "new.h5", "--format", name, "-o", FORMATS[name]))
    made = sorted(file for file in files if file.startswith(("a.", "a_")))
    which = chosen(rng, *made)
    binary = b"\0" in files[which]
    note, content = ("good", files[which]) if rng.random() < 0.125 else \
        (bytes_changed if binary else damaged_text)(files[which], rng)  # fmt: skip
    command = ["info", which, "--json", "out.json"]
    return Case(f"{name}, {which}: {note}", {**{item: files[item] for item in made}, which: content}, command, {},
                lambda folder: {}, note == "good")  # fmt: skip


def stored(rng, kind):
    """A run whose store has a damaged entry gives what it gives without a store, and replaces it where its seal is
    broken."""
    files = _of_run(STORED)
    which = chosen(rng, *sorted(file for file in files if file.startswith("points/") and file.endswith(".h5")))
    note, content = bytes_changed(files[which], rng)
    kept = {name: item for name, item in files.items() if name != "new.h5"}
    expected = _numbers(files["new.h5"])
    if is_unsealed(files[which], content):
        expected["replaced"] = np.array(True)

    def read(folder):
        return outcome(folder) | {"replaced": np.array((folder / which).read_bytes() != content)}

    return Case(f"{which}: {note}", {**kept, which: content}, ["reduce", "new.toml"], expected, read, True, which)


def _numbers(result: bytes):
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "new.h5").write_bytes(result)
        return outcome(Path(name))


def numbered(rng, kind):
    """Nodes of an interface in a text give what the same numbers in the job give."""
    labels = rng.permutation(np.arange(1, 17))[: int(rng.integers(3, 8))].astype(str)
    lines = [chosen(rng, " ", ", ", "\t").join(part) for part in np.array_split(labels, int(rng.integers(1, 4)))]
    good = text(["# nodes"] * int(rng.integers(2)) + lines, rng)
    note, content = ("good", good) if rng.random() < 0.125 else damaged_text(good, rng)
    try:
        found = [readings.whole(word, 1, readings.LARGEST_LABEL)
                 for line in readings.lines_of(content) for word in readings.words_of(line)]  # fmt: skip
        readings.require(found, "nothing")
        expected = _numbers(_of_run(NUMBERED.replace("{}", str(found)))["new.h5"])
    except (readings.Nonsense, AssertionError):
        expected = None
    files = {"block.h5": good_files()["block.h5"], "new.toml": NUMBERED.replace("{}", '"list.txt"').encode()}
    return Case(f"list.txt: {note}", {**files, "list.txt": content}, ["reduce", "new.toml"], expected, outcome,
                note == "good" and expected is not None)  # fmt: skip


KINDS = {"exports": exported, "point store": stored, "node numbers": numbered}
