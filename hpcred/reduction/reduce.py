"""The main job: a model, a frame, a damping law and a list of basis ingredients enter, a reduced model leaves."""

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import apply, copy_of, create_block
from ..linalg.factorisation import SolverOptions
from ..model.damping import ModalDamping, Structural
from ..model.frames import apply_frame
from ..model.second_order_model import SYMMETRIC_TO
from ..parallel.failures import ComputationError, InputError
from ..parallel.stages import Progress
from .context import Context
from .point_blocks import chains_in_groups
from .projection import diagonalise, project, project_columns
from .record import provenance
from .reduced_damping import reduced_damping
from .reduced_model import ReducedModel
from .two_sided import biorthogonal

ORTHONORMAL_TO = 1e-12


def reduce(
    model, basis, frame=None, damping=None, tolerance=1e-12, drop_above=None, progress=None,
    projection="one_sided", allow_unstable=False, groups=1, options=None,
) -> ReducedModel:  # fmt: skip
    """Reduce a SecondOrderModel by projection onto the span of the ingredients. Collective.

    `basis`: list of Modes, Krylov, SecondOrderKrylov, StaticCorrection; each extends what the ones before it gave.
    `frame`: Tangent, Chord, Buckens or None; `damping`: Rayleigh, Caughey, GivenDamping, ModalDamping, Structural
    or None. `tolerance`: relative size of the new part of a vector below which it is dropped as dependent.
    `drop_above`: pseudo-modes above this frequency (Hz) are cut after the diagonalisation. The reduced model has
    V^T M V = I and diagonal V^T K V.

    `projection`: "one_sided" (W = V), or "two_sided": where the outputs differ from the inputs, W is built from C^T
    (33), W^T M V = I, and twice as many moments match; the result may be unstable, which is refused unless
    `allow_unstable`.

    `groups`: number of groups of ranks that factor different expansion points at the same time, each with a copy of
    the matrices, or "auto": as many as points, ranks and memory allow. `options`: SolverOptions. Raises
    InputError or ComputationError, the same on all ranks; `model` is not changed.
    """
    progress = progress or Progress(model.comm, show=False)
    _check_model(model)
    two_sided = projection == "two_sided" and model.Ct is not None
    if two_sided and (drop_above is not None or isinstance(damping, ModalDamping)):
        raise InputError(
            "projection: 'two_sided' leaves no diagonal model, which drop_above and modal damping need; "
            "take 'one_sided'"
        )
    with progress.stage("frame"):
        framed = apply_frame(model, frame, damping)
    rigid = framed.rigid.R if framed.rigid is not None else None
    contexts = [Context(framed, progress, tolerance, options or SolverOptions())]
    if two_sided:
        contexts.append(contexts[0].dual())
    bases = [Basis(framed.model.M, rigid, tolerance) for _ in contexts]
    try:
        _check_size(framed, basis)
        groups = _number_of_groups(groups, contexts[0], basis)
        chains = chains_in_groups(basis, contexts, groups) if groups > 1 else {}
        for i, ingredient in enumerate(basis):
            for c, (vectors, context) in enumerate(zip(bases, contexts, strict=True)):
                if (i, c) in chains:
                    chains[i, c].join(vectors, context)
                else:
                    ingredient.extend(vectors, context)
        for context in contexts:
            context.release()
        if not all(vectors.size for vectors in bases):
            raise InputError("basis: no vector is left; no mode lies in the bands and no input loads the body")
        with progress.stage("project"):
            if two_sided:
                rom, defect = _project_oblique(model, framed, *bases, contexts[0], allow_unstable)
            else:
                rom, defect = _project(model, framed, bases[0], contexts[0], drop_above)
        rom.provenance = provenance(model, framed, basis, frame, damping, contexts, progress, defect)
        rom.provenance["projection"] = "two_sided" if two_sided else "one_sided"
        rom.provenance["unstable_poles"] = [[pole.real, pole.imag] for pole in rom.unstable_poles()]
        return rom
    finally:
        for item in (*contexts, *bases, framed):
            item.close()


def _number_of_groups(wanted, context, basis):
    """Groups of ranks for the expansion points. Collective. Raises InputError."""
    points = sum(hasattr(item, "chain") for item in basis)
    ranks = context.model.comm.size
    if wanted != "auto":
        if isinstance(wanted, str) or not 1 <= wanted <= ranks:
            raise InputError(f"groups: found {wanted!r}, expected 1 to {ranks}, the number of ranks, or 'auto'")
        return min(wanted, max(points, 1))
    most = min(points, ranks)
    if most < 2:
        return 1
    with context.progress.stage("estimate"):
        need, have = context.solver.estimate()
        context.release()
    found = max(1, min(most, int(have / (1.2 * max(need, 1)))))
    context.progress.say(f"{found} groups of ranks: a factor needs about {need:.0f} MB, there are {have:.0f} MB")
    return found


