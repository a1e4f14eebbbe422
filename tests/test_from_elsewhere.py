"""Files and folders from elsewhere run no code, write to no other place, and do not take all memory."""

import io
import json
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import CHORD_JOB, MODES_JOB, reduce_linkage
from launch import mpi_environment

import hpcred as package
from hpcred.cli.main import run
from hpcred.files import response_file
from hpcred.files.hdf5 import writing
from hpcred.files.locks import lock_name, temporary_name
from hpcred.files.seal import MARK, TAIL
from hpcred.files.system_errors import open_input
from hpcred.parallel.failures import ComputationError, InputError
from hpcred.parallel.petsc import MPI
from hpcred.workflows import batch, sweep

HOSTILE = "</script><script>document.title='ran'</script><img src=x onerror=alert(1)>\"'${1}{{7*7}}"
SWEEP = 'job = "job.toml"\n[[vary]]\nkey = "basis.0.order"\nvalues = [0]\nnames = ["{name}"]\n[launch]\nlauncher = ""\n'
LAUGHS = '<!ENTITY l0 "ha">' + "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
GRID = '<?xml version="1.0"?><!DOCTYPE V [{}]><VTKFile type="UnstructuredGrid"><Piece {}>{}</Piece></VTKFile>'


class Code:
    """Leaves the file `ran` when it is loaded."""

    def __reduce__(self):
        return os.mkdir, ("ran",)


