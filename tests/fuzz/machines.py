"""Files of machines and of what drives a body: machine.toml, measured bodies, superelements, tables of loads.

Tables of loads have a second reading of their numbers; heads are judged by what a plain table with them gives. Measured
bodies and superelements have no second reading, but an archive, whose sums tell: there only how a command ends counts.
"""

import csv
import functools
import io
import re
import tempfile
from pathlib import Path

import numpy as np
import scipy.io

from .beside import _of_run
from .judge import REFUSED, Case, inside, run_case, run_good, write
from .matrices import chosen
from .mutations import bytes_changed, damaged_text
from .readings import Nonsense, require
from .tables import BLOCK, MODES, case, no_echo

HEAD = 'output = "new.h5"\ndamping = {kind = "rayleigh", alpha = 2.0, beta = 1e-6}\n'
JOINTED = f"""{HEAD}coordinates = "interface"
{BLOCK}[[basis]]
kind = "constraint_modes"
[[basis]]
kind = "fixed_interface_modes"
count = 2
"""
DRIVEN = f"""{HEAD}model = "block.h5"
inputs = [[5, "x"]]
outputs = [[5, "x"], {{node = 5, direction = "z", quantity = "acceleration"}}]
[[base]]
on = {{box = [[0.039, -1.0, -1.0], [0.041, 1.0, 1.0]]}}
directions = ["z"]
{MODES}"""
TWO = '[[body]]\nname = "a"\nresult = "new.h5"\n[[body]]\nname = "b"\nresult = "{}"\n'
MACHINES = [
    TWO.format("new.h5") + 'turn = {axis = "z", degrees = 90.0}\nposition = [0.0, 0.0, 0.1]\nnodes = {foot = 21}\n'
    '[[joint]]\nkind = "rigid"\nbodies = ["a.end", "b.foot"]\n[[mass]]\nat = "a.end"\nmass = 0.1\n',
    TWO.format("new.h5") + '[[joint]]\nkind = "bushing"\nbodies = ["a.end", "ground"]\nstiffness = [1e4, 1e4, 1e4]\n'
    'damping = [1.0, 1.0, 1.0]\nlaw = {kind = "maxwell", factors = [0.5], times = [1e-3]}\n',
    'band = [0.0, 100.0]\n' + TWO.format("new.h5") + '[[joint]]\nkind = "bushing"\nbodies = ["a.end", "b.end"]\n'
    'table = "bushing.csv"\nat = {amplitude = 1.5}\n',
]  # fmt: skip
MEASURED = 'output = "out.csv"\n' + TWO.format("tool.{}") + 'kind = "measured"\n[[joint]]\nkind = "bushing"\n' \
           'bodies = ["a.end", "b.foot"]\nstiffness = [1e4, 1e4, 1e4]\n'  # fmt: skip
BUSHING = "f_hz,amplitude,re_x,im_x\n" + "".join(f"{f},{a},{1e4 + f},{a}\n" for a in (1, 2) for f in (0, 1000))
DRIVES = {
    "psd": ["f [Hz],base:z [g^2/Hz]", "f [Hz],5:x [N^2/Hz],base:z [(m/s^2)^2/Hz],5:x/base:z coherence [1]"],
    "harmonic": ["f [Hz],base:z [g],base:z phase [deg]", "f [Hz],5:x [kN],base:z [mm]"],
    "srs": ["t [s],base:z [m/s^2]", "t [s],base:z [g],5:x [N]"],
}  # fmt: skip
NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", re.ASCII)


@functools.cache
def _tool() -> dict[str, bytes]:
    """The responses of a mass, in three formats."""
    from hpcred.files.frf_file import write_frf
    from hpcred.files.response_file import Responses

    f, names = np.linspace(10.0, 100.0, 5), ["foot:x", "foot:y", "foot:z"]
    H = np.eye(3) / (-10.0 * (2 * np.pi * f[:, None, None]) ** 2 + 1e4j)
    found = Responses(frequencies=f, input_names=tuple(names), output_names=tuple(names), response=H,
                      places={"foot": (3, np.array([0.04, 0.005, 0.005]))})  # fmt: skip
    with tempfile.TemporaryDirectory() as name, inside(name):
        write_frf("tool.unv", found, H, False)
        write_frf("tool.npz", found, H, True)
        cells = np.array(names, dtype=object)
        scipy.io.savemat("tool.mat", {"frequencies": f, "H": H, "input_names": cells, "output_names": cells})
        return {path.name: path.read_bytes() for path in Path().iterdir()}


