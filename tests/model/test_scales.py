"""Powers of two for inputs and outputs in units far from those of the rest."""

import numpy as np
import pytest

import hpcred
from hpcred.model.scales import in_usual_units

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("size, usual", [(0.0, True), (1e-40, True), (3.0, True), (1e40, True), (1e-60, False),
                                         (1e60, False), (1e200, False)])  # fmt: skip
def test_only_what_is_far_from_one_is_scaled_and_keeps_its_digits(comm, size, usual):
    loads, measures = size * np.array([[1.0], [-0.7], [0.0]]), np.ones((3, 1))
    columns = {"inputs": loads, "input_names": ["u"], "outputs": measures, "output_names": ["y"]}
    with (
        hpcred.SecondOrderModel.from_scipy(np.eye(3), np.eye(3), comm=comm, **columns) as model,
        in_usual_units(model) as (other, inputs, outputs),
    ):
        assert outputs == 1.0 and (inputs == 1.0) == usual == (other is model)
        assert np.log2(inputs) == round(np.log2(inputs)) and (usual or 0.25 <= size / inputs <= 1.0)
        mine = np.concatenate(comm.allgather(other.B.getDenseArray().real))
        assert np.array_equal(mine * inputs, loads)
        assert np.array_equal(np.concatenate(comm.allgather(other.Ct.getDenseArray().real)), measures)
