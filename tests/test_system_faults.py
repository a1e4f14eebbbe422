"""Failures of system calls (open, read, write, truncate, rename, memory, ...) end in one sentence with the file's name,
limits of files and memory in one sentence.

system_faults.c, loaded ahead of all libraries, lets one call on a file of the working folder fail.
"""

import errno
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import MODES_JOB, SIMULATION, to_dense
from launch import mpi_environment

import hpcred as package
from hpcred.files.checked import CHECKSUM
from hpcred.files.locks import Taken
from hpcred.files.room import NoRoom
from hpcred.writers.registry import WRITERS

SOURCE = Path(__file__).with_name("system_faults.c")
SUPERELEMENT_JOB = """
model = "model.h5"
output = "bearings.h5"
coordinates = "interface"
frame = {kind = "buckens"}
interface = [{name = "end", nodes = [20], kind = "rigid"}]
[[basis]]
kind = "craig_bampton"
count = 3
"""
SWEEP = """
job = "job.toml"
[[vary]]
key = "damping.alpha"
values = [1.0, 2.0]
[evaluate]
points = 3
band = [1.0, 50.0]
[launch]
launcher = ""
"""
MACHINE = """
output = "machine.h5"
[[body]]
name = "link"
result = "bearings.h5"
[[mass]]
at = "link.end"
mass = 0.1
"""
MEASURED = """
output = "coupled.csv"
[[body]]
name = "tool"
kind = "measured"
result = "tool.npz"
[[body]]
name = "link"
result = "bearings.h5"
[[joint]]
bodies = ["link.end", "tool.end"]
kind = "bushing"
stiffness = [1e4, 0.0, 0.0]
"""
SUPERELEMENTS = [export.name for export in WRITERS.all() if export.needs == "superelement"]
COMMANDS = {
    "convert": "convert -K K.mtx -M M.mtx --nodes nodes.txt --dofs dofs.txt --inputs 20:z -o c.h5 --json c.json",
    "reduce": "reduce job.toml --json r.json",
    "bearings": "reduce bearings.toml",
    "store": "reduce job.toml --store points",
    "list": "store points --check --json s.json",
    "evaluate": "evaluate result.h5 --full model.h5 --frequencies 10,150 -o e.h5 --figure e.png",
    "response": "response model.h5 --frequencies 10,150 --frame buckens --damping loss:0.01 -o y.csv --figure y.svg",
    "modes": "modes model.h5 --count 8 --figure m.png",
    "plan": "plan job.toml --json p.json",
    "assemble": "assemble machine.toml --json a.json",
    "measured": "assemble measured.toml",
    "simulate": "simulate sim.toml --set paraview=true",
    "recover": "recover result.h5 simulation.h5 -o motion.pvd",
    "recover-h5": "recover result.h5 simulation.h5 -o motion.h5",
    "report": "report result.h5 --full model.h5 --solves 2 --csv tables --png figures -o r.html",
    "sweep": "sweep sweep.toml --json w.json",
    "collect": "collect sweep.toml -o table.csv --figures figures",
    "collect-h5": "collect sweep.toml -o table.h5",
    "info": "info model.h5 --json i.json",
    **{f"export-{name}": f"export {'bearings' if name in SUPERELEMENTS else 'result'}.h5 --format {name}"
       for name in (entry.name for entry in WRITERS.own)},
}  # fmt: skip
FIRST = ("reduce", "bearings", "store", "simulate", "recover", "sweep")  # others need their outputs
ALONE = ("sweep", "collect", "collect-h5")  # without mpiexec
ERRORS = {
    "open": "EIO EACCES EMFILE ENFILE ENOMEM ESTALE", "create": "EIO EACCES ENOSPC EROFS EDQUOT EMFILE ENOMEM",
    "read": "EIO EINVAL ESTALE", "write": "EIO EINVAL ENOSPC EDQUOT EFBIG ESTALE", "truncate": "EIO EROFS EPERM",
    "allocate": "EIO ENOSPC EOPNOTSUPP", "rename": "EIO EACCES EROFS ENOSPC EXDEV", "remove": "EIO EACCES EROFS EBUSY",
    "mkdir": "EIO EACCES ENOSPC EROFS", "sync": "EIO ENOSPC EDQUOT", "lock": "ENOLCK EIO", "memory": "ENOMEM",
    "size": "EFBIG", "space": "ENOMEM",
}  # fmt: skip
LIMITS = {"size": (1, 200_000), "space": (100, 1500)}  # of files in bytes, of addresses in MB, from the start on
OUT_OF_MEMORY = "out of memory|more memory than this process may take"  # the latter where a library is being loaded
LIMIT = 300  # seconds of a command on a busy machine, or five times what it took there without a fault
ABORTED = (-6, -11, 134, 139, 157)  # exit status, also of mpiexec, of a process that a library ends: by SIGABRT,
# by SIGSEGV, or SCOTCH by MPI_Abort where it gets no thread


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """system_faults.c as a shared library."""
    if sys.platform != "linux" or shutil.which("cc") is None:
        pytest.skip("faults of system calls need Linux and a compiler")
    path = tmp_path_factory.mktemp("library") / "system_faults.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", path, SOURCE, "-ldl"], check=True)
    return path