class Page(HTMLParser):
    """Tags and their attributes, and the text in scripts."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self._script = [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._script = tag == "script"

    def handle_endtag(self, tag):
        self._script = self._script and tag != "script"

    def handle_data(self, text):
        if self._script:
            self.scripts.append(text)


def test_names_are_text_in_a_report(tmp_path, monkeypatch):
    """Those of inputs, outputs, interfaces, stages and warnings in a result, and that of its file."""
    monkeypatch.chdir(tmp_path)
    reduce_linkage(tmp_path)
    reduced = package.read_result("result.h5").reduced
    names = tuple(f"{HOSTILE}{k}" for k in range(len(reduced.input_names)))
    record = replace(reduced.record, warnings=(HOSTILE,), model=HOSTILE)
    reduced = replace(reduced, input_names=names, output_names=names, record=record)
    file = HOSTILE.replace("/", "|")[:80] + ".h5"
    package.write_result(file, reduced)
    package.report_file([file], output="plain.html")
    page = Page(Path("plain.html").read_text(encoding="utf-8"))
    scripts = [attributes.get("type") for tag, attributes in page.tags if tag == "script"]
    assert scripts == ["application/json", None, None, None]
    assert "img" not in [tag for tag, _ in page.tags]
    assert not [key for _, attributes in page.tags for key in attributes if key.startswith("on")]
    data = json.loads(page.scripts[0])
    assert data["results"][0]["pairs"][0]["name"] == f"{names[0]}/{names[0]}"
    assert "7*7" not in "".join(page.scripts[1:])


NAME = "a;touch ran;$(touch ran)`touch ran`'&& touch ran #"


def batch_script(kind):
    """The script of a sweep whose file, results and store have such a name, as bash runs it: the process that ended."""
    text = 'output = "results"\n' + SWEEP.format(name=NAME) + '[launch.environment]\nX = "$(touch ran)"\n'
    Path(f"{NAME}.toml").write_text(text)
    assert run(["sweep", f"{NAME}.toml", f"--{kind}", "--store", f"store {NAME}"]) == 0
    (script,) = Path("results").glob(f"*.{kind}")
    return subprocess.run(
        ["bash", str(script)], capture_output=True, text=True, timeout=200,
        env=mpi_environment(SLURM_ARRAY_TASK_ID="1", PBS_ARRAY_INDEX="1"),
    )  # fmt: skip


def test_a_batch_script_runs_with_names_as_words(linkage_folder):
    """Those of the sweep file, of its results and of the store; what a sweep file says as shell lines is left out, and
    modules of the folder of submission are not run."""
    if sys.version_info >= (3, 11):  # else Python has no safe path
        Path("numpy.py").write_text("open('ran', 'w')")
    done = batch_script("slurm")
    assert done.returncode == 0, done.stderr
    assert len(list(Path("results").glob("*.h5"))) == 1 and Path(f"store {NAME}").is_dir()
    assert not list(Path().rglob("ran"))


@pytest.mark.parametrize("kind", ["slurm", "pbs"])
def test_names_are_words_in_a_batch_script(linkage_folder, monkeypatch, kind):
    """Its command gets them as they are."""
    monkeypatch.setattr(batch, "HPCRED", [sys.executable, "-I", "-S", "-c", "import sys; print(sys.argv[1:])"])
    done, here = batch_script(kind), Path().absolute()
    assert done.returncode == 0, done.stderr
    words = ["sweep", f"{here}/{NAME}.toml", "--store", f"{here}/store {NAME}", "--index", "1", "--of", "1"]
    assert done.stdout == f"{words}\n" and not list(Path().rglob("ran"))


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 has no safe path")
@pytest.mark.parametrize("kind", ["jobs/sweep.sh", "jobs/sweep.pbs", "jobs/sweep.slurm", "slurm", "pbs"])
def test_modules_of_the_folder_of_submission_are_not_run(linkage_folder, tmp_path_factory, kind):
    """By the commands of a script, in whose place a small program stands that loads a module."""
    stub = tmp_path_factory.mktemp("stub") / "hpcred"
    stub.mkdir()
    (stub / "__init__.py").touch()
    (stub / "__main__.py").write_text("import json, sys\nprint('ran as', sys.argv[1])\n")
    Path("json.py").write_text("open('ran', 'w')")
    Path("sweep.toml").write_text(SWEEP.format(name="a"))
    script = Path(__file__).parents[1] / kind
    if "/" not in kind:
        assert run(["sweep", "sweep.toml", f"--{kind}"]) == 0
        (script,) = Path("sweep").glob(f"*.{kind}")
    done = subprocess.run(
        ["bash", str(script), "sweep.toml"], capture_output=True, text=True, timeout=200,
        env=mpi_environment(SLURM_ARRAY_TASK_ID="1", PBS_ARRAY_INDEX="1", SLURM_ARRAY_TASK_COUNT="1", SHARES="1",
                            SWEEP="sweep.toml", PBS_O_WORKDIR=".", HPCRED_PYTHON=sys.executable,
                            PYTHONPATH=str(stub.parent)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == "ran as sweep\n" + "ran as collect\n" * (kind == "jobs/sweep.sh")
    assert not Path("ran").exists()


def test_scripts_run_python_safely():
    """Those that are too long to be run here as well."""
    for script in (Path(__file__).parents[1] / "jobs").iterdir():
        lines = [line for line in script.read_text().splitlines() if "-m hpcred" in line]
        assert all('"$python" $safely -m hpcred' in line for line in lines), script


@pytest.mark.usefixtures("forked_commands")
@pytest.mark.parametrize("name", [".order-a.h5.lock", "order-a.h5", ".order-a.log.lock", "order-a.log", "order-a.toml"])
def test_a_pipe_laid_in_the_folder_of_a_sweep_is_not_waited_for(linkage_folder, capfd, name):
    Path("sweep.toml").write_text(SWEEP.format(name="a"))
    Path("sweep").mkdir()
    os.mkfifo(Path("sweep", name))
    status, told = run(["sweep", "sweep.toml"]), capfd.readouterr()
    assert "pipe or a device" in told.err + told.out if name != "order-a.log" else status == 0
    assert "internal error" not in told.err


def test_logs_of_a_sweep_replace_no_other_file(linkage_folder, capsys):
    Path("sweep.toml").write_text(SWEEP.format(name="a"))
    Path("sweep").mkdir()
    Path("sweep/order-a.log").write_text("diary\n")
    assert run(["sweep", "sweep.toml"]) == 2
    assert "sweep/order-a.log: found a file that is no log of a sweep" in capsys.readouterr().err
    assert Path("sweep/order-a.log").read_text() == "diary\n"


def test_a_sweep_that_fails_leaves_no_empty_folder(linkage_folder, monkeypatch):
    def refused(_):
        raise ComputationError("no")

    Path("sweep.toml").write_text('output = "deep/sweep"\n' + SWEEP.format(name="a"))
    monkeypatch.setattr(sweep, "check_log", refused)
    assert run(["sweep", "sweep.toml"]) == 1
    assert not Path("deep").exists()


def test_names_that_collapse_make_two_tables(linkage_folder):
    Path("job.toml").write_text(MODES_JOB)
    assert run(["reduce", "job.toml"]) == 0
    for name in ("a b.h5", "a_b.h5", "A_b.h5", "measured_a b.h5"):
        shutil.copy("result.h5", name)
    assert run(["report", "a b.h5", "a_b.h5", "A_b.h5", "-o", "r.html", "--csv", "tables", "--json", "r.json"]) == 0
    files = json.loads(Path("r.json").read_text())["files"]
    assert len({name.lower() for name in files}) == len(files)
    assert sorted(files) == sorted(map(str, Path("tables").iterdir()))
    assert sum(Path(name).name.startswith("frequencies_") for name in files) == 3


def test_an_error_leaves_no_part_of_a_report(linkage_folder, monkeypatch):
    """Nor of a Campbell diagram: outputs of a command appear together."""
    Path("job.toml").write_text(MODES_JOB)
    assert run(["reduce", "job.toml"]) == 0
    before = sorted(Path().rglob("*"))
    monkeypatch.setattr("hpcred.workflows.report_files.write_responses", lambda *_: 1 / 0)
    assert run(["report", "result.h5", "-o", "r.html", "--csv", "new/tables"]) == 1
    assert sorted(Path().rglob("*")) == before


def test_names_in_other_bytes_than_utf_8(linkage_folder, capsys):
    Path("job.toml").write_text(MODES_JOB)
    assert run(["reduce", "job.toml", "--set", "output=r\udcff.h5"]) == 2
    said = capsys.readouterr().err
    assert "output: found 'r\\udcff.h5', with letters that names of files do not have in this locale" in said
    assert len(said) < 400
    assert run(["reduce", "job.toml"]) == 0
    os.rename("result.h5", "r\udcff.h5")
    assert run(["--quiet", "report", "r\udcff.h5", "-o", "p\udcff.html", "--csv", "t"]) == 0
    assert "r\\xff" in Path("p\udcff.html").read_text(encoding="utf-8")
    assert Path("t/frequencies_r_xff.csv").exists()


def test_nested_json_is_damage(linkage_folder, capsys):
    """In a seal, and in the record of a file with the right checksums."""
    deep = b"[" * 200_000 + b"]" * 200_000
    with open("model.h5", "ab") as file:
        file.write(deep + TAIL.pack(len(deep), zlib.crc32(deep), MARK))
    with writing("f.h5", MPI.COMM_SELF) as file:
        for key, value in (("format", response_file.FORMAT), ("version", response_file.VERSION)):
            file.attribute(key, value)
        file.small("frequencies", np.ones(1))
        file.small("input_names", ["a"])
        file.small("output_names", ["a"])
        file.small("record", deep.decode())
    for name in ("model.h5", "f.h5"):
        assert run(["info", name]) == 2
        said = capsys.readouterr().err
        assert f"{name}: " in said and "the file is damaged" in said, name


def test_a_result_of_another_user_in_a_sticky_folder_is_refused_at_once(linkage_folder, monkeypatch, capsys):
    Path("shared").mkdir()
    Path("shared").chmod(0o1777)
    Path("shared/result.h5").touch()
    os.chmod("shared/result.h5", 0o666)
    for path, owner in (("shared", 4321), ("shared/result.h5", 4321)):
        os.chown(path, owner, owner) if os.geteuid() == 0 else pytest.skip("needs root")
    monkeypatch.setattr(os, "geteuid", lambda: 1234)
    assert run(["reduce", "job.toml", "--set", "output=shared/result.h5"]) == 2
    assert "belongs to another user" in capsys.readouterr().err


@pytest.mark.parametrize("make", [
    lambda name: f'model = "{name}"\n[[basis]]\nkind = "modes"\ncount = 1\n',
    lambda name: f'model = "model.h5"\n[[basis]]\nkind = "{name}"\ncount = 1\n',
    lambda name: f'model = "model.h5"\n{name} = 1\n[[basis]]\nkind = "modes"\ncount = 1\n',
    lambda name: f'model = "model.h5"\ninputs = ["{name}"]\n[[basis]]\nkind = "modes"\ncount = 1\n',
])  # fmt: skip
def test_a_name_of_a_million_letters_does_not_come_back(linkage_folder, capsys, make):
    Path("job.toml").write_text(make("a" * 10**6))
    assert run(["reduce", "job.toml"]) == 2
    assert len(capsys.readouterr().err) < 5000


def test_pickles_are_not_loaded(linkage_folder, capsys):
    np.save("K.npy", np.array([Code()], object), allow_pickle=True)
    Path("M.mat").write_bytes(pickle.dumps(Code()))
    np.savez("K.npz", format=np.array([Code()], object), data=np.array([Code()], object), shape=[2, 2])
    for file in ("K.npy", "M.mat", "K.npz"):
        assert run(["convert", "-K", file, "-M", file, "-o", "new.h5"]) == 2
        assert run(["info", file]) == 2 or file == "K.npz"  # of which info reads the heads
        assert f"{file}: " in capsys.readouterr().err
    assert not Path("ran").exists() and not Path("new.h5").exists()


def test_archives_and_entities_that_unpack_to_more_than_they_are(linkage_folder, capsys):
    with zipfile.ZipFile("bomb.fmu", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", b" " * 2**27)
    Path("bomb.vtu").write_text(GRID.format(LAUGHS, 'NumberOfPoints="&l11;"', ""))
    Path("secret").write_text("12")
    entity = f'<!ENTITY x SYSTEM "{Path("secret").absolute()}">'
    Path("entity.vtu").write_text(GRID.format(entity, 'NumberOfPoints="1" NumberOfCells="1"', "&x;"))
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 10**9)})
    Path("huge.npy").write_bytes(head.getvalue())
    for file in ("bomb.fmu", "bomb.vtu", "entity.vtu", "huge.npy"):
        assert run(["info", file]) == 2, file
        said = capsys.readouterr().err
        assert f"{file}: " in said and "internal error" not in said


def test_entries_of_a_store_are_in_their_own_files(linkage_folder, capsys):
    """Links of HDF5 in an entry are not followed: the run computes what it should have found."""
    assert run(["reduce", "job.toml", "--store", "points"]) == 0
    reference = package.read_result("result.h5").reduced
    (entry,) = Path("points").glob("krylov-*.h5")
    Path("moved.h5").write_bytes(entry.read_bytes())
    with h5py.File(entry, "a") as file:
        del file["blocks/0"]
        file["blocks/0"] = h5py.ExternalLink(str(Path("moved.h5").absolute()), "/blocks/0")
    capsys.readouterr()
    assert run(["store", "points", "--json", "rows.json"]) == 1
    (row,) = json.loads(Path("rows.json").read_text())
    assert not row["valid"] and "link" in row["reason"]
    assert run(["reduce", "job.toml", "--store", "points", "--verbose"]) == 0
    assert "is a link to something else" in capsys.readouterr().err
    again = package.read_result("result.h5").reduced
    assert np.array_equal(again.K, reference.K)


def test_links_laid_in_a_shared_folder_lead_nowhere(linkage_folder, capsys):
    """Under the names of the lock and of what becomes the output, which others can guess."""
    Path("mine").write_text("years of notes\n")
    for name in (temporary_name(Path("result.h5")), Path(f"{temporary_name(Path('result.h5'))}.h5")):
        name.symlink_to("mine")
    Path("job.toml").write_text(MODES_JOB)
    assert run(["reduce", "job.toml"]) == 0
    lock_name(Path("result.h5")).symlink_to("mine")
    capsys.readouterr()
    assert run(["reduce", "job.toml"]) == 2
    assert ".result.h5.lock cannot be opened (Too many levels of symbolic links)" in capsys.readouterr().err
    assert Path("mine").read_text() == "years of notes\n"


@pytest.mark.usefixtures("forked_commands")
def test_the_log_of_a_run_replaces_a_link_and_not_what_it_leads_to(linkage_folder):
    Path("job.toml").write_text(CHORD_JOB)
    Path("sweep.toml").write_text(SWEEP.format(name="one"))
    Path("sweep").mkdir()
    Path("mine").write_text("years of notes\n")
    for name in ("order-one.log", "one.log"):
        Path("sweep", name).symlink_to(Path("mine").absolute())
    assert run(["sweep", "sweep.toml"]) == 0
    assert Path("mine").read_text() == "years of notes\n"
    assert len([path for path in Path("sweep").glob("*.log") if not path.is_symlink()]) == 1


def test_names_do_not_colour_the_terminal(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with package.linkage() as model:
        package.write_model("model.h5", model.with_fields(sets={"\x1b[31mred\x1b]0;title\x07": np.array([20])}))
    assert run(["info", "model.h5"]) == 0
    said = capsys.readouterr()
    assert "[31mred" in said.out and not set("\x1b\x07") & set(said.out + said.err)


@pytest.mark.parametrize("line", [
    ["plan", "NAME"], ["response", "NAME", "--frequencies", "10,20", "-o", "NAME.csv"],
    ["convert", "-K", "K.mtx", "-M", "K.mtx", "-o", "NAME"], ["info", "NAME"],
])  # fmt: skip
def test_names_of_files_do_not_steer_the_terminal(tmp_path, monkeypatch, capsys, line):
    monkeypatch.chdir(tmp_path)
    name = "\x1b[31mred\x1b]0;title\x07\n.h5"
    scipy.io.mmwrite("K.mtx", scipy.sparse.eye(4, format="coo"))
    if line[0] != "convert":
        with package.linkage() as model:
            package.write_model(name, model)
    run([word.replace("NAME", name) for word in line])
    said = capsys.readouterr()
    told = (said.out + said.err).partition("#!/bin/bash")[0]  # a script has its words as they are
    assert "[31mred" in told and not set("\x1b\x07") & set(told)


@pytest.mark.parametrize("line", [
    'band = "a\\nhpcred: b"', 'tolerance = ["a\\nb"]', 'outputs = ["a\\nb"]', '"a\\nb" = 1', 'units = "a\\nb"',
    '[[parameter]]\nname = "e"\nrange = [1.0, 2.0]\n[[term]]\nof = "K"\nfile = "k.mtx"\nfactor = """e\n+\n1"""',
])  # fmt: skip
def test_a_message_has_one_line_whatever_a_job_has(linkage_folder, capsys, line):
    """A name with line breaks could end it by lines of its own."""
    Path("job.toml").write_text(f'model = "model.h5"\n{line}\n')
    assert run(["reduce", "job.toml"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and said[0].startswith("hpcred: error: ") and "\n" not in said[0]


def test_a_job_names_files_as_they_stand(linkage_folder, capsys):
    """No variable, pattern or command of a shell is followed in them."""
    for name in ("$HOME.h5", "~.h5", "$(touch ran).h5", "|touch ran.h5"):
        Path("job.toml").write_text(CHORD_JOB.replace('"model.h5"', json.dumps(name)))
        assert run(["reduce", "job.toml"]) == 2
        assert f"{name}: no such file" in capsys.readouterr().err
    assert not list(Path().glob("ran*"))


def test_matplotlib_takes_nothing_from_the_working_folder(linkage_folder):
    """As a file matplotlibrc there could name programs, such as LaTeX."""
    Path("matplotlibrc").write_text("text.usetex: True\ntext.latex.preamble: \\input{evil}\nsavefig.dpi: 7\n")
    program = (
        "from hpcred.report import figures, mode_pictures; figures.DOTS = mode_pictures.DOTS = 20; "
        "from hpcred.cli.main import run; assert run(['modes', 'model.h5', '--count', '7', '--figure', 'm.png']) == 0; "
        "found = figures._matplotlib().rcParams; print(found['text.usetex'], found['savefig.dpi'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=mpi_environment())
    assert done.returncode == 0 and done.stdout.split()[-2:] == ["False", "figure"], done.stderr


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python looks in the working folder first")
def test_runs_of_a_sweep_load_no_modules_of_the_working_folder(linkage_folder):
    Path("job.toml").write_text(CHORD_JOB)
    Path("sweep.toml").write_text(SWEEP.format(name="one"))
    for name in ("numpy", "psutil", "h5py"):
        Path(f"{name}.py").write_text("import os\nos.mkdir('ran')\n")
    assert run(["sweep", "sweep.toml"]) == 0
    assert Path("sweep/order-one.h5").exists() and not Path("ran").exists()


def test_what_would_be_waited_for_is_no_file(tmp_path, monkeypatch):
    """A pipe, and a file of the kernel that has no number of bytes and waits for more, such as /proc/kmsg."""

    def nothing_yet(*_):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.txt").write_text("1 2 3\n")
    with open_input(tmp_path / "a.txt") as file:
        assert file.read() == b"1 2 3\n"
    with pytest.raises(InputError, match="pipe: this is a pipe or a device"), open_input(tmp_path / "pipe"):
        pass
    monkeypatch.setattr(os, "pread", nothing_yet)
    with pytest.raises(InputError, match="a.txt: this is a pipe or a device"), open_input(tmp_path / "a.txt"):
        pass
