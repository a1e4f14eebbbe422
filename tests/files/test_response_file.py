"""Files of responses: what is written is read again, to the last digit, by h5py, csv and numpy."""

import csv

import numpy as np
import pytest

from hpcred import InputError
from hpcred.files import Responses, read_responses, write_responses

PAIRS = ["20:z/1:x", "20:z/B.mtx, column 2"]


@pytest.fixture
def responses():
    random = np.random.default_rng(1)
    H = random.standard_normal((5, 1, 2)) + 1j * random.standard_normal((5, 1, 2))
    return Responses(
        frequencies=np.linspace(0, 0.3, 5), input_names=("1:x", "B.mtx, column 2"), output_names=("20:z",), response=H,
        eps=random.random(5), record={"tolerance": 1e-6},
    )  # fmt: skip


def test_hdf5_and_back(responses, tmp_path, comm):
    write_responses(tmp_path / "r.h5", responses, comm)
    again = read_responses(tmp_path / "r.h5")
    for key in ("frequencies", "response", "eps"):
        assert np.array_equal(getattr(again, key), getattr(responses, key))
    assert again.input_names == responses.input_names and again.output_names == responses.output_names
    assert again.record == responses.record and again.reduced is None and again.full is None


@pytest.mark.parametrize("polar", [False, True])
def test_csv(responses, tmp_path, comm, polar):
    """Names with commas stay one column, and complex numbers come back."""
    write_responses(tmp_path / "r.csv", responses, comm, polar)
    with open(tmp_path / "r.csv", newline="") as file:
        head, *lines = csv.reader(file)
    first, second = ("abs", "deg") if polar else ("re", "im")
    assert head == ["f_hz", *(f"{part}_{pair}" for pair in PAIRS for part in (first, second)), "eps"]
    values = np.array(lines, dtype=float)
    a, b = values[:, 1:-1:2], values[:, 2:-1:2]
    found = a * np.exp(1j * np.deg2rad(b)) if polar else a + 1j * b
    if polar:
        assert np.allclose(found, responses.response[:, 0], rtol=1e-14, atol=0)
    else:
        assert np.array_equal(found, responses.response[:, 0])
    assert np.array_equal(values[:, 0], responses.frequencies) and np.array_equal(values[:, -1], responses.eps)


def test_two_responses_in_one_csv(responses, tmp_path, comm):
    responses.reduced, responses.full, responses.response = responses.response, 2 * responses.response, None
    write_responses(tmp_path / "r.csv", responses, comm)
    head = (tmp_path / "r.csv").read_text().splitlines()[0]
    assert "re_20:z/1:x_reduced" in head and "im_20:z/1:x_full" in head


def test_another_file_is_refused(tmp_path, comm, responses):
    (tmp_path / "r.h5").write_text("f_hz,re_1\n")
    with pytest.raises(InputError, match="found no HDF5 file, expected one of format"):
        read_responses(tmp_path / "r.h5")
