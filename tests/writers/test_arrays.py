"""Arrays for NumPy and MATLAB: everything that affects numbers is in them."""

import numpy as np
import pytest
import scipy.io
from helpers import exported

import hpcred
from hpcred import Buckens, Modes, Rayleigh, Structural
from hpcred.body.body import body_of
from hpcred.writers.arrays import BodyMat, BodyNpz


@pytest.mark.parametrize("damping", [Rayleigh(2.0, 1e-5), Structural(0.02)])
@pytest.mark.parametrize("writer, read", [(BodyNpz, np.load), (BodyMat, scipy.io.loadmat)])
def test_arrays_give_the_transfer_function(tmp_path, damping, writer, read):
    """H(s) from the file alone, with D, outputs and loss factor, is that of the reduced model."""
    with hpcred.linkage() as model:
        model = model.with_inputs([(20, "z"), (1, "x")])
        model = model.with_outputs([(7, "y")])
        with hpcred.reduce(model, [Modes(index=tuple(range(7, 13)))], Buckens(), damping) as rom:
            body = body_of(model, rom)
    exported(writer, tmp_path / "body", body)
    file = read(tmp_path / "body")
    s, eta = 2j * np.pi * rom.frequencies[0], np.ravel(file["loss_factor"])[0]
    dynamic = s * s * file["M"] + s * file["D"] + (1 + 1j * eta) * file["K"]
    found = file["C"] @ np.linalg.solve(dynamic, file["B"])
    assert found == pytest.approx(rom.transfer_function(s), rel=1e-12)
    names = [str(np.ravel(name)[0]) for key in ("input_names", "output_names") for name in np.ravel(file[key])]
    assert names == ["20:z", "1:x", "7:y"]
    assert file["nodes"].ravel().tolist() == [1, 7, 20]
    assert np.array_equal(file["phi"], [shape.phi for shape in body.nodes])
    assert np.array_equal(file["psi"], [shape.psi for shape in body.nodes])
    assert np.array_equal(file["Cr1"], body.floating_frame.Cr1)
    assert np.ravel(file["mass"])[0] == body.floating_frame.mass and len(file["masses"].ravel()) == 3
    assert "mean of directions" in str(np.ravel(file["comment"])[0])
