"""Tangent, chord and Buckens frames: what they hold, and the elastic response of a free body."""


import numpy as np
import pytest
import scipy.linalg
import scipy.spatial.transform
from helpers import dense_model, gather

import hpcred
from hpcred import Buckens, Chord, Krylov, Modes, Tangent
from hpcred.examples import linkage as example
from hpcred.model.frames import apply_frame

pytestmark = pytest.mark.mpi

ALL_LOADS = (*example.SUPPORTS, example.LOAD)


def test_inertia_relief_is_the_elastic_response_whatever_the_supports(linkage):
    """At 0 Hz: the pseudo-inverse of K that is M-orthogonal to the rigid-body modes."""
    linkage = linkage.with_inputs(ALL_LOADS)
    K, M, B = dense_model(linkage)
    values, modes = scipy.linalg.eigh(K, M)
    elastic = modes[:, 6:]
    expected = B.T @ elastic @ np.diag(1 / values[6:]) @ elastic.T @ B
    results = []
    for supports in (None, example.SUPPORTS, tuple((5, d) for d in ("x", "y", "z", "rx", "ry", "rz"))):
        frame = Buckens(supports)
        results.append(hpcred.frequency_response(linkage, [0.0], frame)[0].real)
        assert np.abs(results[-1] - expected).max() < 1e-9 * np.abs(expected).max()
        with hpcred.reduce(linkage, [Krylov(0.0, 1)], frame) as rom:
            assert np.abs(rom.transfer_function(0.0) - expected).max() < 1e-8 * np.abs(expected).max()
    with pytest.raises(hpcred.InputError, match="expected 6 dofs"):
        hpcred.reduce(linkage, [Krylov(0.0)], Buckens(example.SUPPORTS[:3] + ((5, "x"), (5, "z"), (6, "x"))))


def test_a_buckens_basis_holds_no_rigid_motion(linkage):
    linkage = linkage.with_inputs(ALL_LOADS)
    with hpcred.reduce(linkage, [Modes(count=3), Krylov(10.0, 1), Krylov(0.0)], Buckens()) as rom:
        V = gather(rom.columns)
        K, M, _ = dense_model(linkage)
        rigid = scipy.linalg.eigh(K, M)[1][:, :6]
        assert np.abs(rigid.T @ M @ V).max() < 1e-9
        assert rom.frequencies.min() > 33.0


def test_frames_hold_what_they_say(linkage):
    with hpcred.reduce(linkage, [Modes(count=5)], Tangent(3)) as rom:
        V = gather(rom.columns)
        assert (V[12:18] == 0).all()
        free = np.delete(np.arange(120), np.arange(12, 18))
        K, M, _ = dense_model(linkage)
        values = scipy.linalg.eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], eigvals_only=True)[:5]
        assert np.allclose(rom.frequencies, np.sqrt(values) / (2 * np.pi), rtol=1e-8)
    with hpcred.reduce(linkage, [Modes(count=5)], Chord((1, 7, 18))) as rom:
        V, nodes = gather(rom.columns).reshape(20, 6, 5), example.positions()
        along = (nodes[6] - nodes[0]) / np.linalg.norm(nodes[6] - nodes[0])
        assert np.abs(V[0, :3]).max() < 1e-12
        assert np.abs(V[6, :3] - np.outer(along, along) @ V[6, :3]).max() < 1e-12  # moves along the chord only
        assert np.abs(V[17, 2]).max() < 1e-12
        assert np.abs(V[17, :2]).max() > 1e-3


def test_chord_frame_in_a_plane_of_no_axis(comm):
    """Turned dofs: the frequencies are those of the body turned the other way."""
    with hpcred.linkage(comm) as straight:
        with hpcred.reduce(straight, [Modes(count=6)], Chord((1, 7, 18))) as rom:
            expected = rom.frequencies
        K, M, _ = dense_model(straight)
        turn = scipy.spatial.transform.Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix()
        everywhere = np.kron(np.eye(40), turn)
        nodes = example.positions() @ turn.T
        rows = np.arange(120)
        dofs = hpcred.Dofs(rows // 6 + 1, (rows % 6).astype(np.int8), nodes[rows // 6])
        with hpcred.SecondOrderModel.from_scipy(
            everywhere @ K @ everywhere.T, everywhere @ M @ everywhere.T, comm=comm, dofs=dofs
        ) as turned:
            turned = turned.with_inputs([(20, "z")])
            with hpcred.reduce(turned, [Modes(count=6)], Chord((1, 7, 18))) as rom:
                assert np.allclose(rom.frequencies, expected, rtol=1e-7)


def test_a_free_body_needs_a_frame(comm):
    with hpcred.solid((3, 2, 2), inputs=2, clamped=False, comm=comm) as model:
        for basis in ([Krylov(0.0)], [Modes(count=3)]):
            with pytest.raises(hpcred.InputError, match="move freely"):
                hpcred.reduce(model, basis)
        with hpcred.reduce(model, [Krylov(0.0, 1)], Buckens()) as rom:
            assert rom.frequencies.min() > 100


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_points_of_a_chord_frame_are_collinear_by_their_angle(comm, size):
    """0.1 microradian is a line, 10 are not, in any unit of length; nor are two points a plane."""
    for angle, fits in ((1e-7, False), (1e-5, True)):
        places = size * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [300.0, 300.0 * angle, 0.0]])
        direction = np.tile(np.arange(3, dtype=np.int8), 3)
        dofs = hpcred.Dofs(np.repeat([1, 2, 3], 3), direction, np.repeat(places, 3, axis=0))
        with hpcred.SecondOrderModel.from_scipy(np.eye(9), np.eye(9), comm=comm, dofs=dofs) as model:
            for nodes, right in (((1, 2, 3), fits), ((1, 2, 2), False), ((1, 1, 3), False)):
                if right:
                    framed = apply_frame(model, Chord(nodes))
                    assert framed.model.size == 3
                else:
                    with pytest.raises(hpcred.InputError, match="collinear"):
                        apply_frame(model, Chord(nodes))
