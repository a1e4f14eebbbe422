"""From DOLFINx to a multibody program without a file in between: a bar of steel, free in space.

DOLFINx meshes it and assembles stiffness and mass on all ranks; hpcred takes the two matrices as they are, reduces them
to a tolerance, and hands the body on. On Debian: apt-get install python3-dolfinx. Run in an empty folder:

    mpiexec -n 2 python bar.py [CELLS ALONG THE BAR]

It leaves bar.h5, bar.SID_FEM and bar.vtu, and prints the frequencies beside those of a slender beam.
"""

# ruff: noqa: E402

import sys

import hpcred

hpcred.start()  # before DOLFINx loads PETSc: then hpcred chooses the build, and the MUMPS with the better ordering

import numpy as np
import ufl
from dolfinx import fem, mesh, plot
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI

LENGTH, WIDTH, HEIGHT = 0.6, 0.03, 0.02  # m
YOUNG, POISSON, DENSITY = 2.1e11, 0.3, 7850.0  # N/m^2, 1, kg/m^3
BAND = (0.0, 3000.0)  # Hz


def space(cells, degree=2, comm=MPI.COMM_WORLD):
    """Displacements on tetrahedra."""
    corners = [np.zeros(3), np.array([LENGTH, WIDTH, HEIGHT])]
    domain = mesh.create_box(comm, corners, cells, mesh.CellType.tetrahedron)
    if hasattr(fem, "functionspace"):  # since DOLFINx 0.7
        return fem.functionspace(domain, ("Lagrange", degree, (3,)))
    return fem.VectorFunctionSpace(domain, ("Lagrange", degree))


def matrices(V, bcs=()):
    """Stiffness and mass; rows of boundary conditions hold a one on the diagonal."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu, lame = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))

    def strain(w):
        return ufl.sym(ufl.grad(w))

    stress = 2 * mu * strain(u) + lame * ufl.tr(strain(u)) * ufl.Identity(3)
    mats = [assemble_matrix(fem.form(form * ufl.dx), list(bcs))
            for form in (ufl.inner(stress, strain(v)), DENSITY * ufl.inner(u, v))]  # fmt: skip
    for mat in mats:
        mat.assemble()
    return mats


def nodes(V):
    """Places of the nodes of this rank, in the order of the rows of PETSc: without those of other ranks (ghosts)."""
    return V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]


def elements(V):
    """Nodes of the cells of this rank in the order of VTK, by kind.

    Nodes are numbered from 1 as DOLFINx numbers its dofs over all ranks, so that three rows belong to each in turn.
    """
    make = getattr(plot, "vtk_mesh", None) or plot.create_vtk_mesh
    cells = make(V)[0]
    local = cells.reshape(-1, 1 + V.dofmap.dof_layout.num_dofs)[:, 1:]
    number = 1 + V.dofmap.index_map.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)
    return {{4: "tetra", 10: "tetra10"}[local.shape[1]]: number}


def rows(V, blocks):
    """Rows of PETSc of some dofs of this rank, as `dolfinx.fem.locate_dofs_...` returns them."""
    number = V.dofmap.index_map.local_to_global(np.asarray(blocks, dtype=np.int32))
    return (3 * number[:, None] + np.arange(3)).ravel()


def nearest(model, point):
    """The number of the node nearest to a point."""
    distance = np.linalg.norm(model.dofs.position - point, axis=1)
    k = int(np.argmin(distance)) if len(distance) else None
    mine = (np.inf, 0) if k is None else (float(distance[k]), int(model.dofs.node[k]))
    return min(model.comm.allgather(mine))[1]


def body(V):
    """The bar as a model, with forces at both ends."""
    K, M = matrices(V)
    model = hpcred.SecondOrderModel.from_petsc(K, M, nodes=nodes(V), elements=elements(V), name="bar")
    for mat in (K, M):
        mat.destroy()  # the model has references
    ends = [nearest(model, (x, WIDTH / 2, HEIGHT / 2)) for x in (0.0, LENGTH)]
    with model:
        return model.with_inputs([(node, direction) for node in ends for direction in "xyz"])


def slender_beam(count):
    """The lowest bending frequencies in Hz of a free beam without shear (Euler and Bernoulli), both planes."""
    roots = np.array([4.730040745, 7.853204624, 10.995607838, 14.137165491])
    found = [roots**2 * thickness / np.sqrt(12) for thickness in (WIDTH, HEIGHT)]
    return np.sort(np.concatenate(found))[:count] * np.sqrt(YOUNG / DENSITY) / (2 * np.pi * LENGTH**2)


def main(along=24):
    V = space((along, 2, 2))
    say = print if V.mesh.comm.rank == 0 else lambda *_: None
    with body(V) as model:
        description = str(model)
        say(description)
        with hpcred.reduce(model, tolerance=1e-4, band=BAND, frame=hpcred.Buckens()) as reduced:
            hpcred.write_result("bar.h5", reduced, model)
            say(reduced.record.accuracy.sentence)
            for found, beam in zip(reduced.frequencies, slender_beam(3), strict=False):
                say(f"{found:10.2f} Hz, slender beam {beam:10.2f} Hz")
    for kind, path in (("sid", "bar.SID_FEM"), ("vtk", "bar.vtu")):
        hpcred.export("bar.h5", kind, path)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
