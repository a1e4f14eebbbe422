"""Convert a model of pyMOR.

Where pyMOR is imported under mpiexec, it keeps all ranks but the first for itself, unless its default says not to.
"""

from __future__ import annotations

import sys
from typing import Any

from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from .second_order_model import SecondOrderModel


def from_pymor(
    model: Any,
    mu: Any = None,
    *,
    name: str = "",
    **labels: Any,
) -> SecondOrderModel:
    """Return the model of pymor.models.iosys.SecondOrderModel, M q'' + E q' + K q = B u, y = Cp q + Cv q'. Collective.

    Parameters
    ----------
    model : pymor.models.iosys.SecondOrderModel
        The same on all ranks, of operators that pyMOR can turn into matrices.
    mu : dict or pymor.parameters.base.Mu, optional
        Values of its parameters, such as {"omega": 300.0}.
    name : str, optional
        By default that of the model in pyMOR.
    **labels
        Further keywords of SecondOrderModel: dofs, names of inputs and outputs, comm, what is known of K.

    Raises
    ------
    InputError
        For other models, discrete time, outputs D u, values that do not fit the parameters, matrices that
        SecondOrderModel refuses, and if pyMOR keeps the other ranks in its event loop.
    """
    if not all(hasattr(model, key) for key in ("M", "E", "K", "B", "Cp", "Cv", "to_matrices")):
        raise InputError(f"from_pymor: found {type(model).__name__}, expected a SecondOrderModel of pyMOR")
    refuse_event_loop("from_pymor")
    name = name or model.name
    if model.sampling_time:
        raise InputError(f"{name}: found discrete time in steps of {model.sampling_time:g} s, expected continuous time")
    if model.parameters and mu is None:
        raise InputError(f"{name}: found parameters {', '.join(model.parameters)}, expected their values in `mu`")
    try:
        M, E, K, B, Cp, Cv, D = model.to_matrices(model.parameters.parse(mu))
    except ValueError as error:
        raise InputError(f"{name}: mu: {error}") from error
    if D is not None and abs(D).max() > 0:
        raise InputError(f"{name}: found outputs D u, which follow the inputs at once, expected D = 0")
    damping = E if abs(E).max() > 0 else None
    return SecondOrderModel(M, damping, K, B, Cp, name=name, Cv=Cv, **labels)


def refuse_event_loop(what: str):
    """Raise InputError where pyMOR keeps, or at its import would keep, the other ranks. Not collective."""
    known = sys.modules.get("pymor.tools.mpi")
    if MPI.COMM_WORLD.size > 1 and (known is None or known.event_loop_settings()["auto_launch"]):
        raise InputError(f"{what}: found {MPI.COMM_WORLD.size} ranks, of which pyMOR takes all but the first when it "
                         "is imported; start one, or turn pymor.tools.mpi.event_loop_settings.auto_launch off in "
                         "pymor_defaults.py and import pymor first")  # fmt: skip
