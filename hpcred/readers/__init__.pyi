from .base import Reader as Reader
from .load_files import read_load as read_load
from .model_source import load_export as load_export
from .model_source import load_source as load_source
from .parts import Parts as Parts
from .superelements import read_superelement as read_superelement
