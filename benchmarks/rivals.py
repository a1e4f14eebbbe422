"""Other methods of the field at small models: sizes for an error, errors at a size, and seconds of processor time.

usage: python benchmarks/rivals.py [--data FOLDER] [--figure rivals.png] [model ...]

All methods are measured alike: the worst direction, relative over the band (docs/theory/error.md), at uniform
frequencies and beside each resonance. hpcred reduces the model as it is. The rivals, dense numerics of
benchmarks/peers and pyMOR, begin with the 450 lowest modes and all static deflections, which makes no difference to the
responses (column "reference" of the results: their largest error beside sparse solves). First-order models of 2 m
states count as m coordinates. FOLDER has the files of published models (benchmarks/models); those that are not there
are left out.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from common import ENVIRONMENT, HERE, PEER_PYTHON, finish, job, workspace

EPS = (1e-2, 1e-4)
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
MODES, UNIFORM, FRESH = 450, 300, 12
BESIDE = (-4, -2, -1, -0.5, 0, 0.5, 1, 2, 4)  # half widths of a resonance
HPCRED, TWO_SIDED = "hpcred", "hpcred, points by hand, two-sided"


@dataclass(frozen=True)
class Own:
    """A model of ours: what to call, its band (Hz), and Rayleigh damping."""

    band: tuple[float, float]
    rayleigh: tuple[float, float]


OWN = {
    "linkage": Own((0, 300), (2.0, 1e-5)),
    "block": Own((0, 20000), (500.0, 2e-7)),
    "plate": Own((0, 20000), (500.0, 2e-7)),
    "apart": Own((0, 20000), (500.0, 2e-7)),  # the block, measured where no force acts
}
PUBLISHED = ("iss", "foundation", "concrete", "shaft")


def model_of(name, folder):
    """The model, its band (Hz), its damping for hpcred, and M, D, K, B, C, Cv of SciPy."""
    import numpy as np
    import scipy.sparse as sp
    from directions import sparse

    import hpcred
    from hpcred.examples import linkage
    from hpcred.model.frames import apply_frame

    if name in OWN:
        own = OWN[name]
        if name == "linkage":
            model = apply_frame(hpcred.linkage(), linkage.FRAME, hpcred.NoDamping()).model
        else:
            model = hpcred.solid((16, 16, 1) if name == "plate" else (10, 5, 4))
        M, K, B = sparse(model.M), sparse(model.K), model.B.getDenseArray().real.copy()
        C = B.T
        if name == "apart":
            C = np.zeros((3, len(B)))
            C[range(3), len(B) // 2 + np.arange(3)] = 1.0
            B = B[:, :3]
        D, damping = own.rayleigh[0] * M + own.rayleigh[1] * K, hpcred.Rayleigh(*own.rayleigh)
        model = hpcred.SecondOrderModel(M, None, K, B, None if C.base is B else C, name=name)
        return model, own.band, damping, (M, D, K, B, C, np.zeros_like(C))
    from models import MODELS

    published = MODELS[name]
    given, band = published.matrices(folder), published.band
    D = sp.csr_matrix(given.K.shape) if given.D is None else given.D
    # viscous damping of the size of the loss factor at mid-band, since states of first order have no loss factor
    D = sp.csr_matrix(D + published.loss_factor / (np.pi * band[1]) * given.K)
    own_C = given.C is not None
    none = np.zeros((given.Cv if given.Cv is not None else given.C if own_C else given.B.T).shape)
    C, Cv = given.C, given.Cv
    if C is None and Cv is None:
        C = given.B.T
    arguments = {"C": given.C} if given.Cv is None else {"C": given.C, "Cv": given.Cv}
    model = hpcred.SecondOrderModel(given.M, D, given.K, given.B, name=name, **arguments)
    return model, band, None, (given.M, D, given.K, given.B, none if C is None else C, none if Cv is None else Cv)


def reference(name, folder):
    """In a job of its own: what hpcred reaches, and the folder's files for the rivals."""
    import numpy as np
    import scipy.sparse as sp
    import scipy.sparse.linalg

    import hpcred

    sys.path.insert(0, str(HERE / "peers"))
    import dense_methods as methods

    model, band, damping, (M, D, K, B, C, Cv) = model_of(name, folder)
    full = methods.Model(M, D, K, B, C, Cv)
    start = time.process_time()
    dense = methods.prepared(full, MODES)
    seconds = time.process_time() - start

    def processor(**keywords):
        start = time.process_time()
        reduced = hpcred.reduce(model, damping=damping, **keywords)
        return reduced, time.process_time() - start

    poles = np.linalg.eigvals(methods.first_order(dense)[0])
    poles = poles[(poles.imag > 0) & (poles.imag < 2.02 * np.pi * band[1])]
    near = np.outer(np.abs(poles.real), BESIDE) + poles.imag[:, None]
    f = np.unique(np.concatenate([np.linspace(*band, UNIFORM), near.ravel() / (2 * np.pi)]))
    f = f[(f >= band[0]) & (f <= band[1]) & ((f > 0) | (not Cv.any()))]
    tight, _ = processor(tolerance=1e-6, band=band)
    measure = tight.record.accuracy.measure

    def scale(f):
        """What errors count by, (S, r, p): velocities are measured as displacements are."""
        rates = Cv.any(axis=1)
        shown = methods.Model(dense.M, dense.D, dense.K, dense.B, dense.C + dense.Cv, 0 * dense.Cv)
        drive = methods.Model(dense.M, dense.D, dense.K, dense.B, dense.B.T, 0 * dense.B.T).response(f)
        h, g = measure.scales(shown.response(f), np.einsum("fii->fi", drive))
        return np.where(rates, np.abs(2 * np.pi * f)[:, None], 1.0)[:, :, None] * h[:, :, None] * g[:, None, :]

    H, scales = dense.response(f), scale(f)
    fresh = np.random.default_rng(1).uniform(*band, FRESH)
    exact = []
    for s in 2j * np.pi * fresh:
        A = (s * s * M + s * D + K).tocsc()
        exact.append((C + s * Cv) @ scipy.sparse.linalg.splu(A).solve(B.astype(complex)))
    away = float((np.abs(np.array(exact) - dense.response(fresh)) / scale(fresh)).max())

    runs = []

    def note(method, reduced, used):
        error = float((np.abs(reduced.transfer_function(2j * np.pi * f) - H) / scales).max())
        runs.append({"method": method, "size": reduced.size, "seconds": used, "eps": error,
                     "unstable": len(reduced.unstable_poles())})  # fmt: skip

    for tolerance in TOLERANCES:
        note(HPCRED, *processor(tolerance=tolerance, band=band))
    if not np.array_equal(C, B.T) and not Cv.any():
        for count in range(1, 9):
            points = [hpcred.Krylov((i + 0.5) * band[1] / count, 0) for i in range(count)]
            note(TWO_SIDED, *processor(basis=points, projection="two_sided", allow_unstable=True))
    sizes = sorted({min(run["size"] for run in runs if run["method"] == HPCRED and run["eps"] <= eps) for eps in EPS})
    np.savez("reference.npz", frequencies=f, response=H, scale=scales, sizes=sizes, band=band)
    np.savez("dense.npz", seconds=seconds, **vars(dense))
    np.savez("loads.npz", B=B, C=C, Cv=Cv)
    for key, matrix in (("M", M), ("D", D), ("K", K)):
        sp.save_npz(f"{key}.npz", sp.csc_matrix(matrix))
    print(json.dumps({"dofs": model.size, "reference": away, "runs": runs}))