@pytest.fixture(scope="module")
def few(library, tmp_path_factory):
    return Room(library, tmp_path_factory.mktemp("few"), ["reduce", "export-npz"])


class Room:
    """A folder with all that the commands read, and wrote once, and copies of it in which calls fail."""

    def __init__(self, library, place, commands=None):
        self.library, self.base, self.copy = library, place / "base", place / "copy"
        self.rescue, self.record, self.calls, self.limits = place / "rescue", place / "record", {}, {}
        for folder in (self.base, self.rescue):
            folder.mkdir()
        make_inputs(self.base)
        self.inputs = set(contents(self.base))
        for command in commands or COMMANDS:
            self.calls[command, 1] = self._counted(self.base, command, 1)

    def run(self, folder, command, ranks, limit=LIMIT, **environment):
        """Exit status (None where it hangs), lines of hpcred on stderr, and all of stderr."""
        launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
        if environment:
            environment |= {"LD_PRELOAD": str(self.library), "FAULTS_RECORD": str(self.record)}
        job = subprocess.Popen(
            [*launcher, sys.executable, "-m", "hpcred", *COMMANDS[command].split()], cwd=folder, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            env=mpi_environment(HPCRED_RESCUE_DIR=str(self.rescue), FAULTS_FOLDER=str(folder), **environment),
        )  # fmt: skip
        try:
            told, status = job.communicate(timeout=limit)[1], job.returncode
        except subprocess.TimeoutExpired:
            job.terminate()
            told, status = job.communicate()[1], None
        said = [line for line in told.splitlines() if line.startswith("hpcred: ")]
        # on a busy machine rank 0 hears how MPI ends it when the other rank has failed
        return status, [line for line in said if line != "hpcred: terminated (rank 0)"] or said, told

    def fresh(self, command):
        """A copy of the folder, in which the command has something to do."""
        shutil.rmtree(self.copy, ignore_errors=True)
        shutil.copytree(self.base, self.copy)
        done = {"sweep": "sweep/*.h5", "store": "points/*"}.get(command, "-")
        for path in [*self.rescue.iterdir(), *self.copy.glob(done)]:
            path.unlink()
        self.record.unlink(missing_ok=True)
        return self.copy

    def calls_of(self, command, ranks):
        """How many calls of each kind the last rank makes."""
        if (command, ranks) not in self.calls:
            self.calls[command, ranks] = self._counted(self.fresh(command), command, ranks)
        return self.calls[command, ranks]

    def _counted(self, folder, command, ranks):
        """Run a command that must succeed, and count the calls of its last rank."""
        self.record.unlink(missing_ok=True)
        begun = time.monotonic()
        status, _, told = self.run(folder, command, ranks, 10 * LIMIT, FAULTS_RANK=only(ranks, ranks - 1))
        self.limits[command, ranks] = max(LIMIT, 5 * (time.monotonic() - begun))
        assert status == 0, (command, ranks, told)
        lines = self.record.read_text().splitlines() if self.record.exists() else []
        counts = Counter(line.split()[0] for line in lines)
        calls = {kind: count * (100 if kind == "memory" else 1) for kind, count in counts.items()}
        return {**calls, **{kind: most for kind, (_, most) in LIMITS.items()}} if calls else {}

    def misfortunes(self, fault):
        """What is wrong after a fault, in words, and what was said."""
        folder = self.fresh(fault.command)
        before = contents(folder)
        limit = self.limits.get((fault.command, fault.ranks), LIMIT)
        status, said, told = self.run(
            folder, fault.command, fault.ranks, limit, FAULTS_RANK=only(fault.ranks, fault.rank),
            FAULT=f"{fault.kind},{fault.number},{getattr(errno, fault.error)},{fault.name}",
        )  # fmt: skip
        if not self.record.exists():
            return [], "did not come to pass"
        files = [Path(line.split(maxsplit=1)[1]) for line in self.record.read_text().splitlines()]
        after, found = contents(folder), []
        left = after
        # Open MPI does not live without files and memory of its own, and says so before hpcred starts
        alone = re.search("PMIX|mca_(base|btl)|MPI_INIT", told)
        silent = fault.kind in LIMITS and fault.ranks > 1 and not said and alone
        by_library = fault.kind in ("memory", "space") or (fault.kind == "size" and "libmpi" in told)
        killed = by_library and status in ABORTED and "internal error" not in told
        if status is None:
            found.append("hangs")
        elif killed:
            # by a library that does not live without memory, such as NumPy's buffers: the next run removes what it
            # left, as after any other kill
            status, _, told = self.run(folder, fault.command, fault.ranks, limit)
            found += [f"exit status {status} of the next run: {told[-1500:]}"] if status else []
            left = contents(folder)
        elif status not in (0, 1, 2, Taken.exit_status, NoRoom.exit_status):
            found.append(f"exit status {status}: {told[-1500:]}")
        elif status and not silent and (len(said) != 1 or "internal error" in told or "Traceback" in told):
            found.append(told[-1500:])
        elif status and fault.kind not in ("memory", *LIMITS) and not any(plain(file) in said[0] for file in files):
            found.append(f"no name: {said[0]}")
        elif not status and (said or "Traceback" in told):
            found.append(told[-1500:])
        known = set(contents(self.base))
        if fault.kind != "remove":
            found += [f"left {name}" for name in set(left) - known]
        for name in before:
            if name in self.inputs and after.get(name) != before[name]:
                found.append(f"damaged {name}")
            elif name not in after or not (name.endswith(".log") or whole(folder / name, before[name])):
                found.append(f"lost {name}")
        name = files[0].name
        return [f"{fault}, {name}: {item}" for item in found], f"{name}: {status} {(said or [''])[0]}"


