"""What MkDocs calls while it builds: reference pages are added to its files, formulas become MathML."""

import html
import re
import sys
from pathlib import Path

import latex2mathml.converter
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

from reference import pages  # noqa: E402  (beside this file, which is in no package)

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.S)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.S)


@event_priority(-100)
def on_config(config):
    """The theme fetches a script for search in local files; the site has its own."""
    config.extra["polyfills"] = ["worker.js"]
    return config


def on_files(files, config):
    for name, text in pages().items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_content(content, page, config, files):
    content = INLINE.sub(lambda found: mathml(found[1], "inline"), content)
    return BLOCK.sub(lambda found: mathml(found[1], "block"), content)


def mathml(formula, display):
    """A formula of LaTeX, as it stands in HTML, as MathML, which browsers draw without a script."""
    return latex2mathml.converter.convert(html.unescape(formula).strip(), display=display)
