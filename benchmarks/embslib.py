"""A SID file in EMBSlib's own reader, the library of flexible bodies for Modelica.

usage: python benchmarks/embslib.py SOURCE, that of github.com/vwaurich/EMBS_ModelicaLib (MIT licence), of which
EMBSlib/Resources/Include/ReadSID_C.h is compiled. Prints for each quantity the largest difference of what the
reader holds from the body in memory, beside the largest entry; a SID file has 12 digits.
"""

import argparse
import ctypes
import json
import subprocess
from pathlib import Path

import numpy as np
from common import workspace

import hpcred
from hpcred.body.body import body_of

GLUE = """
#include <stddef.h>
int matrix2Index(int, int, int, int);
int matrix3Index(int, int, int, int, int, int);
void ModelicaFormatMessage(const char *text, ...) {}
#include "ReadSID_C.h"
"""
SYMMETRIC = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # xx, yy, zz, xy, xz, yz of an inertia


def body(folder):
    """Write the SID file of a free block and return the body."""
    with hpcred.solid((4, 2, 2), clamped=False) as block, block.with_inputs([(1, "z"), (40, "x")]) as model:
        rom = hpcred.reduce(model, [hpcred.Modes(count=5)], hpcred.Buckens(), hpcred.ModalDamping(0.02))
        hpcred.write_result(folder / "rod.h5", rom, model)
        found = body_of(model, rom)
    hpcred.export(folder / "rod.h5", "sid", folder / "rod.SID_FEM", options={"ge_order": "coordinate"})
    return found


def expected(found):
    """Return constant and linear parts by name: (r, c) and (m, r, c), or None. Me, the identity, has no entries."""
    frame, reduced = found.floating_frame, found.reduced
    m = reduced.size
    Ge = frame.Ge.reshape(m, 3, m).transpose(0, 2, 1).reshape(m, 3 * m)  # by coordinate
    return {
        "mdCM": (frame.mc[:, None], frame.Ct[:, :, None]),
        "J": (frame.J[SYMMETRIC][:, None], np.array([part[SYMMETRIC] for part in frame.dJ])[:, :, None]),
        "Ct": (frame.Ct, None), "Cr": (frame.Cr, frame.Cr1.transpose(1, 0, 2)), "Gr": (frame.Gr, None),
        "Ge": (Ge, None), "Oe": (frame.Oe, frame.Oe1.transpose(1, 0, 2)), "Ke": (reduced.K, None),
        "De": (reduced.D, None),
    }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    include = parser.parse_args().source / "EMBSlib/Resources/Include"
    with workspace() as folder:
        folder = Path(folder)
        found = body(folder)
        (folder / "glue.c").write_text(GLUE)
        command = ["cc", "-shared", "-fPIC", "-w", "-I", include.resolve(), "glue.c", "-o", "reader.so", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        reader = ctypes.CDLL(folder / "reader.so")
        reader.SIDFileConstructor_C.restype, reader.getMass.restype = ctypes.c_void_p, ctypes.c_double
        sid = ctypes.c_void_p(reader.SIDFileConstructor_C(str(folder / "rod.SID_FEM").encode()))

    def taken(function, *names, shape):
        """What the reader gives for the shape; untouched, and so NaN, where its own differs."""
        array = np.full(shape, np.nan)
        sizes = shape if len(shape) == 2 else (shape[1], shape[0], shape[2])  # of linear parts: rows, coordinates, ...
        getattr(reader, function)(sid, *names, array.ctypes.data_as(ctypes.c_void_p), *map(ctypes.c_size_t, sizes))
        return array

    rows = {"mass": far(reader.getMass(sid), found.floating_frame.mass)}
    for name, (constant, linear) in expected(found).items():
        rows[name] = far(taken("getM0", name.encode(), shape=constant.shape), constant)
        if linear is not None:
            rows[f"{name}, linear"] = far(taken("getM1", name.encode(), shape=linear.shape), linear)
    for k, node in enumerate(found.nodes, 1):
        for name, matrix in (("origin", node.position[:, None]), ("phi", node.phi), ("psi", node.psi)):
            rows[f"{name} of node {node.node}"] = far(taken("getM0Node", name.encode(), k, shape=matrix.shape), matrix)
    print(json.dumps(rows, indent=1))


def far(found, wanted):
    """The largest difference beside the largest entry; NaN where the shape is another."""
    return float(np.abs(found - wanted).max() / (np.abs(wanted).max() or 1.0))


if __name__ == "__main__":
    main()
