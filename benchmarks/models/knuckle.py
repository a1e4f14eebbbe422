"""The steering knuckle of FEDEM's car suspension: a Nastran mesh with RBE2, which CalculiX assembles.

It needs ccx and pyNastran. FEDEM reduces with lumped masses; those here are consistent, as CalculiX has them.

The mesh has 3,992 CTETRA of ten nodes and five RBE2 on four nodes, which are the supernodes of FEDEM and here the
inputs: forces and moments on each. Two of the RBE2 share nodes and hang on the same node, so that they are one rigid
body.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse

import hpcred

from .published import Arrays, Published, all_ranks


def input_lines(path) -> tuple[list[str], list[int]]:
    """Lines of a CalculiX input file for a Nastran file of CTETRA and RBE2, and the nodes on which the RBE2 hang."""
    from pyNastran.bdf.bdf import read_bdf

    mesh = read_bdf(str(path), debug=None)
    known = {"GRID", "CTETRA", "RBE2", "MAT1", "PSOLID", "CORD2R", "PARAM", "ENDDATA"}
    if unknown := set(mesh.card_count) - known:
        raise hpcred.InputError(f"{path}: found {', '.join(sorted(unknown))}, expected only {', '.join(sorted(known))}")
    bodies: dict[int, set[int]] = {}
    for rigid in mesh.rigid_elements.values():
        if rigid.cm != "123456":
            raise hpcred.InputError(f"{path}: RBE2 {rigid.eid}: found the directions {rigid.cm}, expected 123456")
        bodies.setdefault(rigid.independent_nodes[0], set()).update(rigid.dependent_nodes)
    members = [node for nodes in bodies.values() for node in nodes]
    if len(set(members)) < len(members) or set(members) & set(bodies):
        raise hpcred.InputError(f"{path}: found RBE2 of different nodes that share a node, expected rigid bodies apart")
    (material,) = mesh.materials.values()
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{n}, " + ", ".join(f"{x:.15g}" for x in node.get_position()) for n, node in sorted(mesh.nodes.items())]
    turned = max(mesh.nodes) + 1
    lines += [f"{turned + k}, " + ", ".join(f"{x:.15g}" for x in mesh.nodes[node].get_position())
              for k, node in enumerate(bodies)]  # fmt: skip
    lines.append("*ELEMENT, TYPE=C3D10, ELSET=EALL")
    lines += [", ".join(map(str, (n, *element.node_ids))) for n, element in sorted(mesh.elements.items())]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{material.e}, {material.nu}", "*DENSITY", f"{material.rho}"]
    lines.append("*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL")
    for k, (node, nodes) in enumerate(bodies.items()):
        lines += [f"*NSET, NSET=RIGID{node}", *(f"{n}," for n in sorted(nodes))]
        lines.append(f"*RIGID BODY, NSET=RIGID{node}, REF NODE={node}, ROT NODE={turned + k}")
    return lines, sorted(bodies)


def run_calculix(folder, name, lines, step, modes=20):
    """Run CalculiX on the lines with a frequency step, in a folder."""
    (Path(folder) / f"{name}.inp").write_text("\n".join([*lines, "*STEP", step, str(modes), "*END STEP", ""]))
    done = subprocess.run(["ccx", name], cwd=folder, capture_output=True, text=True)
    if done.returncode not in (0, 201):  # 201: matrices were stored, and nothing solved
        raise hpcred.ComputationError(f"ccx {name}: {done.stdout[-1000:]}")


def frequencies(path, modes=20) -> np.ndarray:
    """The frequencies in Hz that CalculiX itself finds; it runs here."""
    with tempfile.TemporaryDirectory(prefix="knuckle-") as folder:
        run_calculix(folder, "modes", input_lines(path)[0], "*FREQUENCY", modes)
        text = (Path(folder) / "modes.dat").read_text().split("P A R T I C I P A T I O N")[0]
    rows = [line.split() for line in text.splitlines()]
    return np.array([float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()])


def assembled(path, comm) -> hpcred.SecondOrderModel:
    """The model of CalculiX's matrices, with forces and moments on the nodes of the RBE2. Collective."""
    folder, nodes = None, None
    with hpcred.agreed(comm):
        if comm.rank == 0:
            if shutil.which("ccx") is None:
                raise hpcred.InputError("knuckle: found no ccx, expected CalculiX; Debian has it as calculix-ccx")
            folder = tempfile.mkdtemp(prefix="knuckle-")
            lines, nodes = input_lines(path)
            run_calculix(folder, "knuckle", lines, "*FREQUENCY, SOLVER=MATRIXSTORAGE")
    folder, nodes = comm.bcast((folder, nodes))
    try:
        with hpcred.readers.load_export(f"{folder}/knuckle.inp", comm, "knuckle") as model:
            return model.with_inputs([(node, "all") for node in nodes])
    finally:
        comm.Barrier()
        if comm.rank == 0:
            shutil.rmtree(folder)


def with_interfaces(model: hpcred.SecondOrderModel) -> hpcred.SecondOrderModel:
    """The same model, whose nodes of the RBE2 are interface nodes, as component modes want them. Collective."""
    nodes = dict.fromkeys(int(name.partition(":")[0]) for name in model.input_names)
    return model.with_interfaces([hpcred.Interface(name=f"joint{node}", nodes=(node,), kind="rigid") for node in nodes])


def fedem_modes(path) -> int:
    """The number of component modes (-ngen) in the options of FEDEM beside the mesh."""
    words = Path(path).with_suffix(".fco").read_text().split()
    return int(words[words.index("-ngen") + 1])


@dataclass(frozen=True, kw_only=True)
class Knuckle(Published):
    """The knuckle, whose matrices come from a run of CalculiX instead of a file."""

    read: None = None

    def matrices(self, folder=None) -> Arrays:
        from hpcred.parallel.petsc import MPI

        with self.model(MPI.COMM_SELF, folder) as model:
            M, K = (scipy.sparse.csr_matrix(mat.getValuesCSR()[::-1]) for mat in (model.M, model.K))
            return Arrays(M=M, D=None, K=K, B=model.B.getDenseArray().copy())

    def model(self, comm=None, folder=None) -> hpcred.SecondOrderModel:
        return assembled(self.path(folder), all_ranks(comm))

    def reduce(self, model, **more):
        return super().reduce(model, **{"frame": hpcred.Buckens(), **more})

    def job(self, model, output="result.h5"):
        return super().job(model, output) + '[frame]\nkind = "buckens"\n'


MODELS = (
    Knuckle(name="knuckle", what="steering knuckle of FEDEM's car suspension, by CalculiX (ccx)", n=22_776,
            file="knuckle.nas", source="openfedem/fedem-solver-tests 81f94ee, TimeDomain/CarSuspension",
            licence="Apache-2.0", where="github.com/openfedem/fedem-solver-tests", band=(0.0, 3000.0)),
)  # fmt: skip