class Fault(NamedTuple):
    """The call of a kind, on files with such a name, that fails, by its number; with + all from it on fail."""

    command: str
    ranks: int
    rank: int
    kind: str
    number: str
    error: str
    name: str = ""


def make_inputs(folder):
    with package.linkage() as model:
        package.write_model(folder / "model.h5", model)
        for key in "KM":
            scipy.io.mmwrite(folder / f"{key}.mtx", scipy.sparse.coo_matrix(to_dense(getattr(model, key))))
        node, direction, position = model.dofs.node, model.dofs.direction, model.dofs.position
        first = np.unique(node, return_index=True)[1]
        np.savetxt(folder / "dofs.txt", np.column_stack([node, direction + 1]), fmt="%d")
        np.savetxt(folder / "nodes.txt", np.column_stack([node[first], position[first]]), fmt="%d %.9g %.9g %.9g")
    (folder / "job.toml").write_text(MODES_JOB)
    (folder / "bearings.toml").write_text(SUPERELEMENT_JOB)
    (folder / "machine.toml").write_text(MACHINE)
    (folder / "measured.toml").write_text(MEASURED)
    np.savez(folder / "tool.npz", frequencies=[10.0, 20.0], H=np.full((2, 1, 1), 1e-5), input_names=["end:x"],
             output_names=["end:x"])  # fmt: skip
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.002").replace("steps = 20", "steps = 2"))


def only(ranks, rank):
    return str(rank) if ranks > 1 else ""


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def plain(file):
    """The name of an output by that of its lock, of what becomes it, or of an instant of its series."""
    return re.sub(r"^\.(.*)\.lock$|^(.*)_vtu_\d+\.vtu$", r"\1\2", re.sub(r"\.tmp-.*", "", file.name))


