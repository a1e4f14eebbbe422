"""Laws of parts whose stiffness depends on frequency."""

from .public_names import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
