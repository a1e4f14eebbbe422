"""Write K.npz, M.npz and nodes.txt from sfepy (tried with 2021.4), for hpcred convert; rows are node by node."""

import numpy as np
import scipy.sparse


def write(problem, field):
    """Take equations K and M of a vector field, before boundary conditions."""
    problem.update_materials()
    problem.time_update()
    problem.equations.init_state()
    for name, equation in zip("KM", problem.equations, strict=True):
        matrix = equation.evaluate(mode="weak", dw_mode="matrix", asm_obj=problem.mtx_a.copy() * 0)
        scipy.sparse.save_npz(f"{name}.npz", matrix)
    places = field.get_coor()
    np.savetxt("nodes.txt", np.column_stack([np.arange(1, len(places) + 1), places]), fmt="%d %.17g %.17g %.17g")
