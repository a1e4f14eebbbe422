from .interfaces.nodes import InterfaceNode as InterfaceNode
from .units import Units as Units
from .units import in_si as in_si
from .units import units_of as units_of
