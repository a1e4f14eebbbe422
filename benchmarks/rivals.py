"""Other methods of the field at small models: sizes for an error, errors at a size, and seconds of processor time.

usage: python benchmarks/rivals.py [--data FOLDER] [--figure rivals.png] [model ...]

All methods are measured alike: the worst direction, relative over the band (docs/theory/error.md), at uniform
frequencies and beside each resonance. hpcred reduces the model as it is. The rivals, dense numerics of
benchmarks/peers and pyMOR, begin with the 120 lowest modes, all static deflections and exact responses at six
frequencies, which makes no difference to the responses (column "reference" of the results: their largest error beside
sparse solves). First-order models of 2 m states count as m coordinates. FOLDER has the files of published models
(benchmarks/models); those that are not there are left out.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from common import ENVIRONMENT, HERE, PEER_PYTHON, finish, job, workspace

EPS = (1e-2, 1e-4)
TOLERANCES = (1e-2, 1e-3, 1e-4)
MODES, SOLVED, UNIFORM, FRESH = 120, 6, 200, 8
BESIDE = (-3, -1, -0.4, 0, 0.4, 1, 3)  # half widths of a resonance
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
LOSS = {"shaft": 2e-3}  # loss factor of a model whose damper leaves modes of the band undamped
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
    loss_factor = published.loss_factor + LOSS.get(name, 0.0)
    D = sp.csr_matrix(D + loss_factor / (np.pi * band[1]) * given.K)
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
    dense = methods.prepared(full, MODES, np.linspace(*band, SOLVED + 1)[1:])
    seconds = time.process_time() - start

    def processor(**keywords):
        start = time.process_time()
        reduced = hpcred.reduce(model, damping=damping, **keywords)
        return reduced, time.process_time() - start

    poles = dense.states.modes[0]
    poles = poles[(poles.imag > 0) & (poles.imag < 2.02 * np.pi * band[1])]
    near = np.outer(np.abs(poles.real), BESIDE) + poles.imag[:, None]
    f = np.unique(np.concatenate([np.linspace(*band, UNIFORM), near.ravel() / (2 * np.pi)]))
    f = f[(f >= band[0]) & (f <= band[1]) & ((f > 0) | (not Cv.any()))]
    reduced = []
    for tolerance in TOLERANCES:
        try:
            reduced.append(processor(tolerance=tolerance, band=band))
        except hpcred.InputError as error:  # a mass matrix whose round-off is above the tolerance
            print(f"{name}, {tolerance:g}: {error}", file=sys.stderr)
    measure = reduced[-1][0].record.accuracy.measure

    def scale(f):
        """What errors count by, (S, r, p): velocities are measured as displacements are."""
        zero = np.zeros_like(dense.C)
        shown, drive = (replace(dense, C=C, Cv=Cv).response(f)
                        for C, Cv in ((dense.C + dense.Cv, zero), (dense.B.T, 0 * dense.B.T)))  # fmt: skip
        h, g = measure.scales(shown, np.einsum("fii->fi", drive))
        return np.where(Cv.any(axis=1), np.abs(2 * np.pi * f)[:, None], 1.0)[:, :, None] * h[:, :, None] * g[:, None, :]

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

    for found in reduced:
        note(HPCRED, *found)
    if not np.array_equal(C, B.T) and not Cv.any():
        for count in range(1, 9):
            points = [hpcred.Krylov((i + 0.5) * band[1] / count, 0) for i in range(count)]
            note(TWO_SIDED, *processor(basis=points, projection="two_sided", allow_unstable=True))
    reached = {eps: [run["size"] for run in runs if run["method"] == HPCRED and run["eps"] <= eps] for eps in EPS}
    if not all(reached.values()):
        sys.exit(f"{name}: hpcred is not within {EPS} of the reference, which is {away:.1e} from sparse solves: {runs}")
    sizes = sorted({min(found) for found in reached.values()})
    np.savez("reference.npz", frequencies=f, response=H, scale=scales, sizes=sizes, band=band)
    saved = {key: getattr(dense, key) for key in ("M", "D", "K", "B", "C", "Cv")}
    np.savez("dense.npz", seconds=seconds, **saved)
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
    """Yield the runs of a model, after hpcred and after each script of peers."""
    with workspace() as folder:
        found = job(1, folder, "--reference", name, *([data] if data else []))
        yield found
        for script in ("dense_rivals.py", "pymor_rivals.py"):
            found["runs"] += rivals(script, folder)
            yield found


def group_of(method):
    """What a method is called in the table, where kinds of one method are together."""
    for kind in ("position-velocity", "free velocity", "position", "velocity"):
        method = method.removesuffix(f" {kind}")
    return method


def least(runs, eps):
    """The smallest run of each group that has an error, by group; unstable models only where there is no other."""
    found = {}
    for run in sorted(runs, key=lambda run: (bool(run["unstable"]), run["size"], run["seconds"])):
        if run["eps"] <= eps:
            found.setdefault(group_of(run["method"]), run)
    return found


def sized(run):
    return "no" if run is None else f"{run['size']}{'*' if run['unstable'] else ''}"


def rows_of(name, found):
    """Rows of a model: for each error and method the size, the seconds, and the error at the size of hpcred."""
    rows = []
    for eps in EPS:
        best = least(found["runs"], eps)
        ours = best[HPCRED]["size"]
        stable = [run["size"] for group, run in best.items() if group != HPCRED and not run["unstable"]]
        for group in dict.fromkeys(group_of(run["method"]) for run in found["runs"]):
            same = [run for run in found["runs"] if group_of(run["method"]) == group and run["size"] == ours]
            run = best.get(group)
            rows.append({
                "model": name, "dofs": found["dofs"], "error": eps, "method": group, "size": sized(run),
                "seconds": run["seconds"] if run else "-",
                "error at the size of hpcred": min(run["eps"] for run in same) if same else "-",
                "hpcred / best": ours / min(stable, default=ours), "reference": found["reference"],
            })  # fmt: skip
    return rows


def overview(runs):
    """A table in Markdown: sizes for both errors, seconds, and the error at the size of hpcred."""
    rows = {(row["model"], row["method"], row["error"]): row for name in runs for row in rows_of(name, runs[name])}
    groups = list(dict.fromkeys(key[1] for key in rows))
    lines = ["| method | " + " | ".join(runs) + " |", "| --- |" + " --- |" * len(runs)]
    for group in groups:
        cells = [group]
        for name in runs:
            loose, close = (rows.get((name, group, eps)) for eps in EPS)
            if loose is None:
                cells.append("-")
                continue
            seconds, equal = close["seconds"], close["error at the size of hpcred"]
            cells.append(f"{loose['size']} / {close['size']}"
                         + (f", {seconds:.2g} s" if seconds != "-" else "")
                         + (f", {equal:.0e}" if equal != "-" else ""))  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    ratios = [" / ".join(format(rows[name, HPCRED, eps]["hpcred / best"], ".2f") for eps in EPS) for name in runs]
    return "\n".join([*lines, "| hpcred / best | " + " | ".join(ratios) + " |"])


def draw(path, runs):
    """The error over the size, a panel a model; of several kinds of a method the best at each size."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    groups = list(dict.fromkeys(group_of(run["method"]) for found in runs.values() for run in found["runs"]))
    lines = (len(runs) + 3) // 3
    figure, axes = plt.subplots(lines, 3, figsize=(11, 3.2 * lines), squeeze=False, layout="constrained")
    axes = axes.ravel()
    for panel in axes[len(runs) :]:
        panel.axis("off")
    for panel, (name, found) in zip(axes, runs.items(), strict=False):
        for number, group in enumerate(groups):
            best = {}
            for run in found["runs"]:
                if group_of(run["method"]) == group and not run["unstable"]:
                    best[run["size"]] = min(best.get(run["size"], run["eps"]), run["eps"])
            if best:
                mark = "os^vd<>xP*+hp"[number % 13]
                panel.semilogy(*zip(*sorted(best.items()), strict=True), f"-{mark}", color=f"C{number % 10}",
                               label=group, markersize=4, linewidth=2.5 if group == HPCRED else 0.8)  # fmt: skip
        ours = max(run["size"] for run in found["runs"] if run["method"] == HPCRED)
        panel.set(xlabel="coordinates", ylabel="error", title=name, ylim=(1e-6, 10.0), xlim=(0, 2.2 * ours))
        panel.grid(alpha=0.3)
    labelled = {label: line for panel in axes for line, label in zip(*panel.get_legend_handles_labels(), strict=True)}
    axes[len(runs)].legend(labelled.values(), labelled.keys(), loc="center left", frameon=False, fontsize="small")
    figure.savefig(path, dpi=130)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("HPCRED_SHARED_DATA"))
    parser.add_argument("--figure", default="rivals.png")
    parser.add_argument("models", nargs="*", choices=[[], *OWN, *PUBLISHED], default=[])
    given = parser.parse_args()
    runs = {}
    for name in given.models or (*OWN, *PUBLISHED):
        try:
            for found in measured(name, given.data):  # what is known when a run is broken off
                runs[name] = found
                Path("rivals_runs.json").write_text(json.dumps(runs, indent=1) + "\n")
        except subprocess.CalledProcessError as error:
            print(f"{name}: left out ({error})", file=sys.stderr)
    draw(given.figure, runs)
    finish("rivals", [row for name, found in runs.items() for row in rows_of(name, found)])
    print(f"\nsize for {EPS[0]:g} / for {EPS[1]:g}, seconds for that, error at the size of hpcred for {EPS[1]:g}\n")
    print(overview(runs))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--reference"]:
        reference(sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    else:
        main()
