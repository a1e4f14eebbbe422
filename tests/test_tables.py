"""Tables and lines of every command, on a terminal of 80 and of 120 columns."""

import ast
import io
import sys
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers import SIMULATION

import hpcred
from hpcred.cli import campbell, main, session
from hpcred.examples.section5 import AUTOMATIC, TABLE_1, TABLE_2, table
from hpcred.parallel import messages
from hpcred.report import tables

CLI = Path(main.__file__).parent
JOB = '''model = "model.h5"
output = "auto.h5"
inputs = [[20, "z"], [1, "x"]]
tolerance = 1e-3
band = [0.0, 300.0]
frame = {kind = "buckens"}
'''
PARAMETRIC = '''model = "crank.h5"
output = "turning.h5"
band = [0.0, 2000.0]
geometric_stiffness = true
frame = {kind = "buckens"}
basis = [{kind = "modes", count = 3}]
interface = [{name = "crank", nodes = {set = "BIG_EYE"}}]
load = [{name = "weight", kind = "gravity", value = [0.0, 0.0, -9.81]}]
'''
BASE = """model = "crank.h5"
output = "base.h5"
band = [0.0, 2000.0]
tolerance = 1e-2
inputs = [["piston", "z"]]
outputs = [["piston", "z"]]
damping = {kind = "modal", ratio = 0.02}
base = [{directions = ["z"], on = "crank", absolute = [["piston", "z"]]}]
interface = [{name = "crank", nodes = {set = "BIG_EYE"}}, {name = "piston", nodes = {set = "SMALL_EYE"}}]
"""
SWEEP = """job = "job.toml"
output = "runs"
[[vary]]
key = "tolerance"
values = [1e-2, 1e-3]
"""
MACHINE = """body = [{name = "rod", result = "auto.h5"}]
joint = [{bodies = ["rod.20", "ground"], kind = "bushing", stiffness = [0.0, 0.0, 1e5]}]
"""


def functions_with_tables():
    """(module, function) of the commands that print tables."""
    for path in CLI.glob("*.py"):
        for function in ast.parse(path.read_text()).body:
            if isinstance(function, ast.FunctionDef):
                called = {ast.unparse(node.func).split(".")[-1] for node in ast.walk(function)
                          if isinstance(node, ast.Call)}  # fmt: skip
                if "show_table" in called:
                    yield path.stem, function.name


class Printed:
    """Prints each table and sentence at both widths, and keeps what does not fit and who asked."""

    def __init__(self, monkeypatch):
        self.faults, self.seen, self.show, self.patch = [], set(), tables.show_table, monkeypatch
        self.fold = messages.folded
        for module in (messages, tables):
            monkeypatch.setattr(module, "folded", self.folded)
        for module in [tables, *(module for name, module in sys.modules.items() if name.startswith("hpcred.cli."))]:
            if hasattr(module, "show_table"):
                monkeypatch.setattr(module, "show_table", self)

    def __call__(self, title, rows):
        code = sys._getframe(1).f_code
        self.seen |= {(Path(code.co_filename).stem, code.co_name)} if rows else set()
        for width in (120, 80):
            self.patch.setenv("COLUMNS", str(width))
            with redirect_stdout(io.StringIO()) as out:
                self.show(title, rows)
            self._look(out.getvalue(), width)

    def folded(self, text):
        for width in (120, 80):
            self.patch.setenv("COLUMNS", str(width))
            self._look(found := self.fold(text), width)
        return found

    def _look(self, text, width):
        """Keep the lines that do not fit, but for a single word, such as a path."""
        self.faults += [line for line in text.splitlines() if (len(line) > width and len(line.split()) > 1)
                        or line != line.rstrip()]  # fmt: skip


