"""Write a Body as the .npz that ObjectFFRFreducedOrderInterface.LoadFromFile of Exudyn reads, with keys of our own.

Its mesh nodes are displacements only: first the interface nodes; then four points around each of them that rotates, the
corners of a small tetrahedron fixed to it, whose mean motion is that of the node; then the surface that is drawn. Its
stresses, where the result has stress modes, are postProcessingModes. The
keys of our own are `names`, names or numbers of the interface nodes, `markerNodes`, the four mesh nodes of each for a
MarkerSuperElementRigid, -1 where it does not rotate, `dampingMatrixReduced`, the matrix D, and of all inputs
`inputNames`, `inputMatrixReduced` (m, p) and `inputResultants` (p, 6), force and moment about the origin of the body
frame. Exudyn leaves them out of account; docs/export-exudyn.md says how to use them. Outputs but nodes have no place.
"""

import numpy as np

from ..body.body import check_moving, remarks, resultants_of, without_node
from ..files.outputs import ZIP
from .arrays import save_npz
from .base import Writer

CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
COMPONENTS = [0, 1, 2, 4, 5, 3]  # xx, yy, zz, yz, zx, xy of the stresses, as Exudyn has them
RADIUS = 0.01  # of the tetrahedra, in radii of gyration of the body; what they measure does not depend on it


def _mesh(body):
    """Mesh nodes (n, 3), displacements (n, 3, m), triangles (t, 3), and the four around each interface node (k, 4)."""
    frame = body.floating_frame
    points = [shape.position[None] for shape in body.nodes]
    phi = [shape.phi[None] for shape in body.nodes]
    markers = np.full((len(body.nodes), 4), -1)
    corners = RADIUS * np.sqrt(np.trace(frame.J) / frame.mass) * CORNERS
    for k, shape in enumerate(body.nodes):
        if shape.rotates:
            markers[k] = np.arange(4) + sum(map(len, points))
            points.append(shape.position + corners)
            phi.append(shape.phi + np.cross(shape.psi.T[None], corners[:, None]).transpose(0, 2, 1))
    triangles = np.zeros((0, 3), dtype=int)
    if body.surface is not None:
        triangles = body.surface.triangles + sum(map(len, points))
        points.append(body.surface.points)
        phi.append(body.surface.phi)
    return np.concatenate(points), np.concatenate(phi), triangles, markers


def _post_processing(body, count) -> dict:
    """The stresses (count, 6 m) of the mesh nodes, six for each mode; zero at nodes without stress modes."""
    if body.stress is None:
        return {}
    numbers = np.full(count, -1)  # no node has this number
    numbers[: len(body.nodes)] = [shape.node for shape in body.nodes]
    if body.surface is not None:
        numbers[count - len(body.surface.nodes) :] = body.surface.nodes
    place = np.searchsorted(body.stress.node, numbers).clip(max=len(body.stress.node) - 1)
    there = body.stress.node[place] == numbers
    matrix = np.zeros((count, body.reduced.size, 6))
    matrix[there] = body.stress.stress[:, place[there]][..., COMPONENTS].transpose(1, 0, 2)
    return {"matrix": matrix.reshape(count, -1), "outputVariableType": "OutputVariableType.StressLocal"}


def _notes(body):
    """What Exudyn learns by a line of script, and what it cannot learn from the file."""
    notes = []
    rotating = ", ".join(shape.name or str(shape.node) for shape in body.nodes if shape.rotates)
    if rotating:
        notes.append(f"rotations of nodes {rotating}: by MarkerSuperElementRigid on the mesh nodes of markerNodes")
    if body.reduced.D.any():
        notes.append(
            "LoadFromFile passes over the damping: give it to the object by mbs.SetObjectParameter(object, "
            "'dampingMatrixReduced', exudyn.MatrixContainer(numpy.load(file)['dampingMatrixReduced']))"
        )
    if loads := without_node(body.reduced.input_names):
        notes.append(f"inputs {', '.join(loads)}: by a user function with inputMatrixReduced and inputResultants")
    if lost := without_node(body.reduced.output_names):
        notes.append(f"outputs that belong to no node are left out: {', '.join(lost)}")
    if body.surface is None:
        notes.append("no surface is drawn: the result has no faces, no basis, or too many dofs")
    if body.stress is None:
        notes.append("no stresses: the result has no stress modes, or those of too many nodes")
    return notes


class Exudyn(Writer):
    """Bodies of Exudyn."""

    suffix, needs, kind, surface, stress = "_exudyn.npz", "body", ZIP, True, True

    def write(self, target, source):
        body = source.body
        check_moving(body, "a file for Exudyn")
        reduced, quantities, count = body.reduced, body.floating_frame, body.reduced.size
        identity = np.eye(3)
        trace_n = np.trace(quantities.N, axis1=1, axis2=2)
        trace_s = quantities.S[0, 0] + quantities.S[1, 1] + quantities.S[2, 2]
        # with Psi~ = skew(Phi_k) side by side, integrals of Psi~^T Psi, Psi~^T Psi~, ...
        psi_psi = -quantities.Cr1.transpose(1, 2, 0).reshape(3 * count, count)
        tilde = trace_s[:, :, None, None] * identity - quantities.S.transpose(2, 3, 1, 0)
        psi_tilde = tilde.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
        reference = trace_n[:, None, None] * identity - quantities.N.transpose(0, 2, 1)
        centre = quantities.mc / quantities.mass
        points, phi, triangles, markers = _mesh(body)
        data = {
            "fileVersion": 1,
            "modeBasis": phi.reshape(-1, count),
            "trigList": triangles,
            "postProcessingModes": np.array(_post_processing(body, len(points)), dtype=object),
            "massMatrixReduced": reduced.M,
            "stiffnessMatrixReduced": reduced.K,
            "infoList": np.array([count, len(points), 3, 4, 7, 7 + count]),
            "rigidBodyNodeType": "NodeType.RotationEulerParameters",
            "xRef": (points - quantities.origin).ravel(),
            "inertiaLocal": quantities.J,
            "Mtt": quantities.mass * identity,
            "totalMass": quantities.mass,
            "chiU": centre,
            "chiUtilde": np.cross(identity, centre),
            "mPsiTildePsi": psi_psi,
            "mPsiTildePsiTilde": psi_tilde,
            "mPhitTPsi": quantities.Ct.T,
            "mPhitTPsiTilde": np.concatenate([np.cross(identity, row) for row in quantities.Ct], axis=1),
            "mXRefTildePsi": -quantities.Cr.T,
            "mXRefTildePsiTilde": reference.transpose(1, 0, 2).reshape(3, -1),
            "names": np.array([shape.name or str(shape.node) for shape in body.nodes]),
            "markerNodes": markers,
            "dampingMatrixReduced": reduced.D,
            "inputNames": np.array(reduced.input_names, dtype=str),
            "inputMatrixReduced": reduced.B,
        }
        resultants = resultants_of(body)
        if resultants is not None:
            data["inputResultants"] = resultants
        save_npz(target, data)
        return [*remarks(body), *_notes(body)]
