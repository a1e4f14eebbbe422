from .materials import ElementProperties as ElementProperties
from .materials import Material as Material
