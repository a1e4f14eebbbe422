"""What a rank may take: SLURM's limits, control groups, the user's word."""

import pytest

from hpcred.parallel import memory
from hpcred.parallel import startup as runtime
from hpcred.parallel.failures import InputError


def test_limits_of_memory(monkeypatch, comm, tmp_path):
    free = memory.available_mb(comm)
    assert 10 < free < 1e7
    monkeypatch.setenv("SLURM_MEM_PER_NODE", "500")
    assert memory.available_mb(comm) == pytest.approx(0.9 * 500 / runtime.ranks_on_node)
    monkeypatch.setenv("SLURM_MEM_PER_CPU", "100")
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "2")
    assert memory.available_mb(comm) == pytest.approx(0.9 * 200)
    monkeypatch.setenv("HPCRED_MEMORY_MB", "77")
    assert memory.available_mb(comm) == 77
    for wrong in ("abc", "nan", "-5", "0", "inf"):
        monkeypatch.setenv("HPCRED_MEMORY_MB", wrong)
        with pytest.raises(InputError, match=f"HPCRED_MEMORY_MB: found '{wrong}'"):
            memory.available_mb(comm)


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
