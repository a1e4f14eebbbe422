"""Model files keep what they are given."""

import numpy as np
import pytest
from helpers import columns_of, to_dense

import hpcred

pytestmark = pytest.mark.mpi


def test_model_file_keeps_everything(comm, folder):
    with hpcred.linkage(comm) as model:
        model = model.with_inputs([(20, "z"), (1, "rx")])
        model = model.with_outputs([(5, "y")])
        K, M, B = to_dense(model.K), to_dense(model.M), columns_of(model.B)
        hpcred.write_model(folder / "a.h5", model)
    with hpcred.read_model(folder / "a.h5", comm) as model:
        for mat, expected in ((model.K, K), (model.M, M)):
            assert np.array_equal(to_dense(mat), expected)
        assert np.array_equal(columns_of(model.B), B)
        assert model.input_names == ("20:z", "1:rx") and model.output_names == ("5:y",)
        assert columns_of(model.Ct)[25 + 0, 0] == 1.0 or columns_of(model.Ct).sum() == 1.0
        assert (model.dofs.node == (np.arange(120) // 6 + 1)[model.first_row :][: model.local_rows]).all()
