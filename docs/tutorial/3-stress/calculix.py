"""Run CalculiX on an input file, and read the von Mises stress at the nodes from its .frd file."""

import re
import subprocess
from pathlib import Path

import numpy as np

import hpcred


def run(name, text):
    """Write an input file and let CalculiX compute it."""
    Path(f"{name}.inp").write_text(text)
    subprocess.run(["ccx", name], capture_output=True, check=True)


def von_mises(name):
    """Return the numbers of nodes and the von Mises stress there, of the first stresses in the file."""
    table = Path(f"{name}.frd").read_text().partition(" STRESS ")[2].partition("\n -3")[0]
    rows = re.findall(r"^ -1 *(\d+)" + 6 * r"(.{12})", table, re.M)
    return [int(row[0]) for row in rows], hpcred.body.von_mises(np.array([row[1:] for row in rows], float))


def compare(name, result, q):
    """Print the largest stress of reduced coordinates and of CalculiX, and the largest difference at any node."""
    nodes, theirs = von_mises(name)
    ours = hpcred.body.von_mises(np.tensordot(q, result.stress_modes(nodes).stress, 1))
    print(f"von Mises stress up to {ours.max() / 1e6:.2f} MPa, CalculiX {theirs.max() / 1e6:.2f} MPa")
    print(f"largest difference at any node: {100 * abs(ours - theirs).max() / theirs.max():.3f} % of that")