def rivals(script, folder):
    """The runs of a script of peers, none where it fails."""
    environment = {**ENVIRONMENT, **{f"{name}_NUM_THREADS": "1" for name in ("MKL", "OMP", "OPENBLAS")}}
    environment.pop("PYTHONPATH", None)
    try:
        run = subprocess.run([PEER_PYTHON, HERE / "peers" / script, folder], check=True, env=environment,
                             stdout=subprocess.PIPE, text=True)  # fmt: skip
    except (subprocess.SubprocessError, OSError) as error:
        print(f"{script}: {error}", file=sys.stderr)
        return []
    *said, last = run.stdout.strip().splitlines()
    print("\n".join(said), file=sys.stderr)
    return json.loads(last)


def measured(name, data):
    with workspace() as folder:
        found = job(1, folder, "--reference", name, *([data] if data else []))
        for script in ("dense_rivals.py", "pymor_rivals.py"):
            found["runs"] += rivals(script, folder)
    return found


def least(runs, eps):
    """The smallest run of each method that has an error, by method."""
    found = {}
    for run in sorted(runs, key=lambda run: (run["size"], run["seconds"])):
        if run["eps"] <= eps:
            found.setdefault(run["method"], run)
    return found


def rows_of(name, found):
    """Rows of the table: for each error the methods with their sizes; and their errors at the size of hpcred."""
    rows = []
    for eps in EPS:
        best = least(found["runs"], eps)
        ours = best[HPCRED]
        stable = {method: run for method, run in best.items() if method != HPCRED and not run["unstable"]}
        smallest = min((run["size"] for run in stable.values()), default=0)
        row = {"model": name, "dofs": found["dofs"], "error": f"{eps:g}", "reference": found["reference"],
               "hpcred / best": ours["size"] / smallest if smallest else 0.0}  # fmt: skip
        for method in dict.fromkeys(run["method"] for run in found["runs"]):
            at = [run for run in found["runs"] if run["method"] == method and run["size"] == ours["size"]]
            equal = f"{at[0]['eps']:.1e}" if at else "-"
            run = best.get(method)
            size = "no" if run is None else f"{run['size']}{'*' if run['unstable'] else ''} ({run['seconds']:.2g} s)"
            row[method] = f"{size}; {equal}"
        rows.append(row)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("HPCRED_SHARED_DATA"))
    parser.add_argument("--figure", default="rivals.png")
    parser.add_argument("models", nargs="*", choices=[[], *OWN, *PUBLISHED], default=[])
    given = parser.parse_args()
    runs = {}
    for name in given.models or (*OWN, *PUBLISHED):
        try:
            runs[name] = measured(name, given.data)
        except subprocess.CalledProcessError as error:
            print(f"{name}: left out ({error})", file=sys.stderr)
        Path("rivals_runs.json").write_text(json.dumps(runs, indent=1) + "\n")
    finish("rivals", [row for name, found in runs.items() for row in rows_of(name, found)])


if __name__ == "__main__":
    if sys.argv[1:2] == ["--reference"]:
        reference(sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    else:
        main()
