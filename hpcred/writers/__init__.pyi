from .base import ExportSource as ExportSource
from .base import Writer as Writer
from .fmu import write_fmu as write_fmu
from .sid import read_sid as read_sid
from .sid import write_sid as write_sid
