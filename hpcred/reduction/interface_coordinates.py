"""Transform a reduced model to interface coordinates, those of a superelement.

With G V of full row rank the first coordinates become the displacements of the interfaces and the others
fixed-interface pseudo-modes (Craig & Bampton, AIAA J. 6(7), 1968, for any span V): with N the null space of G V,

    V^ = V [Psi, Phi],   Phi = N X,  Phi^T K Phi = omega^2,  Phi^T M Phi = I,
    G V Psi = I,  Phi^T K Psi = 0,   M^ = [M_bb M_bi; M_ib I],   K^ = [K_bb 0; 0 omega^2].

The transfer function stays what it was. For a free body in the Buckens frame the rigid-body modes join the basis, so
that the superelement moves as a whole without force; what is known of its error stays true for its elastic part.
"""

from __future__ import annotations

import numpy as np

from ..fe.dofs import DIRECTIONS
from ..linalg.blocks import create_block, inner, local_rows
from ..linalg.eigensolver import graded_eigenpairs, symmetric_part
from ..linalg.pencil import massless_last, modes_of
from ..model.damping import GivenDamping
from ..model.frames import Chord, NoFrame, Tangent
from ..model.rigid_body.modes import RigidBodyModes
from ..parallel.decisions import decided
from ..parallel.failures import InputError
from .components.craig_bampton import check_directions, interface_forces
from .result.reduced_model import ReducedModel
from .run.projection import Projection, project, project_columns

RIGID = 1e-8  # of the largest stiffness of a column: less counts as so much
UNMOVED = 1e-9  # singular value of G V, its rows scaled, below which a direction of the interfaces cannot move


def check_interface_coordinates(model, frame):
    """Refuse what has no interface coordinates. Collective."""
    where = "coordinates: 'interface'"
    if not model.interfaces:
        raise InputError(f"{where} needs at least one [[interface]]")
    check_directions(model)
    if not model.is_symmetric("K"):
        raise InputError(f"{where} does not go with the unsymmetric K of {model.name}, which no superelement has; "
                         "leave it out")  # fmt: skip
    if isinstance(frame, Tangent | Chord):
        raise InputError(
            f"{where} does not go with frame kind '{frame.kind}', which holds nodes of the body; take 'none' for a "
            "supported body and 'buckens' for a free one"
        )
    if isinstance(frame, NoFrame):
        rigid = RigidBodyModes(model)
        if rigid.count:
            raise InputError(
                f"{where}: {model.name} has {rigid.count} rigid-body motions without force; take frame kind "
                "'buckens', whose rigid-body modes then are part of the superelement"
            )


def to_interface_coordinates(framed, modal: Projection, tau=0.0) -> Projection:
    """Return the same span, and the rigid-body modes of the frame, in interface coordinates; `tau`: of the inner
    product, see Run. Collective. Raises InputError."""
    whole = modal if framed.rigid is None else _with_rigid(framed, modal)
    motion = inner(interface_forces(framed.model), whole.columns)
    M, K = whole.operator["M"], whole.operator["K"]
    T = decided(framed.model.comm, transformation, motion, M, K, framed.model.interfaces, tau)
    block = create_block(framed.model.K, T.shape[1])
    with local_rows(whole.columns) as old, local_rows(block) as new:
        new[...] = old @ T
    # what Phi^T M Phi = I, Phi^T K Phi = omega^2 and Phi^T K Psi = 0 are, exactly
    count, operator = len(motion), whole.operator.projected(T)
    M, K = operator["M"], operator["K"]
    static = np.diag(M)[count:] < 0.5  # others have mass 1
    M[count:, count:] = np.diag(np.where(static, 0.0, 1.0))
    M[:count, count:][:, static] = M[count:, :count][static] = 0.0
    K[:count, count:] = K[count:, :count] = 0.0
    K[count:, count:] = np.diag(np.diag(K)[count:])
    frequencies = np.concatenate([np.zeros(framed.rigid_size), modal.frequencies])
    return Projection(operator, T.T @ whole.B, whole.C @ T, frequencies, block, modal.defect,
                      interfaces=framed.model.interfaces)  # fmt: skip


def _with_rigid(framed, modal: Projection) -> Projection:
    """Return the projection on [R, V] in place of V: M^ = I and K^ = 0 for the rigid-body motion, to the last digit.

    A given damping matrix acts on it; other damping is that of the deformation and does not.
    """
    model, rigid = framed.model, framed.rigid
    first, last = modal.columns.getActiveColumns()
    count, size = rigid.count, rigid.count + last - first
    block = create_block(model.K, size)
    with local_rows(block) as new, local_rows(rigid.R) as R, local_rows(modal.columns) as V:
        new[:, :count], new[:, count:] = R, V

    def beside(value, corner):
        result = np.zeros((size, size))
        result[:count, :count], result[count:, count:] = corner, value
        return result

    operator = modal.operator.map(lambda matrix: beside(matrix, 0.0))
    changed = {"M": beside(modal.operator["M"], np.eye(count))}
    if isinstance(framed.damping, GivenDamping):
        D = project(model.D, block)
        changed["D"] = symmetric_part(D) if model.is_symmetric("D") else D
    B = np.concatenate([project_columns(rigid.R, model.B), modal.B])
    C = B.T if model.Ct is None else np.concatenate([project_columns(rigid.R, model.Ct).T, modal.C], axis=1)
    operator = operator.with_matrices(operator.matrices | changed)
    return modal._replace(columns=block, operator=operator, B=B, C=C)


