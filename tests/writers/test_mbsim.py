"""The file for MBSim: read back by the rules of its ExternalFlexibleFfrBody, whose equations are assembled here."""

from dataclasses import replace
from itertools import product

import h5py
import numpy as np
import pytest
from helpers import to_dense

import hpcred
from hpcred import Buckens, InputError, ModalDamping, Modes, Structural
from hpcred.body.body import body_of
from hpcred.model.rotation import skew


@pytest.fixture
def rod(tmp_path):
    """Of a free block: its result file, body, dense mass matrix, labels and basis."""
    with hpcred.solid((4, 2, 2), clamped=False, inputs=2) as model:
        rom = hpcred.reduce(model, [Modes(count=4)], Buckens(), ModalDamping(0.02))
        hpcred.write_result(tmp_path / "rod.h5", rom, model)
        with h5py.File(tmp_path / "rod.h5") as file:
            V = file["basis/V"][...].T
        return body_of(model, rom), to_dense(model.M), model.dofs, V


def read(path):
    """The quantities of MBSim by their names in its importData."""
    with h5py.File(path) as file:
        found = {name: item[...] for name, item in file.items()}
    m = found["shape function integral"].shape[1]
    r, P = found["position shape function integral"], found["shape function shape function integral"]
    blocks = iter(np.split(P, 6))
    PP = np.zeros((3, 3, m, m))
    for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        PP[a, b] = next(blocks)
        PP[b, a] = PP[a, b].T
    return found, np.array(np.split(r, 3)), PP  # r[k] (3, m), PP[a][b] (m, m)


def mass_matrix(found, rP, PP, q):
    """M(q) as MBSim's updateMb and assemble add it up."""
    m = len(q)
    rr, P = found["position position integral"], found["shape function integral"]
    M = np.zeros((6 + m, 6 + m))
    M[:3, :3] = found["mass"] * np.eye(3)
    M[3:6, :3] = skew(found["position integral"] + P @ q)
    inertia = np.trace(rr) * np.eye(3) - rr
    for i in range(m):
        one = np.array([[2 * (rP[1][1, i] + rP[2][2, i]), -(rP[1][0, i] + rP[0][1, i]), -(rP[2][0, i] + rP[0][2, i])],
                        [0, 2 * (rP[0][0, i] + rP[2][2, i]), -(rP[2][1, i] + rP[1][2, i])],
                        [0, 0, 2 * (rP[0][0, i] + rP[1][1, i])]])  # fmt: skip
        inertia = inertia + (np.triu(one) + np.triu(one, 1).T) * q[i]
    for i, j in product(range(m), repeat=2):
        two = np.array([[PP[1][1][i, j] + PP[2][2][i, j], -PP[1][0][i, j], -PP[2][0][i, j]],
                        [-PP[0][1][i, j], PP[0][0][i, j] + PP[2][2][i, j], -PP[2][1][i, j]],
                        [-PP[0][2][i, j], -PP[1][2][i, j], PP[0][0][i, j] + PP[1][1][i, j]]])  # fmt: skip
        inertia = inertia + two * q[i] * q[j]
    M[3:6, 3:6] = inertia
    M[6:, :3] = P.T
    turns = [-PP[1][2] + PP[1][2].T, -PP[2][0] + PP[2][0].T, -PP[0][1] + PP[0][1].T]
    rest = np.stack([rP[1][2] - rP[2][1], rP[2][0] - rP[0][2], rP[0][1] - rP[1][0]], axis=1)
    M[6:, 3:6] = rest + np.stack([turn @ q for turn in turns], axis=1)
    M[6:, 6:] = PP[0][0] + PP[1][1] + PP[2][2]
    return np.tril(M) + np.tril(M, -1).T


