"""The tables of evidence: what pages show is what was saved, and one case has one number."""

import json
import re
import sys

import pytest
from docs_pages import DOCS, ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
import tables


@pytest.mark.parametrize("page", tables.PAGES)
def test_tables_of_pages_are_those_of_the_saved_results(page):
    assert tables.written(page) == (ROOT / page).read_text()


def test_every_table_of_the_page_is_made():
    """Those of evidence that a hand wrote say what models are, and have no results."""
    page = (DOCS / "evidence.md").read_text()
    shown = {name for path in tables.PAGES for _, name, _ in tables.BLOCK.findall((ROOT / path).read_text())}
    assert shown == {*tables.EVIDENCE, "runs", "compared", "more"}
    heads = re.findall(r"^\| (.*)\n\| ---", tables.BLOCK.sub("", page), re.M)
    assert [head.partition(" |")[0] for head in heads] == ["model"]


def numbers_of_cases():
    found = {}
    for case, value, run in tables.claims():
        found.setdefault(case, {}).setdefault(value, run)
    return found


def test_one_case_has_one_number():
    """A body, tolerance and method has one size, one error and one time on the page, whichever runs have it."""
    found = numbers_of_cases()
    assert {case: values for case, values in found.items() if len(values) > 1} == {}
    assert ("iss", 1e-4, "hpcred", "size") in found and len(found) > 150


def test_two_numbers_for_a_case_are_seen(tmp_path, monkeypatch):
    for path in tables.OUTCOMES.glob("*.json"):
        (tmp_path / path.name).write_text(path.read_text())
    row = {"model": "iss", "error": 1e-4, "method": "hpcred", "size": "1", "seconds": "-"}
    (tmp_path / "rivals.new.json").write_text(json.dumps({"rows": [row]}))
    monkeypatch.setattr(tables, "OUTCOMES", tmp_path)
    assert len(numbers_of_cases()["iss", 1e-4, "hpcred", "size"]) == 2


def test_every_run_says_where_it_is_from():
    for path in tables.OUTCOMES.glob("*.json"):
        found = json.loads(path.read_text())
        assert all(found[key] for key in ("machine", "date", "commit", "rows")), path
        assert found["versions"] or found["recorded"], path
