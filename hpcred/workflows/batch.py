"""Write a script for SLURM or PBS that runs the jobs of a sweep file as an array, and submit it if asked."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

from mpi4py import MPI

from ..files.hdf5 import atomic_output
from ..parallel.declared import spelled
from ..parallel.failures import ComputationError, InputError
from ..settings.sweep_file import read_sweep
from .children import HPCRED
from .sweep import folder_of, refuse_ranks

SUBMIT = {"slurm": "sbatch", "pbs": "qsub"}
AGAIN = 10  # times that a job that was stopped is put into the queue again

SLURM = """#!/bin/bash
# hpcred sweep
#SBATCH --job-name={name}
#SBATCH --array=1-{shares}{at_once}
#SBATCH --nodes={nodes}
#SBATCH --ntasks={ranks}
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu={memory}M
#SBATCH --time={time}
#SBATCH --output={log}
#SBATCH --open-mode=append
#SBATCH --requeue
#SBATCH --signal=B:TERM@60
{lines}set -euo pipefail
index=${{SLURM_ARRAY_TASK_ID:?submit this script as an array, as its --array says}}
"""

PBS = """#!/bin/bash
# hpcred sweep
#PBS -N {name}
{array}#PBS -l select={nodes}:ncpus={each}:mpiprocs={each}:ompthreads=1:mem={node_memory}mb
#PBS -l walltime={time}
#PBS -o {folder}
#PBS -j oe
#PBS -r y
{lines}set -euo pipefail
index=${{PBS_ARRAY_INDEX{single}}}
"""

BODY = """{setup}export PYTHONSAFEPATH=1  # no modules of the working folder, which may be another user's
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 HDF5_USE_FILE_LOCKING=FALSE PYTHONUNBUFFERED=1
export GLIBC_TUNABLES=${{GLIBC_TUNABLES:-glibc.malloc.hugetlb=1}}  # memory in large pages, where they must be asked for

# SIGTERM comes ahead of the time limit; by USR1 the runs end after the current point, which a store keeps
{command} --index "$index" --of {shares} &
run=$!
trap 'signalled=1; kill -USR1 "$run" 2>/dev/null || true' TERM USR1
while true; do  # a signal ends `wait` before the run ends
    signalled=0 status=0
    wait "$run" || status=$?
    [ "$signalled" = 1 ] || break
done
"""

REQUEUE = """# 75: it stopped as asked; 138: it was asked before it could listen
if {{ [ "$status" = 75 ] || [ "$status" = 138 ]; }} && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {again} ]; then
    scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}"
fi
"""


@spelled
def write_script(path, kind: str, *, store=None, submit: bool = False, comm=None) -> dict:
    """Write a batch script into the folder of the results, as [launch] of a sweep file says.

    Parameters
    ----------
    path : str or PathLike
        The sweep file.
    kind : {"slurm", "pbs"}
    store : str or PathLike, optional
        As for run_sweep.
    submit : bool
        Hand it to sbatch or qsub.

    Returns
    -------
    dict
        `script`, the command that submits it, and what that said.

    Raises
    ------
    InputError, ComputationError
        For a sweep file that does not fit, and a script that is not accepted.
    """
    refuse_ranks(comm, "sweep")
    sweep = read_sweep(path, store)
    if submit and shutil.which(SUBMIT[kind]) is None:
        raise InputError(f"--submit: there is no {SUBMIT[kind]} on this machine")
    with folder_of(sweep):
        script = sweep.folder / f"{sweep.path.stem}.{kind}"
        with atomic_output(script, MPI.COMM_SELF) as temporary:
            temporary.write_text(script_of(sweep, kind, store), encoding="utf-8")
        command, answer = [SUBMIT[kind], str(script)], None
        if submit:
            # Python's own environment: MPI has put into that of the process what the ranks of the job must not find
            run = subprocess.run(
                command, capture_output=True, text=True, stdin=subprocess.DEVNULL, env=dict(os.environ)
            )
            if run.returncode:
                raise ComputationError(f"{SUBMIT[kind]} {script}: {(run.stderr or run.stdout).strip()}")
            answer = run.stdout.strip()
        return {"script": str(script), "command": shlex.join(command), "said": answer}


def script_of(sweep, kind, store=None) -> str:
    """Return the text of an array script of a Sweep."""
    launch = sweep.launch
    shares = min(launch.shares or len(sweep.runs), len(sweep.runs))
    directive = "#SBATCH" if kind == "slurm" else "#PBS"
    lines = list(launch.lines)
    if launch.account:
        lines.insert(0, f"{directive} {'--account=' if kind == 'slurm' else '-A '}{launch.account}")
    if launch.partition:
        lines.insert(0, f"{directive} {'--partition=' if kind == 'slurm' else '-q '}{launch.partition}")
    setup = [f"module load {name}" for name in launch.modules] + list(launch.setup)
    setup += [f"export {name}={shlex.quote(value)}" for name, value in launch.environment.items()]
    command = [*HPCRED, "sweep", str(sweep.path.absolute())]
    command += ["--store", str(Path(store).absolute())] if store else []
    folder, each = sweep.folder.absolute(), launch.ranks // launch.nodes
    at_once = f"%{launch.at_once}" if launch.at_once else ""
    if any(character in str(folder) for character in '\n"\\'):
        raise InputError(f"output {folder}: quotation marks, backslashes and line breaks cannot stand in the head of a "
                         "batch script; choose another folder")
    values = {
        "name": "".join(letter if letter.isalnum() else "-" for letter in sweep.path.stem), "shares": shares,
        "at_once": at_once, "nodes": launch.nodes, "ranks": launch.ranks, "each": each, "memory": launch.memory_mb,
        "node_memory": each * launch.memory_mb, "time": launch.time,
        "folder": _quoted(folder), "again": AGAIN,
        "single": ":-1" if shares == 1 else ":?submit this script as an array, as its -J says",
        "log": _quoted(str(folder).replace("%", "%%") + "/share-%a.log"),
        "array": f"#PBS -J 1-{shares}{at_once}\n" if shares > 1 else "",  # PBS takes no array of one
        "lines": "".join(line + "\n" for line in lines), "setup": "".join(line + "\n" for line in setup),
        "command": shlex.join(command),
    }  # fmt: skip
    head, tail = (SLURM, REQUEUE) if kind == "slurm" else (PBS, "")
    return head.format(**values) + BODY.format(**values) + tail.format(**values) + 'exit "$status"\n'


def _quoted(name) -> str:
    """Quote a name for the head of a script, where # begins a comment and blanks separate arguments."""
    return str(name) if re.fullmatch(r"[\w./%+@:=,-]+", str(name)) else f'"{name}"'
