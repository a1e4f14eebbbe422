"""Write a Body as the HDF5 file that ExternalFlexibleFfrBody of MBSim reads.

Its names are those of MBSim's importData: integrals of the position R and the shapes Phi over the mass, the stiffness
and damping of the coordinates, and positions, shapes and stresses of the interface nodes. Before the HDF5 data, in a
user block, which HDF5 passes over, stands a line by which the file is known.
"""

import h5py
import numpy as np

from ..body.body import check_moving, inputs_without_node, maker, remarks
from ..parallel.failures import InputError
from .base import Writer

BEGIN = b"# hpcred body for MBSim"
BLOCK = 512  # bytes of the user block, the least that HDF5 has
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
SAME = 1e-10  # of the largest entry, by which a symmetric matrix may differ from its transpose


def _symmetric(name, matrix):
    """Return the symmetric matrix, since MBSim keeps one half. Raises InputError for others."""
    if np.abs(matrix - matrix.T).max() > SAME * np.abs(matrix).max():
        raise InputError(f"found an unsymmetric {name}, expected a symmetric one, of which MBSim keeps one half; take "
                         "the arrays by format 'npz'")  # fmt: skip
    return (matrix + matrix.T) / 2


def datasets_of(body) -> dict:
    """Return the datasets by name. Raises InputError for a body that MBSim cannot have."""
    check_moving(body, "a file for MBSim")
    frame, reduced, nodes = body.floating_frame, body.reduced, body.nodes
    size = reduced.size
    # integrals over the mass
    datasets = {
        "mass": frame.mass,
        "position integral": frame.mc,
        "position position integral": _symmetric("inertia", np.trace(frame.J) / 2 * np.eye(3) - frame.J),
        "shape function integral": frame.Ct.T,
        "stiffness matrix": _symmetric("stiffness matrix", reduced.K),
        "damping matrix": _symmetric("damping matrix", reduced.D),
        "position shape function integral": frame.N.transpose(1, 2, 0).reshape(9, size),
        "shape function shape function integral": np.concatenate([frame.S[pair] for pair in PAIRS]),
    }
    # interface nodes, and stresses at them
    if nodes:
        datasets |= {
            "node numbers": np.array([node.node for node in nodes], dtype="i4"),
            "nodal relative position": np.concatenate([node.position - frame.origin for node in nodes]),
            "nodal shape matrix of translation": np.concatenate([node.phi for node in nodes]),
            "nodal shape matrix of rotation": np.concatenate([node.psi for node in nodes]),
        }
    if nodes and body.stress is not None:
        place = np.searchsorted(body.stress.node, datasets["node numbers"]).clip(max=len(body.stress.node) - 1)
        there = body.stress.node[place] == datasets["node numbers"]
        stress = np.where(there[None, :, None], body.stress.stress[:, place], 0.0)  # (m, nodes, 6)
        datasets["nodal stress matrix"] = stress.transpose(1, 2, 0).reshape(-1, size)
    return datasets


class MbsimFile(Writer):
    """Bodies of MBSim."""

    suffix, needs, stress = "_mbsim.hdf5", "body", True

    def write(self, target, source):
        body = source.body
        # in memory of HDF5 itself, which crashes at exit where writing to an object of Python failed
        with h5py.File("body", "w", driver="core", backing_store=False, userblock_size=BLOCK) as file:
            for name, value in datasets_of(body).items():
                file[name] = value
            file.flush()
            content = file.id.get_file_image()
        target.write_bytes((BEGIN + f", {maker(body.reduced)}\n".encode()).ljust(BLOCK, b"\0") + content)
        return [*remarks(body), *inputs_without_node(body), *_notes(body)]

    def begins(self, start):
        return start.startswith(BEGIN)

    def describe(self, path):
        with h5py.File(path, "r") as file:
            arrays = {name: " x ".join(map(str, array.shape)) or "1" for name, array in file.items()}
        return {"format": "body for MBSim (ExternalFlexibleFfrBody)", "arrays": arrays}


def _notes(body):
    """Yield what MBSim makes of the numbers."""
    S, Me = body.floating_frame.S, body.floating_frame.Me
    trace = S[0, 0] + S[1, 1] + S[2, 2]
    if (off := np.abs(trace - Me).max() / np.abs(Me).max()) > 1e-6:
        yield f"MBSim takes the mass of the coordinates from the integrals of products, which is off by {off:.1g}"
    if body.stress is not None and body.nodes:
        yield "stresses are those of the interface nodes, zero where the result has none"
