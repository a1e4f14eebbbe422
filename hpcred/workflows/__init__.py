"""Commands as functions, from files to files, and what commands print."""

from ..public_names import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
