"""The first frequency of the blade over its speed, and its stress at the last one, against CalculiX."""

import re
from pathlib import Path

import calculix
import h5py

import hpcred

result = hpcred.read_result("blade.h5")
for speed in (1, 200, 400):
    calculix.run("speed", Path("spin.inp").read_text().replace("160000.", f"{speed**2}."))
    theirs = float(re.search(r"^ +1 +\S+ +\S+ +(\S+)", Path("speed.dat").read_text(), re.M)[1])
    ours = result.at_preload(hpcred.body.Preload(omega=(0.0, 0.0, speed))).reduced.frequencies[0]
    print(f"{speed:3} rad/s: hpcred {ours:.3f} Hz, CalculiX {theirs:.3f} Hz, {100 * (ours / theirs - 1):.3f} %")

with h5py.File("spin_up.h5") as file:
    calculix.compare("speed", result, file["elastic"][-1])
