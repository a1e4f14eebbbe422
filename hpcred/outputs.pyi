from .model.outputs.cuts import CutOutput as CutOutput
from .model.outputs.motions import MotionOutput as MotionOutput
from .model.outputs.stresses import StressOutput as StressOutput
