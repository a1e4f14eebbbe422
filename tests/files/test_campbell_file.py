"""Files of Campbell diagrams: what is written is read again, and tables have a column for each quantity."""

from dataclasses import replace

import numpy as np
import pytest

import hpcred
from hpcred.analysis import CriticalSpeed, FullPoles
from hpcred.files.campbell_file import kind_of_campbell
from hpcred.files.outputs import OtherKind, kind_of
from hpcred.files.response_file import FORMAT as RESPONSES


@pytest.fixture
def diagram():
    """Two modes, of which one begins later, with a full model and all else that there can be."""
    poles = np.array([[-1 + 10j, complex(np.nan, np.nan)], [-2 + 11j, -3 + 0j], [1 + 12j, -4 + 0j]])
    critical = CriticalSpeed(order=2.0, mode=0, value=5.5, frequency=1.7, damping_ratio=0.1, whirl="forward")
    full = tuple(FullPoles(value=value, poles=np.array([-1 + 10j, -2 + value * 1j]), residual=1e-12)
                 for value in (0.0, 2.5))  # fmt: skip
    return hpcred.analysis.Campbell(
        parameter="omega", unit="rad/s", values=np.array([0.0, 2.5, 10.0]), poles=poles, orders=(1.0, 2.0), highest=5.0,
        orbits=np.array([[0.0, np.nan], [0.9, 0.0], [1.0, 0.0]]), stability_limit=7.0, unstable_frequency=1.8,
        critical_speeds=(critical,), full=full, warnings=("a warning",),
    )  # fmt: skip


def test_hdf5_and_back(diagram, tmp_path, comm):
    hpcred.files.write_campbell(tmp_path / "c.h5", diagram, comm, {"result": "r.h5"})
    again = hpcred.files.read_campbell(tmp_path / "c.h5")
    for key in ("values", "poles", "orbits", "frequencies", "damping_ratios"):
        assert np.array_equal(getattr(again, key), getattr(diagram, key), equal_nan=True)
    for key in ("parameter", "unit", "orders", "highest", "stability_limit", "unstable_frequency", "critical_speeds",
                "warnings", "whirl"):  # fmt: skip
        assert getattr(again, key) == getattr(diagram, key)
    assert [item.value for item in again.full] == [0.0, 2.5]
    for one, other in zip(again.full, diagram.full, strict=True):
        assert np.array_equal(one.poles, other.poles) and one.residual == other.residual


def test_a_stable_model_without_more(diagram, tmp_path, comm):
    plain = replace(diagram, stability_limit=None, unstable_frequency=None, critical_speeds=(), full=(), orders=())
    hpcred.files.write_campbell(tmp_path / "c.h5", plain, comm)
    again = hpcred.files.read_campbell(tmp_path / "c.h5")
    assert again.stability_limit is None and again.full == again.critical_speeds == again.orders == ()


def test_csv(diagram, tmp_path, comm):
    path = tmp_path / "c.csv"
    hpcred.files.write_campbell(path, diagram, comm)
    head = path.read_text().splitlines()[0].split(",")
    assert head == ["omega", "rpm", "f_1_hz", "damping_1", "orbit_1", "f_2_hz", "damping_2", "orbit_2"]
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert table["rpm"][-1] == pytest.approx(300 / np.pi)
    assert np.array_equal(table["f_1_hz"], diagram.frequencies[:, 0]) and np.isnan(table["f_2_hz"][0])
    assert np.array_equal(table["damping_1"], diagram.damping_ratios[:, 0])
    kind = kind_of_campbell(path, "omega")
    assert isinstance(kind, OtherKind) and kind.begins(path.read_bytes()) and not kind.begins(b"omega,depth\n1,2\n")


def test_other_files_are_refused(tmp_path, comm):
    responses = hpcred.files.Responses(frequencies=np.zeros(1), input_names=("u",), output_names=("u",))
    hpcred.files.write_responses(tmp_path / "r.h5", responses, comm)
    assert RESPONSES in kind_of(tmp_path / "r.h5")
    with pytest.raises(hpcred.InputError, match="hpcred-campbell"):
        hpcred.files.read_campbell(tmp_path / "r.h5")
