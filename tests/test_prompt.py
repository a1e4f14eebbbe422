"""What stands everywhere on a command line, `modes`, and `info` of files that hpcred wrote."""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA
from helpers import CHORD_JOB, SIMULATION, refused, said
from launch import mpi_environment

import hpcred
from hpcred.cli.main import run
from hpcred.files.point_store import PointStore
from hpcred.parallel import startup
from hpcred.report.tables import as_json, show_table, told_apart
from hpcred.workflows import modes as workflow

JOB = 'model = "model.h5"\nband = [0.0, 300.0]\ntolerance = 1e-3\n[frame]\nkind = "buckens"\n'


@pytest.mark.parametrize("command", [[], ["reduce"], ["example"], ["example", "solid"], ["modes"]])
def test_help_has_a_short_name(capsys, command):
    assert run([*command, "-h"]) == 0
    assert capsys.readouterr().out.startswith(" ".join(["Usage: hpcred", *command]))


@pytest.mark.usefixtures("forked_commands")
def test_shells_complete_commands_and_options(hpcred):
    for words, expected in (("hpcred mod", "modes"), ("hpcred reduce --out-of", "--out-of-core")):
        found = hpcred(_HPCRED_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1))
        assert found.stdout.split() == [expected]


@pytest.mark.parametrize(
    ("words", "closed", "status", "begun"),
    [
        ("convert --list-formats", "stdout", 141, True),
        ("info model.h5 --json -", "stdout", 141, False),
        ("info missing.h5", "stdout", 2, False),
        ("info missing.h5", "stderr", 2, False),
    ],
)
def test_a_reader_that_has_gone_ends_a_command_silently(linkage_folder, forks, monkeypatch, words, closed, status,
                                                        begun):  # fmt: skip
    """As SIGPIPE ends other programs; an error keeps its own status, also where nobody reads it.

    Not of forks is only what a process begins and ends with.
    """
    monkeypatch.setattr(forks, "commands", not begun)
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "hpcred", *words.split()]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | {closed: writer}
    found = subprocess.run(command, **streams, text=True, env=mpi_environment(), timeout=60, restore_signals=False)
    os.close(writer)
    assert found.returncode == status
    told = found.stdout or found.stderr or ""
    assert ("error" in told) == (status == 2 and closed == "stdout") and "ipe" not in told


def test_a_run_that_is_asked_to_stop_can_be_told_by_its_status(linkage_folder, monkeypatch, capsys):
    """A search with a store, after its first point."""
    job = CHORD_JOB.partition("[[basis]]")[0].replace("[frame]", "tolerance = 1e-7\nband = [1.0, 300.0]\n[frame]")
    Path("job.toml").write_text(job)
    save = PointStore.save

    def save_and_ask(self, *state):
        save(self, *state)
        os.kill(os.getpid(), signal.SIGUSR1)

    monkeypatch.setattr(PointStore, "save", save_and_ask)
    assert run(["reduce", "job.toml", "--store", "points"]) == 75
    assert "the same command goes on from what was kept" in capsys.readouterr().err
    assert not Path("result.h5").exists()


def test_json_on_standard_output_is_alone_there(hpcred, linkage_folder, forks, monkeypatch):
    """Also what PETSc itself prints goes elsewhere."""
    found = hpcred("info", "model.h5", "--modes", 8, "--json", "-", "--", "-mat_view_nothing", "-log_view")
    report = json.loads(found.stdout)
    assert report["lowest_frequencies_hz"][:6] == [0.0] * 6 and report["lowest_frequencies_hz"][6] > 30
    assert "rigid body modes" in found.stderr and "PETSc Performance Summary" in found.stderr
    assert "nothing used the PETSc option -mat_view_nothing" in found.stderr
    monkeypatch.setattr(forks, "commands", True)
    other = hpcred("info", "model.h5", "--modes", 8, "--json=-")
    assert json.loads(other.stdout).keys() == report.keys() and "rigid body modes" in other.stderr


def test_json_has_no_nan():
    assert json.loads(as_json({"a": [1.0, float("nan")], "b": (float("-inf"), "x")})) == {"a": [1.0, None],
                                                                                         "b": [None, "x"]}  # fmt: skip


