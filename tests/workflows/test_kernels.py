"""`hpcred bench --save`: the quickest kernels of OpenBLAS are found, kept, taken by later runs, and forgotten."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
from launch import mpi_environment
from mpi4py import MPI

import hpcred as package
from hpcred.parallel import kernels, processor
from hpcred.parallel.failures import InputError
from hpcred.workflows import kernels as workflow

CPU = "processor\t: 0\nmodel name\t: Some EPYC\nflags\t\t: fpu pni sse4_2 avx avx2 avx512bw\n\nflags\t\t: amx\n"
ARM = "processor : 0\nFeatures : fp asimd asimddp\nCPU implementer : 0x41\nCPU variant : 0x3\nCPU part : 0xd0c\n\n"
PROGRAM = """
import os, hpcred
from hpcred.parallel import processor, startup
hpcred.start()
comm = startup.start_mpi()
found = comm.gather((os.environ.get("OPENBLAS_CORETYPE"), processor.blas(), processor.chosen_by()))
if comm.rank == 0:
    print(found)
"""


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine of one known processor, and settings of its own."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setattr(kernels, "PROCESSORS", tmp_path / "cpuinfo")
    for name in (kernels.CORETYPE, kernels.TAKEN):
        monkeypatch.setenv(name, "")  # what the test sets is undone
        monkeypatch.delenv(name)
    (tmp_path / "cpuinfo").write_text(CPU)

    def save(text):
        kernels.place().parent.mkdir(parents=True, exist_ok=True)
        kernels.place().write_text(text if isinstance(text, str) else json.dumps(text))

    return SimpleNamespace(save=save, cpuinfo=tmp_path / "cpuinfo")


def taken():
    kernels.take_saved()
    return kernels.os.environ.get(kernels.CORETYPE)


def test_a_processor_is_known_by_its_name_and_flags(machine):
    first = kernels.processor()
    assert first.startswith("Some EPYC ") and "amx" not in kernels.flags(), "of another processor of the list"
    machine.cpuinfo.write_text(CPU.replace(" avx512bw", ""))
    assert kernels.processor() != first, "as in a virtual machine that hides some"
    machine.cpuinfo.write_text(ARM)
    assert kernels.processor().startswith("0x41 0x3 0xd0c ") and kernels.flags() == {"fp", "asimd", "asimddp"}
    machine.cpuinfo.unlink()
    assert kernels.flags() == set() and kernels.processor(), "as on macOS"


def test_kernels_that_a_processor_is_able_to(machine):
    has = {"Prescott", "Haswell", "SkylakeX", "Cooperlake"}.__contains__
    assert kernels.possible(kernels.flags(), has) == ["SkylakeX", "Haswell", "Prescott"]
    machine.cpuinfo.write_text(ARM)
    assert kernels.possible(kernels.flags(), lambda name: True)[:2] == ["NeoverseN1", "ThunderX2T99"]


def test_saved_kernels_are_taken_on_their_processor_alone(machine):
    assert taken() is None
    machine.save({kernels.processor(): "Haswell"})
    assert taken() == "Haswell" and kernels.origin("Haswell") == "hpcred bench --save"
    machine.cpuinfo.write_text(CPU.replace("Some EPYC", "Another"))
    assert taken() is None, "inherited from another machine, as by jobs of a batch system"


def test_the_users_own_setting_stands(machine, monkeypatch):
    machine.save({kernels.processor(): "Haswell"})
    monkeypatch.setenv(kernels.CORETYPE, "Zen")
    assert taken() == "Zen" and kernels.origin("Zen") == kernels.CORETYPE and kernels.origin("Prescott") == "OpenBLAS"
    monkeypatch.setenv(kernels.CORETYPE, "")
    assert taken() == "", "OpenBLAS shall choose"


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", '"x"', "[" * 100_000, {"x": 7}, {"x": "Rubbish"}, b"\xff\xfe"])
def test_a_damaged_file_is_no_choice(machine, text):
    if isinstance(text, dict):
        text = {kernels.processor(): text["x"]}
    machine.save("" if isinstance(text, bytes) else text)
    if isinstance(text, bytes):
        kernels.place().write_bytes(text)
    assert taken() is None
    said = kernels.damage()
    assert str(kernels.place()) in said and "`hpcred bench --save`" in said and "`hpcred bench --forget`" in said
    assert workflow.forget_kernels() is None and not kernels.place().exists()
    machine.save("{")
    workflow._keep({kernels.processor(): "Haswell"}, MPI.COMM_SELF)
    assert kernels.damage() is None and taken() == "Haswell"


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda path: path.mkdir()])
def test_a_pipe_or_a_device_is_not_read(machine, make):
    """Each start of a command reads the file of saved kernels."""
    kernels.place().parent.mkdir(parents=True)
    make(kernels.place())
    assert taken() is None
    assert "the saved kernels cannot be read (" in kernels.damage()


def test_what_is_saved_for_others_outlives_damage(machine):
    machine.save({kernels.processor(): "Rubbish", "another processor": "Zen"})
    assert "found 'Rubbish', expected kernels" in kernels.damage()
    assert workflow.forget_kernels() is None and kernels.saved() == {"another processor": "Zen"}
    machine.save({"another processor": "of a later version"})
    assert kernels.damage() is None and workflow.forget_kernels() is None and kernels.place().exists()


def test_a_command_says_that_the_file_is_damaged(hpcred, tmp_path):
    file = tmp_path / "settings/hpcred/kernels.json"
    file.parent.mkdir(parents=True)
    file.write_text("{")
    settings = {"XDG_CONFIG_HOME": str(tmp_path / "settings")}
    package.write_model(tmp_path / "model.h5", package.solid((2, 1, 1)))
    run = hpcred("info", "model.h5", ranks=2, **settings)
    assert run.returncode == 0 and run.stderr.count(f"warning: {file}: ") == 1
    run = hpcred("bench", "--forget", ranks=2, **settings)
    assert "damaged and is removed" in run.stdout and not run.stderr and not file.exists()
    assert str(file) not in hpcred("info", "model.h5", **settings).stderr
    file.write_text(json.dumps({kernels.processor(): "Rubbish", "another processor": "Zen"}))
    run = hpcred("bench", "--forget", **settings)
    assert "damaged and is written anew for other" in run.stdout and "Zen" in file.read_text()


def measured(name, seconds):
    return {"kernels": name, "dgemm_gflops": 1.0, "factor_seconds": seconds}


@pytest.mark.parametrize(("seconds", "quickest"), [(1.9, "Haswell"), (1.5, "SkylakeX")])
def test_others_are_worth_it_from_a_twentieth_on(seconds, quickest):
    found = [measured("Haswell", 2.0), "status -4", measured("skylakex", seconds), measured("Haswell", 2.0),
             measured("Haswell", 0.1)]  # fmt: skip
    report = workflow.compared(["Cooperlake", "SkylakeX", "Haswell", "Zen"], found)
    assert report["quickest"] == quickest and report["own"] == "Haswell"
    assert [row["ratio"] for row in report["table"]] == [seconds / 2, 1.0]
    assert report["not_here"] == ["Cooperlake", "Zen"], "one ended early, one took others than it was told"
    with pytest.raises(InputError, match="kernels cannot be measured: a process that factors ended with 'status -4'"):
        workflow.compared(["Haswell"], ["status -4", "status -4"])


def test_a_process_that_dies_is_no_measurement(monkeypatch):
    monkeypatch.setattr(workflow, "PROGRAM", "import os, signal; os.kill(os.getpid(), signal.SIGILL)  # {root} {cells}")
    assert workflow._measured((1, 1, 1), "Haswell") == "status -4"
    monkeypatch.setattr(workflow, "PROGRAM", "import sys; sys.exit('no PETSc')")
    assert workflow._measured((1, 1, 1), "Haswell") == "no PETSc"


def test_another_blas_has_nothing_to_choose(monkeypatch, machine):
    monkeypatch.setattr(processor, "choices", lambda: None)
    monkeypatch.setattr(processor, "blas", lambda: "libmkl_rt.so.2")
    found = workflow.bench_kernels()
    assert found["why_none"] == (
        "the BLAS is libmkl_rt.so.2, not an OpenBLAS with DYNAMIC_ARCH: there are no kernels to choose"
    )
    with pytest.raises(InputError, match="--save: the BLAS is libmkl_rt.so.2"):
        workflow.bench_kernels(save=True)
    assert not kernels.place().exists()


@pytest.mark.slow
def test_saved_and_forgotten(hpcred, tmp_path):
    """By the command, on two ranks; later runs take what was saved, and results say so."""
    settings = {"XDG_CONFIG_HOME": str(tmp_path / "settings"), "OPENBLAS_CORETYPE": ""}
    run = hpcred("bench", "--cells", 4, 3, 3, "--save", "--json", "bench.json", ranks=2, **settings)
    found = json.loads((tmp_path / "bench.json").read_text())["kernels"] if run.returncode == 0 else {}
    if not found.get("table"):
        assert run.returncode == 2 and "there are no kernels to choose" in run.stderr
        pytest.skip("a BLAS without kernels to choose")
    assert f"{found['quickest']} is kept for later runs" in run.stdout and found["kept"] == found["quickest"]
    file = tmp_path / "settings/hpcred/kernels.json"
    other = next(row["kernels"] for row in found["table"] if row["kernels"] != found["own"])
    assert json.loads(file.read_text()) == {found["processor"]: found["quickest"]}
    file.write_text(json.dumps({found["processor"]: other, "another processor": "Zen"}, indent=1))
    environment = mpi_environment(**settings)
    del environment["OPENBLAS_CORETYPE"]
    words = ["mpiexec", "-n", "2", sys.executable, "-c", PROGRAM]
    ranks = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout
    assert ranks.count(f"('{other}', '") == 2 and ranks.count(f", {other}', 'hpcred bench --save')") == 2
    late = [sys.executable, "-c", "import numpy, hpcred; hpcred.start()\n"
            "from hpcred.parallel import processor, startup\nprint(processor.hints(startup.start_mpi()))"]  # fmt: skip
    said = subprocess.run(late, env=environment, capture_output=True, text=True, check=True).stdout
    assert "in Python, import hpcred before numpy" in said or f", {other}" in said

    package.write_model(tmp_path / "model.h5", package.solid((3, 2, 2)))
    (tmp_path / "job.toml").write_text('model = "model.h5"\n[[basis]]\nkind = "modes"\ncount = 2\n')
    run = hpcred("reduce", "job.toml", "--json", "record.json", **settings)
    assert json.loads((tmp_path / "record.json").read_text())["versions"]["blas_kernels_chosen_by"] == "OpenBLAS"
    assert "(kernels chosen by OpenBLAS)" in hpcred("info", "result.h5").stdout

    run = hpcred("bench", "--forget", **settings)
    assert run.returncode == 0 and f"the kernels {other} are no longer kept" in run.stdout
    assert json.loads(file.read_text()) == {"another processor": "Zen"}
    assert "no kernels are kept" in hpcred("bench", "--forget", **settings).stdout
    assert "--forget: cannot be combined" in hpcred("bench", "--forget", "--save", **settings).stderr
