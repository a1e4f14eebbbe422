"""Runs a page: its files are written, its commands run in order, and what they print is put in the page.

A block ```toml title="job.toml" (or of any other language with a title) is a file. A block ```console has commands
behind "$ " and below each what it prints. A folder with the name of the page has scripts, meshes and jobs that its
commands take, and its pictures, which are taken over from the folder of the run. From the root of the repository, with
gmsh and CalculiX for the first, the third and the fourth tutorial, Exudyn for the third, and chromium for the gallery:

    python docs/tutorial/run.py docs/tutorial/1-lever.md
    python docs/tutorial/run.py docs/tutorial/2-crank.md
    python docs/tutorial/run.py docs/tutorial/3-stress.md
    python docs/tutorial/run.py docs/tutorial/4-machine.md
    python docs/tutorial/run.py docs/gallery.md
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

FILE = re.compile(r'^```\w+ title="([^"]+)"\n(.*?)^```$', re.M | re.S)
SESSION = re.compile(r"^```console\n(.*?)^```$", re.M | re.S)
BLOCK = re.compile(rf"(?:{FILE.pattern})|(?:{SESSION.pattern})", re.M | re.S)
WIDTH = 80  # of tables, as on most terminals
WIDEST, COLOURS = 900, 256  # of pictures, which a site carries with it
ROOT = Path(__file__).parents[2]


class Failed(Exception):
    """A command of the page did not end as it should."""


def run_page(text: str, folder: Path, beside: Path | None = None) -> str:
    """The text of the page with what its commands print when they run in the folder, with scripts, meshes and jobs
    of another folder `beside` them. Raises Failed."""
    environment = _environment(folder)
    for name in beside.glob("*") if beside is not None else ():
        if name.suffix in (".py", ".geo", ".toml"):
            shutil.copy(name, folder)

    def replaced(found):
        if found[1]:
            path = folder / found[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(found[2])
            return found[0]
        said = [f"$ {command}\n{_output(command, folder, environment)}" for command in commands(found[3])]
        return "```console\n" + "".join(said) + "```"

    return BLOCK.sub(replaced, text)


def commands(session: str) -> list[str]:
    """The commands of a console block; a line that ends with a backslash goes on in the next."""
    return [found.rstrip("\n") for found in re.findall(r"^\$ ((?:.*\\\n)*.*)$", session, re.M)]


def _output(command, folder, environment):
    words = ["bash", "-o", "pipefail", "-c", command]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=1200)
    if done.returncode:
        raise Failed(f"$ {command}\n{done.stdout}{done.stderr}\nexit status {done.returncode}")
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    return "".join(f"{line}\n" for line in lines if line)


def _environment(folder):
    """`hpcred` and `python` are of this repository; as many ranks as a page asks for; tables as wide as a page."""
    tools = Path(tempfile.mkdtemp(dir=folder, prefix=".bin"))
    for name, command in (("hpcred", f"{sys.executable} -m hpcred"), ("python", sys.executable)):
        shim = tools / name
        shim.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
        shim.chmod(0o755)
    return {
        "OPENBLAS_NUM_THREADS": "1",
        **os.environ,
        "PATH": f"{tools}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": str(WIDTH),
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
    }


def pictures(text: str, page: Path) -> list[str]:
    """The names of the pictures that the page has of the run."""
    return re.findall(rf"!\[[^]]*\]\({re.escape(page.stem)}/([^)/]+)\)", text)


def picture(folder, name) -> Path:
    """Where a run left a picture. Raises Failed."""
    for path in sorted(Path(folder).rglob(name)):
        return path
    raise Failed(f"the page has the picture {name}, which no command made")


def save_small(source, target):
    """Write a picture with fewer pixels and colours, so that the repository and the site stay small."""
    with Image.open(source) as found:
        found = found.convert("RGB")
        found.thumbnail((WIDEST, 2 * WIDEST))
        found.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)


def main(page):
    page = Path(page)
    with tempfile.TemporaryDirectory() as folder:
        text = run_page(page.read_text(), Path(folder), page.with_suffix(""))
        for name in pictures(text, page):
            page.with_suffix("").mkdir(exist_ok=True)
            save_small(picture(folder, name), page.with_suffix("") / name)
    page.write_text(text)


if __name__ == "__main__":
    main(*sys.argv[1:])
