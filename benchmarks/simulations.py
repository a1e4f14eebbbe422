"""Simulations in time beside Exudyn: processor seconds at the same accuracy, of one run.

usage: python benchmarks/simulations.py [pendulum] [crank]; Exudyn is in the environment of the peers.

`pendulum`: a soft bar of 26 coordinates, undamped, falls from the horizontal on a hinge, so that its weight sets it
vibrating at once. `crank`: the rod of the tutorial turns on its big bearing at 3,000 rpm, damped. Both programs move
the same reduced body, each in several steps or tolerances. The error is the largest distance of the tip from where a
much finer simulation has it, over the largest distance that it moves; each program has a reference of its own, and how
far these are apart is in the table. Exudyn's seconds at an error of hpcred's are interpolated.
"""

import argparse
import json
import subprocess
import time
from pathlib import Path

import numpy as np
from common import ENVIRONMENT, HERE, PEER_PYTHON, finish, workspace

import hpcred
from hpcred import Buckens, Interface, Modes, Nodes, Rayleigh, Simulation, StaticCorrection
from hpcred.simulation import Joint

TOLERANCES = 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7  # relative ones; absolute ones are a thousandth
OUTPUTS = 200


def ends(low, high):
    """Return interfaces "left" and "right" on the faces of a block in x."""
    return [Interface(name=name, nodes=Nodes(box=((x - 1e-6, -1, -1), (x + 1e-6, 1, 1))))
            for name, x in (("left", low), ("right", high))]  # fmt: skip


def pendulum(folder):
    """Write result.h5 of the soft bar; return its motion."""
    with (
        hpcred.solid((60, 2, 2), size=(1.0, 0.01, 0.01), clamped=False, young=2e9, poisson=0.3, density=1200.0) as bare,
        bare.with_interfaces(ends(0.0, 1.0)) as plain, plain.with_inputs(["left", "right"]) as model,
        hpcred.reduce(model, [Modes(count=14), StaticCorrection()], Buckens()) as rom,
    ):  # fmt: skip
        hpcred.write_result(folder / "result.h5", rom, model)
    return {"hinge": "left", "tip": "right", "axis": (0.0, 0.0, 1.0), "end": 1.0, "gravity": (0.0, -9.81, 0.0),
            "turning": (0.0, 0.0, 0.0), "steps": (2500, 5000, 10_000, 20_000), "fine": 160_000,
            "damp_above": (20.0, 100.0)}  # fmt: skip


def crank(folder):
    """Write result.h5 of the rod; return its motion."""
    bearings = [Interface(name=name, nodes=Nodes(set=nodes)) for name, nodes in (("left", "BIG_EYE"),
                                                                                ("right", "SMALL_EYE"))]  # fmt: skip
    with (
        hpcred.crank(3000) as bare, bare.with_interfaces(bearings) as plain,
        plain.with_inputs(["left", "right"]) as model,
        hpcred.reduce(model, tolerance=1e-3, band=(0.0, 4000.0), frame=Buckens(), damping=Rayleigh(20.0, 1e-6)) as rom,
    ):  # fmt: skip
        hpcred.write_result(folder / "result.h5", rom, model)
    return {"hinge": "left", "tip": "right", "axis": (0.0, 1.0, 0.0), "end": 0.04, "gravity": (0.0, 0.0, -9.81),
            "turning": (0.0, 314.159265, 0.0), "steps": (1000, 2000, 4000, 8000), "fine": 64_000,
            "damp_above": (1000.0, 4000.0)}  # fmt: skip


def ours(folder, case):
    """Return settings, processor seconds and places of the tip of each simulation, the finest last."""
    result = hpcred.read_result(folder / "result.h5")
    body = result.body(["left", "right"])
    place = next(shape for shape in body.nodes if shape.name == case["hinge"]).position - body.floating_frame.origin
    setup = {
        "end": case["end"], "steps": OUTPUTS, "gravity": case["gravity"], "angular_velocity": case["turning"],
        "velocity": tuple(np.cross(case["turning"], -place).tolist()),
        "constraint": (Joint(case["hinge"], kind="revolute", axis=case["axis"]),), "observe": (case["tip"],),
    }  # fmt: skip
    own = [{"damp_above": frequency} for frequency in case["damp_above"]]
    own += [{"relative_tolerance": value, "absolute_tolerance": 1e-3 * value} for value in TOLERANCES]
    found = []
    for settings in own:
        begun = time.process_time()
        motion = hpcred.simulate(body, Simulation(**settings, **setup))
        seconds = time.process_time() - begun
        tip, (key, value) = motion.node_position[:, motion.node_names.index(case["tip"])], next(iter(settings.items()))
        found.append({"setting": f"{key} {value:g}", "seconds": seconds, "tip": tip})
    return found


def theirs(folder, case):
    """Return processor seconds, steps and places of the tip of each simulation by Exudyn, the finest last."""
    hpcred.export(folder / "result.h5", "exudyn", folder / "body.npz")
    free = np.flatnonzero(case["axis"])[0]
    given = {key: case[key] for key in ("hinge", "tip", "end", "gravity", "turning")}
    given |= {"outputs": OUTPUTS, "axes": [1] * 3 + [int(k != free) for k in range(3)],
              "steps": [*case["steps"], case["fine"]]}  # fmt: skip
    command = [PEER_PYTHON, str(HERE / "peers/exudyn_motion.py"), str(folder / "body.npz"), json.dumps(given)]
    run = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT)
    return json.loads(run.stdout.strip().splitlines()[-1])


def measured(name, folder):
    """Return the lines of both programs for one motion."""
    case = CASES[name](folder)
    runs = {"hpcred": ours(folder, case), "exudyn": theirs(folder, case)}
    places = {program: [np.array(run.pop("tip")) for run in found] for program, found in runs.items()}
    finest = places["hpcred"][-1]
    way = np.abs(finest - finest[0]).max()
    for program, found in runs.items():
        for run, tip in zip(found, places[program], strict=True):
            run["error"] = float(np.abs(tip - places[program][-1]).max() / way)
    apart = float(np.abs(places["exudyn"][-1] - finest).max() / way)
    # Exudyn's seconds at the same error: a straight line through the logarithms
    errors, seconds = (np.log([run[key] for run in runs["exudyn"][:-1]]) for key in ("error", "seconds"))
    for run in runs["hpcred"][:-1]:
        at = np.log(run["error"])
        slope, level = np.polyfit(errors, seconds, 1)
        run["exudyn_seconds"] = float(np.exp(np.polyval([slope, level], at)))
    return {"case": name, "way": float(way), "references_apart": apart, **runs}


def rows_of(found):
    """Return a row for each setting of hpcred, for the table of evidence."""
    return [{"case": found["case"], "settings": run["setting"], "error": run["error"], "seconds": run["seconds"],
             "Exudyn at this error (s)": run["exudyn_seconds"], "references apart": found["references_apart"]}
            for run in found["hpcred"][:-1]]  # fmt: skip


CASES = {"pendulum": pendulum, "crank": crank}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="case")
    results = []
    for name in parser.parse_args().cases:
        with workspace() as place:
            results += rows_of(measured(name, Path(place)))
    finish("simulations", results)
