"""How much memory a rank may take: of the machine, a container and the batch system, the smallest limit counts."""

import ctypes
import os
import resource
from contextlib import suppress
from pathlib import Path

import psutil

from . import startup
from .failures import InputError

SHARE = 0.9  # of what is free; the rest is for buffers and other programs
MB = 2**20
GROUPS = Path("/sys/fs/cgroup")


def available_mb(comm) -> float:
    """MB that each rank may take in addition to what it has, the same number on all ranks. Collective.

    The environment variable HPCRED_MEMORY_MB sets it by hand, per rank. Raises InputError where that is no number.
    """
    by_hand = os.environ.get("HPCRED_MEMORY_MB")
    if by_hand:
        with suppress(ValueError):
            if 0 < float(by_hand) < float("inf"):
                return float(by_hand)
        raise InputError(f"HPCRED_MEMORY_MB: found '{by_hand}' in the environment, expected a number of MB above 0")
    free, process = node_mb() / startup.ranks_on_node, psutil.Process().memory_info()
    per_cpu = os.environ.get("SLURM_MEM_PER_CPU", "")
    if per_cpu.isdigit():
        free = min(free, float(per_cpu) * int(os.environ.get("SLURM_CPUS_PER_TASK", "1")) - process.rss / MB)
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    if soft != resource.RLIM_INFINITY:
        free = min(free, (soft - process.vms) / MB)
    return SHARE * max(min(comm.allgather(free)), 0.0)


def node_mb() -> float:
    """Free memory of this node for the job, in MB."""
    limits = [psutil.virtual_memory().available / MB, *_control_groups()]
    per_node = os.environ.get("SLURM_MEM_PER_NODE", "")
    if per_node.isdigit() and int(per_node):
        limits.append(float(per_node) - psutil.Process().memory_info().rss / MB * startup.ranks_on_node)
    return min(limits)


def _groups_of_process():
    try:
        return Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []


def _control_groups():
    """What the control groups of this process (version 2 and 1) leave, in MB. File cache can be given back."""
    free = []
    for group in _groups_of_process():
        _, controllers, name = group.split(":", 2)
        if controllers not in ("", "memory"):
            continue
        root = GROUPS if not controllers else GROUPS / "memory"
        limit, used = ("memory.max", "memory.current") if not controllers else (
            "memory.limit_in_bytes", "memory.usage_in_bytes")  # fmt: skip
        folder = root / name.lstrip("/")
        # a container shows its own group as the root
        for place in {root, folder, *(parent for parent in folder.parents if root in parent.parents)}:
            try:
                most = (place / limit).read_text().strip()
                if most != "max" and int(most) < 2**60:
                    now = int((place / used).read_text())
                    stat = dict(line.split() for line in (place / "memory.stat").read_text().splitlines())
                    free.append((int(most) - now + int(stat.get("inactive_file", 0))) / MB)
            except (OSError, ValueError):
                continue
    return free


def give_back():
    """Hand freed memory back to the operating system: Open MPI tells malloc to keep it for ever."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of the GNU C library
    if trim is not None:
        trim(0)
