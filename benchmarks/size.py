"""Size and seconds for an accuracy: the automatic reduction beside modes, uniform points and pyMOR.

usage: python benchmarks/size.py [--ranks 2] [--figure size.png] [model ...]

Every method is run for growing sizes, and its largest relative error over the band is taken from full solves at uniform
frequencies and at all resonances. The table has the smallest size that reaches each accuracy, with the seconds of that
run; the figure the error over the size. pyMOR takes bodies that are held only, and SECONDS at most for each run.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from common import ENVIRONMENT, HERE, PEER_PYTHON, finish, job, workspace

EPS = (1e-2, 1e-4, 1e-6)
SECONDS = 120
UNIFORM = 150  # frequencies of the reference, beside three at each resonance
ROWS = {  # of benchmarks/adaptive.py: numbers of modes, of points with order 1 and 3, orders of SOR-IRKA
    "linkage": (range(2, 41, 2), range(1, 9), range(1, 6), range(2, 13, 2)),
    "solid": ((5, 10, 20, 30, 40, 60, 80), range(1, 7), range(1, 4), range(10, 41, 10)),
    "free": ((5, 10, 20, 30, 40, 60, 80), range(1, 7), range(1, 4), ()),
    "free-18000": ((5, 10, 20, 40, 60), range(1, 7), range(1, 4), ()),
    "plate": ((20, 40, 60, 80, 100, 120), range(4, 13, 2), range(2, 7), range(40, 101, 20)),
}
METHODS = {
    "automatic": "automatic", "modes": "modes only", "frm": "modes + frm", "order 1": "uniform points, order 1",
    "order 3": "uniform points, order 3", "irka": "pyMOR SOR-IRKA", "interpolation": "pyMOR interpolation",
}  # fmt: skip


def reference(name):
    """reference.npz with full solves, and the framed model for pyMOR where it takes it."""
    import numpy as np
    from adaptive import ROWS as MODELS
    from adaptive import frame_of, model_of

    import hpcred
    from hpcred.model.frames import apply_frame
    from hpcred.reduction.small.damping import measured_damping

    hpcred.start("complex")
    row, frame = MODELS[name], frame_of(MODELS[name])
    damping = hpcred.Rayleigh(*row.rayleigh) if row.rayleigh else hpcred.NoDamping()
    measured_with = measured_damping(damping, 1e-3, row.band)[0]
    with model_of(row) as model:
        with hpcred.reduce(model, frame=frame, damping=damping, tolerance=1e-4, band=row.band) as reduced:
            poles = reduced.frequencies[reduced.frequencies < 0.99 * row.band[1]]
        f = np.unique(np.concatenate([np.linspace(*row.band, UNIFORM), *(poles * (1 + x * 1e-3) for x in (-2, 0, 2))]))
        measured = hpcred.Structural(measured_with.eta) if measured_with.eta else damping
        full = hpcred.frequency_response(model, f, frame, measured)
        framed = apply_frame(model, frame or hpcred.NoFrame(), hpcred.NoDamping())
        if framed.rigid is None:
            hpcred.write_model("framed.h5", framed.model)
        if model.comm.rank == 0:
            np.savez("reference.npz", frequencies=f, response=full,
                     alpha=measured_with.alpha, beta=measured_with.beta, eta=measured_with.eta)  # fmt: skip
            print(json.dumps({"frequencies": len(f)}))


def ours(name):
    """What this program reaches by its own methods."""
    import numpy as np
    from adaptive import ROWS as MODELS
    from adaptive import frame_of, model_of

    import hpcred
    from hpcred import InputError, Krylov, Modes, StaticCorrection

    row, (counts, first, third, _) = MODELS[name], ROWS[name]
    frame, damping = frame_of(row), hpcred.Rayleigh(*row.rayleigh) if row.rayleigh else None
    given = np.load("reference.npz")
    f, full, eta = given["frequencies"], given["response"], float(given["eta"])

    def uniform(count, order):
        return [Krylov((i + 0.5) * row.band[1] / count, order) for i in range(count)]

    runs = [("automatic", {"tolerance": eps, "band": row.band}) for eps in EPS]
    runs += [("modes", {"basis": [Modes(count=count)]}) for count in counts]
    runs += [("frm", {"basis": [Modes(count=count), StaticCorrection()]}) for count in counts]
    runs += [("order 1", {"basis": uniform(count, 1)}) for count in first]
    runs += [("order 3", {"basis": uniform(count, 3)}) for count in third]
    found = []
    with model_of(row) as model:
        for method, keywords in runs:
            try:
                reduced = hpcred.reduce(model, frame=frame, damping=damping, **keywords)
            except InputError as error:  # more vectors than the body has
                print(error, file=sys.stderr)
                continue
            with reduced:
                damped = replace(reduced, loss_factor=eta)
                eps = hpcred.relative_error(full, hpcred.frequency_response(damped, f)).max()
                found.append({"method": method, "size": reduced.size, "seconds": reduced.record.timing.elapsed,
                              "eps": float(eps)})  # fmt: skip
        if model.comm.rank == 0:
            print(json.dumps(found))


def peer(folder, method, order):
    """A run of pyMOR, or None where it fails or takes too long."""
    command = [PEER_PYTHON, HERE / "peers/pymor_size.py", folder / "framed.h5", folder / "reference.npz", method]
    environment = {**ENVIRONMENT, **{f"{name}_NUM_THREADS": "2" for name in ("MKL", "OMP", "OPENBLAS")}}
    environment.pop("PYTHONPATH", None)
    try:
        run = subprocess.run([*map(str, command), str(order)], check=True, env=environment, timeout=SECONDS,
                             stdout=subprocess.PIPE, text=True)  # fmt: skip
    except (subprocess.SubprocessError, OSError) as error:
        print(f"pyMOR, {method} {order}: {error}", file=sys.stderr)
        return None
    return {"method": method, **json.loads(run.stdout.strip().splitlines()[-1])}


def measured(name, ranks):
    """All runs of a model."""
    with workspace() as folder:
        folder = Path(folder)
        job(ranks, folder, "--reference", name)
        runs = job(ranks, folder, "--ours", name)
        if (folder / "framed.h5").exists():
            _, first, _, orders = ROWS[name]
            tried = [("irka", order) for order in orders] + [("interpolation", count) for count in first]
            runs += [run for method, order in tried if (run := peer(folder, method, order)) is not None]
    return runs


def best(runs, method, eps):
    """Size and seconds of the smallest model of a method that reaches an accuracy."""
    good = [run for run in runs if run["method"] == method and run["eps"] <= eps]
    if not good:
        return "no" if any(run["method"] == method for run in runs) else "-"
    run = min(good, key=lambda run: (run["size"], run["seconds"]))
    return f"{run['size']} ({run['seconds']:.2g} s)"


def draw(path, runs):
    """The error over the size, a panel a model, three in a row, and the legend in the place after the last one."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    lines = len(runs) // 3 + 1
    figure, axes = plt.subplots(lines, 3, figsize=(11, 3.4 * lines), squeeze=False, layout="constrained")
    axes = axes.ravel()
    for panel in axes[len(runs) :]:
        panel.axis("off")
    styles = {method: (f"-{mark}", f"C{i}") for i, (method, mark) in enumerate(zip(METHODS, "osd^v+x", strict=True))}
    for panel, (name, found) in zip(axes, runs.items(), strict=False):
        for method, label in METHODS.items():
            points = sorted((run["size"], run["eps"]) for run in found if run["method"] == method)
            if points:
                style, colour = styles[method]
                panel.semilogy(*zip(*points, strict=True), style, color=colour, label=label, markersize=4,
                               linewidth=2 if method == "automatic" else 1)  # fmt: skip
        panel.set(xlabel="coordinates", ylabel="largest relative error", title=name, ylim=(1e-9, 30.0))
        panel.grid(alpha=0.3)
    labelled = {label: line for panel in axes for line, label in zip(*panel.get_legend_handles_labels(), strict=True)}
    axes[len(runs)].legend(labelled.values(), labelled.keys(), loc="center left", frameon=False)
    figure.savefig(path, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--figure", default="size.png")
    parser.add_argument("models", nargs="*", choices=[[], *ROWS], default=[])
    given = parser.parse_args()
    runs = {name: measured(name, given.ranks) for name in given.models or ROWS}
    Path("size_runs.json").write_text(json.dumps(runs, indent=1) + "\n")
    draw(given.figure, runs)
    finish("size", [
        {"model": name, "eps": f"{eps:g}", **{label: best(found, method, eps) for method, label in METHODS.items()}}
        for name, found in runs.items() for eps in EPS
    ])  # fmt: skip


if sys.argv[1:2] == ["--reference"]:
    reference(sys.argv[2])
elif sys.argv[1:2] == ["--ours"]:
    ours(sys.argv[2])
else:
    main()
