from .body import Body as Body
from .body import body_of as body_of
from .floating_frame import FloatingFrame as FloatingFrame
from .geometric_stiffness import GeometricStiffness as GeometricStiffness
from .loaded_states import LoadedState as LoadedState
from .preload import Preload as Preload
from .stress import StressModes as StressModes
from .stress import von_mises as von_mises
