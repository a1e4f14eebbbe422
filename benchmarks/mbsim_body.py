"""MBSim's flexible body from CalculiX as a second opinion: the integrals of its 14 modes beside those of hpcred.

    python benchmarks/mbsim_body.py FOLDER

FOLDER has the files of examples/xml/calculix_body of github.com/mbsim-env/mbsim (LGPL-2.1, not part of hpcred):
calculix.sti, .mas, .dof and .frd, and input_data.h5, which MBSim's tool made from them. MBSim takes the shapes from
CalculiX, a beam held at one end, and integrates with a mass that is lumped to the diagonal in proportion to that of the
consistent matrix; hpcred integrates with the consistent matrix. Both are computed here. Writes
mbsim_body.json.
"""

import sys
from pathlib import Path

import h5py
import numpy as np
import scipy.sparse
from common import finish
from models.published import all_ranks

import hpcred

PRODUCTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # order of MBSim's blocks of shape times shape


def compared(folder):
    """Rows of quantity, and the largest relative difference of MBSim from hpcred with either mass."""
    folder = Path(folder)
    with h5py.File(folder / "input_data.h5") as file:
        theirs = {key: file[key][()] for key in file}
    with hpcred.readers.load_export(folder / "calculix.sti", all_ranks(None), "MBSim's body") as model:
        M, K = (scipy.sparse.csr_matrix(mat.getValuesCSR()[::-1]) for mat in (model.M, model.K))
        order = np.lexsort((model.dofs.direction, model.dofs.node))  # of MBSim: by node
        place = model.dofs.position[order][::3]
    M, K = (matrix[order][:, order] for matrix in (M, K))
    shapes = theirs["nodal shape matrix of translation"]
    mass = M[::3, ::3]  # of one direction, the same in all
    total = mass.sum()
    lumped = scipy.sparse.diags(mass.diagonal() * total / mass.diagonal().sum())

    free = np.repeat(shapes.reshape(len(place), -1).any(axis=1), 3)
    with hpcred.SecondOrderModel(M[free][:, free], None, K[free][:, free]) as held:
        found = hpcred.natural_modes(held, count=shapes.shape[1]).frequencies
    stiffness = shapes.T @ K @ shapes
    quotients = np.sqrt(np.diag(stiffness) / np.einsum("ij,ij->j", shapes, M @ shapes)) / (2 * np.pi)
    table = [
        {"quantity": "places of the nodes", "consistent mass": far(theirs["nodal relative position"], place.ravel())},
        {"quantity": "mass", "consistent mass": far(theirs["mass"], total)},
        {"quantity": "stiffness matrix", "consistent mass": far(theirs["stiffness matrix"], stiffness)},
        {"quantity": "frequencies of CalculiX's shapes", "consistent mass": far(quotients, found)},
    ]
    consistent, diagonal = (integrals(each, place, shapes) for each in (mass, lumped))
    return table + [
        {"quantity": key} | {what: far(theirs[key], each[key]) for what, each in
                             (("consistent mass", consistent), ("lumped mass", diagonal))}
        for key in consistent
    ]  # fmt: skip


def integrals(mass, place, shapes):
    """Integrals by their names in MBSim's file: mass (N, N) of one direction, places (N, 3), shapes (3 N, m)."""
    one, moved = np.ones(len(place)), [shapes[k::3] for k in range(3)]
    return {
        "position integral": one @ mass @ place,
        "position position integral": place.T @ mass @ place,
        "shape function integral": np.array([one @ mass @ U for U in moved]),
        "position shape function integral": np.array([x @ mass @ U for x in place.T for U in moved]),
        "shape function shape function integral": np.vstack([moved[a].T @ mass @ moved[b] for a, b in PRODUCTS]),
    }


def far(found, expected):
    """The largest difference beside the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    finish("mbsim_body", compared(sys.argv[1]))
