"""The main job: a model, a frame, a damping law and a list of basis ingredients enter, a reduced model leaves."""

import numpy as np

from ..errors import ComputationError, InputError
from ..linalg.basis import Basis
from ..linalg.block import apply, copy_of, create_block, inner
from ..model.damping import ModalDamping, Structural, caughey_terms
from ..model.frame import apply_frame
from ..model.model import SYMMETRIC_TO
from ..progress import Progress
from ..provenance import provenance
from ..rom import ReducedModel
from .context import Context
from .projection import diagonalise, project, project_columns

ORTHONORMAL_TO = 1e-12


def reduce(model, basis, frame=None, damping=None, tolerance=1e-12, drop_above=None, progress=None) -> ReducedModel:
    """Reduce a SecondOrderModel by Galerkin projection onto the span of the ingredients. Collective.

    `basis`: list of Modes, Krylov, StaticCorrection, ...; each extends what the ones before it gave. `frame`:
    Tangent, Chord, Buckens or None; `damping`: Rayleigh, GivenDamping or None. `tolerance`: relative size of the
    new part of a vector below which it is dropped as dependent. `drop_above`: pseudo-modes above this frequency
    (Hz) are cut after the diagonalisation. The reduced model has V^T M V = I and diagonal
    V^T K V. Raises InputError or ComputationError, the same on all ranks; `model` is not changed.
    """
    progress = progress or Progress(model.comm, show=False)
    for key in ("M", "K"):
        if model.symmetry_defects[key] > SYMMETRIC_TO:
            raise InputError(
                f"{model.name}: matrix {key} is not symmetric: ||A - A^T|| / ||A|| = "
                f"{model.symmetry_defects[key]:.1e}, expected round-off (below {SYMMETRIC_TO:g})"
            )
    if model.B is None or not model.input_names:
        raise InputError(f"{model.name} has no inputs; name them by `inputs`, as dof numbers or [node, direction]")
    with progress.stage("frame"):
        framed = apply_frame(model, frame, damping)
    context = Context(framed, progress, tolerance)
    rigid = framed.rigid.count if framed.rigid is not None else 0
    vectors = Basis(framed.model.M, deflate=framed.rigid.R if rigid else None, tolerance=tolerance)
    try:
        _check_size(framed.model, basis, rigid)
        for ingredient in basis:
            ingredient.extend(vectors, context)
        if vectors.size == 0:
            raise InputError("basis: no vector is left; no mode lies in the bands and no input loads the body")
        rom, defect = _project(model, framed, vectors, context, drop_above)
        rom.provenance = provenance(model, framed, basis, frame, damping, context, progress, defect)
        return rom
    finally:
        context.close()
        vectors.close()
        framed.close()


def _law(damping, context, columns, frequencies):
    """D of the reduced model for the damping laws that have no sparse matrix."""
    if isinstance(damping, ModalDamping):
        return np.diag(4 * np.pi * frequencies * damping.at(frequencies))
    if (terms := caughey_terms(damping)) is not None:
        return _project_caughey(terms, context, columns)
    return np.zeros((len(frequencies), len(frequencies)))


def _project_caughey(terms, context, columns):
    """V^T M sum_k a_k (M^-1 K)^k V (39), by solves with M."""
    model = context.model
    context.solver.factor_mass()
    power = copy_of(columns, model.M)  # (M^-1 K)^k V
    result = terms[0] * np.eye(power.getSizes()[1])
    for coefficient in terms[1:]:
        force = create_block(model.K, power.getSizes()[1])
        apply(model.K, power, force)
        result += coefficient * inner(columns, force)
        context.solver.solve(force, power)
        force.destroy()
    power.destroy()
    return (result + result.T) / 2


def _check_size(model, basis, rigid):
    """Refuse a basis that cannot fit before anything is factored."""
    if not basis:
        raise InputError("basis: the list of ingredients is empty")
    for item in basis:
        if hasattr(item, "check"):
            item.check(model.size, rigid)
    columns = sum(item.columns(model.B.getSize()[1], rigid) for item in basis)
    if columns > model.size - rigid:
        raise InputError(
            f"basis: {columns} vectors asked for, but {model.name} has only {model.size - rigid} elastic "
            "coordinates in this frame; ask for fewer modes, points or lower orders"
        )


def _project(model, framed, vectors, context, drop_above):
    """The diagonalised reduced model with its basis in all dofs, and the orthonormality defect."""
    progress, full = context.progress, framed.model
    with progress.stage("project"):
        stiffness = project(full.K, vectors.columns)
        squares = diagonalise(vectors, stiffness)
        frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
        if drop_above is not None:
            kept = int((frequencies <= drop_above).sum())
            if kept == 0:
                raise InputError(f"drop_above: no pseudo-frequency lies below {drop_above:g} Hz")
            context.note(f"pseudo-frequencies up to {drop_above:g} Hz", len(frequencies), kept)
            vectors.turn(np.eye(len(frequencies))[:, :kept])
            frequencies, squares = frequencies[:kept], squares[:kept]
        defect = vectors.defect()
        if defect > ORTHONORMAL_TO:
            raise ComputationError(
                f"the basis has lost its orthonormality: max |V^T M V - I| = {defect:.1e}, "
                f"allowed is {ORTHONORMAL_TO:g}"
            )
        columns = vectors.columns
        small = {key: project(mat, columns) for key, mat in full.matrices.items()}
        if "D" not in small:
            small["D"] = _law(framed.damping, context, columns, frequencies)
        inputs = project_columns(columns, full.B)
        outputs = inputs if full.Ct is None else project_columns(columns, full.Ct)
        if framed.restore is not None:
            everywhere = create_block(model.K, vectors.size)
            apply(framed.restore, columns, everywhere)
        else:
            everywhere = copy_of(columns, model.K)
    small = model.comm.bcast(small)
    symmetric = {key: (value + value.T) / 2 for key, value in small.items() if key != "D" or full.symmetric}
    rom = ReducedModel(
        **(small | symmetric), B=inputs, C=outputs.T.copy(), frequencies=frequencies,
        loss_factor=framed.damping.loss_factor if isinstance(framed.damping, Structural) else 0.0,
        input_names=model.input_names, output_names=model.output_names, columns=everywhere,
    )  # fmt: skip
    return rom, defect
