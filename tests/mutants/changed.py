"""A plugin of pytest: hpcred with one module from another source, "module=source", which HPCRED_MUTANT names.

It comes before hpcred is imported, and also in the sessions on several ranks that a session starts (PYTEST_PLUGINS).
"""

import os
from importlib.machinery import SourceFileLoader
from pathlib import Path

module, _, source = os.environ["HPCRED_MUTANT"].partition("=")
as_it_is = SourceFileLoader.get_code


def get_code(loader, name):
    if loader.path == module:
        return compile(Path(source).read_text(), module, "exec", dont_inherit=True)
    return as_it_is(loader, name)


SourceFileLoader.get_code = get_code
