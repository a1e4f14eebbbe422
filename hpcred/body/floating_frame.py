"""Compute the floating-frame quantities (13, 22): the integrals of a reduced body that a multibody program needs.

They follow from the mass matrix, the labels of the rows and the basis V. The body frame has the axes of the
finite-element model, and its origin unless another is given. With Phi_k the displacement field of column k:

    mass, mc = integral of R dm, J = integral of skew(R)^T skew(R) dm     by rigid-body motions, exact
    Ct_k = integral of Phi_k dm,  Cr_k = integral of R x Phi_k dm         likewise
    N[k]_ab = integral of R_a Phi_kb dm,  S[a, b]_kl = integral of Phi_ka Phi_lb dm

N and S are bilinear in the scalar mass matrix of one direction. This is exact if M does not couple directions and is
the same for all of them (solid elements). For nodes with rotations the mean of the directions is taken, an
approximation. So it is for matrices that couple directions, as after a condensation or with dependent dofs, where
S[0, 0] + S[1, 1] + S[2, 2] is not V^T M V. `lumped`, the row sums of M, is another approximation. Directions in which
no node can move do not contribute: a planar body has no mass in z, and quantities that M does not contain are NaN (see
model.rigid_body.modes.RigidBody).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..fe.dofs import OWN, SCALAR, require_dofs
from ..linalg.blocks import create_block, inner, local_rows, real_rows, times
from ..linalg.csr import diagonal_matrix
from ..model.rigid_body.modes import SAME_MASS, rigid_body_of, rigid_motions
from ..model.rotation import skew
from ..parallel.exchange import exchange
from ..parallel.petsc import MPI, PETSc
from ..reduction.run.projection import WIDTH, project

SAME_PRODUCTS = 1e-8  # of the sizes of two columns; more is no round-off


@dataclass
class FloatingFrame:
    """Floating-frame quantities (13, 22) of a body with m elastic coordinates q. SI units, axes of the model.

    Attributes
    ----------
    masses : ndarray, shape (3,)
        Mass in x, y and z in kg.
    mc : ndarray, shape (3,)
        First moment of mass in kg m.
    J : ndarray, shape (3, 3)
        Inertia about the origin of the body frame in kg m^2.
    Ct, Cr : ndarray, shape (m, 3)
        Couplings with translation and rotation, integrals of Phi_k and of R x Phi_k.
    N : ndarray, shape (m, 3, 3)
        Integrals of R_a Phi_kb.
    S : ndarray, shape (3, 3, m, m)
        Integrals of Phi_ka Phi_lb.
    Me : ndarray, shape (m, m)
        V^T M V.
    origin : ndarray, shape (3,)
        Origin of the body frame in m.
    integrals : str
        "consistent", "mean of directions" or "lumped"; after "; " the dofs that are left out of all integrals.
    """

    masses: np.ndarray
    mc: np.ndarray
    J: np.ndarray
    Ct: np.ndarray
    Cr: np.ndarray
    N: np.ndarray
    S: np.ndarray
    Me: np.ndarray
    origin: np.ndarray
    integrals: str = "consistent"

    @cached_property
    def Ct1(self) -> np.ndarray:
        """(m, m, 3): the part of Ct in row i that is linear in q_k, [i, k]; zero without geometric stiffness."""
        return np.zeros((*self.Me.shape, 3))

    @property
    def mass(self) -> float:
        """The largest of the masses in kg; held dofs and dofs that are left out reduce that of a direction."""
        return float(self.masses.max())

    @cached_property
    def Cr1(self) -> np.ndarray:
        """(m, m, 3): [i, k] = integral of Phi_k x Phi_i dm, so that C_r(q)_i = Cr_i + sum_k Cr1[i, k] q_k."""
        S = self.S
        cross = [S[1, 2] - S[2, 1], S[2, 0] - S[0, 2], S[0, 1] - S[1, 0]]
        return np.stack(cross, axis=-1).transpose(1, 0, 2)

    @cached_property
    def dJ(self) -> np.ndarray:
        """(m, 3, 3): derivative of the inertia by q_k at q = 0: integral of 2 R.Phi_k I - R Phi_k^T - Phi_k R^T dm."""
        trace = np.trace(self.N, axis1=1, axis2=2)
        return 2 * trace[:, None, None] * np.eye(3) - self.N - self.N.transpose(0, 2, 1)

    @cached_property
    def J2(self) -> np.ndarray:
        """(m, m, 3, 3): integral of Phi_k.Phi_l I - Phi_k Phi_l^T dm, symmetric in k and l.

        J(q) = J + sum_k dJ_k q_k + sum_kl J2_kl q_k q_l.
        """
        S = self.S
        trace = S[0, 0] + S[1, 1] + S[2, 2]
        outer = S.transpose(2, 3, 0, 1)
        # in the order of rows: a simulation multiplies it at every step
        return np.ascontiguousarray(trace[:, :, None, None] * np.eye(3) - (outer + outer.transpose(0, 1, 3, 2)) / 2)

    @property
    def Gr(self) -> np.ndarray:
        """(3, 3 m): block k = -2 integral of skew(R) skew(Phi_k) dm; its symmetric part is dJ_k."""
        trace = np.trace(self.N, axis1=1, axis2=2)
        blocks = 2 * (trace[:, None, None] * np.eye(3) - self.N.transpose(0, 2, 1))
        return blocks.transpose(1, 0, 2).reshape(3, -1)

    @property
    def Ge(self) -> np.ndarray:
        """(m, 3 m): 2 integral of Phi_k x Phi_i dm in row i, column c m + k for component c."""
        return (self.Cr1 - self.Cr1.transpose(1, 0, 2)).transpose(0, 2, 1).reshape(len(self.Ct), -1)

    @property
    def Oe(self) -> np.ndarray:
        """(m, 6): coefficients of wx^2, wy^2, wz^2, wx wy, wy wz, wx wz in integral of Phi_i^T skew(w)^2 R dm."""
        return _quadratic(self.N.transpose(1, 2, 0))

    @cached_property
    def Oe1(self) -> np.ndarray:
        """(m, m, 6): the part of Oe in row i that is linear in q_k, [i, k]; symmetric, being the integral itself."""
        return _quadratic(self.S).transpose(1, 0, 2)

    def first_moment(self, q) -> np.ndarray:
        """Return mass times centre of mass (3,) in the body frame, at the elastic coordinates q (m,)."""
        return self.mc + self.translations(q / 2).T @ q

    def translations(self, q) -> np.ndarray:
        """Return the couplings Ct(q) (m, 3) with translation at q (m,), the derivative of the first moment."""
        return self.Ct + q @ self.Ct1

    @cached_property
    def _linear(self) -> np.ndarray:
        """(m, 18 m): what q or its rate is multiplied by at each evaluation, side by side; see `varied`."""
        m = len(self.Ct)
        blocks = self.Ct1, self.Cr1, self.Cr1 - self.Cr1.transpose(1, 0, 2), 2 * self.J2.reshape(m, m, 9)
        return np.ascontiguousarray(np.concatenate(blocks, axis=2).transpose(1, 0, 2).reshape(m, 18 * m))

    def varied(self, vectors) -> np.ndarray:
        """Return, for vectors (..., m) such as q and q', the changes (..., m, 18) of Ct (3 columns), of Cr (3), the
        gyroscopic couplings Cr1 - Cr1^T (3), and the changes of dJ/dq (9)."""
        return (vectors @ self._linear).reshape(*np.shape(vectors), 18)

    @cached_property
    def _at_rest(self) -> np.ndarray:
        """The parts of the mass matrix (6 + m, 6 + m) that do not change."""
        M = np.zeros((6 + len(self.Ct),) * 2)
        M[:3, :3], M[6:, 6:] = self.mass * np.eye(3), self.Me
        return M

    def mass_matrix(self, q) -> np.ndarray:
        """Return the mass matrix M(q) (6 + m, 6 + m) of (13) at q (m,)."""
        change, M = self.varied(q), self._at_rest.copy()
        couplings = np.concatenate([self.Ct, self.Cr], axis=1) + change[:, :6]
        moment = skew(self.mc + q @ (self.Ct + change[:, :3] / 2))
        M[3:6, :3], M[:3, 3:6] = moment, -moment
        slope = self.dJ.reshape(-1, 9) + change[:, 9:] / 2  # the mean of those at 0 and at q
        M[3:6, 3:6] = self.J + (q @ slope).reshape(3, 3)
        M[6:, :6], M[:6, 6:] = couplings, couplings.T
        return M

    def in_coordinates(self, X: np.ndarray) -> FloatingFrame:
        """Return the quantities in the coordinates z (k,) with q = X z, X (m, k)."""
        columns = {key: np.tensordot(X.T, getattr(self, key), axes=1) for key in ("Ct", "Cr", "N")}
        return replace(self, **columns, S=X.T @ self.S @ X, Me=X.T @ self.Me @ X)

    def arrays(self) -> dict:
        """Return all quantities by name, as stored in result.h5."""
        own = ("masses", "mc", "J", "Ct", "Cr", "N", "S", "Me", "origin")
        derived = ("mass", "Cr1", "dJ", "Gr", "Ge", "Oe", "Oe1")
        return {name: np.asarray(getattr(self, name)) for name in own + derived}


def _quadratic(field):
    """Return six coefficients of u^T skew(w)^2 r from field[a, b] = integral of r_a u_b; last axis added."""
    trace = field[0, 0] + field[1, 1] + field[2, 2]
    diagonal = [field[a, a] - trace for a in range(3)]
    mixed = [field[a, b] + field[b, a] for a, b in ((0, 1), (1, 2), (0, 2))]
    return np.stack(diagonal + mixed, axis=-1)


def floating_frame(model, columns, origin=(0.0, 0.0, 0.0), lumped=False, Me=None) -> FloatingFrame:
    """Return the floating-frame quantities of a model and a basis. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The full model, with nodes.
    columns : SLEPc.BV, shape (n, m)
        The basis V, such as `ReducedModel.columns`.
    origin : array_like, shape (3,), default (0, 0, 0)
        Origin of the body frame in m.
    lumped : bool, default False
        Whether integrals that are quadratic in the shapes use row sums of M instead of the consistent mass matrix.
    Me : ndarray, shape (m, m), optional
        V^T M V, if it is known.

    Raises
    ------
    InputError
        Without node coordinates.

    Notes
    -----
    Equations (13) and (22). Masses, first moment, inertia, Ct and Cr are exact for all elements; N and S are exact for
    solid elements.
    """
    dofs = require_dofs(model, "a floating frame")
    origin = np.asarray(origin, dtype=float)
    motions = rigid_motions(model, origin)
    momentum = times(model.M, motions)
    gram, coupling = inner(motions, momentum), inner(momentum, columns)
    rigid = model.comm.bcast(rigid_body_of(gram))
    rotations = model.comm.allreduce(bool(((dofs.direction > 2) & (dofs.direction < SCALAR)).any()), op=MPI.LOR)
    every = np.flatnonzero(rigid.masses > 0)
    Me = project(model.M, columns) if Me is None else Me
    mass = _lumped(model) if lumped else model.M
    N, S = _integrals(model, columns, origin, mass, every if rotations else _heaviest(rigid.masses))
    exact = not rotations and model.comm.bcast(_adds_up(S, Me))
    if not (exact or rotations or lumped):
        N, S = _integrals(model, columns, origin, mass, every)
    kind = "lumped" if lumped else "consistent" if exact else "mean of directions"
    if turned := model.comm.allreduce(int((dofs.direction >= OWN).sum())):
        kind += f"; {turned} dofs in directions of their own (own1 to own6) have no part in mass, inertia and couplings"
    first_moment = rigid.masses.max() * rigid.centre
    result = FloatingFrame(
        rigid.masses, first_moment, rigid.inertia, coupling[:3].T.copy(), coupling[3:].T.copy(), N, S, Me, origin, kind
    )
    return model.comm.bcast(result)


def _adds_up(S, Me):
    """Test whether S[0, 0] + S[1, 1] + S[2, 2] is Me, each coordinate in its own size."""
    sizes = np.sqrt(np.abs(np.diag(Me)))
    return bool((np.abs(np.einsum("aakl->kl", S) - Me) <= SAME_PRODUCTS * np.outer(sizes, sizes)).all())


def _heaviest(masses):
    """Return the first direction with all the mass: no node is missing in it."""
    return np.flatnonzero(masses >= (1 - SAME_MASS) * masses.max())[:1] if masses.max() > 0 else []


def _integrals(model, columns, origin, mass, bases):
    """Return N (m, 3, 3) and S (3, 3, m, m), the mean of those by the mass matrices of the directions `bases`.
    Collective."""
    count = int(np.diff(columns.getActiveColumns())[0])
    chunks = [slice(low, min(low + WIDTH, count)) for low in range(0, count, WIDTH)]
    N, S = np.zeros((count, 3, 3)), np.zeros((3, 3, count, count))
    for base in bases:
        mine = np.flatnonzero(model.dofs.direction == base)
        points = (model.dofs.position - origin)[mine]
        places = (model.first_row + mine).astype(PETSc.IntType)
        chosen = PETSc.IS().createGeneral(places, model.K.comm)
        scalar = mass.createSubMatrix(chosen, chosen)  # of one direction: a ninth of the matrix
        fields = [real_rows(times(_transfer(model, d, base, mine), columns)) for d in range(3)]
        for b in range(3):
            for chunk in chunks:
                load = _product(scalar, fields[b][:, chunk])
                N[chunk, :, b] += load.T @ points / len(bases)
                for a in range(b + 1):
                    S[a, b, :, chunk] += fields[a].T @ load / len(bases)
    N, S = model.comm.allreduce(N), model.comm.allreduce(S)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        S[b, a] = S[a, b].T
    return N, S


def _product(scalar, values):
    """Return the scalar mass matrix times columns (rows, k), the rows of this rank of both. Collective."""
    block = create_block(scalar, values.shape[1])
    with local_rows(block) as rows:
        rows[...] = values
    with local_rows(times(scalar, block)) as rows:
        return rows.real.copy(order="F")


def _transfer(model, source, target, mine):
    """Return T that takes the component in direction `source` of every node to the place of its row in direction
    `target`; `mine`: the local rows in that direction."""
    comm, dofs = model.comm, model.dofs
    rows = np.arange(model.first_row, model.first_row + model.local_rows)
    if source == target:
        wanted, sources = rows[mine], rows[mine]
    else:
        # rows of a node meet on a rank that its number chooses
        shares = []
        for direction in (target, source):
            those = dofs.direction == direction
            node = dofs.node[those]
            shares.append(exchange(comm, _meeting_rank(node, comm.size), [node, rows[those]]))
        (node_t, row_t), (node_s, row_s) = shares
        _, at_t, at_s = np.intersect1d(node_t, node_s, return_indices=True)
        owner = np.searchsorted(model.row_starts, row_t[at_t], side="right") - 1
        wanted, sources = exchange(comm, owner, [row_t[at_t], row_s[at_s]])
        order = np.argsort(wanted)
        wanted, sources = wanted[order], sources[order]
    counts = np.zeros(len(mine) + 1, dtype=PETSc.IntType)
    counts[np.searchsorted(rows[mine], wanted) + 1] = 1
    csr = (np.cumsum(counts, dtype=PETSc.IntType), sources.astype(PETSc.IntType), np.ones(len(sources)))
    return PETSc.Mat().createAIJ(((len(mine), None), (model.local_rows, model.size)), csr=csr, comm=model.K.comm)


def _meeting_rank(node, ranks):
    """Return ranks (nodes,) that share node numbers evenly, also those that go up in tens (Fibonacci hashing)."""
    mixed = node.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return ((mixed >> np.uint64(40)) % np.uint64(ranks)).astype(np.int64)


def _lumped(model):
    """Return a diagonal matrix with the row sums of M for unit translations."""
    values, moved = np.zeros(model.local_rows), model.dofs.direction < 3
    with local_rows(times(model.M, rigid_motions(model))) as rows:
        values[moved] = rows.real[moved, model.dofs.direction[moved]]
    return diagonal_matrix(model.K, values)
