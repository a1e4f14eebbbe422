"""A reduced body for other programs: SID, MATLAB, NumPy, Exudyn and ParaView files from a result file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..formats.hdf5 import atomic_output, reading
from ..formats.result_file import FORMAT, read_result
from ..formats.sid import build_sid, write_sid
from ..multibody.equations_of_motion import FlexibleBody
from ..multibody.floating_frame import FloatingFrame
from ..multibody.node_shapes import NodeShape, shapes_in_file
from ..parallel.failures import InputError, agreed
from ..reduction.reduced_model import ReducedModel
from ..report.mode_pictures import draw_shapes, write_vtk


@dataclass
class Body:
    """What a multibody program needs of a flexible body."""

    rom: ReducedModel
    frame: FloatingFrame
    nodes: list[NodeShape]


def read_body(path, nodes=None) -> Body:
    """The body of a result file with chosen interface nodes, by default those of the inputs and outputs.

    Called on one rank. Raises InputError where the file has no floating-frame quantities or no such node.
    """
    from ..parallel.petsc import MPI

    rom = read_result(path, MPI.COMM_SELF)
    with reading(path, FORMAT) as file:
        if "floating_frame" not in file:
            raise InputError(
                f"{path}: no floating-frame quantities; the model had no node coordinates, or the projection was "
                "two-sided"
            )
        group = file["floating_frame"]
        arrays = {key: group[key][()] for key in ("mc", "J", "Ct", "Cr", "N", "S", "Me", "origin")}
        frame = FloatingFrame(mass=float(group["mass"][()]), integrals=group["integrals"][()].decode(), **arrays)
        if nodes is None:
            nodes = [int(node) for node in file["interface/node"][...]] if "interface" in file else []
        return Body(rom, frame, shapes_in_file(file, list(nodes), str(path)))


def check_elastic(body):
    """Raise InputError if the reduced body can move as a rigid one: the floating frame does that already."""
    M = FlexibleBody(body.frame, body.rom.K, body.rom.D).mass_matrix(np.zeros(len(body.frame.Ct)))
    rest = M[6:, 6:] - M[6:, :6] @ np.linalg.pinv(M[:6, :6], rcond=1e-12) @ M[:6, 6:]
    if np.linalg.eigvalsh(rest).min() < 1e-9 * np.linalg.eigvalsh(body.frame.Me).max():
        lowest = body.rom.frequencies.min()
        raise InputError(
            f"the reduced body contains rigid-body motions (lowest pseudo-frequency {lowest:.3g} Hz), which the "
            "floating frame has already; reduce with frame 'buckens' and modes from number 7, or hold the body"
        )


def remarks(body: Body) -> list[str]:
    """What was approximated or is not there."""
    found = []
    if body.frame.integrals != "consistent":
        found.append(f"integrals quadratic in the shapes: {body.frame.integrals}, an approximation")
    still = [str(shape.node) for shape in body.nodes if not shape.rotates]
    if still:
        found.append(f"no rotational dofs at nodes {', '.join(still)}: psi is zero there")
    return found


def comment(body: Body) -> str:
    """One line on what the file is."""
    version = body.rom.provenance["versions"]["hpcred"]
    return "; ".join([f"No. nodes, No. modes: hpcred {version}", *remarks(body)])


def export_sid(body: Body, path):
    """A SID file."""
    shapes = [(s.node, s.position - body.frame.origin, s.phi, s.psi) for s in body.nodes]
    rom = body.rom
    write_sid(path, build_sid(body.frame, rom.K, rom.D, rom.frequencies, shapes, comment(body)))


def named_arrays(body: Body) -> dict:
    """All matrices by name: M, D, K, B, C, frequencies, the floating-frame quantities, and the nodes."""
    rom = body.rom
    count = rom.size
    arrays = {key: getattr(rom, key) for key in ("M", "D", "K", "B", "C", "frequencies")}
    arrays |= body.frame.arrays()
    arrays |= {
        "nodes": np.array([shape.node for shape in body.nodes], dtype=float),
        "positions": np.array([s.position - body.frame.origin for s in body.nodes]).reshape(-1, 3),
        "phi": np.array([shape.phi for shape in body.nodes]).reshape(-1, 3, count),
        "psi": np.array([shape.psi for shape in body.nodes]).reshape(-1, 3, count),
    }
    return arrays


def export_matlab(body: Body, path):
    """A .mat file for MATLAB, Octave and Neweul-M2 users; every array under its name."""
    try:
        from scipy.io import savemat
    except ImportError as error:
        raise InputError("--format matlab needs SciPy: pip install 'hpcred[matlab]'") from error
    with open(path, "wb") as file:
        savemat(file, {**named_arrays(body), "comment": comment(body)}, oned_as="column")


def export_npz(body: Body, path):
    """A .npz file; every array under its name."""
    with open(path, "wb") as file:
        np.savez(file, **named_arrays(body), comment=comment(body))


def export_exudyn(body: Body, path):
    """A .npz file that Exudyn's ObjectFFRFreducedOrderInterface.LoadFromFile reads; its nodes are the interface.

    Damping is not part of that format; Exudyn takes Rayleigh coefficients when the object is added.
    """
    frame, count = body.frame, body.rom.size
    identity = np.eye(3)
    trace_n = np.trace(frame.N, axis1=1, axis2=2)
    trace_s = frame.S[0, 0] + frame.S[1, 1] + frame.S[2, 2]
    # with Psi~ = skew(Phi_k) side by side, integrals of Psi~^T Psi, Psi~^T Psi~, ...
    psi_psi = -frame.Cr1.transpose(1, 2, 0).reshape(3 * count, count)
    tilde = trace_s[:, :, None, None] * identity - frame.S.transpose(2, 3, 1, 0)
    psi_tilde = tilde.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
    reference = trace_n[:, None, None] * identity - frame.N.transpose(0, 2, 1)
    centre = frame.mc / frame.mass
    data = {
        "fileVersion": 1,
        "modeBasis": np.array([shape.phi for shape in body.nodes]).reshape(-1, count),
        "trigList": np.zeros((0, 3), dtype=int),
        "postProcessingModes": np.array({}, dtype=object),
        "massMatrixReduced": body.rom.M,
        "stiffnessMatrixReduced": body.rom.K,
        "infoList": np.array([count, len(body.nodes), 3, 4, 7, 7 + count]),
        "rigidBodyNodeType": "NodeType.RotationEulerParameters",
        "xRef": np.array([shape.position - frame.origin for shape in body.nodes]).ravel(),
        "inertiaLocal": frame.J,
        "Mtt": frame.mass * identity,
        "totalMass": frame.mass,
        "chiU": centre,
        "chiUtilde": np.cross(identity, centre),
        "mPsiTildePsi": psi_psi,
        "mPsiTildePsiTilde": psi_tilde,
        "mPhitTPsi": frame.Ct.T,
        "mPhitTPsiTilde": np.concatenate([np.cross(identity, row) for row in frame.Ct], axis=1),
        "mXRefTildePsi": -frame.Cr.T,
        "mXRefTildePsiTilde": reference.transpose(1, 0, 2).reshape(3, -1),
    }
    with open(path, "wb") as file:
        np.savez(file, **data)


EXPORTS = {
    "sid": (export_sid, ".SID_FEM"),
    "matlab": (export_matlab, ".mat"),
    "npz": (export_npz, ".npz"),
    "exudyn": (export_exudyn, ".npz"),
}
PICTURES = {"vtk": (write_vtk, ".vtu"), "png": (draw_shapes, ".png")}


def export_result(result, kind, output, nodes, comm) -> dict:
    """Write a result file in another format on rank 0; returns what was written. Collective. Raises InputError."""
    if kind not in EXPORTS | PICTURES:
        raise InputError(f"--format: found '{kind}', expected one of {', '.join(EXPORTS | PICTURES)}")
    if kind in PICTURES and nodes is not None:
        raise InputError(f"--nodes: '{kind}' shows all nodes; leave it out")
    output = Path(output or default_name(result, kind))
    report = None
    with atomic_output(output, comm) as temporary, agreed(comm):
        if comm.rank == 0 and kind in PICTURES:
            report = {"output": str(output), "format": kind, "shapes": PICTURES[kind][0](result, temporary)}
        elif comm.rank == 0:
            body = read_body(result, nodes)
            if not body.nodes:
                raise InputError(f"{result}: no interface nodes; name some by --nodes")
            if kind in ("sid", "exudyn"):
                check_elastic(body)
            EXPORTS[kind][0](body, temporary)
            report = {
                "output": str(output),
                "format": kind,
                "coordinates": body.rom.size,
                "nodes": [shape.node for shape in body.nodes],
                "remarks": remarks(body),
            }
    return comm.bcast(report)


def default_name(result, kind) -> Path:
    """result.h5 -> result.SID_FEM, result.mat, result.npz, result_exudyn.npz, result.vtu, result.png."""
    path = Path(result)
    stem = f"{path.stem}_exudyn" if kind == "exudyn" else path.stem
    return path.with_name(stem + (EXPORTS | PICTURES)[kind][1])
