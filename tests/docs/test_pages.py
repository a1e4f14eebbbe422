"""The pages by themselves: links, commands, messages, names of files, and the reference that is made from the code."""

import ast
import inspect
import re
import shlex
import shutil
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated, Literal
from xml.etree import ElementTree

import pytest
import typer.main
from docs_pages import DOCS, PAGES, PATHS, ROOT, reference, tutorial
from pydantic import Field

import hpcred.cli.main
import hpcred.cli.session
from hpcred.writers.registry import WRITERS

GENERATED = reference.pages()
COMMANDS = dict(reference.commands(typer.main.get_command(hpcred.cli.main.app)))
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)
CODE = re.compile(r"`[^`\n]+`")
LINK = re.compile(r"\]\(([^)#\s]*)(?:#[^)]*)?\)")


def name_of(page):
    return str(page.relative_to(ROOT))


def broken_links(page, text):
    """The targets of a page that are neither files nor pages made from the code."""
    for target in LINK.findall(CODE.sub("", FENCE.sub("", text))):
        place = (page.parent / target).resolve()
        made = place.is_relative_to(DOCS) and place.relative_to(DOCS).as_posix() in GENERATED
        if target and not target.startswith(("http://", "https://")) and not place.exists() and not made:
            yield target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files(page):
    assert not list(broken_links(page, page.read_text()))


def test_broken_links_are_seen():
    text = "[a](faq.md#q) [b](nothing.md) [c](reference/job-file.md) [d](https://gmsh.info) `[e](code.md)`"
    assert list(broken_links(DOCS / "index.md", text)) == ["nothing.md"]


def commands_in(text):
    """(command line, whether it is whole) of hpcred, in blocks of code and in sentences."""
    text = re.sub("<!--.*?-->", "", text, flags=re.S)
    blocks = [block.split("\n", 1)[1].rsplit("\n", 1)[0] for block in FENCE.findall(text)]
    blocks += re.findall(r"(?:^    .*\S.*\n?)+", text, re.M)
    for line in "\n".join(blocks).replace("\\\n", " ").splitlines():
        found = re.match(r"\s*(?:\$ )?(?:(?:mpiexec -n \d+|srun) )?(hpcred (?!->).*)$", line)
        if found:
            yield re.split(r" [|>] |  +#|\s+% ", found[1])[0], True
    for code in CODE.findall(FENCE.sub("", text)):
        if code.startswith("`hpcred ") and "..." not in code:
            yield re.split(r" \\?\| ", code.strip("`"))[0], False  # tables have "\\|"


def refusal(line, whole):
    """What the parser says against a command line, or None."""
    _, *words = shlex.split(line, comments=True)
    words = words[: words.index("--")] if "--" in words else words
    if not words or words[0].startswith("-"):
        return None
    words = [word for word in words if word not in hpcred.cli.session.FLAGS]
    size = 2 if tuple(words[:2]) in COMMANDS else 1
    if tuple(words[:size]) not in COMMANDS:
        return None if not whole and any(name[: len(words)] == tuple(words) for name in COMMANDS) else "no such command"
    try:
        COMMANDS[tuple(words[:size])].make_context("hpcred", words[size:])
    except Exception as error:
        if whole or not re.search("Missing|requires an argument", str(error)):
            return str(error) or type(error).__name__
    return None


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_can_be_typed(page):
    assert not {line: why for line, whole in commands_in(page.read_text()) if (why := refusal(line, whole))}


def test_wrong_commands_are_seen():
    text = "    mpiexec -n 2 hpcred reduce j --grups 2  # x\n\n    hpcred reduce\n\n`hpcred reduse` `hpcred reduce`"
    text += "\n\n| `hpcred info m.h5 \\| head -1` |"
    assert [bool(refusal(*found)) for found in commands_in(text)] == [True, True, True, False, False]
    assert len([line for page in PAGES for line in commands_in(page.read_text())]) > 60


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_files_that_are_named_exist(page):
    named = re.findall(r"`((?:docs|examples|jobs|tests|hpcred|benchmarks)/[\w./-]+\.\w+)`", page.read_text())
    assert [name for name in named if not (ROOT / name).exists()] == []
    for path, function in re.findall(r"`(tests/[\w/]+(?:\.py)?)::(\w+)`", page.read_text()):
        assert f"def {function}(" in (ROOT / path).read_text(), path


