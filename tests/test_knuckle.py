"""FEDEM's steering knuckle, assembled by CalculiX from a Nastran mesh with RBE2."""

import shutil

import numpy as np
import pytest

import hpcred
from benchmarks.models import MODELS
from benchmarks.models import knuckle as made_of
from tests.shared_data import shared

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")]
KNUCKLE = MODELS["knuckle"]


@pytest.fixture(scope="module")
def mesh():
    pytest.importorskip("pyNastran")
    return shared("real/knuckle.nas")


@pytest.fixture(scope="module")
def model(mesh):
    with KNUCKLE.model() as assembled:
        yield assembled


def test_modes_are_those_of_calculix(mesh, model):
    assert model.size == KNUCKLE.n and len(model.input_names) == 24
    found = hpcred.natural_modes(model, count=12).frequencies
    own = made_of.frequencies(mesh, 12)
    assert np.abs(found[6:] / own[6:] - 1).max() < 1e-6  # as many digits as CalculiX prints
    assert np.abs(found[:6]).max() < 1e-6 * found[6] and np.abs(own[:6]).max() < 1e-5 * own[6]


def test_reduced_to_a_tolerance_and_as_fedem_does(mesh, model):
    with KNUCKLE.reduce(model) as rom:
        assert rom.record.accuracy.reached and 20 < rom.size < 45
        check = hpcred.check_reduced(rom, model, 4, seed=2)
        assert check.passed, check.sentence
        modes = rom.frequencies[:4]
    exact = hpcred.natural_modes(model, count=10).frequencies[6:]
    assert np.abs(modes / exact - 1).max() < 1e-6
    jointed = made_of.with_interfaces(model)
    with (
        jointed,
        hpcred.reduce(jointed, hpcred.CraigBampton(count=made_of.fedem_modes(mesh)), hpcred.Buckens()) as theirs,
    ):
        assert theirs.size == 24 - 6 + 12
        # from above, as Rayleigh's quotients are, and less accurate at nearly the same size
        above = theirs.frequencies[:4] / exact - 1
        assert (above > 1e-5).all() and above.max() < 1e-2


@pytest.mark.parametrize("old, new, message", [
    ("PSOLID  ", "CONM2          1       1       0     1.0\nPSOLID  ", "found CONM2, expected only"),
    ("3993       4  123456", "3993       4     123", "RBE2 3993: found the directions 123, expected 123456"),
    ("3994       1  123456", "3994       3  123456", "found RBE2 of different nodes that share a node"),
])  # fmt: skip
def test_meshes_that_are_refused(mesh, tmp_path, old, new, message):
    text = mesh.read_text()
    assert text.count(old) == 1
    (tmp_path / "other.nas").write_text(text.replace(old, new))
    with pytest.raises(hpcred.InputError, match=message):
        made_of.input_lines(tmp_path / "other.nas")
