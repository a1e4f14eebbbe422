"""Write K.mtx, M.mtx, dofs.txt and nodes.txt from Kratos (tried with 10.4), for hpcred convert."""

import KratosMultiphysics as KM
from KratosMultiphysics import StructuralMechanicsApplication as SMA

DIRECTIONS = {"DISPLACEMENT_X": 1, "DISPLACEMENT_Y": 2, "DISPLACEMENT_Z": 3,
              "ROTATION_X": 4, "ROTATION_Y": 5, "ROTATION_Z": 6}  # fmt: skip


def write(builder, scheme, part):
    """After the solution of an eigenvalue problem with this builder, scheme and model part."""
    space = KM.UblasSparseSpace()
    A, x, rhs = space.CreateEmptyMatrixPointer(), space.CreateEmptyVectorPointer(), space.CreateEmptyVectorPointer()
    builder.SetReshapeMatrixFlag(True)
    builder.ResizeAndInitializeVectors(scheme, A, x, rhs, part)
    for level, name in ((1, "M"), (2, "K")):
        space.SetToZeroMatrix(A)
        part.ProcessInfo[SMA.BUILD_LEVEL] = level
        builder.BuildLHS(scheme, part, A)
        KM.WriteMatrixMarketMatrix(f"{name}.mtx", A, False)
    rows = sorted((d.EquationId, d.Id(), DIRECTIONS[d.GetVariable().Name()]) for d in builder.GetDofSet())
    with open("dofs.txt", "w") as file:
        file.writelines(f"{node} {d}\n" for row, node, d in rows if row < builder.GetEquationSystemSize())
    with open("nodes.txt", "w") as file:
        file.writelines(f"{n.Id} {n.X0!r} {n.Y0!r} {n.Z0!r}\n" for n in part.Nodes)
