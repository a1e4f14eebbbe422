"""The machine on other mounts: frequencies, and how far the tool gives way, for four stiffnesses of its feet."""

import time
from dataclasses import replace

import numpy as np

import hpcred
from hpcred.settings.machine_file import read_machine

job = read_machine("machine.toml")
f = np.linspace(1.0, 400.0, 2000)
for factor in (0.5, 1.0, 2.0, 4.0):
    start, joints = time.process_time(), []
    for joint in job.joint:
        of_feet = "ground" in joint.bodies
        joints.append(replace(joint, stiffness=tuple(factor * k for k in joint.stiffness)) if of_feet else joint)
    machine = hpcred.assemble(job.body, joints, band=job.band, inputs=["spindle.tool:y"], outputs=["spindle.tool:y"])
    H = np.abs(machine.frequency_response(f)[:, 0, 0])
    modes = ", ".join(f"{value:.1f}" for value in machine.reduced.frequencies[:3])
    print(
        f"feet x {factor}: {modes} Hz, at most {H.max():.2e} m/N at {f[H.argmax()]:.0f} Hz, "
        f"error about {machine.accuracy.largest:.0e}, {time.process_time() - start:.1f} s of processor time"
    )
