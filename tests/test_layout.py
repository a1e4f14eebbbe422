"""The rules of the house: floors, public names, docstrings, and PETSc loaded only when it is used."""

import ast
import gc
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from importlib import metadata
from importlib.util import resolve_name
from operator import attrgetter
from pathlib import Path

import pytest
from docs_pages import reference
from launch import mpi_environment

import hpcred
from hpcred.cli.main import run

HOUSE = Path(hpcred.__file__).parent
FLOORS = ["cli", "workflows", "report", "writers", "readers", "settings", "files"]
FLOORS += ["examples", "simulation", "assembly", "body", "analysis", "reduction", "model", "fe", "linalg", "parallel"]
ROOMS = {"reduction": ["", "parametric", "search", "components", "run", "small", "result"]}  # "": modules in no room
PEERS = {"control", "exudyn", "fmpy", "meshio", "pymor", "pyNastran", "pyuff", "pyyeti"}
DOORS = ("", "__main__", "public_names", "laws", "loads", "outputs")  # the street door, and public modules beside it
ATTACHED = "public_names.attached"
PUBLIC = r'""".+"""\n\nfrom \.+public_names import attached\n\n__getattr__, __dir__, __all__ = attached\(.+\)\n'
FACADE = {  # methods that stand for public functions of rooms above
    "Campbell": {"plot"},
    "ReducedModel": {"export", "frequency_response", "plot", "save", "to_pymor", "to_state_space"},
    "SecondOrderModel": {"frequency_response", "plot_modes"},
}
MODULES = {
    ".".join(path.relative_to(HOUSE).with_suffix("").parts).removesuffix("__init__").rstrip("."): path
    for path in sorted(HOUSE.rglob("*.py"))
}


@cache
def tree_of(path):
    gc.disable()  # which looks at all trees again and again, and takes four fifths of the time
    try:
        return ast.parse(path.read_text())
    finally:
        gc.enable()


def children(node):
    """The statements and branches right below a module, a statement or a branch."""
    for field in ("body", "handlers", "orelse", "finalbody", "cases"):
        yield from getattr(node, field, ())


def statements(node):
    """All of these below, without the expressions in them, which are many more."""
    for child in children(node):
        yield child
        yield from statements(child)


def imports(name, path):
    """The modules of hpcred, without its name, that a module imports anywhere in its text."""
    here = ".".join(["hpcred", *name.split(".")[: None if path.name == "__init__.py" else -1]]).rstrip(".")
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), here) if node.level else node.module
            targets = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for target in targets:
            if target.startswith("hpcred."):
                yield target.removeprefix("hpcred.")


def floor(name):
    return FLOORS.index(name.split(".")[0])


def public_imports(path):
    """The scopes, such as "ReducedModel.plot" or "", in which a module imports the public names of hpcred."""
    def scopes(node, scope):
        for child in children(node):
            named = isinstance(child, (ast.ClassDef, ast.FunctionDef))
            yield from scopes(child, f"{scope}.{child.name}".lstrip(".") if named else scope)
            if isinstance(child, ast.Import) and any(alias.name == "hpcred" for alias in child.names):
                yield scope
            if isinstance(child, ast.ImportFrom) and child.module == "hpcred" and not child.level:
                yield scope

    return scopes(tree_of(path), "")


def contracted(arrows, room):
    """Return the arrows among the modules and the folders in a room."""
    def place(name):
        parts = name.split(".")
        return parts[len(room)] if parts[: len(room)] == room and len(parts) > len(room) else None

    found = {}
    for name, targets in arrows.items():
        if (here := place(name)) is not None:
            found.setdefault(here, set()).update({place(target) for target in targets} - {here, None})
    return found


def test_every_room_has_its_floor():
    rooms = {name.split(".")[0] for name in MODULES} - set(DOORS)
    assert rooms == set(FLOORS)


def test_no_import_goes_up():
    arrows = [(name, target) for name in MODULES if name not in DOORS for target in imports(name, MODULES[name])
              if target != ATTACHED]  # fmt: skip
    assert not [arrow for arrow in arrows if arrow[1].split(".")[0] not in FLOORS], "names of the street door"
    assert not [arrow for arrow in arrows if floor(arrow[1]) < floor(arrow[0])]


