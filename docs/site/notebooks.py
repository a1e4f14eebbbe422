"""Notebooks: their cells enter; what they give, and Markdown for the site, leave. From the root of the repository,

    python docs/site/notebooks.py docs/notebook.ipynb

runs the cells of a notebook and puts into it what they print and draw, and the value of the last line of each.
"""

from __future__ import annotations

import ast
import base64
import html
import io
import json
import os
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path


def run_cells(notebook: dict) -> dict:
    """The notebook with the outputs of its code cells, which run in order in the current folder."""
    names, cells = {}, []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            cell = cell | {"outputs": _outputs("".join(cell["source"]), names)}
        cells.append(cell)
    return notebook | {"cells": cells}


def _outputs(source, names) -> list[dict]:
    *body, last = ast.parse(source).body
    if not isinstance(last, ast.Expr):
        body, last = [*body, last], None
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    found = []
    if text := printed.getvalue():
        found.append({"output_type": "stream", "name": "stdout", "text": text.splitlines(keepends=True)})
    if value is not None:
        data = {"text/plain": repr(value).splitlines(keepends=True)}
        if hasattr(value, "_repr_html_"):
            data = {"text/html": [value._repr_html_()], **data}
        if hasattr(value, "_repr_png_"):
            data = {"image/png": _small(value._repr_png_()), "text/plain": [f"<{type(value).__name__}>"]}
        found.append({"output_type": "execute_result", "execution_count": None, "metadata": {}, "data": data})
    return found


def _small(picture: bytes) -> str:
    """A picture with few colours, in base64."""
    from PIL import Image  # which is there where figures are drawn

    small, drawn = io.BytesIO(), Image.open(io.BytesIO(picture)).convert("RGB")
    drawn.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(small, "png", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def as_markdown(path: Path) -> str:
    """A page of the site with the cells of a notebook and what they gave."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            text, data = "".join(output.get("text", ())), output.get("data", {})
            if "image/png" in data:
                parts.append(f'<img alt="{html.escape(source)}" src="data:image/png;base64,{data["image/png"]}">')
            elif "text/html" in data:
                parts.append("".join(data["text/html"]))
            elif text or data:
                parts.append(f"```text\n{(text or ''.join(data['text/plain'])).rstrip()}\n```")
    return "\n\n".join([*parts, f"[This page as a notebook]({path.name})"]) + "\n"


def main(path):
    path = Path(path)
    notebook = json.loads(path.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        notebook = run_cells(notebook)
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.path[:0] = [os.getcwd()]
    main(Path(sys.argv[1]).resolve())
