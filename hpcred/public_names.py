"""Give modules the public names of their stubs, each imported when it is first used."""

import ast
import sys
import warnings
from importlib import import_module
from pathlib import Path


def attached(package, file, renamed=None):
    """Return `__getattr__`, `__dir__` and `__all__` of a module, by the imports in the stub beside its file.

    Names of the version before are found with a DeprecationWarning: those of public modules in the stub, and those that
    are `renamed`.
    """
    root, places = sys.modules[package].__package__, {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text()).body:
        if isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            places |= {alias.name: (module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Assign):  # name = module.other
            places[node.targets[0].id] = (f".{node.value.value.id}", node.value.attr)

    def find(name):
        if name == "__version__" and "." not in package:
            return _version(package)
        if name not in places:
            return _found_elsewhere(name)
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

    def _found_elsewhere(name):
        meant, modules = "", [other for other, (module, _) in places.items() if module == "."]
        if modules and not name.startswith("_"):  # rooms are asked for their modules too
            if name in (renamed or {}):
                _warn(name, renamed[name])
                return find(renamed[name])
            for owner in modules:
                if name in (module := import_module(f".{owner}", root)).__all__:
                    _warn(name, f"{owner}.{name}")
                    return getattr(module, name)
        if not name.startswith("_"):
            from .parallel.declared import nearest

            meant = nearest(name, places)
        raise AttributeError(f"{package} has no '{name}'{meant}", name=name, obj=sys.modules[package])

    def _warn(name, place):
        warnings.warn(f"{package}.{name} is {package}.{place}; the old name goes with the next version",
                      DeprecationWarning, stacklevel=4)  # fmt: skip

    return find, lambda: sorted(places), sorted(places)


def _version(package):
    from importlib import metadata  # which takes 40 ms, and few ask

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # of a checkout that is not installed
        return "unknown"