def whole(path, before):
    """Whether an output that may have been replaced is complete."""
    if path.suffix == ".h5":
        with h5py.File(path, "r") as file:
            return CHECKSUM in file.attrs or "checksum" in file.attrs
    return path.stat().st_size > 0.8 * len(before)


def sample(room, count, seed, commands=tuple(COMMANDS)):
    """Faults of commands, ranks, kinds, calls and errors drawn at random."""
    draw = random.Random(seed)
    for _ in range(count):
        calls = {}
        while not calls:  # of a rank that touches no file
            command = draw.choice(commands)
            ranks = 1 if command in ALONE else draw.choice([1, 2])
            calls = room.calls_of(command, ranks)
        kind = draw.choice(sorted(calls))
        if kind in LIMITS:
            least, most = LIMITS[kind]
            number = f"{least * (most / least) ** draw.random():.0f}"
        else:
            number = draw.choice([1, calls[kind], draw.randint(1, calls[kind])])
            number = f"{number}{draw.choice(['', '', '+'])}"
        yield Fault(command, ranks, ranks - 1, kind, number, draw.choice(ERRORS[kind].split()))


NOT_WRITTEN = "./result.h5: cannot be written (Input/output error)"


def later(*case):
    return pytest.param(*case, marks=pytest.mark.slow)


@pytest.mark.parametrize("fault, sentence", [
    (("reduce", 1, 0, "open", "1", "EACCES", "job.toml"), "job.toml: cannot be read (Permission denied)"),
    later(("reduce", 2, 1, "read", "5+", "EIO", "model.h5"), "model.h5: cannot be read (Input/output error)"),
    (("reduce", 1, 0, "write", "10+", "EIO", "result.h5.tmp"), NOT_WRITTEN),
    later(("reduce", 1, 0, "write", "18+", "EIO", "result.h5.tmp"), NOT_WRITTEN),
    later(("reduce", 2, 0, "write", "20+", "EIO", "result.h5.tmp"), NOT_WRITTEN),
    (("reduce", 2, 1, "write", "3", "EIO", "result.h5.tmp"), "output ./result.h5: cannot be written ("),
    (("reduce", 1, 0, "rename", "1+", "EROFS", "result.h5"), "./result.h5: cannot be written (Read-only file system)"),
    (("export-npz", 1, 0, "write", "1", "ESTALE", "npz.tmp"), "result.npz: cannot be written (Stale file handle)"),
    later(("export-npz", 1, 0, "sync", "1", "EDQUOT"), "output result.npz: the disk is full"),
    later(("export-npz", 2, 0, "read", "1+", "EIO", "result.h5"), "result.h5: cannot be read (Input/output error)"),
    (("export-npz", 1, 0, "memory", "200+", "ENOMEM"), OUT_OF_MEMORY),
], ids=lambda item: item if isinstance(item, str) else "")  # fmt: skip
def test_a_fault_is_a_sentence(few, fault, sentence):
    found, said = few.misfortunes(Fault(*fault))
    assert not found and any(words in said for words in sentence.split("|")), (found, said)


def test_a_result_that_cannot_be_written_is_written_elsewhere(few):
    found, said = few.misfortunes(Fault("reduce", 1, 0, "rename", "1+", "EROFS", "result.h5"))
    assert not found and "what was to be written is in" in said
    saved = package.read_result(few.rescue / "result.h5").reduced
    assert np.array_equal(saved.K, package.read_result(few.base / "result.h5").reduced.K)


@pytest.mark.slow
def test_faults_of_many_calls(library, tmp_path):
    """HPCRED_SYSTEM_FAULTS of them, by default 60."""
    count, seed = int(os.environ.get("HPCRED_SYSTEM_FAULTS", "60")), int(os.environ.get("HPCRED_SEED", time.time()))
    print(f"seed {seed}")
    some = random.Random(seed).sample(list(COMMANDS), min(count // 4 + 1, len(COMMANDS)))  # each takes its time first
    commands = [name for name in COMMANDS if name in (*FIRST, *some)]
    room, wrong = Room(library, tmp_path, commands), []
    for fault in sample(room, count, seed, commands):
        found, said = room.misfortunes(fault)
        wrong += found
        print(*fault, said, *found, flush=True)
    assert not wrong, "\n".join(wrong)
