"""Reference pages from the code: its dataclasses, docstrings and command line enter, Markdown leaves.

Nothing here names a key, an array, an option or a function of hpcred: what is added to the code is on the pages.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin, get_type_hints

import typer.main

import hpcred
import hpcred.cli.main
import hpcred.files
import hpcred.settings

WORDS = {str: "text", int: "whole number", float: "number", bool: "true or false"}
ON_KEYS = "Names, kinds and defaults are those of the code that reads the file; unknown keys are refused."
ON_FILES = (
    "All files are HDF5 with the attributes `format` and `version`; `n` is the number of dofs of the model, `m` of the "
    "coordinates of the reduced one, `p` of inputs, `r` of outputs. Read them with h5py, MATLAB's `h5read` or any "
    "other reader."
)
ON_PYTHON = (
    'Most public names are those of `hpcred` itself: `hpcred.reduce`, `hpcred.Krylov`. Others are those of a public '
    'module, such as `hpcred.loads.Gravity`: {modules}. "Collective." in a text means that '
    "all ranks call it, with the same arguments. Frequencies are in Hz, all other quantities in the units of the "
    "model, SI where it is in SI."
)
SECTION = re.compile(r"^(Parameters|Attributes|Returns|Raises|Notes|Examples)\n-+\n", re.M)
PAGE_OF_NAMES = "[`{name}`](python.md#{place})"
PATH = re.compile(r"\b[a-z]\w*(?:\.[a-z]\w*)*\.(\w+)")  # of something in the code
ROOMS = {
    "reduction": "Reduction",
    "model": "Models, frames, damping, interfaces",
    "analysis": "Responses and errors",
    "body": "Bodies",
    "simulation": "Simulation in time",
    "assembly": "Machines of reduced bodies",
    "readers": "Models of other programs",
    "writers": "Exports",
    "files": "Files of hpcred",
    "settings": "Jobs",
    "workflows": "Commands as functions",
    "linalg": "Factorisation",
    "parallel": "Running",
    "examples": "Examples",
}


@cache
def pages() -> dict[str, str]:
    """All reference pages by their place in docs/."""
    found = {"command-line": command_line(), "python": python_names(), "files": hdf5_files()}
    modules = modules_of(hpcred.settings)
    tables = [(name, table) for name, module in modules.items() for table in tables_of_files(module)]
    texts = [table for _, table in tables if len(fields(table)) == 1]  # around a table that an option takes
    for name, table in tables:
        if table not in texts:
            found[name.replace("_", "-")] = keys_of_file(f"the {name.replace('_', ' ')}", table)
    known = {kind for name, table in tables if name == "job_file" for _, kind in inner_tables(table)}
    inner = [(path, kind) for table in texts for path, kind in inner_tables(table) if kind not in known]
    found["job-file"] = joined([found["job-file"], *(keys_of_a_text(path, kind) for path, kind in inner)])
    return {f"reference/{name}.md": text for name, text in found.items()}


def keys_of_a_text(path, kind) -> str:
    """A section on a table that options of the command line take, and no file."""
    name = path.strip("`[]")
    about = f"The value of `--{name}`, such as `--{name} '{{key = value}}'`; jobs have no such table."
    return joined([f"## {path} of the command line", about, text_of(kind), table_of_keys(kind)])


def modules_of(package) -> dict:
    """The modules of a package by name."""
    names = [item.name for item in pkgutil.iter_modules(package.__path__)]
    return {name: importlib.import_module(f"{package.__name__}.{name}") for name in names}


# keys of TOML files


def tables_of_files(module) -> list:
    """The outermost dataclasses of a TOML file that a module defines."""
    own = [item for item in vars(module).values() if is_dataclass(item) and item.__module__ == module.__name__]
    return [item for item in own if "__pydantic_config__" in vars(item)]


def keys_of_file(name, table) -> str:
    """A page with all keys of a TOML file, and of the tables in it."""
    others = [text_of(item) for item in sources(table) if not meanings(item)]
    parts = [f"# Keys of {name}", ON_KEYS, text_of(table), *others, table_of_keys(table)]
    inner = list(dict.fromkeys(inner_tables(table)))
    for path, kind in inner:
        others = {key for name, other in inner if name == path and other is not kind for key in hints_of(other)}
        own = next((key for key in hints_of(kind) if key not in others), "") if others else ""
        parts += [f"## {path} with `{own}`" if own else f"## {path}", text_of(kind), table_of_keys(kind)]
    return joined(parts)


def joined(parts) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"


def sources(table) -> list:
    """The dataclasses whose keys a table has as its own: those it extends, and those that its docstring refers to."""
    named = re.findall(r"\bsee\s+((?:\w+\.)+)([A-Z]\w+)", inspect.getdoc(table))
    referred = [getattr(importlib.import_module(f"hpcred.{module.rstrip('.')}"), name) for module, name in named]
    own = {item.name for item in fields(table)}
    found = [item for item in (*table.__mro__[1:-1], *referred) if is_dataclass(item)]
    return [item for item in found if {field.name for field in fields(item)} <= own]


def inner_tables(table, prefix="", seen=()):
    """(heading, dataclass) of all tables below a table, depth first."""
    for key, hint in hints_of(table).items():
        many = get_origin(plain(hint)) is tuple or any(get_origin(part) is tuple for part in get_args(plain(hint)))
        for kind in dataclasses_in(hint):
            if kind in seen:
                continue
            path = f"{prefix}{key}"
            named = kind_of(kind)
            mark = f"`[[{path}]]`" if many else f"`[{path}]`"
            yield f'{mark} of kind "{named}"' if named else mark, kind
            yield from inner_tables(kind, f"{path}.", (*seen, kind))


def hints_of(table):
    hints = get_type_hints(table, include_extras=True)
    return {item.name: hints[item.name] for item in fields(table)}


def plain(hint):
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def dataclasses_in(hint) -> list:
    """The dataclasses that a type may be, or be a tuple of."""
    hint = plain(hint)
    if is_dataclass(hint):
        return [hint]
    return [item for part in get_args(hint) for item in dataclasses_in(part)] if get_origin(hint) is not Literal else []


def kind_of(table) -> str | None:
    """What the key `kind` must be for this table, or None where it has none or leaves a choice."""
    words = get_args(plain(hints_of(table).get("kind")))
    return words[0] if len(words) == 1 else None


def in_words(hint) -> str:
    """A type as users write it."""
    hint = plain(hint)
    if hint in WORDS:
        return WORDS[hint]
    if is_dataclass(hint):
        return "table"
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        return " or ".join(f'`"{word}"`' for word in parts)
    if origin is tuple and parts[-1:] == (...,):
        return "tables" if dataclasses_in(parts[0]) else f"list of {in_words(parts[0])}"
    if origin is tuple:
        return f"[{', '.join(in_words(part) for part in parts)}]"
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(in_words(part) for part in parts if part is not NoneType))
    return "table" if origin is dict else str(getattr(hint, "__name__", hint))


def default_of(item) -> str:
    if item.default is MISSING and item.default_factory is MISSING:
        return "required"
    value = item.default_factory() if item.default is MISSING else item.default
    if is_dataclass(value):
        return f'kind `"{kind_of(type(value))}"`' if kind_of(type(value)) else "its defaults"
    if value is None or value == ():
        return "-"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        value = list(value)
    return "`" + (f'"{value}"' if isinstance(value, str) else str(value).replace("'", '"')) + "`"


def table_of_keys(table) -> str:
    hints, tag = hints_of(table), kind_of(table)
    items = [item for item in fields(table) if item.name != "kind" or not tag]
    rows = [(f"`{item.name}`", in_words(hints[item.name]), default_of(item)) for item in items]
    known = {}
    for item in reversed((table, *sources(table))):
        known |= meanings(item)
    if not rows or not known:
        return markdown_table(("key", "value", "default"), rows) if rows else "No keys but `kind`."
    rows = [(*row, known.get(item.name, "")) for row, item in zip(rows, items, strict=True)]
    return markdown_table(("key", "value", "default", "meaning"), rows)


# docstrings


def text_of(item) -> str:
    """Return the docstring without its list of fields as Markdown; a paragraph that explains fields becomes a list."""
    names = {field.name for field in fields(item)} if is_dataclass(item) else set()
    text, found = sections(item)
    text = "\n\n".join([text, *(found[name] for name in ("Notes",) if name in found)])
    paragraphs = re.split(r"\n\s*\n", linked(text, PAGE_OF_NAMES))
    return "\n\n".join(_as_list(escaped(part), names) for part in paragraphs)


def sections(item) -> tuple[str, dict[str, str]]:
    """Return the text of a docstring above its numpydoc sections, and the sections by name."""
    text, *pieces = SECTION.split(inspect.getdoc(item) or "")
    return text.strip(), dict(zip(pieces[::2], (piece.strip("\n") for piece in pieces[1::2]), strict=True))


def meanings(item) -> dict[str, str]:
    """Return what the sections Parameters and Attributes of a docstring say of each name, as Markdown in one line."""
    found = {}
    for section in ("Parameters", "Attributes"):
        entries = re.split(r"^(?=\S)", sections(item)[1].get(section, ""), flags=re.M)
        for head, _, body in (entry.partition("\n") for entry in entries if entry.strip()):
            text = escaped(linked(" ".join(body.split()), PAGE_OF_NAMES))
            found |= {name.strip(): text for name in head.partition(" : ")[0].split(",")}
    return found


def linked(text, link) -> str:
    """A text with links where it has the path of a public name in the code, such as reduction.settings.Reduction."""
    places = {place.removeprefix("hpcred."): place for names in public_places().values() for place in names}
    return PATH.sub(
        lambda path: link.format(name=path[1], place=places[path[0]]) if path[0] in places else path[0], text
    )


def _as_list(paragraph, names):
    if paragraph.startswith("    "):
        return paragraph
    one = " ".join(paragraph.split())
    cuts = [found.start(2) for found in re.finditer(r"(^|[.;] )(`?(\w+)`?(?=[ :,(]))", one) if found[3] in names]
    if len(cuts) < 3:
        return paragraph
    pieces = [one[start:stop].strip().rstrip(";") for start, stop in zip(cuts, [*cuts[1:], None], strict=True)]
    return "\n\n".join(([one[: cuts[0]].strip()] if cuts[0] else []) + ["\n".join(f"- {piece}" for piece in pieces)])


def escaped(text) -> str:
    """`<` outside of code, which Markdown would take for HTML."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else part.replace("<", "&lt;") for part in parts)


