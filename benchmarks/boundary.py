"""Other boundary conditions than those of the reduction: each bearing free, held, or with a mass on it.

usage: python benchmarks/boundary.py

A connecting rod is reduced once by each method, to as many coordinates as a reduction to 1e-4 has, rigid-body motion
included. Then each of its bearings is free, held in all directions, or carries 1, 10 and 100 times the mass of the rod,
and the frequencies of what comes out, up to the end of the band, are set against those of the full model. (After
Witteveen, WJM 2, 2012, 311, who finds component mode synthesis best there.)
"""

import json
import sys

from common import finish, job, workspace

BAND, DOFS, ARM = (0.0, 4000.0), 1200, 0.02  # Hz; dofs; radius of gyration of the masses in m
STATES = ("held", 1, 10, 100)
HELD = (1e12, 1e9)  # N/m and N m/rad


def measured():
    """In a job of its own: rows of the table."""
    import numpy as np
    import scipy.linalg
    from directions import sparse

    import hpcred
    from hpcred import Buckens, CraigBampton, Interface, Modes, Nodes
    from hpcred.reduction import ResidualAttachment

    bearings = [Interface(name=name, nodes=Nodes(set=name)) for name in ("BIG_EYE", "SMALL_EYE")]
    rows, roms = [], {}
    with hpcred.crank(DOFS) as free, free.with_interfaces(bearings) as jointed:
        mass = hpcred.inspect(jointed)["mass_kg"]
        with jointed.with_inputs([(item.name, "all") for item in bearings]) as model:
            K, M = sparse(model.K).toarray(), sparse(model.M).toarray()
            full = K, M, model.B.getDenseArray().real.copy()
            kept = {"frame": Buckens(), "coordinates": "interface"}
            with hpcred.reduce(model, tolerance=1e-4, band=BAND, **kept) as rom:
                size, roms["to a tolerance"] = rom.size, (rom.K, rom.M, rom.B)
            for name, basis, keywords in (
                ("Craig-Bampton", [CraigBampton(count=size - 12)], kept),
                ("modes and attachment modes", [Modes(count=size - 18), ResidualAttachment()], kept),
                ("modes", [Modes(count=size - 6)], {"frame": Buckens()}),
            ):
                with hpcred.reduce(model, basis, **keywords) as rom:
                    found = rom.K, rom.M, rom.B
                if not keywords.get("coordinates"):  # with its rigid-body modes
                    rigid = scipy.linalg.eigh(K, M, subset_by_index=[0, 5])[1]
                    stiffness, inertia = (scipy.linalg.block_diag(part, own)
                                          for part, own in zip((np.zeros((6, 6)), np.eye(6)), found[:2], strict=True))
                    found = stiffness, inertia, np.vstack([rigid.T @ full[2], found[2]])
                roms[f"{name} ({len(found[0])})"] = found

    def frequencies(K, M, B, states):
        stiff, heavy = np.zeros(12), np.zeros(12)
        for k, state in enumerate(states):
            part = slice(6 * k, 6 * k + 6)
            if state == "held":
                stiff[part] = np.repeat(HELD, 3)
            elif state != "free":
                heavy[part] = state * mass * np.repeat([1.0, ARM**2], 3)
        count = min(len(K), 40) - 1
        eigenvalues = scipy.linalg.eigh(K + (B * stiff) @ B.T, M + (B * heavy) @ B.T, subset_by_index=[0, count])[0]
        f = np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi)
        return f[f > 1.0]

    for states in [("free", "free"), *((a, "free") for a in STATES), *(("free", a) for a in STATES),
                   *((a, a) for a in STATES)]:  # fmt: skip
        exact = frequencies(*full, states)
        exact = exact[exact < BAND[1]]
        row = {"big eye": str(states[0]), "small eye": str(states[1]), "modes": len(exact)}
        for name, matrices in roms.items():
            found = frequencies(*matrices, states)[: len(exact)]
            row[name] = float(np.abs(found / exact - 1).max(initial=0.0)) if len(found) == len(exact) else "missing"
        rows.append(row)
    print(json.dumps([{**row, "size": size} for row in rows]))


def main():
    with workspace() as folder:
        finish("boundary", job(1, folder, "--measured"))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measured"]:
        measured()
    else:
        main()
