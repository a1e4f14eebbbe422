"""What MkDocs calls while it builds: pages are made of the code and of notebooks, formulas become MathML, and buttons
copy the commands of a console alone."""

import html
import re
import sys
from pathlib import Path

import latex2mathml.converter
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tutorial"), str(HERE.parents[1])]

from notebooks import as_markdown  # noqa: E402  (beside this file, which is in no package)
from reference import linked, pages  # noqa: E402
from run import commands  # noqa: E402  (in docs/tutorial)

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.S)
CONSOLE = re.compile(r'<div class="language-console highlight">(.*?)</div>', re.S)
CELL = re.compile(r"<td[^>]*>.*?</td>", re.S)
SMALL = re.compile(r"(?<![\w.=-])-?\d[\d.]*e-\d+(?![^<]*>)")  # numbers that a browser would break behind e-
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.S)


@event_priority(-100)
def on_config(config):
    """The theme fetches a script for search in local files; the site has its own."""
    config.extra["polyfills"] = ["worker.js"]
    return config


def on_files(files, config):
    notebooks = [file for file in files if file.src_uri.endswith(".ipynb")]
    made = {str(Path(file.src_uri).with_suffix(".md")): as_markdown(Path(file.abs_src_path)) for file in notebooks}
    for name, text in (pages() | made).items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_content(content, page, config, files):
    content = INLINE.sub(lambda found: mathml(found[1], "inline"), content)
    content = CONSOLE.sub(with_commands, content)
    content = CELL.sub(lambda found: SMALL.sub(r'<span class="number">\g<0></span>', found[0]), content)
    if page.file.src_uri == "reference/python.md":
        content = linked(content, '<a href="#{place}"><code>{name}</code></a>')
    return BLOCK.sub(lambda found: mathml(found[1], "block"), content)


def with_commands(found):
    """A console block whose button copies the commands alone, without prompts and what they print."""
    typed = commands(html.unescape(re.sub(r"<[^>]+>", "", found[1])))
    return found[0].replace("<div ", f'<div data-copy="{html.escape(chr(10).join(typed))}" ', 1)


def mathml(formula, display):
    """A formula of LaTeX, as it stands in HTML, as MathML, which browsers draw without a script."""
    return latex2mathml.converter.convert(html.unescape(formula).strip(), display=display)
