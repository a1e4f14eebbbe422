"""Licences of what others made, the citation, and the version, which stands in several files."""

import re
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml
from conftest import DATA

import hpcred

ROOT = Path(__file__).parent.parent
PACKAGE = Path(hpcred.__file__).parent
OWN = {"body.c", "report.html", "report.css", "report.js", "three_parts.js", "README.md"}


def licences_of_data():
    """(pattern of names, file of the licence) of the table in SOURCES.md."""
    for line in (DATA / "SOURCES.md").read_text().splitlines():
        if line.startswith("| `"):
            files, _, licence = line.strip("| ").split(" | ")
            for pattern in re.findall("`(.+?)`", files):
                yield pattern, DATA / re.search(r"\]\((.+?)\)", licence)[1]


def test_each_file_of_data_has_one_licence():
    rows = list(licences_of_data())
    names = [path.relative_to(DATA).as_posix() for path in DATA.rglob("*") if path.is_file()]
    names = [name for name in names if name != "SOURCES.md" and not name.startswith("LICENSES/")]
    wrong = {name: found for name in names if len(found := [row for row in rows if fnmatch(name, row[0])]) != 1}
    assert len(names) > 70 and not wrong
    assert [pattern for pattern, _ in rows if not any(fnmatch(name, pattern) for name in names)] == []
    kept = {path.resolve() for path in (DATA / "LICENSES").iterdir()} | {ROOT / "LICENSE"}
    assert {path.resolve() for _, path in rows} == kept
    assert all("Permission is hereby granted" in text or "Redistribution and use" in text
               for text in (path.read_text() for path in kept))  # fmt: skip


@pytest.mark.parametrize("folder", ["report/assets", "writers/fmi2"])
def test_each_vendored_file_has_a_licence(folder):
    """`name.LICENSE` for name.js or name-part.js, or LICENSE with the names of files in it."""
    folder = PACKAGE / folder
    texts = {path.name: path.read_text() for path in folder.glob("*LICENSE")}
    for path in folder.iterdir():
        if path.name not in OWN and path.name not in texts:
            short = f"{re.match('[a-z]+', path.name)[0]}.LICENSE"
            assert short in texts or path.name in texts.get("LICENSE", ""), path.name
    assert texts and all("Copyright" in text for text in texts.values())


def test_versions_agree():
    version = re.search('^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.M)[1]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    heads = re.findall(r"^## (\S+)(?: - (\d{4}-\d\d-\d\d))?$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert heads.pop(0) == ("Unreleased", "")
    (newest, date), *_ = heads
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    assert newest == version == citation["version"] == recipe["context"]["version"]
    assert "date-released" not in citation or str(citation["date-released"]) == date


def test_the_citation_names_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors", "license", "references"} <= set(citation)
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Lehner", "Eberhard"]
    assert paper["title"] in " ".join((ROOT / "README.md").read_text().split()) and str(paper["year"]) == "2006"


def requirements(recipe):
    """{name: what follows it} of a file for conda, with the names of PyPI."""
    given = yaml.safe_load((ROOT / recipe).read_text())
    lines = given["dependencies"] if "dependencies" in given else given["requirements"]["run"]
    words = (line.replace("python-xxhash", "xxhash").split(maxsplit=1) for line in lines if isinstance(line, str))
    return {name: " ".join(rest) for name, *rest in words}


@pytest.mark.parametrize("recipe", ["environment.yml", "packaging/conda/recipe.yaml"])
def test_recipes_name_what_hpcred_needs(recipe):
    """With the same bounds, and the packages that pip is not asked for."""
    text = (ROOT / "pyproject.toml").read_text()
    listed = re.search(r"^dependencies = \[\n(.*?)^\]", text, re.M | re.S)[1]
    needed = dict(re.findall(r"^    \"(\w+)([^\";]*)\"", listed, re.M))
    known = requirements(recipe)
    assert len(needed) > 8 and {"petsc", "petsc4py", "slepc4py", "mpi4py"} <= set(known)
    assert {name: known.get(name) for name, bound in needed.items() if bound not in known.get(name, "no")} == {}


def test_the_recipe_of_a_feedstock_has_what_the_project_has():
    text = (ROOT / "pyproject.toml").read_text()
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text())
    assert f'"Programming Language :: Python :: {recipe["context"]["python_min"]}"' in text
    about, (entry,) = recipe["about"], recipe["build"]["python"]["entry_points"]
    command, place = entry.split(" = ")
    assert f'description = "{about["summary"]}"' in text and f'{command} = "{place}"' in text
    assert f'text = "{about["license"]}"' in text and (ROOT / about["license_file"]).exists()


def test_the_workflow_runs_what_there_is():
    """Targets of make and files of the checkout, and Pythons that the classifiers name."""
    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    targets = {word for line in commands if line.startswith("make ") for word in line.split()[1:]}
    makefile = (ROOT / "Makefile").read_text()
    assert {"demo", "test", "test-pip"} <= targets
    assert all(re.search(rf"^{target}:", makefile, re.M) for target in targets)
    classified = re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text())
    assert set(jobs["pip"]["strategy"]["matrix"]["python"]) <= set(classified)
