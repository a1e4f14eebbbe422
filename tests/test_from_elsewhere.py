"""Files and folders from elsewhere run no code, write to no other place, and do not take all memory."""

import io
import json
import os
import pickle
import subprocess
import sys
import zipfile
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers import CHORD_JOB, MODES_JOB, reduce_linkage
from launch import mpi_environment

import hpcred as package
from hpcred.cli.main import run
from hpcred.files.locks import lock_name, temporary_name

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


@pytest.mark.parametrize("kind", ["slurm", "pbs"])
def test_names_are_words_in_a_batch_script(linkage_folder, kind):
    """Those of the sweep file, of its results and of the store; what a sweep file says as shell lines is left out."""
    Path("job.toml").write_text(CHORD_JOB)
    name = "a;touch ran;$(touch ran)`touch ran`'&& touch ran #"
    text = 'output = "results"\n' + SWEEP.format(name=name) + '[launch.environment]\nX = "$(touch ran)"\n'
    Path(f"{name}.toml").write_text(text)
    assert run(["sweep", f"{name}.toml", f"--{kind}", "--store", f"store {name}"]) == 0
    (script,) = Path("results").glob(f"*.{kind}")
    done = subprocess.run(
        ["bash", str(script)], capture_output=True, text=True, timeout=200,
        env=mpi_environment(SLURM_ARRAY_TASK_ID="1", PBS_ARRAY_INDEX="1"),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list(Path("results").glob("*.h5"))) == 1 and Path(f"store {name}").is_dir()
    assert not list(Path().rglob("ran"))


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
    done = subprocess.run([sys.executable, "-m", "hpcred", "modes", "model.h5", "--figure", "m.png"],
                          capture_output=True, text=True, env=mpi_environment())  # fmt: skip
    assert done.returncode == 0, done.stderr
    from PIL import Image

    assert Image.open("m.png").width > 500
    program = "from hpcred.report.figures import pyplot; print(pyplot().rcParams['text.usetex'])"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout.split() == ["False"]


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python looks in the working folder first")
def test_runs_of_a_sweep_load_no_modules_of_the_working_folder(linkage_folder):
    Path("job.toml").write_text(CHORD_JOB)
    Path("sweep.toml").write_text(SWEEP.format(name="one"))
    for name in ("numpy", "psutil", "h5py"):
        Path(f"{name}.py").write_text("import os\nos.mkdir('ran')\n")
    assert run(["sweep", "sweep.toml"]) == 0
    assert not Path("ran").exists()