def test_pages_that_the_program_names_exist():
    named = {
        name for path in (ROOT / "hpcred").rglob("*.py") for name in re.findall(r"docs/[\w/-]+\.md", path.read_text())
    }
    assert named and [name for name in named if not (ROOT / name).exists()] == []


def sentences_of_the_program(quoted):
    """The texts in the code, with … for what is filled in, of modules with all words of one that is quoted."""
    quoted = [re.findall(r"\w\w+", text) for text in quoted]
    for path in (ROOT / "hpcred").rglob("*.py"):
        code = path.read_text()
        if not any(all(word in code for word in words) for words in quoted):
            continue
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
            elif isinstance(node, ast.JoinedStr):
                yield "".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values)


def says(sentence, parts):
    """Whether the parts are in it, one after another."""
    place = 0
    for part in parts:
        if (place := sentence.find(part, place)) < 0:
            return False
        place += len(part)
    return True


def test_messages_are_those_of_the_program():
    """Each message that the page explains is said somewhere, word for word."""
    quoted = re.findall(r"^`([^`]+)`.*\n:   ", (DOCS / "troubleshooting.md").read_text(), re.M)
    known = set(sentences_of_the_program(quoted))
    assert len(quoted) > 15
    assert [text for text in quoted if not any(says(item, text.split("…")) for item in known)] == []


def test_all_exports_are_on_their_page():
    assert {entry.name for entry in WRITERS.own} <= set(re.findall(r"`([\w-]+)`", (DOCS / "exports.md").read_text()))


def test_the_gallery_has_ten_small_pictures_each_behind_its_command():
    text = (DOCS / "gallery.md").read_text()
    parts = text.split("\n## ")[1:]
    names = [tutorial.pictures(part, DOCS / "gallery.md") for part in parts]
    assert len(parts) == 10 and all(len(found) == 1 for found in names)
    for part, (name,) in zip(parts, names, strict=True):
        assert "```console\n$ " in part.partition("![")[0], name
        assert (DOCS / "gallery" / name).stat().st_size < 130_000, name
    assert {path.name for path in (DOCS / "gallery").iterdir()} == {name for (name,) in names}


@pytest.mark.parametrize("page", [ROOT / "README.md", DOCS / "index.md"], ids=lambda page: page.name)
def test_the_first_picture_is_vectors_with_colours_for_light_and_dark(page):
    first = re.search(r"!\[[^]]+\]\(([^)]+)\)", page.read_text())[1]
    picture = (page.parent / first).read_text()
    assert first.endswith(".svg") and "@media (prefers-color-scheme: dark)" in picture and "<title" in picture
    ElementTree.fromstring(picture)


CLAIM = re.compile(r"\b(?:never|refused|refuses|not followed|not loaded|unchanged|not waited)\b")


def claims_without_test(text):
    """Rows of tables and paragraphs that promise what never happens and name no test of it."""
    blocks = re.split(r"\n\n|\n(?=- )", text)
    parts = [part for block in blocks for part in (block.splitlines() if "\n|" in block else [block])]
    return [part for part in parts if CLAIM.search(part) and not re.search(r"`(?:tests/[^`]+|make \w+)`", part)]


def test_what_never_happens_has_a_test():
    page = (DOCS / "robustness.md").read_text()
    assert claims_without_test(page) == [] and len(CLAIM.findall(page)) > 25
    assert claims_without_test("It is never so.\n\n| a | refused | `tests/x.py` |\n| b | refused | |") != []


COMMON = {"comm", "progress"}  # which mean the same in all functions


def named_in(function):
    """The names of its section Parameters."""
    heads = re.findall(r"^(\S[^:\n]*?)(?: :|$)", reference.sections(function)[1].get("Parameters", ""), re.M)
    return {name.strip(" *") for head in heads for name in head.split(",")}