@pytest.mark.parametrize("house", ROOMS)
def test_no_import_goes_up_among_rooms(house):
    def room(name):
        first = name.split(".")[1]
        return ROOMS[house].index(first if MODULES[f"{house}.{first}"].name == "__init__.py" else "")

    modules = [name for name in MODULES if name.startswith(f"{house}.")]
    arrows = [(name, target) for name in modules for target in imports(name, MODULES[name])]
    arrows = [arrow for arrow in arrows if arrow[1].startswith(f"{house}.")]
    assert not [arrow for arrow in arrows if room(arrow[1]) < room(arrow[0])]
    assert {name.split(".")[1] for name in modules if name.count(".") > 1} == {*ROOMS[house]} - {""}


def test_public_names_are_for_facade_methods():
    """Nothing below the street door calls them, but methods that a user expects at a model."""
    allowed = {f"{owner}.{method}" for owner, methods in FACADE.items() for method in methods}
    found = {(name, scope) for name, path in MODULES.items() if name not in DOORS for scope in public_imports(path)}
    rooms = sorted((name, scope) for name, scope in found if name.split(".")[0] != "cli")
    assert {scope for _, scope in rooms} == allowed, rooms


def test_no_imports_go_in_a_circle():
    """Nor do those inside functions, nor those among the folders of a room."""
    arrows = {name: set(imports(name, path)) for name, path in MODULES.items() if name not in DOORS}
    modules = {name: {target if target in MODULES else target.rpartition(".")[0] for target in targets}
               for name, targets in arrows.items()}  # fmt: skip
    TopologicalSorter(modules).prepare()  # raises CycleError
    for path in HOUSE.rglob("__init__.py"):
        TopologicalSorter(contracted(modules, list(path.parent.relative_to(HOUSE).parts))).prepare()


def test_imports_are_seen(tmp_path):
    """The rule above can fail."""
    module = tmp_path / "module.py"
    module.write_text("def f():\n    from ..report import tables\n    from . import solvers\n    import hpcred.cli\n")
    assert set(imports("linalg.module", module)) == {"report.tables", "linalg.solvers", "cli"}


@pytest.mark.parametrize("package", sorted(PEERS))
def test_make_test_peers_runs_the_tests_with_a_package(package):
    """A test file that imports it has tests marked peers with its name."""
    folder = Path(__file__).parent
    files = {path: path.read_text() for path in folder.rglob("test_*.py")}
    using = {path for path, text in files.items() if re.search(rf"^ *(import|from) {package}\b", text, re.M)}
    marked = {path for path, text in files.items() if f'mark.peers("{package}")' in text}
    assert marked and using <= marked


def test_public_names_resolve_and_say_what_they_are():
    assert not [name for name, item in reference.public_names().items() if not item.__doc__]


def test_no_public_name_of_a_room_is_that_of_a_module_in_it():
    """An import of the module would put it in place of the other."""
    hidden = [name for name in reference.public_names() if name in MODULES or name.rpartition(".")[2] in MODULES]
    assert hidden == []


def test_names_of_the_version_before_are_found_with_a_warning():
    places = {place.rpartition(".")[2]: place for place in reference.public_names() if "." in place}
    for name, place in (places | hpcred._RENAMED).items():
        if name not in hpcred.__all__:
            with pytest.warns(DeprecationWarning, match=f"hpcred.{name} is hpcred.{place}; ") as caught:
                assert getattr(hpcred, name) is attrgetter(place)(hpcred)
            assert caught[0].filename == __file__


def test_the_package_has_its_version(capsys):
    installed = metadata.version("hpcred")
    assert hpcred.__version__ == installed
    assert run(["--version"]) == 0 and capsys.readouterr().out == f"hpcred {installed}\n"
    with pytest.raises(AttributeError, match="hpcred.files has no '__version__'"):
        getattr(hpcred.files, "__version__")  # noqa: B009


def test_modules_say_what_they_do_and_rooms_are_empty():
    for name, path in MODULES.items():
        tree = tree_of(path)
        if path.with_suffix(".pyi").exists() and name:
            assert re.fullmatch(PUBLIC, path.read_text()), name
        elif path.name == "__init__.py" and name not in ("", "parallel"):  # which says where mpi4py is missing
            assert not tree.body or (len(tree.body) == 1 and ast.get_docstring(tree)), name
        else:
            assert ast.get_docstring(tree), name


def test_petsc_is_loaded_when_it_is_first_used():
    """So that a job can choose the build."""
    modules = ["hpcred." + name if name else "hpcred" for name in MODULES if name != "__main__"]
    program = (
        f"import importlib, sys\nfor name in {modules}:\n    importlib.import_module(name)\n"
        "print([name for name in sys.modules if name.split('.')[0] in ('petsc4py', 'slepc4py')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=mpi_environment())
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
