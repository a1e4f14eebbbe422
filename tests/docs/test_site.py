"""The built site: strict, whole, and without anything from a network."""

import html
import importlib.util
import inspect
import os
import re
import shutil
import subprocess
import sys

import pytest
from docs_pages import DOCS, PATHS, ROOT, reference, tutorial

import hpcred

pytestmark = [
    pytest.mark.docs,
    pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="needs the extra 'docs'"),
]
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_every_page_is_there_and_in_the_navigation(site):
    pages = {page.relative_to(DOCS).with_suffix(".html").as_posix() for page in DOCS.rglob("*.md")}
    pages |= {name.replace(".md", ".html") for name in reference.pages()}
    assert [name for name in sorted(pages) if not (site / name).is_file()] == []
    start = (site / "index.html").read_text()
    menu = set(re.findall(r'<a href="([^"#]+)" class="md-nav__link', start)) | {"index.html"}
    assert pages <= menu


def test_nothing_is_fetched(site):
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"?(?:https?:)?//[^>]*>", text) == [], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//|@import", sheet.read_text()), sheet


def test_formulas_are_drawn_without_a_script(site):
    for page in (site / "theory").glob("*.html"):
        text = page.read_text()
        assert "<math" in text and "arithmatex" not in text and "merror" not in text, page
        assert not re.search(r"\$[^$<]*\\\w+", text), page


def test_small_numbers_stay_on_one_line(site):
    cells = re.findall(r"<td[^>]*>(.*?)</td>", (site / "evidence.html").read_text(), re.S)
    small = [cell for cell in cells if re.search(r"\de-\d", cell)]
    assert len(small) > 50 and all('<span class="number">' in cell for cell in small)


def test_buttons_copy_commands_alone(site):
    text = (site / "tutorial" / "2-crank.html").read_text()
    copied = list(map(html.unescape, re.findall(r'<div data-copy="([^"]*)" class="language-console', text)))
    page = (DOCS / "tutorial" / "2-crank.md").read_text()
    typed = ["\n".join(tutorial.commands(block)) for block in tutorial.SESSION.findall(page)]
    assert copied == typed and any("hpcred reduce" in block for block in copied)
    assert not any(line.startswith(("$ ", " ─")) for block in copied for line in block.splitlines())


def test_the_notebook_is_a_page_and_a_file(site):
    text = (site / "notebook.html").read_text()
    assert text.count('src="data:image/png;base64,') == 2 and 'href="notebook.ipynb"' in text
    assert (site / "notebook.ipynb").read_bytes() == (DOCS / "notebook.ipynb").read_bytes()


def test_every_public_name_has_its_place(site):
    text = (site / "reference" / "python.html").read_text()
    assert re.search(r'id="(hpcred\.[\w.]+)"', text)[1].endswith(".reduce")
    assert not PATHS.findall(re.sub(r"<[^>]+>", "", text))
    places = {place.rpartition(".")[2] for place in re.findall(r'id="(hpcred\.[\w.]+)"', text)}
    assert {item.__name__ for item in reference.public_names().values()} <= places


def test_keywords_that_may_be_left_out_are_shown_so(site):
    """Also those that the signature in the code has as **keywords."""
    text = (site / "reference" / "python.html").read_text()
    part = text[text.index('id="hpcred.reduction.reduce.reduce"') :]
    rows = re.findall(r"<tr.*?</tr>", part[: part.index("</table>")], re.S)
    needed = [re.search(r"<code>(\w+)</code>", row)[1] for row in rows if "required" in row]
    assert needed == ["model"] and len(rows) > len(inspect.signature(hpcred.reduce).parameters)  # one is the head


@pytest.mark.skipif(BROWSER is None, reason="needs chromium")
def test_the_search_works_in_local_files(site, tmp_path):
    done = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}", "--dump-dom",
         "--virtual-time-budget=10000", f"{(site / 'index.html').as_uri()}?q=inertia+relief"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert re.search(r"\d+ matching documents", done.stdout)
    assert "theory/free-bodies.html" in done.stdout.partition("md-search-result__list")[2]
