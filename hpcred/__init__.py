"""Reduced flexible bodies by moment matching, in parallel.

The names below are the public interface; the command line uses nothing else. PETSc is imported when the first of
them is used, so that `hpcred.start("complex")` can choose the build before.
"""

from importlib import import_module

from .parallel.failures import ComputationError, InputError
from .parallel.startup import start

_PUBLIC = {
    "SecondOrderModel": "model.second_order_model",
    "Dofs": "model.dofs",
    "Tangent": "model.frames",
    "Chord": "model.frames",
    "Buckens": "model.frames",
    "Rayleigh": "model.damping",
    "GivenDamping": "model.damping",
    "Caughey": "model.damping",
    "ModalDamping": "model.damping",
    "Structural": "model.damping",
    "Modes": "reduction.modes",
    "Krylov": "reduction.krylov",
    "SecondOrderKrylov": "reduction.second_order_krylov",
    "StaticCorrection": "reduction.krylov",
    "SolverOptions": "linalg.factorisation",
    "reduce": "reduction.reduce",
    "ReducedModel": "reduction.reduced_model",
    "frequency_response": "analysis.frequency_response",
    "relative_error": "analysis.error",
    "error_integral": "analysis.error",
    "read_model": "formats.model_file",
    "write_model": "formats.model_file",
    "read_result": "formats.result_file",
    "write_result": "formats.result_file",
    "convert": "workflows.convert",
    "inspect": "analysis.summary",
    "FloatingFrame": "multibody.floating_frame",
    "floating_frame": "multibody.floating_frame",
    "node_shapes": "multibody.node_shapes",
    "Body": "workflows.export",
    "read_body": "workflows.export",
    "export_result": "workflows.export",
    "read_sid": "formats.sid",
    "write_sid": "formats.sid",
    "Simulation": "multibody.simulation",
    "ConstantForce": "multibody.simulation",
    "SineForce": "multibody.simulation",
    "TableForce": "multibody.simulation",
    "Joint": "multibody.simulation",
    "simulate": "multibody.simulation",
    "linkage": "examples.linkage",
    "solid": "examples.solid",
    "Progress": "parallel.progress",
}

__all__ = ["ComputationError", "InputError", "start", *_PUBLIC]


def __getattr__(name):
    if name in _PUBLIC:
        return getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
    raise AttributeError(f"module 'hpcred' has no attribute '{name}'")


def __dir__():
    return __all__
