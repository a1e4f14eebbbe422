"""Move a body on a hinge in Exudyn by its generalised-alpha method.

usage: python exudyn_motion.py FILE.npz CASE, a JSON object with hinge, tip (names), axes (six of 0 and 1 that the hinge
holds), end, outputs, steps (a list), gravity, turning (rad/s); prints processor seconds and places of the tip of each.
"""

import json
import sys
import time

import exudyn
import numpy as np
from exudyn import itemInterface as items
from exudyn.FEM import ObjectFFRFreducedOrderInterface

path, case = sys.argv[1], json.loads(sys.argv[2])
file, interface = np.load(path), ObjectFFRFreducedOrderInterface()
interface.LoadFromFile(path)
names, places = file["names"].tolist(), file["xRef"].reshape(-1, 3)
hinge, tip = (names.index(case[key]) for key in ("hinge", "tip"))
omega = np.array(case["turning"])


def moved(steps):
    """Return processor seconds and the places of the tip (outputs + 1, 3) by so many steps."""
    mbs = exudyn.SystemContainer().AddSystem()
    body = interface.AddObjectFFRFreducedOrder(
        mbs, positionRef=[0, 0, 0], gravity=case["gravity"], initialAngularVelocity=omega.tolist(),
        initialVelocity=np.cross(omega, -places[hinge]).tolist(),
    )["oFFRFreducedOrder"]  # fmt: skip
    mbs.SetObjectParameter(body, "dampingMatrixReduced", exudyn.MatrixContainer(file["dampingMatrixReduced"]))
    ground = mbs.AddObject(items.ObjectGround())
    bearing = mbs.AddMarker(items.MarkerSuperElementRigid(
        bodyNumber=body, meshNodeNumbers=file["markerNodes"][hinge].tolist(), weightingFactors=[0.25] * 4,
        useAlternativeApproach=True, rotationsExponentialMap=2,
    ))  # fmt: skip
    support = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=ground, localPosition=places[hinge].tolist()))
    mbs.AddObject(items.GenericJoint(markerNumbers=[support, bearing], constrainedAxes=case["axes"]))
    position = exudyn.OutputVariableType.Position
    sensor = mbs.AddSensor(items.SensorSuperElement(
        bodyNumber=body, meshNodeNumber=tip, storeInternal=True, outputVariableType=position
    ))  # fmt: skip
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = steps, case["end"]
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.solution.sensors.writePeriod = case["end"] / case["outputs"]
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    settings.parallel.numberOfThreads = 1
    begun = time.process_time()
    mbs.SolveDynamic(settings)
    seconds = time.process_time() - begun
    return {"steps": steps, "seconds": seconds, "tip": mbs.GetSensorStoredData(sensor)[:, 1:].tolist()}


found = [moved(steps) for steps in case["steps"]]
print(json.dumps(found))
