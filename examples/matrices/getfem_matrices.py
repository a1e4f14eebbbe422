"""Write K.mtx, M.mtx and nodes.txt from getfem (tried with 5.4), for hpcred convert; rows are point by point."""

import getfem
import numpy as np


def write(mim, mf, mf_data, lam, mu, rho):
    """Take a displacement `mf` of three components."""
    K = getfem.asm_linear_elasticity(mim, mf, mf_data, lam, mu)
    M = getfem.asm_mass_matrix(mim, mf, mf)
    M.scale(rho)
    K.save("mm", "K.mtx")
    M.save("mm", "M.mtx")
    places = mf.basic_dof_nodes()[:, ::3].T
    np.savetxt("nodes.txt", np.column_stack([np.arange(1, len(places) + 1), places]), fmt="%d %.17g %.17g %.17g")