@pytest.mark.usefixtures("forked_commands")
def test_tables_of_all_commands_fit_and_have_no_trailing_blanks(linkage_folder, monkeypatch, capsys):
    printed = Printed(monkeypatch)
    with hpcred.crank(dofs=600) as rod:
        hpcred.write_model("crank.h5", rod)
    for name, text in (("job.toml", JOB), ("turning.toml", PARAMETRIC), ("sweep.toml", SWEEP),
                       ("machine.toml", MACHINE)):  # fmt: skip
        Path(name).write_text(text)
    Path("simulation.toml").write_text(SIMULATION.replace("result.h5", "auto.h5").replace("steps = 20", "steps = 2"))
    Path("base.toml").write_text(BASE)
    Path("psd.csv").write_text("f [Hz],base:z [g^2/Hz]\n20,0.01\n2000,0.01\n")
    Path("sine.csv").write_text("f [Hz],base:z [g]\n20,1\n2000,1\n")
    Path("shock.csv").write_text("t [s],base:z [g]\n0,0\n0.005,50\n0.01,0\n")
    for line in (
        "convert --list-formats", "info model.h5", "info crank.h5", "bores crank.h5", "modes crank.h5 --count 2",
        "info", "modes model.h5 --count 8", "reduce job.toml --store store",
        "reduce job.toml --details --set output='other.h5'", "store store", "plan model.h5 --ranks 4",
        "reduce turning.toml", "info turning.h5", "campbell turning.h5 --range 0,3000 --points 3",
        "evaluate auto.h5 --estimate", "evaluate auto.h5 --full model.h5 --points 3",
        "evaluate auto.h5 --full model.h5 --check 2",
        "assemble machine.toml", "evaluate auto.h5 other.h5 --full model.h5 --points 3", "simulate simulation.toml",
        "recover auto.h5 simulation.h5 -o r.csv", "sweep sweep.toml", "collect sweep.toml",
        "response model.h5 --frame buckens --inputs 20:z --band 1,300 --points 11 --check 1",
        "reduce base.toml", "response base.h5 --psd psd.csv", "response base.h5 --harmonic sine.csv",
        "response base.h5 --srs shock.csv", "info base.h5 --details", "export auto.h5 --format sid",
        "export auto.h5 --format statespace-mat", "export turning.h5 --format paraview", "example solid --dofs 100",
        "report auto.h5",
    ):  # fmt: skip
        assert main.run(line.split()) == 0, (line, capsys.readouterr().err)
        printed._look(capsys.readouterr().out, 80)  # lines to copy, which are not folded, too
    _of_long_commands(monkeypatch)
    assert printed.faults == []
    assert set(functions_with_tables()) <= printed.seen, set(functions_with_tables()) - printed.seen


def _of_long_commands(monkeypatch):
    """Print what the commands that take minutes print, with the texts that they have."""
    found = {"size": 14, "Q": 1.91546e-09, "eps_max": 3.19955e-10}
    rows = {}
    for key, part in (("table_1", (AUTOMATIC, *TABLE_1)), ("table_2", TABLE_2)):
        columns, lines = table([{"row": row, **found} for row in part])
        rows[key] = [dict(zip(columns, line, strict=True)) for line in lines]
    figure = {"row": 2, "method": "modal + second-order Krylov", "size": 14,
              "largest |u_y - reference| (m)": 1.23456e-9, "constraint drift (m)": 1.23456e-12,
              "energy defect": 1.23456e-12}  # fmt: skip
    rows["figure_5"] = [figure, figure]
    monkeypatch.setattr(hpcred, "demo", lambda *_, **__: rows["table_1"], raising=False)
    monkeypatch.setattr(hpcred, "paper", lambda *_, show, **__: show(rows) or rows, raising=False)
    machine = {"processor": "a processor with a long name of many words that fills more than a line of 80, 3 GHz"}
    monkeypatch.setattr(hpcred, "bench", lambda *_, **__: machine | {"hints": []}, raising=False)
    timing = SimpleNamespace(elapsed=1.0, memory_mb_per_rank=(100.0,), seconds={"other": 1.0})
    monkeypatch.setattr(session, "progress", lambda: SimpleNamespace(timing=lambda: timing), raising=False)
    for line in ("", "paper --figures none", "bench"):
        assert main.run(line.split()) == 0
    pole = {"value": 314.159, "frequency": 1234.56, "damping_ratio": 0.0123456, "distance": 1.23456e-9}
    campbell._show_full({"parameter": "omega", "full": [pole], "residual": 1e-12})


@pytest.mark.parametrize("columns", [80, 120])
def test_points_have_a_line_of_their_own(monkeypatch, capsys, columns):
    """No text of the demo's table is broken."""
    monkeypatch.setenv("COLUMNS", str(columns))
    names, rows = table([{"row": row, "size": 14, "Q": 1.91546e-09, "eps_max": 3.1e-10} for row in TABLE_1])
    tables.show_table(None, [dict(zip(names, row, strict=True)) for row in rows])
    lines = capsys.readouterr().out.splitlines()
    for row in TABLE_1:
        assert any(row.points in line for line in lines) and any(row.method in line for line in lines)
