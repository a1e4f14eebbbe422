"""From which speed on a body that spins is told of: by the elastic energy of the full model, solved in numpy."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import dense_model

import hpcred
from hpcred import Modes
from hpcred.body.body import body_of
from hpcred.body.spin_stress import lacks_spin, warnings_of_spin

SPINS = np.array([[300.0, -40.0, 100.0], [20.0, 10.0, -30.0], [-200.0, 90.0, 150.0], [0.0, 0.0, 0.0]])


def test_energy_of_a_body_that_spins_is_that_of_the_full_model():
    with hpcred.solid((2, 1, 1)) as model, hpcred.reduce(model, [Modes(count=24)]) as rom:
        body, (K, M, _) = body_of(model, rom), dense_model(model)
        points = model.dofs.position[::3]
    forces = np.array([M @ -np.cross(w, np.cross(w, points)).ravel() for w in SPINS])
    energy = (forces * np.linalg.solve(K, forces.T).T).sum(axis=1).max() / 2
    (told,) = warnings_of_spin(body, SPINS, 0.999 * energy / 0.1**2)
    assert told.startswith("stress: the body turns by up to 319 rad/s")  # the norm of the first
    assert not warnings_of_spin(body, SPINS, 1.001 * energy / 0.1**2)
    assert not warnings_of_spin(body, SPINS[:0], 0.0)
    assert np.linalg.norm(SPINS, axis=1).max() == pytest.approx(319, abs=0.5)


def test_loads_that_may_be_centrifugal():
    for kind, spins, lacks in (("pressure", False, True), ("given", False, False), ("deck", True, False)):
        item = hpcred.loads.LoadColumn(name="l", kind=kind, force=(0.0,) * 3, moment=(0.0,) * 3, spins=spins)
        assert lacks_spin(SimpleNamespace(loads=(item,))) == lacks
    assert lacks_spin(SimpleNamespace(loads=())) and not lacks_spin(None)
