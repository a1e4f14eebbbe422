"""Programs that use public names pass a strict type checker, which finds words that are spelled wrong."""

import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest
from docs_pages import reference

import hpcred

USES = "from typing import Any\n\nimport hpcred\n\n\ndef use(*a: Any, **k: Any) -> None:\n"
WRONG = """import hpcred

with hpcred.linkage() as model:
    hpcred.reduce(model, tolerence=1e-4)
    hpcred.Modes(count="six")
    hpcred.reduce(model, hpcred.Modes(count=6)).frequency_responses([1.0])
"""


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """A function that gives the errors of a strict check of a program; what is known of hpcred is kept."""
    pytest.importorskip("mypy")
    tmp_path = tmp_path_factory.mktemp("checked")

    def check(program):
        (tmp_path / "program.py").write_text(program)
        options = ["--strict", "--follow-imports=silent", "--cache-dir", str(tmp_path / "cache")]
        options += ["--disable-error-code=func-returns-value"]  # what returns nothing is used like the others here
        place = os.environ | {"MYPYPATH": str(Path(hpcred.__file__).parents[1])}  # of an editable installation
        done = subprocess.run([sys.executable, "-m", "mypy", *options, "program.py"], cwd=tmp_path, text=True,
                              capture_output=True, env=place)  # fmt: skip
        return [line for line in done.stdout.splitlines() if ": error:" in line]

    return check


def test_all_public_names_have_types(checked):
    """Functions, classes and their methods; of what is typed in part the parts count."""
    lines = []
    for name, item in reference.public_names().items():
        if inspect.isabstract(item):
            continue
        value = f"v_{name.replace('.', '_')}"
        lines.append(f"    {value} = hpcred.{name}(*a, **k)")
        for method, _ in inspect.getmembers(item, inspect.isfunction) if inspect.isclass(item) else ():
            if not method.startswith("_"):
                lines.append(f"    {value}.{method}(*a, **k)")
    assert len(lines) > 200
    assert checked(USES + "\n".join(lines) + "\n") == []


def test_a_checker_sees_what_is_wrong(checked):
    errors = checked(WRONG)
    assert len(errors) == 3 and 'did you mean "tolerance"' in errors[0]
    assert 'expected "int' in errors[1] and '"frequency_responses"' in errors[2]
