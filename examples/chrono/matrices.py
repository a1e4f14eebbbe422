"""Write a result in interface coordinates as the matrices of a ChModalAssembly of Project Chrono.

    python matrices.py arm.h5        # arm_M.txt, arm_K.txt: row, column, value; arm_nodes.txt: counts, and x y z

Chrono keeps its own count of the coordinates inside of an assembly, six a node, and passes over rows beyond them. So
the modal coordinates of the body are given to internal nodes without elements, filled up with coordinates that nothing
moves: a mass of 1 on a spring far above all frequencies of the body.
"""

import sys
from pathlib import Path

import numpy as np

import hpcred

FAR = 10.0  # times the highest frequency of the body
MORE = 6  # coordinates beyond those of the body, which Chrono's eigensolver needs


def matrices(reduced):
    """Return M and K (n, n), six coordinates a node, and how many modes and internal nodes they have."""
    if not reduced.interfaces:
        raise hpcred.InputError('expected a result of a job with coordinates = "interface"')
    boundary = 6 * len(reduced.interfaces)
    modes = reduced.size - boundary
    inside = -(-(modes + MORE) // 6)
    n = boundary + 6 * inside
    M, K = np.eye(n), np.zeros((n, n))
    M[: reduced.size, : reduced.size], K[: reduced.size, : reduced.size] = reduced.M, reduced.K
    last = np.arange(reduced.size, n)
    highest = FAR * 2 * np.pi * max(reduced.frequencies.max(), 1.0)
    K[last, last] = (highest * (1 + 0.01 * np.arange(len(last)))) ** 2
    return M, K, modes, inside


def main(path):
    path = Path(path)
    reduced = hpcred.read_result(path).reduced
    M, K, modes, inside = matrices(reduced)
    for key, matrix in (("M", M), ("K", K)):
        lines = (f"{i} {j} {matrix[i, j]:.17g}\n" for i, j in zip(*np.nonzero(matrix), strict=True))
        path.with_name(f"{path.stem}_{key}.txt").write_text("".join(lines))
    places = "".join("{:.17g} {:.17g} {:.17g}\n".format(*item.position) for item in reduced.interfaces)
    text = f"{len(M)} {modes} {inside} {len(reduced.interfaces)}\n{places}"
    path.with_name(f"{path.stem}_nodes.txt").write_text(text)
    print(
        f"{len(reduced.interfaces)} nodes, {modes} modes: {path.stem}_M.txt, {path.stem}_K.txt, {path.stem}_nodes.txt"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