def machine(rng, kind):
    from hpcred.settings.machine_file import MachineJob

    made = case(rng, MachineJob, MACHINES, "fuzz.toml", ["assemble", "fuzz.toml"], no_echo)
    made.files |= {"new.h5": _of_run(JOINTED)["new.h5"], "bushing.csv": BUSHING.encode()}
    return made


def measured(rng, kind):
    name = chosen(rng, *_tool())
    job = MEASURED.format(name.rpartition(".")[2]).encode()
    good = _tool()[name]
    note, content = ("good", good) if rng.random() < 0.125 else bytes_changed(good, rng)
    files = {"new.h5": _of_run(JOINTED)["new.h5"], "fuzz.toml": job, name: content}
    of_good = _numbers({**files, name: good}, ("assemble", "fuzz.toml")) if name.endswith(".npz") else {}
    return Case(f"{name}: {note}", files, ["assemble", "fuzz.toml"], of_good, _table, note == "good")


def bushing(rng, kind):
    """A table of a joint over frequency: how the command ends."""
    note, content = damaged_text(BUSHING.encode(), rng)
    files = {"new.h5": _of_run(JOINTED)["new.h5"], "fuzz.toml": MACHINES[2].encode(), "bushing.csv": content}
    return Case(note, files, ["assemble", "fuzz.toml"], {}, lambda folder: {})


def superelement(rng, kind):
    name = chosen(rng, "abaqus", "nastran")
    ending = {"abaqus": "inp", "nastran": "bdf"}[name]
    good = _of_run(JOINTED, ("export", "new.h5", "--format", name, "-o", f"a.{ending}"))[f"a.{ending}"]
    note, content = ("good", good) if rng.random() < 0.125 else damaged_text(good, rng)
    command = ["convert", f"a.{ending}", "out.h5", "--superelement"]
    return Case(f"{name}: {note}", {f"a.{ending}": content}, command, {}, lambda folder: {}, note == "good")


def drive(rng, kind):
    """A table of loads gives what a plain one with the same heads and numbers gives."""
    option = chosen(rng, *DRIVES)
    head, rows = chosen(rng, *DRIVES[option]), int(rng.integers(2, 6))
    first = np.sort(rng.uniform(1.0, 500.0, rows)) * (1e-4 if option == "srs" else 1.0)
    table = np.column_stack([first, rng.uniform(0.0, 1.0, (rows, head.count(",")))])
    lines = [head, *(", ".join(f"{value:.6g}" for value in row) for row in table)]
    good = "".join(f"{line}\n" for line in lines).encode()
    note, content = ("good", good) if rng.random() < 0.125 else damaged_text(good, rng)
    command = ("response", "new.h5", f"--{option}", "drive.csv", "-o", "out.csv")
    result = _of_run(DRIVEN)["new.h5"]
    try:
        expected = _numbers({"new.h5": result, "drive.csv": _plain(content)}, command)
    except (Nonsense, UnicodeDecodeError, csv.Error):
        expected = None
    files = {"new.h5": result, "drive.csv": content}
    return Case(f"{option}: {note}", files, list(command), expected, _table, note == "good")


def _plain(content: bytes) -> bytes:
    """A table of loads with each number in one form. Raises Nonsense where one is none."""
    require(content.endswith(b"\n"), "no end")
    text = content.decode("utf-8-sig")
    rows = [row for row in csv.reader(io.StringIO(text, newline=""))
            if row and not row[0].lstrip().startswith(("#", "%", "**"))]  # fmt: skip
    require(rows, "no head")
    for row in rows[1:]:
        require(all(NUMBER.fullmatch(cell) for cell in row), "no number")
    lines, file = [rows[0], *([float(cell) for cell in row] for row in rows[1:])], io.StringIO()
    require(all(value == 0 or 1e-200 <= abs(value) <= 1e30 for row in lines[1:] for value in row), "beyond all units")
    csv.writer(file, lineterminator="\n").writerows(lines)
    return file.getvalue().encode()


def _numbers(files, command):
    """What a command writes for good files, or None where it refuses them."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        made = Case("", files, list(command), {}, lambda folder: {})
        if run_case(made)[0] == REFUSED:
            return None
        write(made, Path(name))
        run_good(made.command)
        return _table(Path(name))


def _table(folder: Path):
    with open(folder / "out.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    return {"heads": np.array(rows[0]), "numbers": np.array(rows[1:], dtype=float)}


KINDS = {"machine.toml": machine, "measured": measured, "joint table": bushing, "superelement": superelement,
         "drive table": drive}  # fmt: skip
