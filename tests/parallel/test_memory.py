"""What a rank may take: SLURM's limits, control groups, the user's word."""

import psutil
import pytest

from hpcred.parallel import memory
from hpcred.parallel import startup as runtime
from hpcred.parallel.failures import InputError


def test_limits_of_memory(monkeypatch, comm, tmp_path):
    free = memory.available_mb(comm)
    assert 10 < free < 1e7
    own = psutil.Process().memory_info().rss / 2**20  # which is no longer there to be taken
    monkeypatch.setenv("SLURM_MEM_PER_NODE", "1500")
    assert memory.available_mb(comm) == pytest.approx(0.9 * (1500 / runtime.ranks_on_node - own), rel=0.05)
    monkeypatch.setenv("SLURM_MEM_PER_CPU", "300")
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "2")
    assert memory.available_mb(comm) == pytest.approx(0.9 * (600 - own), rel=0.05)
    monkeypatch.setenv("HPCRED_MEMORY_MB", "77")
    assert memory.available_mb(comm) == 77
    for wrong in ("abc", "nan", "-5", "0", "inf"):
        monkeypatch.setenv("HPCRED_MEMORY_MB", wrong)
        with pytest.raises(InputError, match=f"HPCRED_MEMORY_MB: found '{wrong}'"):
            memory.available_mb(comm)


def test_the_address_space_that_is_taken_is_not_free(monkeypatch, comm):
    taken = psutil.Process().memory_info().vms
    monkeypatch.setattr(memory.resource, "getrlimit", lambda _: (taken + 100 * 2**20, -1))
    assert memory.available_mb(comm) == pytest.approx(90, abs=10)


def test_a_control_group_limits_memory(monkeypatch, tmp_path):
    """A container with 1000 MB of which 400 are taken, 100 of them by file cache."""
    group = tmp_path / "job"
    group.mkdir()
    (group / "memory.max").write_text(str(1000 * 2**20))
    (group / "memory.current").write_text(str(400 * 2**20))
    (group / "memory.stat").write_text(f"anon 1\ninactive_file {100 * 2**20}\n")
    monkeypatch.setattr(memory, "GROUPS", tmp_path)
    monkeypatch.setattr(memory, "_groups_of_process", lambda: ["0::/job"])
    assert memory._control_groups() == pytest.approx([700])
    (group / "memory.max").write_text("max")
    assert memory._control_groups() == []
