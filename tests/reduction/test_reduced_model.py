"""Reduced models that were made by hand, with numbers that are none."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from helpers import exported

import hpcred
import hpcred as package
from hpcred.body.body import body_of
from hpcred.model.operator import Operator, Term
from hpcred.parallel.failures import InputError
from hpcred.reduction.result.record import UnknownPart
from hpcred.writers.arrays import BodyMat, BodyNpz
from hpcred.writers.exudyn import Exudyn
from hpcred.writers.mbdyn import MbdynFile
from hpcred.writers.superelement import superelement

WAYS = {
    "sid": lambda path, body: hpcred.writers.write_sid(path, body),
    "npz": lambda path, body: exported(BodyNpz, path, body),
    "matlab": lambda path, body: exported(BodyMat, path, body),
    "exudyn": lambda path, body: exported(Exudyn, path, body),
    "mbdyn": lambda path, body: exported(MbdynFile, path, body),
    "fmu": lambda path, body: hpcred.writers.write_fmu(path, body.reduced),
    "state space": lambda path, body: hpcred.state_space(body.reduced),
    "superelement": lambda path, body: superelement(replace(body.reduced, interfaces=(None,))),
    "simulation": lambda path, body: hpcred.simulate(body, hpcred.Simulation(end=0.01, steps=2)),
    "response": lambda path, body: hpcred.frequency_response(body.reduced, [1.0]),
}


@pytest.fixture(scope="module")
def body():
    with (
        hpcred.linkage() as model,
        model.with_inputs([(20, "z")]) as loaded,
        hpcred.reduce(loaded, [hpcred.Modes(count=2)], hpcred.Buckens()) as rom,
    ):
        return body_of(loaded, rom)


@pytest.mark.parametrize("way", WAYS)
def test_matrices_with_nan_or_inf_are_refused_by_name(body, tmp_path, way):
    for key, wrong in (("M", np.nan), ("D", -np.inf), ("K", np.inf), ("B", np.nan), ("C", np.nan)):
        matrix = getattr(body.reduced, key).copy()
        matrix.flat[-1] = wrong
        with pytest.raises(InputError, match=f"reduced model: {key} has 1 of {matrix.size} numbers that are NaN"):
            WAYS[way](tmp_path / "out", replace(body, reduced=replace(body.reduced, **{key: matrix})))
    assert not list(tmp_path.iterdir())


@pytest.mark.mpi
def test_a_damping_matrix_with_nan_is_refused_on_all_ranks(comm, linkage):
    D = linkage.K.duplicate(copy=True)
    if comm.rank == comm.size - 1:
        D.setValue(119, 119, np.nan)
    D.assemble()
    with pytest.raises(InputError, match=r"matrix D has entries that are NaN or Inf, .* dof 120 \(node 20, rz\)"):
        linkage.with_damping_matrix(D)
    D.destroy()


@pytest.mark.parametrize("gain", [0.0, 1.0, -1.0])
def test_forces_that_follow_the_motion_make_a_model_flutter(gain):
    """s^2 = -(2 -+ i gain) of a K that is symmetric but for a circulatory part; damping of 0.1 delays it."""
    K, one = np.array([[2.0, gain], [-gain, 2.0]]), np.eye(2)
    made = [hpcred.ReducedModel(one, d * one, K, one, one, np.full(2, 0.2), 0.0, ("a", "b"), ("a", "b"))
            for d in (0.0, 0.1, 1.0)]  # fmt: skip
    root = np.sqrt(-2.0 + 1j * abs(gain) + 0j)
    assert len(made[0].unstable_poles()) == (2 if gain else 0)
    if gain:
        assert np.allclose(np.sort(made[0].unstable_poles().imag), [-root.imag, root.imag])
        assert np.allclose(made[0].unstable_poles().real, root.real)
        assert len(made[1].unstable_poles()) == 2 and not len(made[2].unstable_poles())
    assert np.allclose(np.sort(np.abs(made[2].poles())), np.sort(np.abs(np.roots([1, 2, 5, 4, 4 + gain**2]))))


def test_negative_damping_and_stiffness_make_a_model_unstable():
    one = np.eye(1)
    for d, k, count in ((-0.1, 1.0, 2), (0.0, -1.0, 1), (0.0, 1.0, 0), (0.1, 1.0, 0)):
        model = hpcred.ReducedModel(one, d * one, k * one, one, one, np.ones(1), 0.0, ("a",), ("a",))
        assert len(model.unstable_poles()) == count


def test_a_reduced_model_does_not_change():
    """Another one with other matrices is made, which has the rest of it: twice K makes poles sqrt(2) times as high."""
    one, law = np.eye(2), hpcred.laws.Maxwell(factors=(0.5,), times=(0.1,))
    plain = hpcred.ReducedModel(one, 0 * one, np.diag([1.0, 4.0]), one, one, np.ones(2), 0.0, ("a", "b"), ("a", "b"))
    for key in ("K", "record", "operator"):
        with pytest.raises(FrozenInstanceError):
            setattr(plain, key, None)
    stiff = replace(plain, K=2 * plain.K)
    assert np.allclose(np.abs(stiff.poles()), np.sqrt(2) * np.abs(plain.poles()))
    assert stiff.M is plain.M and stiff.B is plain.B and not plain.viscoelastic
    damped = replace(stiff, viscoelastic=[Term(one, law, "Kv")])
    assert damped.K is stiff.K and damped.operator["Kv1"] is one
    assert not replace(damped, viscoelastic=()).added and replace(damped, operator=plain.operator).K is plain.K
    expected = np.linalg.inv((2j) ** 2 * one + stiff.K + law.coefficient(2j) * one)
    assert np.allclose(damped.transfer_function(2j), expected)


def test_what_a_reduced_model_needs():
    one = np.eye(1)
    with pytest.raises(TypeError, match="found no D, K, B, C, frequencies, expected M, D, K, B, C and frequencies"):
        hpcred.ReducedModel(M=one)
    with pytest.raises(TypeError, match="found no M, B, expected"):
        hpcred.ReducedModel(operator=Operator.of(None, one, one), C=one, frequencies=np.ones(1))


def test_parts_of_a_basis_that_are_not_known_make_none():
    """As of a record that another program has made."""
    with hpcred.linkage() as model, pytest.raises(InputError, match="kind 'theirs', whose class is not known here"):
        hpcred.reduce(model, (UnknownPart("theirs", {"count": 3}),))
    with hpcred.linkage() as model, pytest.raises(InputError, match="kind 'modes' with settings that it does not take"):
        hpcred.reduce(model, (UnknownPart("modes", {"count": "many"}),))


def test_parts_of_a_basis_that_were_read_before_their_classes_were_known(hpcred, tmp_path):
    """As in a process that begins by reading a result."""
    basis = [package.Modes(count=2), package.SecondOrderKrylov(frequency=9.0)]
    with package.linkage() as model, package.reduce(model, basis, package.Buckens()) as rom:
        package.write_result(tmp_path / "rom.h5", rom, model)
    script = (
        "import hpcred\n"
        "basis = hpcred.read_result('rom.h5').reduced.record.basis\n"
        "print(*(type(part).__name__ for part in basis))\n"
        "with hpcred.linkage() as model, hpcred.reduce(model, basis, hpcred.Buckens()) as rom:\n"
        "    print(*(part.kind for part in rom.record.basis), rom.record.basis[0] == hpcred.Modes(count=2))"
    )
    run = hpcred(program=("-c", script))
    assert run.stdout.split() == ["UnknownPart"] * 2 + ["modes", "second_order_krylov", "True"], run.stderr
