"""Give packages the public names of their stubs, each imported when it is first used."""

import ast
import sys
import warnings
from importlib import import_module
from pathlib import Path


def attached(package, file, moved=None):
    """Return `__getattr__`, `__dir__` and `__all__` of a module, by the imports in the stub beside its file.

    `moved`: where names of the version before are now, which are found with a DeprecationWarning.
    """
    root, places = sys.modules[package].__package__, {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text()).body:
        if isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            places |= {alias.name: (module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Assign):  # name = module.other
            places[node.targets[0].id] = (f".{node.value.value.id}", node.value.attr)
    moved = moved or {}

    def find(name):
        if name in moved:
            place = f"{package}.{moved[name]}"
            warnings.warn(f"{package}.{name} is {place}; the old name goes with the next version",
                          DeprecationWarning, stacklevel=2)  # fmt: skip
            owner, _, name = place.rpartition(".")
            return getattr(import_module(owner), name)
        if name not in places:
            meant = _meant(name, places) if package == "hpcred" else ""  # rooms are asked for their modules too
            raise AttributeError(f"{package} has no '{name}'{meant}", name=name, obj=sys.modules[package])
        module, attribute = places[name]
        if module == ".":
            item = import_module(f".{attribute}", root)
        else:
            item = getattr(import_module(module, root), attribute)
        if isinstance(item, type):
            from .parallel.declared import with_spelled_fields

            item = with_spelled_fields(item)
        vars(sys.modules[package])[name] = item
        return item

    return find, lambda: sorted(places), sorted(places)


def _meant(name, names):
    if name.startswith("_"):
        return ""
    from .parallel.declared import nearest

    return nearest(name, names)
