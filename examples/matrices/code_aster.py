"""Write K.npz, M.npz, dofs.txt and nodes.txt from code_aster for hpcred convert; the calls were not run."""

import numpy as np
import scipy.sparse

DIRECTIONS = {"DX": 1, "DY": 2, "DZ": 3, "DRX": 4, "DRY": 5, "DRZ": 6}


def write(mesh, stiffness, mass):
    """Take K and M of ASSE_MATRICE without dualised supports, which would add Lagrange multipliers."""
    for name, matrix in (("K", stiffness), ("M", mass)):
        values, rows, columns, size = matrix.getValuesWithDescription()  # older versions: EXTR_MATR(sparse=True)
        scipy.sparse.save_npz(f"{name}.npz", scipy.sparse.csr_matrix((values, (rows, columns)), shape=(size, size)))
    dofs = stiffness.getDOFNumbering().getNodeAndComponentFromDOF()
    np.savetxt("dofs.txt", [(node + 1, DIRECTIONS[component]) for node, component in dofs], fmt="%d")
    places = np.array(mesh.getCoordinates().getValues()).reshape(-1, 3)
    np.savetxt("nodes.txt", np.column_stack([np.arange(1, len(places) + 1), places]), fmt="%d %.17g %.17g %.17g")
