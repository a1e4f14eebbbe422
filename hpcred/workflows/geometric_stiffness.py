"""Make the geometric stiffness that a job asks for: of hpcred's own stresses, or of files of the program."""

from __future__ import annotations

import numpy as np

from ..body.geometric_stiffness import GeometricStiffness
from ..body.loaded_states import (
    LoadedState,
    require_axial,
    require_state,
    stiffness_of_difference,
    stiffness_of_stress,
    stiffness_of_stresses,
)
from ..body.unit_states import geometric_stiffness, require_stresses
from ..files.hdf5 import kind_of_file
from ..files.model_file import FORMAT as MODEL
from ..files.model_file import read_model
from ..files.text import require_file
from ..model.units import in_si, units_of
from ..parallel.failures import InputError, agreed


def check_geometric_stiffness(job, model) -> list[str]:
    """Refuse what a job asks for and the model does not have, before the reduction; returns warnings of elements that
    are missing. Collective. Raises InputError."""
    warnings = []
    if job.geometric_stiffness and job.projection == "two_sided" and model.Ct is not None:
        raise InputError(
            "geometric_stiffness: a two-sided projection has no displacements of second order; leave it out, or "
            "reduce with projection = 'one_sided'"
        )
    if job.geometric_stiffness is True:
        warnings = require_stresses(model).warnings()
    for loaded in job.loaded_states:
        require_state(model, loaded.state)
        with agreed(model.comm):
            for name in (loaded.stresses, loaded.file, loaded.opposite):
                if name is not None:
                    require_file(name)
            of_stress = _is_of_stress(loaded)
        if loaded.file is not None and loaded.matrix is None and not of_stress:
            require_axial(model, loaded.state)
    return warnings


def geometric_stiffness_of_job(job, model, reduced) -> GeometricStiffness | None:
    """Return the geometric stiffness of a reduced model, None where the job does not ask for it. Collective. Raises
    InputError."""
    if job.geometric_stiffness is True:
        return geometric_stiffness(model, reduced.columns, job.frame, origin=job.body_origin, factoring=job.factoring)
    if not job.geometric_stiffness:
        return None
    matrices = [_matrix(loaded, model, reduced.columns) for loaded in job.loaded_states]
    states = tuple(loaded.state for loaded in job.loaded_states)
    return GeometricStiffness(states, np.array(matrices), np.array(job.body_origin))


def _matrix(loaded: LoadedState, model, columns) -> np.ndarray:
    """Return the stiffness of a unit of a state by its files. Collective."""
    units = units_of(loaded.units or model.converted_from or "SI")
    if loaded.stresses is not None:
        from ..readers.stresses.calculix_dat import read_points  # as other readers, loaded when it is used

        element, point, stress = read_points(loaded.stresses, model.comm)
        stress = stress * (units.mass / units.length / units.time**2)
        return stiffness_of_stresses(model, columns, element, point, stress, loaded.stresses) / loaded.value
    with agreed(model.comm):
        of_stress = _is_of_stress(loaded)
    if of_stress:
        return _of_stress(loaded, units, model, columns) / loaded.value
    others = [name and _loaded(name, units, loaded, model.comm) for name in (loaded.file, loaded.opposite)]
    return stiffness_of_difference(model, columns, loaded, *others) / loaded.value


def _is_of_stress(loaded) -> bool:
    """Test whether the file of a state has the stiffness of its stress. Raises InputError."""
    from ..readers.ansys.full import has_stress_stiffness

    if loaded.file is None or not has_stress_stiffness(loaded.file):
        return False
    if loaded.opposite is not None:
        raise InputError(f"geometric_stiffness.opposite: {loaded.file} has the stiffness of the stress, which needs "
                         "none; leave it out")  # fmt: skip
    return True


def _of_stress(loaded, units, model, columns) -> np.ndarray:
    """Return the stiffness of the stress of a state in a file of a buckling analysis. Collective."""
    from ..readers.ansys.full import BUCKLING, read_parts
    from ..readers.assembly import assemble

    parts = read_parts(loaded.file, model.comm, BUCKLING)
    matrices = parts.matrices  # of which M may be anything, and is refused as a mass
    matrices["K"], matrices["M"] = matrices["M"], matrices["K"]
    with assemble(parts, model.comm, loaded.file) as read, in_si(read, units) as other:
        elastic = other.M.copy()
        elastic.scale(units.time**-2)  # it was converted as a mass
        return stiffness_of_stress(model, columns, loaded, other, elastic)


def _loaded(name, units, loaded, comm):
    """Return the model of a file of a LoadedState in SI, with K of its name, or its own. Collective."""
    kind, matrix, system = None, loaded.matrix, loaded.units
    with agreed(comm):
        kind = kind_of_file(name)
    if kind == MODEL:
        if matrix:
            raise InputError(f"geometric_stiffness.matrix: {name} is a model of hpcred, whose K has no other name")
        if system and units_of(system) != units_of("SI"):
            raise InputError(f"geometric_stiffness.units: {name} is a model of hpcred, which is in SI; leave units out")
        return read_model(name, comm)
    from ..readers.model_source import load_export  # which loads the readers of all formats

    with load_export(name, comm, variables={"K": matrix} if matrix else None) as model:
        return in_si(model, units)