def test_mbsim_has_the_mass_matrix_of_the_deformed_body(tmp_path, rod):
    """Against kinetic energies of the nodes: M(q) by velocities of the deformed mesh and its mass matrix."""
    body, M, dofs, V = rod
    report = hpcred.export(tmp_path / "rod.h5", "mbsim")
    assert report["output"].endswith("rod_mbsim.hdf5")
    q = 1e-3 * np.random.default_rng(1).standard_normal(body.reduced.size)
    found = mass_matrix(*read(tmp_path / "rod_mbsim.hdf5"), q)
    assert (dofs.direction.reshape(-1, 3) == [0, 1, 2]).all()
    points = dofs.position[::3] + (V @ q).reshape(-1, 3)
    turned = np.concatenate([-skew(point) for point in points])
    motions = np.hstack([np.tile(np.eye(3), (len(points), 1)), turned, V])
    wanted = motions.T @ M @ motions
    assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()
    for part in (np.s_[3:6, 3:6], np.s_[6:, 3:6], np.s_[3:6, :3], np.s_[6:, :3]):  # each with what q changes
        assert np.abs(found - wanted)[part].max() < 1e-9 * max(np.abs(wanted[part]).max(), 1e-6)


def test_matrices_and_nodes(tmp_path, rod):
    body = rod[0]
    hpcred.export(tmp_path / "rod.h5", "mbsim")
    found, *_ = read(tmp_path / "rod_mbsim.hdf5")
    for name, matrix in (("stiffness matrix", body.reduced.K), ("damping matrix", body.reduced.D)):
        assert np.abs(found[name] - matrix).max() <= 1e-14 * np.abs(matrix).max()
    assert found["node numbers"].tolist() == [node.node for node in body.nodes] and len(body.nodes) > 0
    for k, node in enumerate(body.nodes):
        rows = slice(3 * k, 3 * k + 3)
        assert np.allclose(found["nodal relative position"][rows], node.position)
        assert np.allclose(found["nodal shape matrix of translation"][rows], node.phi, atol=0)
        assert np.array_equal(found["nodal shape matrix of rotation"][rows], node.psi)
    assert "nodal stress matrix" not in found
    described = hpcred.info(tmp_path / "rod_mbsim.hdf5")
    assert "MBSim" in described["format"] and described["arrays"]["stiffness matrix"] == "4 x 4"
    hpcred.export(tmp_path / "rod.h5", "mbsim")  # which replaces its own file, and no model
    with pytest.raises(InputError, match="rod.h5"):
        hpcred.export(tmp_path / "rod.h5", "mbsim", tmp_path / "rod.h5")
    with hpcred.solid((2, 1, 1)) as other:
        hpcred.write_model(tmp_path / "other.h5", other)
    with pytest.raises(InputError, match="other.h5"):
        hpcred.export(tmp_path / "rod.h5", "mbsim", tmp_path / "other.h5")


def test_stresses_of_interface_nodes(tmp_path):
    with hpcred.solid((3, 2, 2), clamped=False, inputs=1) as model:
        rom = hpcred.reduce(model, [Modes(count=3)], Buckens())
        stress = hpcred.stress_modes(model, rom.columns)
        hpcred.write_result(tmp_path / "s.h5", rom, model, stress=stress)
    nodes = [int(stress.node[2]), int(stress.node[5])]
    report = hpcred.export(tmp_path / "s.h5", "mbsim", nodes=nodes)
    assert any("stresses are those of the interface nodes" in text for text in report["remarks"])
    found = read(tmp_path / "s_mbsim.hdf5")[0]["nodal stress matrix"].reshape(2, 6, 3)
    assert np.allclose(found, stress.stress[:, [2, 5]].transpose(1, 2, 0))


def test_bodies_that_are_refused(tmp_path):
    with hpcred.solid((3, 2, 2), clamped=False, inputs=1) as model:
        rom = hpcred.reduce(model, [Modes(count=3)], Buckens(), Structural(0.02))
        hpcred.write_result(tmp_path / "s.h5", rom, model)
        with pytest.raises(InputError, match="no meaning in time and no place in a file for MBSim"):
            hpcred.export(tmp_path / "s.h5", "mbsim")
        rom = hpcred.reduce(model, [Modes(count=3)], Buckens())
        rom = replace(rom, D=np.triu(np.ones((3, 3))))
        hpcred.write_result(tmp_path / "d.h5", rom, model)
    with pytest.raises(InputError, match="found an unsymmetric damping matrix, expected a symmetric one"):
        hpcred.export(tmp_path / "d.h5", "mbsim")