def _check_model(model):
    for key in ("M", "K"):
        if model.symmetry_defects[key] > SYMMETRIC_TO:
            raise InputError(
                f"{model.name}: matrix {key} is not symmetric: ||A - A^T|| / ||A|| = "
                f"{model.symmetry_defects[key]:.1e}, expected round-off (below {SYMMETRIC_TO:g})"
            )
    if model.B is None or not model.input_names:
        raise InputError(f"{model.name} has no inputs; name them by `inputs`, as dof numbers or [node, direction]")


def _check_size(framed, basis):
    """Refuse a basis that cannot fit before anything is factored."""
    if not basis:
        raise InputError("basis: the list of ingredients is empty")
    model, rigid = framed.model, framed.rigid.count if framed.rigid is not None else 0
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
    full = framed.model
    squares = diagonalise(vectors, project(full.K, vectors.columns))
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    if drop_above is not None:
        kept = int((frequencies <= drop_above).sum())
        if kept == 0:
            raise InputError(f"drop_above: no pseudo-frequency lies below {drop_above:g} Hz")
        context.note(f"pseudo-frequencies up to {drop_above:g} Hz", len(frequencies), kept)
        vectors.turn(np.eye(len(frequencies))[:, :kept])
        frequencies = frequencies[:kept]
    mass, defect = vectors.gram()
    if defect > ORTHONORMAL_TO:
        raise ComputationError(
            f"the basis has lost its orthonormality: max |V^T M V - I| = {defect:.1e}, allowed is {ORTHONORMAL_TO:g}"
        )
    columns = vectors.columns
    small = {"M": mass} | {key: project(mat, columns) for key, mat in full.matrices.items() if key != "M"}
    if "D" not in small:
        small["D"] = reduced_damping(framed.damping, context, columns, frequencies)
    for key, value in small.items():
        if key != "D" or full.symmetric:
            small[key] = (value + value.T) / 2
    inputs = project_columns(columns, full.B)
    outputs = inputs if full.Ct is None else project_columns(columns, full.Ct)
    rom = _reduced_model(model, framed, small, inputs, outputs.T.copy(), frequencies)
    rom.columns = _everywhere(model, framed, columns)
    return rom, defect


def _project_oblique(model, framed, right, left, context, allow_unstable):
    """The reduced model of a two-sided projection (20), its poles checked, and the biorthonormality defect."""
    full = framed.model
    defect = biorthogonal(left, right, context)
    V, W = right.columns, left.columns
    small = {key: project(mat, V, W) for key, mat in full.matrices.items()}
    frequencies = np.sort(np.sqrt(np.abs(np.linalg.eigvals(small["K"])))) / (2 * np.pi)
    if "D" not in small:
        small["D"] = reduced_damping(framed.damping, context, V, frequencies, W)
    inputs, outputs = project_columns(W, full.B), project_columns(V, full.Ct)
    rom = _reduced_model(model, framed, small, inputs, outputs.T.copy(), frequencies)
    unstable = rom.unstable_poles()
    if len(unstable) and not allow_unstable:
        listed = ", ".join(f"{pole.real:.3g}{pole.imag:+.4g}i" for pole in unstable[:6])
        raise InputError(
            f"projection: the two-sided reduced model is unstable, with {len(unstable)} poles in the right "
            f"half-plane ({listed}{', ...' if len(unstable) > 6 else ''} rad/s); take projection = 'one_sided', "
            "which keeps stability, or allow_unstable = true for frequency responses only"
        )
    rom.columns, rom.left_columns = (_everywhere(model, framed, block) for block in (V, W))
    return rom, defect


def _reduced_model(model, framed, small, inputs, outputs, frequencies):
    """The same arrays on all ranks, to the last digit."""
    small, inputs, outputs, frequencies = model.comm.bcast((small, inputs, outputs, frequencies))
    loss = framed.damping.loss_factor if isinstance(framed.damping, Structural) else 0.0
    return ReducedModel(
        **small, B=inputs, C=outputs, frequencies=frequencies, loss_factor=loss,
        input_names=model.input_names, output_names=model.output_names,
    )  # fmt: skip


def _everywhere(model, framed, columns):
    """A basis in all dofs of the model, as a new block."""
    if framed.restore is None:
        return copy_of(columns, model.K)
    first, last = columns.getActiveColumns()
    result = create_block(model.K, last - first)
    apply(framed.restore, columns, result)
    return result
