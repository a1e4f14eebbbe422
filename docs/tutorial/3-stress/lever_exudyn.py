"""The lever in Exudyn: held at its big bearing, under the pulse of pressure."""

import exudyn
import numpy as np
from exudyn.FEM import ObjectFFRFreducedOrderInterface
from exudyn.itemInterface import GenericJoint, MarkerBodyRigid, MarkerSuperElementRigid, ObjectGround
from exudyn.rigidBodyUtilities import EulerParameters2GLocal, EulerParameters2RotationMatrix

file, mbs = np.load("lever_exudyn.npz"), exudyn.SystemContainer().AddSystem()
interface = ObjectFFRFreducedOrderInterface()
interface.LoadFromFile("lever_exudyn.npz")
body = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0])["oFFRFreducedOrder"]
mbs.SetObjectParameter(body, "dampingMatrixReduced", exudyn.MatrixContainer(file["dampingMatrixReduced"]))
big = file["markerNodes"][list(file["names"]).index("big")].tolist()
held = mbs.AddMarker(MarkerSuperElementRigid(bodyNumber=body, meshNodeNumbers=big, weightingFactors=[0.25] * 4))
ground = mbs.AddMarker(MarkerBodyRigid(bodyNumber=mbs.AddObject(ObjectGround())))
mbs.AddObject(GenericJoint(markerNumbers=[ground, held]))

k = list(file["inputNames"]).index("pressure")
force, moment = np.split(file["inputResultants"][k], 2)


def pulse(mbs, t, item, q, q_t):
    p = q[3:7] + np.array([1.0, 0.0, 0.0, 0.0])  # Euler parameters
    turned = EulerParameters2RotationMatrix(p) @ force, EulerParameters2GLocal(p).T @ moment
    return np.interp(t, [0, 0.001, 0.002], [0, 1, 0]) * np.concatenate([*turned, file["inputMatrixReduced"][:, k]])


mbs.SetObjectParameter(body, "forceUserFunction", pulse)
mbs.Assemble()
settings = exudyn.SimulationSettings()
settings.timeIntegration.endTime, settings.timeIntegration.numberOfSteps = 0.01, 1000
settings.solution.file.writePeriod = 5e-5
mbs.SolveDynamic(settings)
