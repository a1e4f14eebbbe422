"""Reduced flexible bodies by moment matching, in parallel.

The names of __init__.pyi and of the public modules that it lists are the public interface; the command line uses
nothing else of hpcred. A name is imported when it is first used, and PETSc when something is computed, so that
`hpcred.start("complex")` can choose the build before.
"""

import os

from .public_names import attached

# One thread a rank: ranks are the parallelism, and threads of BLAS would share their cores. HDF5 has no use for
# file locks on parallel file systems. Both must be known before numpy and h5py are imported.
for _name, _value in {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "H5PY_ALWAYS_USE_MPI": "1",
    "HDF5_USE_FILE_LOCKING": "FALSE",
}.items():
    os.environ.setdefault(_name, _value)

_OF_PLACES = {  # names that were those of hpcred in the version before
    "analysis": "Bore Campbell Check CriticalSpeed DampedModes FullPoles FullResponse NaturalModes error_integral",
    "assembly": "BushingJoint MachineBody PointMass RigidJoint Turn",
    "body": "Body FloatingFrame GeometricStiffness LoadedState Preload StressModes body_of von_mises",
    "fe": "ElementProperties Material",
    "files": "Responses Result read_campbell read_responses write_campbell write_responses",
    "laws": "Fractional FractionalKelvinVoigt Hysteretic Maxwell",
    "loads": "Centrifugal DeckLoad GivenLoad Gravity LineLoad LoadColumn MovingLoad Pressure Temperature Traction",
    "model": "InterfaceNode Units in_si units_of",
    "outputs": "CutOutput MotionOutput StressOutput",
    "readers": "Parts Reader load_export load_source read_load",
    "reduction": (
        "Accuracy Component ConstraintModes FixedInterfaceModes Guyan Limits Measure ParameterAccuracy "
        "ParameterPoint ParametricReducedModel Record ReducedTerm Reductor ResidualAttachment"
    ),
    "settings": "Job Source read_job",
    "simulation": (
        "Bushing ConstantDrive ConstantForce ConstantLoad ConstantMoment Joint LineSpring Motion RampDrive "
        "SineDrive SineForce SineLoad SineMoment TableDrive TableForce TableLoad TableMoment"
    ),
    "workflows": (
        "Assembly add_stresses check_result compare_results estimate_of_result export_reduced inspect_file "
        "installation list_formats mass_in_words plot_campbell plot_modes plot_response prune_store "
        "tables_of_modes verify_file write_deck write_script"
    ),
    "writers": "ExportSource Writer read_sid write_fmu write_sid",
}
_MOVED = {name: f"{place}.{name}" for place, names in _OF_PLACES.items() for name in names.split()} | {
    "check": "inspect",
    "bores_of_file": "bores", "collect_sweep": "collect", "describe_file": "info", "evaluate_result": "evaluate",
    "export_result": "export", "list_store": "store", "modes_of_file": "modes", "plan_file": "plan",
    "reproduce": "paper", "response_file": "response", "run_demo": "demo", "run_sweep": "sweep",
    "write_example": "example",
}
__getattr__, __dir__, __all__ = attached(__name__, __file__, _MOVED)
