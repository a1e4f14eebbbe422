"""The pages whose commands are run: what they show is what comes out, but for numbers that depend on the machine."""

import json
import re
import shutil
from importlib.util import find_spec

import pytest
from docs_pages import DOCS, ROOT, notebooks, tutorial

from hpcred.parallel.petsc import is_complex

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
OF_THE_MACHINE = ("time ", "MUMPS ", "real PETSc", "complex PETSc")
needs_programs = pytest.mark.skipif(not (shutil.which("ccx") and shutil.which("gmsh")), reason="needs ccx and gmsh")
needs_browser = pytest.mark.skipif(not shutil.which("chromium"), reason="needs chromium")
needs_exudyn = pytest.mark.skipif(find_spec("exudyn") is None, reason="needs exudyn")


def said(text):
    """The words that the commands of a page print; where tables break lines depends on their numbers."""
    lines = [line for block in tutorial.SESSION.findall(text) for line in block.splitlines()]
    plain = (re.sub("─+", "", NUMBER.sub("#", line)) for line in lines if not line.startswith(OF_THE_MACHINE))
    return {word.rstrip(";") for line in plain for word in line.split()}


@pytest.mark.usefixtures("forked_commands")
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(DOCS / "tutorial" / "1-lever.md", marks=[pytest.mark.ccx, needs_programs]),
        pytest.param(DOCS / "tutorial" / "2-crank.md", marks=pytest.mark.slow),
        pytest.param(DOCS / "tutorial" / "3-stress.md", marks=[pytest.mark.ccx, needs_programs, needs_exudyn]),
        pytest.param(DOCS / "tutorial" / "4-machine.md", marks=[pytest.mark.ccx, needs_programs]),
        pytest.param(DOCS / "gallery.md", marks=[pytest.mark.slow, pytest.mark.chromium, needs_browser]),
        DOCS / "bearings.md",
        ROOT / "README.md",
    ],
    ids=lambda page: page.stem,
)
def test_what_a_page_shows_is_what_its_commands_print(page, tmp_path):
    text = page.read_text()
    printed, shown = said(tutorial.run_page(text, tmp_path, page.with_suffix(""))), said(text)
    assert printed == shown or (is_complex() and printed > shown)  # which adds that modes cannot be counted
    for name in tutorial.pictures(text, page):
        assert tutorial.picture(tmp_path, name).stat().st_size > 10_000 and (page.with_suffix("") / name).exists()


def test_a_notebook_has_what_its_cells_give(tmp_path, monkeypatch):
    """Texts but for their numbers, and pictures."""
    monkeypatch.chdir(tmp_path)
    path = DOCS / "notebook.ipynb"
    known = json.loads(path.read_text())
    page, fresh = notebooks.as_markdown(path), notebooks.run_cells(known)
    for old, new in zip(known["cells"], fresh["cells"], strict=True):
        data, made = ([item.get("data", item) for item in cell.get("outputs", ())] for cell in (old, new))
        assert [item.keys() for item in data] == [item.keys() for item in made]
        for item, other in zip(data, made, strict=True):
            assert ["image/png" in item or words(item)] == ["image/png" in other or words(other)]
        assert "".join(old["source"]) in page
    assert page.count('src="data:image/png;base64,iVBOR') == 2 and "](notebook.ipynb)" in page


def words(output):
    """The words of a text that a cell gives."""
    return NUMBER.sub("#", "".join(output.get("text", output.get("text/plain")))).split()


def test_a_page_is_written_anew(tmp_path):
    page = 'a\n```toml title="x.toml"\nn = 1\n```\n```console\n$ cat x.toml | \\\n  wc -l\nold\n$ echo b\n```\nc\n'
    made = tutorial.run_page(page, tmp_path)
    assert made == page.replace("old\n", "1\n").replace("$ echo b\n", "$ echo b\nb\n")
    assert said(made) != said(page)


def test_a_command_that_fails_is_no_output(tmp_path):
    with pytest.raises(tutorial.Failed, match=r"(?s)hpcred reduce no.toml.*no such file.*exit status 2"):
        tutorial.run_page("```console\n$ hpcred reduce no.toml | cat\n```\n", tmp_path)
