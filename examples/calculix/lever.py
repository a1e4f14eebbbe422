"""From CAD to a multibody program with free software: a lever with two bearings.

gmsh meshes it, CalculiX computes frequencies and writes its matrices, hpcred reduces them and hands the body on.
On Debian: apt-get install calculix-ccx python3-gmsh. Run in an empty folder:

    python lever.py [SIZE OF ELEMENTS in m]

It leaves lever.SID_FEM and lever_exudyn.npz, and prints the frequencies beside those of CalculiX.
"""

import subprocess
import sys
from pathlib import Path

import gmsh
import numpy as np

import hpcred

BEARINGS = ((0.0, 0.018), (0.2, 0.010))  # place along x and radius in m
MODES = 14  # six of them rigid


def mesh(size):
    """Node numbers, their places, and tetrahedra of ten nodes in the order of CalculiX."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    cad = gmsh.model.occ
    bar = cad.addBox(0, -0.015, -0.01, 0.2, 0.03, 0.02)
    eyes = [cad.addCylinder(x, 0, -0.015, 0, 0, 0.03, radius) for x, radius in ((0.0, 0.03), (0.2, 0.02))]
    body, _ = cad.fuse([(3, bar)], [(3, eye) for eye in eyes])
    holes = [cad.addCylinder(x, 0, -0.02, 0, 0, 0.04, radius) for x, radius in BEARINGS]
    cad.cut(body, [(3, hole) for hole in holes])
    cad.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.ElementOrder", 2)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("HighOrder")
    number, place, _ = gmsh.model.mesh.getNodes()
    (kind,), _, (nodes,) = gmsh.model.mesh.getElements(3)
    gmsh.finalize()
    assert kind == 11, "expected tetrahedra of ten nodes only"
    tetrahedra = nodes.reshape(-1, 10)[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]
    used = np.isin(number, tetrahedra)
    return number[used].astype(int), place.reshape(-1, 3)[used], tetrahedra


def write_input(path, step, number, place, tetrahedra):
    """An input file for CalculiX: the holes are rigid, and each hangs on a node that moves and one that turns."""
    middle = int(number.max()) + 1
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{n}, {x:.12g}, {y:.12g}, {z:.12g}" for n, (x, y, z) in zip(number, place, strict=True)]
    lines += [f"{middle + k}, {x:g}, 0., 0." for k, x in enumerate(x for x, _ in BEARINGS for _ in range(2))]
    lines.append("*ELEMENT, TYPE=C3D10, ELSET=EALL")
    lines += [f"{k + 1}, " + ", ".join(map(str, nodes)) for k, nodes in enumerate(tetrahedra)]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1e11, 0.3", "*DENSITY", "7850."]
    lines.append("*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL")
    for k, (x, radius) in enumerate(BEARINGS):
        hole = number[np.hypot(place[:, 0] - x, place[:, 1]) < radius + 5e-4]
        lines += [f"*NSET, NSET=HOLE{k}", *(f"{n}," for n in hole)]
        lines.append(f"*RIGID BODY, NSET=HOLE{k}, REF NODE={middle + 2 * k}, ROT NODE={middle + 2 * k + 1}")
    lines += ["*STEP", step, str(MODES), "*END STEP"]
    Path(path).write_text("\n".join(lines) + "\n")
    return middle, middle + 2


def run_calculix(name):
    done = subprocess.run(["ccx", name], capture_output=True, text=True)
    if "*ERROR" in done.stdout:
        sys.exit(done.stdout[done.stdout.index("*ERROR") :])


def frequencies_of_calculix(path):
    """Frequencies in Hz of a .dat file."""
    text = Path(path).read_text().split("P A R T I C I P A T I O N")[0]
    rows = [line.split() for line in text.splitlines()]
    return np.array([float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()])


def main(size=0.012):
    parts = mesh(size)
    write_input("lever_modes.inp", "*FREQUENCY", *parts)
    first, second = write_input("lever.inp", "*FREQUENCY, SOLVER=MATRIXSTORAGE", *parts)
    for name in ("lever_modes", "lever"):
        run_calculix(name)
    own = frequencies_of_calculix("lever_modes.dat")[6:]

    # each bearing takes forces and moments: six inputs
    inputs = [(node, direction) for node in (first, second) for direction in ("x", "y", "z", "rx", "ry", "rz")]
    for sentence in hpcred.convert("lever.inp", "model.h5", inputs=inputs)["sentences"]:
        print(sentence)
    with hpcred.read_model("model.h5") as model:
        basis = [hpcred.Modes(count=len(own)), hpcred.StaticCorrection()]
        with hpcred.reduce(model, basis, hpcred.Buckens()) as reduced:
            hpcred.write_result("lever.h5", reduced, model)
            print(f"{model.size} dofs, {reduced.size} coordinates")
            found = reduced.frequencies[: len(own)]
    for here, there in zip(found, own, strict=True):
        print(f"{here:12.3f} Hz, CalculiX {there:12.3f} Hz, difference {abs(here / there - 1):.1e}")
    for kind, path in (("sid", "lever.SID_FEM"), ("exudyn", "lever_exudyn.npz")):
        report = hpcred.export("lever.h5", kind, path)
        print(f"{report['output']}: {report['coordinates']} elastic coordinates, nodes {report['nodes']}")
    return float(np.abs(found / own - 1).max())


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