def test_quiet_and_verbose(linkage_folder, capsys):
    assert run(["--quiet", "info", "model.h5"]) == 0
    assert capsys.readouterr() == ("", "")
    assert run(["info", "model.h5", "--verbose"]) == 0
    assert "] read: model.h5" in capsys.readouterr().err
    assert "cannot be combined" in refused(capsys, "info", "model.h5", "--quiet", "--verbose")
    assert run(["info", "model.h5", "--quiet", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["size"] == 120


def test_petsc_options_that_nothing_used_are_named(hpcred, linkage_folder, monkeypatch, capsys):
    found = hpcred("reduce", "job.toml", "--", "-shift_mat_mumps_icntl_14", "80", "-shift_nothing", "1", ranks=2)
    assert found.stdout.count("nothing used the PETSc option -shift_nothing 1;") == 1
    monkeypatch.setattr(startup, "started", lambda: False)  # as in a command that needs no PETSc
    assert run(["--version", "--", "-nothing"]) == 0
    assert "nothing used the PETSc option -nothing;" in capsys.readouterr().out


def test_a_table_for_a_closed_pipe_is_no_internal_error(monkeypatch):
    reader, writer = os.pipe()
    os.close(reader)
    closed = os.fdopen(writer, "w")
    monkeypatch.setattr("sys.stdout", closed)
    with pytest.raises(BrokenPipeError):
        show_table("", [{"name": "a", "value": 1.0}])
    with suppress(BrokenPipeError):  # of what is still in its buffer
        closed.close()


@pytest.mark.parametrize("columns", [None, 80, 72])
def test_tables_fit_the_terminal(monkeypatch, capsys, columns):
    """Numbers and short words are whole; text takes several lines."""
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns:
        monkeypatch.setenv("COLUMNS", str(columns))
    points = "10 Hz (1), 150 Hz (5), 240 Hz (3), 300 Hz (1)"
    rows = [{"row": 1, "method": "modal + second-order Krylov", "points (order)": points, "size": 14,
             "largest |u_y - reference| (m)": 1.23456e-07, "Q": 1.98765e-10}]  # fmt: skip
    show_table("title", rows)
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= (columns or 80)
    assert all(word in text for word in ("1.23456e-07", "1.98765e-10", "second-order", "|u_y"))


def test_words_of_tables_are_whole_and_as_they_are(monkeypatch, capsys):
    """Names of files can be copied, however long; nothing in a text is taken for a sign or a colour."""
    monkeypatch.setenv("COLUMNS", "80")
    name = "basis-modal_order-1_tolerance-0.0001_frame-buckens.h5"
    show_table("", [{"run": "1", "worst": "piston:x: 6e-05 at 0 Hz [bold]", "file": name, "other": f"{name}/{name}"}])
    text = capsys.readouterr().out
    assert f" {name}\n" in text and f" {name}/{name}\n" in text
    assert "piston:x:" in text and "[bold]" in text
    show_table("", [{"run": "1", "worst": "a b " * 30, "file": name, "f (Hz)": 1234.5}])
    text = capsys.readouterr().out
    assert name in text and " 1234.5\n" in text and "…" not in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("names, short", [
    (["basis-modal_order-1", "basis-modal_order-3", "basis-krylov_order-1"], ["modal_1", "modal_3", "krylov_1"]),
    (["tol-1e-04_n-7", "tol-1e-06_n-7"], ["1e-04", "1e-06"]),
    (["order-0", "order-200"], ["0", "200"]),
    (["order-0", "a_b"], ["order-0", "a_b"]),
    (["order-0"], ["order-0"]),
    (["coarse", "fine"], ["coarse", "fine"]),
])  # fmt: skip
def test_names_of_runs_are_as_short_as_they_may(names, short):
    assert told_apart(names) == short


def test_modes_of_a_file(linkage_folder, capsys):
    assert run(["modes", "model.h5", "--count", "8", "--figure", "m.png", "--json", "m.json"]) == 0
    text = capsys.readouterr().out
    assert "6 rigid-body modes at 0 Hz, which move all of the mass" in text and "    7  33.30" in text
    assert not re.search(r"^ +[1-6] ", text, re.M)
    report = json.loads(Path("m.json").read_text())
    assert np.sum(report["effective_masses"], axis=0) == pytest.approx(report["masses"])
    assert Path("m.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in Path().iterdir()) == ["job.toml", "m.json", "m.png", "model.h5"]
    assert run(["modes", "model.h5", "--count", "2", "--frame", "tangent:7"]) == 0
    text = capsys.readouterr().out
    assert "0 rigid-body modes;" in text and "sum" in text and "    1  " in text
    for arguments, says in (
        (["--count", "0"], "expected at least 1"), (["--figure", "m.jpg"], "ends in .png"),
        (["--count", "6", "--figure", "n.png"], "no elastic mode"), (["--frame", "loose"], "--frame: found 'loose'"),
    ):  # fmt: skip
        assert says in refused(capsys, "modes", "model.h5", *arguments)


def test_a_picture_numbers_modes_as_the_table_does(linkage_folder, monkeypatch):
    seen = []
    monkeypatch.setattr(workflow, "draw_shapes", lambda path, shapes: (Path(path).touch(), seen.append(shapes)))
    assert run(["modes", "model.h5", "--count", "8", "--figure", "m.png", "--json", "m.json"]) == 0
    frequencies = json.loads(Path("m.json").read_text())["frequencies_hz"]
    (shapes,) = seen
    assert shapes.first == 7 and shapes.names == [f"pseudo-mode {k}: {frequencies[k - 1]:.6g} Hz" for k in (7, 8)]


def test_info_of_everything_that_hpcred_writes(linkage_folder, capsys):
    Path("job.toml").write_text(JOB)
    said(capsys, "reduce", "job.toml")
    said(capsys, "response", "model.h5", "--band", "0,300", "--points", "11", "--frame", "buckens", "-o", "r.h5")
    said(capsys, "export", "result.h5")
    Path("sim.toml").write_text(SIMULATION)
    said(capsys, "simulate", "sim.toml")
    for name, expected in (
        ("result.h5", ["hpcred result", "dofs 120", "frame buckens", "(tolerance 0.1 %) over 0 to 300 Hz"]),
        ("r.h5", ["frequency responses", "frequencies 11", "band hz 0, 300", "arrays response, eps"]),
        ("simulation.h5", ["hpcred simulation", "times 21", "constraints 1:x, 1:y, 1:z, 7:x, 7:z, 14:z"]),
        ("result.SID_FEM", ["SID file", "mass 5.39798", "interface nodes 20"]),
        (str(DATA / "sid" / "beam.SID_FEM"), ["SID file", "mass 12.5604", "1860, 1861, 1862"]),
    ):
        text = said(capsys, "info", name)
        assert all(part in text for part in expected), text
        assert "convert it first" in refused(capsys, "info", name, "--modes", "3")
    assert "at least 1" in refused(capsys, "info", "model.h5", "--modes", "0")


def test_reduce_begins_with_the_verdict_and_ends_with_what_to_do_next(linkage_folder, capsys):
    to_tolerance = ["--set", "tolerance=1e-3", "--set", "band=[0.0, 300.0]"]
    assert run(["reduce", "job.toml", *to_tolerance]) == 0
    text = capsys.readouterr().out
    verdict = r"largest error 0\.\d+ % \(tolerance 0\.1 %\) over 0 to 300 Hz, verified at .* Hz \(uncompressed model\)"
    assert re.match(verdict, text)
    assert "Expansion points" not in text and "\nnext: hpcred evaluate result.h5 --full model.h5 --check 5  # " in text
    assert run(["reduce", "job.toml", *to_tolerance, "--details"]) == 0
    details = capsys.readouterr().out
    assert details.startswith(text.splitlines()[0]) and "Expansion points" in details and "max |V^T M V - I|" in details
    assert run(["info", "result.h5", "--details"]) == 0
    assert "Expansion points" in capsys.readouterr().out
    assert run(["reduce", "job.toml", "--set", "output=my rod.h5"]) == 0
    assert "  hpcred report 'my rod.h5'  " in capsys.readouterr().out  # as a shell takes it


def test_what_to_do_next_is_possible_without_nodes(tmp_path, monkeypatch, capsys):
    """A floating frame needs nodes."""
    monkeypatch.chdir(tmp_path)
    K = 1e6 * (2 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1))
    hpcred.write_model("model.h5", hpcred.SecondOrderModel(M=np.eye(9), K=K, B=np.eye(9, 1)))
    Path("job.toml").write_text('model = "model.h5"\noutput = "result.h5"\nbasis = [{kind = "modes", count = 3}]\n')
    assert run(["reduce", "job.toml"]) == 0
    export = next(line for line in capsys.readouterr().out.splitlines() if " export " in line)
    assert run(export.partition("#")[0].split()[1:]) == 0


def test_programs_are_names_of_formats(linkage_folder, capsys):
    assert run(["reduce", "job.toml"]) == 0
    assert run(["export", "result.h5", "--format", "SIMPACK"]) == 0
    assert "result.SID_FEM: " in capsys.readouterr().out
