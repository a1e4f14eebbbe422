"""The pages of the documentation, and the programs in docs/ that make parts of them."""

import importlib.util
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PATHS = re.compile(r"\bsee (?:the module |(?:[a-z]\w*\.)+)\w+")  # of the code, which a reader of a page does not have
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def load(path):
    """A program of docs/ or examples/ as a module."""
    spec = importlib.util.spec_from_file_location(f"program_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where pickle looks for its classes
    spec.loader.exec_module(module)
    return module


notebooks = load(DOCS / "site" / "notebooks.py")
reference = load(DOCS / "site" / "reference.py")
tutorial = load(DOCS / "tutorial" / "run.py")
