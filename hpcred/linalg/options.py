"""Set PETSc options for the time of a with block."""

from contextlib import contextmanager

from ..parallel.petsc import PETSc


@contextmanager
def temporary_options(prefix: str, defaults: dict, forced: dict | None = None):
    """Set options in the block: `defaults` where the user has set nothing, `forced` in any case."""
    options = PETSc.Options(prefix)
    values = {key: value for key, value in defaults.items() if not options.hasName(key)} | (forced or {})
    before = {key: options.getString(key) for key in values if options.hasName(key)}
    for key, value in values.items():
        options[key] = value
    try:
        yield
    finally:
        for key in values:
            options.delValue(key)
            if key in before:
                options[key] = before[key]
