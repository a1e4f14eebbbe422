"""Bodies in floating frames: shapes, stresses, and the stiffness of loads and spins."""

from ..public_names import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