def transformation(motion, M, K, interfaces, tau=0.0):
    """Return [Psi, Phi] (m, m) from G V (6k, m) and V^T M V, V^T K V; `tau`: where M may be singular, see Run. Raises
    InputError for a rank-deficient G V."""
    count, size = motion.shape
    # G V = U S W^T with scaled rows: of full rank, where every direction of the interfaces moves by itself
    sizes = np.linalg.norm(motion, axis=1)
    scaled = motion / np.maximum(sizes, 1e-300)[:, None]
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    weak = np.flatnonzero(values < UNMOVED)
    if size < count or weak.size or not sizes.all():
        place = int(np.abs(left[:, weak[0]]).argmax()) if weak.size else int(sizes.argmin())
        missing = count - min(size, count) + weak.size
        raise InputError(
            f"coordinates: the basis of {size} vectors cannot move interface '{interfaces[place // 6].name}' in "
            f"direction {DIRECTIONS[place % 6]} by itself ({missing} of {count} directions are missing); add a "
            "component of kind 'constraint_modes', or all directions of the interfaces to the inputs; if drop_above "
            "cut them off, leave it out"
        )
    # Psi with G V Psi = I, and N with G V N = 0, which leave columns that hardly move an interface to themselves
    psi, N = _split(scaled, sizes, np.diag(K))
    if N.shape[1] == 0:
        return psi
    # Phi = N X with Phi^T K Phi = omega^2, Phi^T M Phi = I; Psi without its part that K couples to Phi
    inside = symmetric_part(N.T @ K @ N), symmetric_part(N.T @ M @ N)
    eigenvalues, X, without = massless_last(*inside, tau) if tau else (*_modes(*inside), 0)
    if without:
        eigenvalues[-without:] = tau**-2
    if eigenvalues[0] <= 1e-12 * eigenvalues.max():
        raise InputError("coordinates: with all interfaces held the body can still move; add an interface")
    phi = N @ X
    psi = psi - phi @ ((phi.T @ K @ psi) / eigenvalues[:, None])
    return np.concatenate([psi, phi], axis=1)


def _split(motion, sizes, stiffnesses):
    """Return Psi (m, 6k) and N (m, m - 6k) of the motion (6k, m) of interfaces, whose rows are divided by `sizes`.

    By elimination with the columns that move them most for their energy: orthogonal combinations would give parts that
    interfaces hardly move, as those of isolated outputs, the round-off of all others, and stiff columns theirs.
    `stiffnesses` (m,): of the columns.
    """
    from scipy.linalg import qr, solve_triangular  # which most models do without

    least = RIGID * stiffnesses.max(initial=0.0) or 1.0
    place = qr(motion / np.sqrt(np.maximum(stiffnesses, least)), mode="economic", pivoting=True)[2]
    Q, R = qr(motion[:, place], mode="economic")
    count, size = motion.shape
    psi, N = np.zeros((size, count)), np.zeros((size, size - count))
    psi[place[:count]] = solve_triangular(R[:, :count], Q.T / sizes)
    N[place[:count]] = -solve_triangular(R[:, :count], R[:, count:])
    N[place[count:], np.arange(size - count)] = 1.0
    return psi, N


def _modes(K, M):
    """Return omega^2 (m,), ascending, and X (m, m) of K and M, symmetric; parts that hardly couple keep their digits.
    """
    try:
        L = np.linalg.cholesky(M)
    except np.linalg.LinAlgError:  # some combination has no mass
        return modes_of(K, M)
    half = np.linalg.solve(L, K)
    eigenvalues, X = graded_eigenpairs(symmetric_part(np.linalg.solve(L, half.T)))
    return eigenvalues, np.linalg.solve(L.T, X)


def elastic_part(reduced: ReducedModel, count: int | None = None) -> ReducedModel:
    """Return the model without the rigid-body motion that interface coordinates brought, in pseudo-modal coordinates.

    Its transfer function is the one in the Buckens frame, which estimates and checks speak of. Other models stay as
    they are. `count`: how many coordinates that motion has, where the model has no record yet.
    """
    count = reduced.rigid_size if count is None else count
    if not count:
        return reduced
    X = modes_of(reduced.K, reduced.M)[1][:, count:]
    return reduced.in_coordinates(X, frequencies=reduced.frequencies[count:], interfaces=(), columns=None)