def markdown_table(head, rows) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)


# arrays of HDF5 files


def hdf5_files() -> str:
    """A page with the arrays of every HDF5 file, as the modules that write them say."""
    parts = ["# Arrays of the files", ON_FILES]
    for module in modules_of(hpcred.files).values():
        name = getattr(module, "FORMAT", None)
        if isinstance(name, str) and name.startswith("hpcred-"):
            parts += [f"## {name}, version {module.VERSION}", f"```text\n{inspect.getdoc(module)}\n```"]
    return joined(parts)


# the command line


def command_line() -> str:
    """A page with every command, argument and option."""
    group = typer.main.get_command(hpcred.cli.main.app)
    parts = ["# Command line", escaped(group.help or ""), escaped(group.epilog or ""), _options(group)]
    for words, command in commands(group):
        name = " ".join(("hpcred", *words))
        arguments = [_metavar(item) for item in command.params if item.param_type_name == "argument"]
        usage = " ".join([name, *arguments, "[options]"])
        parts += [f"## {name}", f"```sh\n{usage}\n```", escaped(command.help or ""), _options(command)]
    return joined(parts)


def commands(group, words=()):
    """(words, command) of every command that does something, through all groups."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*words, name))
        elif not command.hidden:
            yield (*words, name), command


def _metavar(item):
    return item.metavar or item.name.upper()


def _options(command):
    rows = []
    for item in command.params:
        if item.param_type_name == "argument" or item.hidden:
            continue
        names, value = ", ".join(f"`{name}`" for name in item.opts), "" if item.is_flag else f"`{_metavar(item)}`"
        rows.append((names, value, "" if item.is_flag else _default(item.default), escaped(item.help or "")))
    return markdown_table(("option", "value", "default", "meaning"), rows) if rows else ""


def _default(value):
    if value in (None, ()):
        return ""
    return f"`{' '.join(map(str, value)) if isinstance(value, tuple | list) else value}`"


# public names


def python_names() -> str:
    """A page with the public names by room, for mkdocstrings."""
    rooms = public_places()
    modules = ", ".join(f"`hpcred.{name}` ({', '.join(f'`{item}`' for item in module.__all__)})"
                        for name in hpcred.__all__ if inspect.ismodule(module := getattr(hpcred, name)))  # fmt: skip
    parts = ["# Python", ON_PYTHON.format(modules=modules)]
    for room in [*ROOMS, *(room for room in rooms if room not in ROOMS)]:
        if room in rooms:
            functions_first = sorted(rooms[room], key=lambda place: place.rpartition(".")[2][0].isupper())
            parts += [f"## {ROOMS.get(room, room)}", *(f"::: {place}" for place in functions_first)]
    return joined(parts)


def public_places() -> dict[str, list[str]]:
    """Where the public names are in the code, by room."""
    rooms = {}
    for name, item in public_names().items():
        own = item.__name__ if hasattr(item, "__name__") else name.rpartition(".")[2]
        rooms.setdefault(item.__module__.split(".")[1], {})[f"{item.__module__}.{own}"] = None
    return {room: sorted(places) for room, places in rooms.items()}


def public_names() -> dict[str, object]:
    """The public names, such as "reduce" and "loads.Gravity", and what they stand for."""
    flat = {name: getattr(hpcred, name) for name in hpcred.__all__}
    return {name: item for name, item in flat.items() if not inspect.ismodule(item)} | {
        f"{name}.{other}": getattr(module, other)
        for name, module in flat.items() if inspect.ismodule(module) for other in module.__all__
    }  # fmt: skip
