"""The pages whose commands are run: what they show is what comes out, but for numbers that depend on the machine."""

import re
import shutil

import pytest
from docs_pages import DOCS, ROOT, tutorial

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
OF_THE_MACHINE = ("time ", "MUMPS ", "real PETSc", "complex PETSc")
needs_programs = pytest.mark.skipif(not (shutil.which("ccx") and shutil.which("gmsh")), reason="needs ccx and gmsh")


def said(text):
    """The words that the commands of a page print; where tables break lines depends on their numbers."""
    lines = [line for block in tutorial.SESSION.findall(text) for line in block.splitlines()]
    plain = (re.sub("─+", "", NUMBER.sub("#", line)) for line in lines if not line.startswith(OF_THE_MACHINE))
    return {word for line in plain for word in line.split()}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(DOCS / "tutorial" / "1-lever.md", marks=[pytest.mark.ccx, needs_programs]),
        pytest.param(DOCS / "tutorial" / "2-crank.md", marks=pytest.mark.slow),
        ROOT / "README.md",
    ],
    ids=lambda page: page.stem,
)
def test_what_a_page_shows_is_what_its_commands_print(page, tmp_path):
    text = page.read_text()
    assert said(tutorial.run_page(text, tmp_path)) == said(text)
    for name in tutorial.pictures(text, page):
        assert tutorial.picture(tmp_path, name).stat().st_size > 10_000 and (page.with_suffix("") / name).exists()


def test_a_page_is_written_anew(tmp_path):
    page = 'a\n```toml title="x.toml"\nn = 1\n```\n```console\n$ cat x.toml | \\\n  wc -l\nold\n$ echo b\n```\nc\n'
    made = tutorial.run_page(page, tmp_path)
    assert made == page.replace("old\n", "1\n").replace("$ echo b\n", "$ echo b\nb\n")
    assert said(made) != said(page)


def test_a_command_that_fails_is_no_output(tmp_path):
    with pytest.raises(tutorial.Failed, match=r"(?s)hpcred reduce no.toml.*no such file.*exit status 2"):
        tutorial.run_page("```console\n$ hpcred reduce no.toml | cat\n```\n", tmp_path)