def test_public_functions_say_what_they_take_and_return():
    lacking = {}
    for name, function in reference.public_names().items():
        if inspect.isfunction(function):
            missing = {*inspect.signature(function).parameters} - COMMON - named_in(function)
            if inspect.signature(function).return_annotation is inspect.Signature.empty:
                missing |= {"Returns"} - {*reference.sections(function)[1]}
            lacking |= {name: missing} if missing else {}
    assert lacking == {}


def methods_of(kind):
    """Its own public methods, by name, each with the same of the classes above, which may explain it."""
    for name in vars(kind):
        above = [vars(base).get(name) for base in kind.__mro__]
        same = [getattr(method, "__func__", method) for method in above]
        if not name.startswith("_") and name != "close" and inspect.isfunction(same[0]):
            yield name, [method for method in same if inspect.isfunction(method)]


def arguments_without_meaning(same):
    """The arguments of a method, as it is written, that no text names, and Returns without a section and a type."""
    method = inspect.unwrap(same[0])
    signature = inspect.signature(method)
    named = {word for item in same for word in re.findall(r"\w+", inspect.getdoc(item) or "")}
    missing = {*signature.parameters} - COMMON - {"self", "cls"} - named
    typed = signature.return_annotation is not inspect.Signature.empty or inspect.isgeneratorfunction(method)
    return missing | ({"Returns"} - {*reference.sections(method)[1]} if not typed else set())


def test_public_methods_say_what_they_take_and_return():
    """Of methods, the words of a sentence will do for arguments, and a type for what is returned."""
    kinds = [item for item in reference.public_names().values() if inspect.isclass(item)]
    methods = [(f"{kind.__name__}.{name}", same) for kind in kinds for name, same in methods_of(kind)]
    assert len(methods) > 150
    assert {name: missing for name, same in methods if (missing := arguments_without_meaning(same))} == {}
    assert dict(methods_of(Flat)) and arguments_without_meaning(dict(methods_of(Flat))["area"]) == {"height", "Returns"}


def fields_without_meaning(kind):
    """The arguments of a class that no section Parameters or Attributes names, of itself or of what it extends."""
    above = reference.sources(kind) if is_dataclass(kind) else []
    named = {name for item in (kind, *above) for name in reference.meanings(item)}
    return {*inspect.signature(kind).parameters} - COMMON - {"kind"} - named


def test_public_classes_say_what_their_arguments_are():
    kinds = [item for item in reference.public_names().values() if inspect.isclass(item)]
    kinds = [item for item in kinds if not issubclass(item, Exception)]
    assert len(kinds) > 60
    assert {item.__name__: lacking for item in kinds if (lacking := fields_without_meaning(item))} == {}
    assert fields_without_meaning(Flat) == {"sides"}


@dataclass(frozen=True, kw_only=True)
class Round:
    """A table. `radius`: in m, |r| <R."""

    radius: float
    kind: Literal["round"] = "round"


