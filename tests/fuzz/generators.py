"""All kinds of cases: a kind and a seed enter, a case leaves; the same one each time."""

import zlib

import numpy as np

from . import arrays, behind, beside, bodies, containers, machines, matrices, meshes, real_files, surroundings, tables
from .judge import Case

MODULES = (matrices, arrays, meshes, bodies, real_files, tables, containers, beside, behind, surroundings, machines)
KINDS = {kind: case for module in MODULES for kind, case in module.KINDS.items()}


def make(kind: str, seed: int, number: int) -> Case:
    return KINDS[kind](np.random.default_rng([zlib.crc32(kind.encode()), seed, number]), kind)
