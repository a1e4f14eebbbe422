from .joints import BushingJoint as BushingJoint
from .joints import MachineBody as MachineBody
from .joints import PointMass as PointMass
from .joints import RigidJoint as RigidJoint
from .joints import Turn as Turn
