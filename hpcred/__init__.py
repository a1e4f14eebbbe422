"""Reduced flexible bodies by moment matching, in parallel.

The names below are the public interface; the command line uses nothing else. PETSc is imported when the first of
them is used, so that `hpcred.start("complex")` can choose the build before.
"""

from importlib import import_module

from .errors import ComputationError, InputError
from .runtime import start

_PUBLIC = {
    "SecondOrderModel": "model.model",
    "Dofs": "model.dofs",
    "Tangent": "model.frame",
    "Chord": "model.frame",
    "Buckens": "model.frame",
    "Rayleigh": "model.damping",
    "GivenDamping": "model.damping",
    "Caughey": "model.damping",
    "ModalDamping": "model.damping",
    "Structural": "model.damping",
    "Modes": "reduction.modes",
    "Krylov": "reduction.krylov",
    "SecondOrderKrylov": "reduction.second_order",
    "StaticCorrection": "reduction.krylov",
    "SolverOptions": "linalg.mumps",
    "reduce": "reduction.reduce",
    "ReducedModel": "rom",
    "frequency_response": "analysis.response",
    "relative_error": "analysis.error",
    "error_integral": "analysis.error",
    "read_model": "formats.model_file",
    "write_model": "formats.model_file",
    "read_result": "formats.result_file",
    "write_result": "formats.result_file",
    "convert": "formats.convert",
    "inspect": "analysis.inspect",
    "FloatingFrame": "multibody.floating_frame",
    "floating_frame": "multibody.floating_frame",
    "node_shapes": "multibody.shapes",
    "Body": "multibody.export",
    "read_body": "multibody.export",
    "export_result": "multibody.export",
    "read_sid": "multibody.sid",
    "write_sid": "multibody.sid",
    "Simulation": "multibody.simulation",
    "ConstantForce": "multibody.simulation",
    "SineForce": "multibody.simulation",
    "TableForce": "multibody.simulation",
    "Joint": "multibody.simulation",
    "simulate": "multibody.simulation",
    "linkage": "examples.linkage",
    "solid": "examples.solid",
    "Progress": "progress",
}

__all__ = ["ComputationError", "InputError", "start", *_PUBLIC]


def __getattr__(name):
    if name in _PUBLIC:
        return getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
    raise AttributeError(f"module 'hpcred' has no attribute '{name}'")


def __dir__():
    return __all__
