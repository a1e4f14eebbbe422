"""Weights with which all inputs and outputs count alike: what the tolerance then says, on any number of ranks."""

import numpy as np
import pytest
from adaptive_models import Case, chain, fresh, reduced_response, unit, up_to

import hpcred
from hpcred.reduction.accuracy import Adaptive
from hpcred.reduction.pseudo_modal import Law, diagonalised, response
from hpcred.reduction.weights import equal_weights, weighed, weighed_ports

pytestmark = pytest.mark.mpi

BAND = (0.0, 2000.0)
EYES = ("BIG_EYE", "SMALL_EYE")


@pytest.fixture
def rod(comm):
    """A free rod with all directions of two bearings: in bending a thousand times softer than along its axis, and in
    rad / (N m) softer than in m / N."""
    bearings = [hpcred.Interface(name=name, nodes=hpcred.Nodes(set=name)) for name in EYES]
    with (
        hpcred.crank(dofs=600, comm=comm) as free,
        free.with_interfaces(bearings) as jointed,
        jointed.with_inputs([(name, "all") for name in EYES]) as loaded,
    ):
        yield loaded


@pytest.fixture
def projected():
    """A random model of 12 coordinates with 3 independent loads, a law, a band in Hz, and ports of 4 inputs and 3
    outputs of very different units."""
    random = np.random.default_rng(3)
    K = np.diag(np.linspace(1.0, 6.0, 12) ** 2 * (2 * np.pi * 100) ** 2)
    model = diagonalised(K, random.standard_normal((12, 3)))
    ports = random.standard_normal((3, 4)) * [1e-6, 1.0, 1e3, 1e9], random.standard_normal((3, 3)) * [1.0, 1e5, 1e-4]
    return model, Law(eta=0.02), (0.0, 500.0), ports


def test_the_largest_response_of_each_output_and_input_becomes_one(projected):
    model, law, band, (Lb, Lc) = projected
    for ports in ((Lb, Lc), (Lb * [1e3, 1e-7, 1.0, 5.0], Lc * [1e-9, 40.0, 2.0])):
        weights = equal_weights(model, law, band, ports)
        frequencies = np.linspace(*band, 2001)
        H = response(model, law, frequencies, weighed_ports(ports, weights))
        assert np.allclose(H, weighed(response(model, law, frequencies, ports), weights))
        mean = np.exp(np.log(np.abs(H)).mean(axis=0))
        assert np.allclose(mean.max(axis=0), 1.0, rtol=0.05) and np.allclose(mean.max(axis=1), 1.0, rtol=0.05)


def test_decoupled_parts_do_not_drive_the_weights_apart():
    """Of two parts one has more outputs, the other more inputs: rows and columns of one norm do not exist there."""
    model = diagonalised(np.diag([1e4, 4e4, 1e5, 2e4, 6e4, 2e5]), np.kron(np.eye(2), np.ones((3, 1))))
    ports = np.repeat(np.eye(2), [6, 1], axis=1), np.repeat(np.eye(2), [1, 6], axis=1)
    outputs, inputs = equal_weights(model, Law(eta=0.02), (0.0, 50.0), ports)
    for part in (outputs[:1] + inputs[:6], outputs[1:] + inputs[6:]):
        assert max(part) < 1e3 * min(part)
    assert np.ptp(inputs[:6]) == 0 and np.ptp(outputs[1:]) == 0


def test_a_gyroscopic_response_has_weights_of_its_own_for_outputs(comm):
    """H is not symmetric there, though outputs are inputs: weighed as one, their difference passed for round-off."""
    K, M = chain(40)
    skew = np.triu(np.random.default_rng(1).uniform(-100.0, 100.0, K.shape), 1)
    case = Case("gyroscopic", K, M, unit(40, 3, 17, 30), up_to(K, M, 8), D=skew - skew.T + 1e-5 * K,
                damping=hpcred.GivenDamping())  # fmt: skip
    adaptive = Adaptive(tolerance=1e-5, band=case.band, weights="equal")
    with case.model(comm) as model, hpcred.reduce(model, damping=case.damping, adaptive=adaptive) as rom:
        accuracy = rom.record.accuracy
        frequencies = fresh(case, rom)
        found = reduced_response(rom, case.law(), frequencies, given=True)
    assert accuracy.reached and accuracy.noise < 1e-7
    assert hpcred.relative_error(case.truth(frequencies), found, accuracy.weights).max() < 1e-5


def test_a_response_is_not_weighed_but_its_error_is(rod):
    """Harmonic analysis to a tolerance with equal weights."""
    law, adaptive = hpcred.Structural(0.01), Adaptive(tolerance=1e-4, band=BAND, weights="equal")
    frequencies = [20.0, 777.0]
    found = hpcred.full_response(rod, frequencies, hpcred.Buckens(), law, adaptive=adaptive, check=2)
    exact = hpcred.frequency_response(rod, frequencies, hpcred.Buckens(), law)
    assert found.accuracy.weights is not None and found.check.passed
    assert hpcred.relative_error(exact, found.response, found.accuracy.weights).max() < 1e-4
    assert hpcred.relative_error(exact, found.response).max() < 1e-3


def test_a_symmetric_response_stays_symmetric_and_silent_ports_keep_their_weight(projected):
    model, law, band, (Lb, _) = projected
    Lb = np.hstack([Lb, np.zeros((3, 1))])
    outputs, inputs = equal_weights(model, law, band, (Lb, Lb))
    assert outputs == inputs and outputs[-1] == 1.0
    weighed_b, weighed_c = weighed_ports((Lb, Lb), (outputs, inputs))
    assert weighed_b is weighed_c


def test_the_tolerance_holds_for_what_is_weighed_and_serves_every_direction(rod, comm):
    """Without weights 1e-2 of all leaves nothing right along the axis."""
    worst = {}
    for weights in ("none", "equal"):
        adaptive = Adaptive(tolerance=1e-2, band=BAND, weights=weights)
        with hpcred.reduce(rod, frame=hpcred.Buckens(), adaptive=adaptive) as rom:
            accuracy = rom.record.accuracy
            check = hpcred.check_reduced(rom, rod, 6, seed=5)
        assert accuracy.reached and (accuracy.weights is None) == (weights == "none")
        assert ("weighed alike" in accuracy.measured) == (weights == "equal")
        assert check.passed and np.allclose(check.said, check.exact, rtol=0.1, atol=1e-6)
        worst[weights] = accuracy.worst_pair[2]
    assert worst["none"] > 0.5 and worst["equal"] < 0.1
    assert "equal weights" not in accuracy.caveat


def test_other_units_of_inputs_and_outputs_give_the_same_body(rod, comm):
    """With weights, a model whose moments are in N mm and rotations in millirad keeps the same coordinates."""
    random = np.random.default_rng(4)
    adaptive, found = Adaptive(tolerance=1e-3, band=BAND, weights="equal"), []
    for scale in (np.ones(12), 10.0 ** random.integers(-6, 7, 12)):
        B = rod.B.getDenseArray().real * scale
        with (
            rod.with_input_columns(B, rod.input_names) as other,
            hpcred.reduce(other, frame=hpcred.Buckens(), adaptive=adaptive) as rom,
        ):
            found.append(rom.frequencies)
    assert np.allclose(*found, rtol=1e-2)
