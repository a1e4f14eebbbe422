"""Sessions that share the items of one rank: each item runs once, also where one of the sessions crashes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from launch import mpi_environment

ITEMS = """
import os, pathlib, signal, time
import pytest

@pytest.mark.parametrize("k", range(4))
def test_it(k):
    with open("ran", "a") as file:
        file.write(f"{__name__} {k} {os.getpid()}\\n")
    if __name__ == "test_0" and k == 0:  # until the other session has come to its second item
        for _ in range(6000):
            if "test_3 1" in pathlib.Path("ran").read_text():
                break
            time.sleep(0.01)
    if __name__ == "test_3" and k == 1:
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_items_that_a_crash_left_run_elsewhere(tmp_path):
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["mpi_items"]\n')
    (tmp_path / "pytest.ini").write_text(f"[pytest]\npythonpath = {Path(__file__).parent}\nmarkers = mpi\n")
    for number in range(4):
        (tmp_path / f"test_{number}.py").write_text(ITEMS)
    environment = {name: value for name, value in mpi_environment().items() if not name.startswith("HPCRED_TEST_")}
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "--beside", "-p", "no:cacheprovider"], cwd=tmp_path,
                          capture_output=True, text=True, timeout=200, env=environment)  # fmt: skip
    assert "1 failed, 15 passed" in done.stdout, done.stdout + done.stderr
    assert "FAILED test_3.py::test_it[1]" in done.stdout
    ran = [line.split() for line in (tmp_path / "ran").read_text().splitlines()]
    assert len(ran) == len({(name, k) for name, k, _ in ran}) == 16  # each once
    assert len({pid for *_, pid in ran}) > 1
