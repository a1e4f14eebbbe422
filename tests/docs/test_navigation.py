"""From the first page to every page, and to the answers of users, by links in the text: three clicks at most."""

import re

import pytest
from docs_pages import DOCS, notebooks, reference

CLICKS = 3
TEXTS = {page.relative_to(DOCS).as_posix(): page.read_text() for page in DOCS.rglob("*.md")} | reference.pages()
TEXTS["notebook.md"] = notebooks.as_markdown(DOCS / "notebook.ipynb")
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def links(page):
    """The pages that a page leads to."""
    text = re.sub(r"^```.*?^```$", "", TEXTS[page], flags=re.M | re.S)
    for target in LINK.findall(text):
        if "://" not in target:
            place = (DOCS / page).parent.joinpath(target).resolve()
            found = place.relative_to(DOCS).as_posix() if place.is_relative_to(DOCS) else ""
            yield found.replace(".ipynb", ".md")


def clicks():
    """The least number of clicks from the first page to each."""
    found, pages = {"index.md": 0}, ["index.md"]
    for page in pages:
        for target in links(page):
            if target in TEXTS and target not in found:
                found[target] = found[page] + 1
                pages.append(target)
    return found


def test_every_page_is_three_clicks_from_the_first():
    found = clicks()
    assert {page: found.get(page) for page in TEXTS if found.get(page, CLICKS + 1) > CLICKS} == {}


ANSWERS = {  # what users ask: the pages that they click on from the first one, and words of the answer
    "engineer": [
        ("How do I install it without root?", "install.md", "pip install"),
        ("Which files does ANSYS have to write?", "formats.md formats-ansys.md", "WRFULL,1"),
        ("My model is in mm and t: what do I type?", "units.md", "--units mm,t,s"),
        ("How do I name a bearing by its hole?", "bearings.md", "hpcred bores"),
        ("How does oil pressure act?", "loads.md", '"pressure"'),
        ("Which tolerance do I need?", "choose.md", "Start with 1e-4"),
        ("How do I give damping ratios?", "damping.md", 'kind  = "modal"'),
        ("Is the result right?", "errors.md", "--check 5"),
        ("How do I get it into SIMPACK?", "exports.md export-simpack.md", "--format sid"),
        ("What is the stress over time?", "tutorial/3-stress.md", "hpcred recover"),
    ],
    "scientist": [
        ("How do I reduce matrices of SciPy?", "python.md", "SecondOrderModel(M, D, K, B, C)"),
        ("What does eps bound?", "theory/error.md", "drive-point"),
        ("How are the points chosen?", "theory/method.md theory/automatic.md", "negative pivots"),
        ("What do balanced truncation and IRKA reach?", "evidence.md", "SOBT"),
        ("Where are the published models?", "evidence.md", "benchmarks.models make"),
        ("How do I go to pyMOR and back?", "python.md", "from_pymor"),
        ("One basis for a range of a parameter?", "parameters.md", "ParametricModel"),
        ("How do I write a component of my own?", "component.md", "run.solvers.factored"),
        ("How are dofs without mass treated?", "theory/method.md", "M singular"),
        ("How do I cite it?", "cite.md", "@software"),
    ],
    "cluster": [
        ("How do I install it on the PETSc of my site?", "install.md", "PETSc 3.18 or later"),
        ("How much memory and time does my job take?", "cluster.md", "hpcred plan"),
        ("Which batch script do I submit?", "cluster.md", "jobs/reduce.slurm"),
        ("What if a factor does not fit?", "cluster.md", 'unfit = "multigrid"'),
        ("Can it use a GPU?", "solvers.md", "cuDSS"),
        ("How does it scale with ranks?", "large.md", "Strong scaling"),
        ("How do I run a hundred variants?", "sweeps.md", "[[vary]]"),
        ("Does a killed run continue?", "store.md", "killed or requeued continues"),
        ("What is on the disk after a crash?", "robustness.md", "SIGKILL"),
        ("Can DOLFINx pass its matrices in memory?", "formats.md dolfinx.md", "from_petsc"),
    ],
}


@pytest.mark.parametrize("user", ANSWERS)
def test_ten_questions_are_answered_in_three_clicks(user):
    assert len(ANSWERS[user]) == 10
    for question, path, words in ANSWERS[user]:
        pages = ["index.md", *path.split()]
        assert len(pages) - 1 <= CLICKS, question
        for page, following in zip(pages, pages[1:], strict=False):
            assert following in set(links(page)), (question, following)
        assert words in TEXTS[pages[-1]], question
