"""List the exports by the words for --format; a suffix that several have means the first.

To add a format, write a Writer (see base), and put its address below.
"""

from ..parallel.plugins import Registry

WRITERS = Registry("writers.base:Writer", "hpcred.writers", {
    "sid": "writers.sid:SidFile",
    "matlab": "writers.arrays:BodyMat",
    "npz": "writers.arrays:BodyNpz",
    "exudyn": "writers.exudyn:Exudyn",
    "mbdyn": "writers.mbdyn:MbdynFile",
    "statespace-mat": "writers.state_space:StateSpaceMat",
    "statespace-npz": "writers.state_space:StateSpaceNpz",
    "fmu": "writers.fmu:Fmu",
    "vtk": "writers.vtk:VtkFile",
    "uff": "writers.uff:UffFile",
    "png": "report.mode_pictures:Picture",
    "svg": "report.mode_pictures:Picture",
    "pdf": "report.mode_pictures:Picture",
    "gif": "report.mode_pictures:Picture",
    "webp": "report.mode_pictures:Picture",
    "nastran": "writers.nastran:DmigCards",
    "nastran-op4": "writers.nastran:ExternalOp4",
    "ansys": "writers.ansys:Matrix50",
    "abaqus": "writers.abaqus:UserElement",
    "simscape": "writers.simscape:FlexibleSolid",
    "openfast": "writers.openfast:ExtPtfm",
    "mbsim": "writers.mbsim:MbsimFile",
})  # fmt: skip
PROGRAMS = {"simpack": "sid", "simulink": "fmu", "dymola": "fmu", "paraview": "vtk"}  # names of formats too