@dataclass(frozen=True, kw_only=True)
class Flat:
    """Another one."""

    sides: tuple[float, ...] = (1.0, 2.0)
    kind: Literal["flat"] = "flat"

    def area(self, height):
        """Return its area."""


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A file. `shapes`: what there is; `name`: how it is called. `size`: in m. `mode`: how."""

    shapes: tuple[Annotated[Round | Flat, Field(discriminator="kind")], ...] = ()
    name: str | None = None
    size: tuple[float, float]
    mode: Literal["a", "b"] = "a"


def test_keys_are_taken_from_dataclasses():
    page = reference.keys_of_file("a drawing", Drawing)
    assert "- `name`: how it is called." in page
    assert "| `size` | [number, number] | required |" in page
    assert '| `mode` | `"a"` or `"b"` | `"a"` |' in page
    assert '## `[[shapes]]` of kind "round"' in page and "\\|r" not in page and "&lt;R" in page
    assert "| `sides` | list of number | `[1.0, 2.0]` |" in page


@dataclass(frozen=True, kw_only=True)
class Plate:
    """A plate.

    Parameters
    ----------
    length, width : float
        In m; a <b.
    name : str, optional
        Its name,
        in two lines.

    Notes
    -----
    It is thin.
    """

    length: float
    width: float = 1.0
    name: str | None = None


def test_numpydoc_sections_become_meanings_of_keys():
    page = reference.keys_of_file("a plate", Plate)
    assert "| key | value | default | meaning |" in page and "-----" not in page.replace("| --- ", "")
    assert "| `width` | number | `1.0` | In m; a &lt;b. |" in page
    assert "| `name` | text | - | Its name, in two lines. |" in page
    assert "A plate.\n\nIt is thin.\n\n|" in page


def test_pages_do_not_send_readers_to_the_code():
    """The page on Python is looked at when the site is built, with the docstrings in it."""
    texts = {path.name: path.read_text() for path in PAGES} | GENERATED
    assert {name: PATHS.findall(text) for name, text in texts.items() if PATHS.search(text)} == {}
    job = GENERATED["reference/job-file.md"]
    assert "see [`Limits`](python.md#hpcred.reduction.search.goal.Limits)" in " ".join(job.split())


def test_the_reference_has_every_key_command_and_name():
    job = GENERATED["reference/job-file.md"]
    for word in ("tolerance", "interface.nodes", "craig_bampton", "loss_factor", "memory_mb", "zeta0", "icntl"):
        assert (word in job) == (word != "icntl")
    for words in COMMANDS:
        assert f"## hpcred {' '.join(words)}\n" in GENERATED["reference/command-line.md"]
    for name, item in reference.public_names().items():
        assert f"\n::: {item.__module__}.{item.__name__}\n" in GENERATED["reference/python.md"] + "\n", name
    modules = "".join(path.read_text() for path in (ROOT / "hpcred" / "files").glob("*.py"))
    kinds = re.findall(r'^FORMAT.*"(hpcred-\w+)"', modules, re.M)
    assert len(kinds) >= 5
    for kind in kinds:
        assert f"## {kind}, version" in GENERATED["reference/files.md"]


def keys_without_meaning(page):
    """(heading, key) of tables whose row and whose text are silent about a key."""
    for part in re.split("^#+ ", page, flags=re.M)[1:]:
        text = re.sub(r"^\|.*$", "", part, flags=re.M)
        for row in re.findall(r"^\| `(?!-)[^`]+` \|.*$", part, re.M):
            key, *_, meaning = (cell.strip(" `") for cell in re.split(r"(?<!\\)\|", row)[1:-1])
            if not (row.count(" | ") == 3 and meaning) and not re.search(rf"(?<![\w.]){re.escape(key)}(?!\w)", text):
                yield part.partition("\n")[0], key


def test_every_key_has_a_meaning_and_every_heading_its_own_name():
    """Keys of a whole file have theirs in the table."""
    pages = {name: text for name, text in GENERATED.items() if name.endswith("-file.md")}
    assert len(pages) >= 4
    for name, text in pages.items():
        headings = re.findall("^## .*$", text, re.M)
        assert not list(keys_without_meaning(text)) and len(set(headings)) == len(headings), name
        if "machine" not in name:
            assert not re.search(r"^\| `.*\| +\|$", text.partition("\n## ")[0], re.M), name
    silent = "# A\n\n`a`: what it is.\n\n| `a` | text | - |\n| `b` | text | - |\n| `c` | text | - |  |\n"
    assert list(keys_without_meaning(silent)) == [("A", "b"), ("A", "c")]


PYTHON = re.compile(r"^```python[^\n]*\n(.*?)^```", re.M | re.S)
RUN = {  # pages whose programs run here, one after the other, and words that they print
    "assembly.md": ["largest error of the machine about"],
    "python.md": ["largest error", "crank:rx"],
    "stress.md": [],
    "damping.md": ["Maxwell(", "j]]"],
    "outputs.md": ["('acceleration 300:x', 'stress 60:xx') (2, 4) (2, 4)"],
    "parameters.md": ["parameters k 0.5 to 3; terms of K (k)"],
    "campbell.md": ["unstable from 1152.6"],
}
SLOW = ("campbell.md",)
SHORT = {  # what stands for other words where a program runs here
    "parameters.md": {"(0.1, 10.0)": "(0.5, 3.0)",
                      "tolerance=1e-3, band=(0.0, 50.0)": "tolerance=1e-1, band=(0.0, 5.0)"},
    "python.md": {"n, spin = 40, 300.0": "n, spin = 24, 300.0", "crank(dofs=1000)": "crank(dofs=600)"},
}
ELSEWHERE = {  # why the programs of a page do not run here
    "component.md": "is examples/component.py, which tests/examples runs",
    "dolfinx.md": "takes matrices of DOLFINx; tests/examples/test_dolfinx.py has them",
    "exports.md": "is the package of tests/plugins",
    "formats.md": "is the package of tests/plugins",
    "formats-others.md": "runs in Kratos, code_aster and GetFEM, which are not there",
    "solvers.md": "needs a job of its own; tests/linalg/test_packages.py has the same class",
    "export-exudyn.md": "tests/writers/test_exudyn.py runs it in Exudyn",
    "export-fmu.md": "needs FMPy; tests/writers has the same calls",
    "export-state-space.md": "needs python-control; tests/writers has the same calls",
}


def test_programs_of_all_pages_run_or_have_a_reason():
    pages = {name_of(page).removeprefix("docs/") for page in PAGES if PYTHON.search(page.read_text())}
    assert pages == {*RUN, *ELSEWHERE} and not {*RUN} & {*ELSEWHERE}


@pytest.mark.parametrize("page", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in RUN])
def test_programs_of_a_page_run(tmp_path, monkeypatch, capsys, logger, page):
    monkeypatch.chdir(tmp_path)
    program = "\n".join(PYTHON.findall((DOCS / page).read_text()))
    for words, others in SHORT.get(page, {}).items():
        assert words in program
        program = program.replace(words, others)
    exec(compile(program, f"docs/{page}", "exec"), {})
    out = capsys.readouterr().out
    assert all(words in out for words in RUN[page])
    assert page != "python.md" or (Path("linkage.SID_FEM").exists() and "INFO" in Path("hpcred.log").read_text())


def test_every_command_has_a_page_and_a_function():
    """On pages that are written by hand; the function is on the page on Python."""
    texts = "\n".join(page.read_text() for page in PAGES)
    assert [name for words in COMMANDS if f"hpcred {(name := ' '.join(words))}" not in texts] == []
    (listed,) = re.findall(
        r"^Every command is also a function.*?reduction are", (DOCS / "python.md").read_text(), re.M | re.S
    )
    names = re.findall(r"`(\w+)`", listed)
    assert [name for name in names if not callable(getattr(hpcred, name, None))] == []
    alone = {words[0] for words in COMMANDS} - {"example"}
    assert [name for name in alone if not {name, f"{name}_file", f"{name}_job"} & {*names}] == []


def test_verdicts_on_pages_are_those_that_commands_print():
    """Pages that are not run quote the first line of `reduce` from one that is."""
    run = (ROOT / "README.md", *(DOCS / "tutorial").glob("*.md"))
    printed = {line.strip() for page in run for line in page.read_text().splitlines()}
    quoted = [
        line.strip()
        for page in PAGES
        for line in page.read_text().splitlines()
        if re.match(r" *largest error \d", line)
    ]
    assert len(quoted) >= 6 and [line for line in quoted if line not in printed] == []


def test_the_cited_version_and_paper_are_those_of_the_citation_file():
    cited, page = (ROOT / "CITATION.cff").read_text(), " ".join((DOCS / "cite.md").read_text().split())
    assert f"version = {{{re.search(r'^version: (.*)$', cited, re.M)[1]}}}" in page
    assert f"title = {{{re.search(r'^title: .(.*).$', cited, re.M)[1]}}}" in page


def broken_tables(text):
    """Heads of tables that no line sets apart, or whose rows have another number of cells."""
    for rows in re.findall(r"(?:^\|[ -].*\n)+", FENCE.sub("", text), re.M):
        cells = [len(re.split(r"(?<!\\)\|", CODE.sub("", row.strip()))) for row in rows.splitlines()]
        if len(cells) < 2 or not re.match(r"\|( *-+ *\|)+$", rows.splitlines()[1]) or len(set(cells)) > 1:
            yield rows.partition("\n")[0]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_tables_have_a_head_and_rows_of_one_length(page):
    assert list(broken_tables(page.read_text() + "\n")) == []


def test_broken_tables_are_seen():
    assert list(broken_tables("| a | b |\n| 1 | 2 |\n\n| c |\n| --- |\n| 1 | 2 |\n\n| d |\n|---|\n| 1 |\n")) == [
        "| a | b |", "| c |",
    ]  # fmt: skip


def test_every_known_system_of_units_is_on_its_page():
    from hpcred.model.units import UNITS

    text = (DOCS / "units.md").read_text()
    for units in UNITS:
        length, mass, time = (re.escape(word.strip()) for word in units.name.partition(" (")[0].split(",")[:3])
        assert re.search(rf"^\| {length} \| {mass}\b.* \| {time} \|", text, re.M), units.name


TYPED = {  # pages whose commands run here, on small models of these names
    "errors.md": ["automatic.h5", "modes.h5", "craig-bampton.h5", "result.h5"],
    "exports.md": ["result.h5"],
    **{f"export-{name}.md": ["result.h5"] for name in ("arrays", "exudyn", "mbdyn", "mbsim", "simpack")},
    "export-state-space.md": ["result.h5"],
    "export-superelements.md": ["arm.h5", "result.h5"],
    "report.md": ["result.h5", "coarse.h5", "fine.h5"],
    "response.md": [],
    "store.md": ["job.toml"],
    "parameters.md": [],  # which makes its own
    "sweeps.md": [],
}
LONG = ("report.md", "parameters.md", "sweeps.md")

TYPED_ELSEWHERE = {  # why the commands of a page do not run here
    **dict.fromkeys(
        ("README.md", "bearings.md", "gallery.md", "tutorial/1-lever.md", "tutorial/2-crank.md", "tutorial/3-stress.md",
         "tutorial/4-machine.md"),
        "test_tutorials runs them, and compares what they print",
    ),
    **dict.fromkeys(
        ("formats.md", "formats-abaqus.md", "formats-ansys.md", "formats-calculix.md", "formats-matlab.md",
         "formats-nastran.md", "units.md"),
        "take files of other programs; tests/readers has small ones",
    ),
    "assembly.md": "takes files of other programs; tests/assembly has them",
    "campbell.md": "takes results over a speed; tests/workflows/test_campbell.py has them",
    "cluster.md": "plans a cube of 10^7 dofs; tests/workflows/test_plan.py runs them",
    "driven.md": "takes a body on a base, and tables of loads; tests/workflows/test_driven.py runs them",
    "evidence.md": "takes files of publishers",
    "export-chrono.md": "takes a model; tests/examples/test_chrono.py has its script",
    "export-modelica.md": "takes a model; benchmarks/embslib.py has the same command",
    "export-fmu.md": "needs a compiler; tests/writers has the same command",
    "export-openfast.md": "takes loads over time; tests/writers has them",
    "geometric-stiffness.md": "takes bodies of solids under load; tests/body has them",
    "install.md": "only says what is installed",
    "large.md": "takes up to 10^6 dofs",
    "recover.md": "takes simulations and CalculiX; the third tutorial runs the same",
    "reduce.md": "takes jobs with other bases; the first block is that of README",
    "solvers.md": "only says what is installed",
}  # fmt: skip


def test_commands_of_all_pages_run_or_have_a_reason():
    pages = {page for page in PAGES if any(whole for _, whole in commands_in(page.read_text()))}
    assert {name_of(page).removeprefix("docs/") for page in pages} == {*TYPED, *TYPED_ELSEWHERE}


@pytest.fixture(scope="module")
def small_results(tmp_path_factory):
    """Models of the linkage and of a connecting rod, and three results."""
    folder = tmp_path_factory.mktemp("small")
    with hpcred.linkage() as bare, bare.with_inputs([(1, "z"), (20, "z")]) as model:
        hpcred.write_model(folder / "model.h5", model)
    with hpcred.crank(dofs=600) as rod:
        hpcred.write_model(folder / "rod.h5", rod)
    ends = ", ".join(f'{{name = "{of}", nodes = {{set = "{of}"}}}}' for of in ("BIG_EYE", "SMALL_EYE"))
    for name, model, job in (
        ("result", "model", "tolerance = 1e-3"),
        ("modes", "model", 'basis = [{kind = "modes", count = 12}]'),
        ("arm", "rod", f'tolerance = 1e-2\ncoordinates = "interface"\ninterface = [{ends}]'),
    ):
        head = f'model = "{model}.h5"\noutput = "{name}.h5"\nband = [0.0, 300.0]\nframe = {{kind = "buckens"}}\n'
        (folder / f"{name}.toml").write_text(head + job + "\n")
        assert hpcred.cli.main.run(["reduce", str(folder / f"{name}.toml"), "--quiet"]) == 0
    return folder


def make_a_turning_bar():
    """model.h5, job.toml and result.h5 of a clamped bar in the frame that turns with it, over its speed."""
    with hpcred.solid((6, 1, 1), (0.3, 0.02, 0.016), 3) as bar:
        hpcred.write_model("model.h5", bar)
    terms = "".join(
        f'[[term]]\nkind = "{kind}"\naxis = "x"\nfactor = "{factor}"\n'
        for kind, factor in (("coriolis", "omega"), ("spin_softening", "omega^2"))
    )
    head = 'model = "model.h5"\noutput = "result.h5"\nband = [5.0, 300.0]\ntolerance = 1e-2\n'
    range_of = '[[parameter]]\nname = "omega"\nrange = [0.0, 400.0]\nunit = "rad/s"\n'
    Path("job.toml").write_text(head + range_of + terms)
    assert hpcred.cli.main.run(["reduce", "job.toml", "--quiet"]) == 0


LESS = {"points": "3", "check": "1", "count": "3", "cells": "4 2 2", "tolerance": "1e-3"}


def shortened(line):
    """A command line with fewer frequencies, modes and elements."""
    return re.sub(r"--(\w+) (\d\S*(?: \d+)*)", lambda found: f"--{found[1]} {LESS.get(found[1], found[2])}", line)


@pytest.mark.parametrize("page", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in TYPED])
def test_commands_of_a_page_run(tmp_path, monkeypatch, small_results, page):
    """Of files with a title, too, such as sweep.toml; with few frequencies and modes."""
    monkeypatch.chdir(tmp_path)
    for name in ("model.h5", *TYPED[page]):
        made = small_results / {"job.toml": "result.toml"}.get(name, name)
        shutil.copy(made if made.exists() else small_results / "modes.h5", name)
    for name, text in tutorial.FILE.findall((DOCS / page).read_text()):
        Path(name).write_text(text)
    if page == "parameters.md":
        make_a_turning_bar()
    lines = [line for line, whole in commands_in((DOCS / page).read_text()) if whole]
    failed = {line for line in lines if hpcred.cli.main.run([*shlex.split(shortened(line))[1:], "--quiet"]) != 0}
    assert lines and failed == set()


def test_targets_of_make_are_those_of_the_makefile():
    """Each that a page names is there, and CONTRIBUTING names each test."""
    targets = set(re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text(), re.M))
    guide = (ROOT / "CONTRIBUTING.md").read_text()
    texts = [guide, *(page.read_text() for page in PAGES)]
    named = {name for text in texts for name in re.findall(r"(?:^    |`)make ([a-z][\w-]*)", text, re.M)}
    assert len(named) > 15 and named <= targets
    helpers = {"test-packages", "test-cuda", "test-debian12"}  # of others, of a GPU, and named beside Debian 13
    assert {name for name in targets if name.startswith("test")} - named <= helpers


def test_the_house_on_the_page_for_developers_is_that_of_the_code():
    """Its rooms, and the files and folders of the sources that it and CONTRIBUTING name."""
    page = (DOCS / "developers.md").read_text()
    (house,) = re.findall(r"```text\n(.*?)```", page, re.S)
    rooms = {path.name for path in (ROOT / "hpcred").iterdir() if (path / "__init__.py").exists()}
    assert set(re.findall(r"^(\w+)/", house, re.M)) == rooms
    below = {path.name for path in (ROOT / "hpcred" / "reduction").iterdir() if (path / "__init__.py").exists()}
    assert set(re.findall(r"^  (\w+)/", house, re.M)) == below
    texts = page + (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`((?:docs|examples|jobs|tests|hpcred|benchmarks|packaging)/[\w./-]+)`", texts)
    assert len(named) > 20 and [name for name in named if not (ROOT / name).exists()] == []
