"""Drives: each rate is the derivative of its value, and values are what the docstrings say."""

import numpy as np
import pytest

from hpcred.simulation.drives import ConstantDrive, RampDrive, SineDrive, TableDrive

WHERE = {"node": 1, "along": (1.0, 0.0, 0.0)}
DRIVES = [
    ConstantDrive(**WHERE, value=2.0), RampDrive(**WHERE, rate=3.0), RampDrive(**WHERE, rate=3.0, duration=0.4),
    SineDrive(**WHERE, amplitude=2.0, frequency=3.0), SineDrive(**WHERE, amplitude=2.0, frequency=3.0, phase=0.7),
    TableDrive(**WHERE, times=(0.1, 0.3, 0.6), values=(1.0, 4.0, 2.0)),
]  # fmt: skip


@pytest.mark.parametrize("drive", DRIVES, ids=lambda drive: type(drive).__name__)
def test_the_rate_is_the_derivative_of_the_value(drive):
    step = 1e-5
    for t in (0.05, 0.17, 0.35, 0.55, 0.9):
        slope = (drive(t + step)[0] - drive(t - step)[0]) / (2 * step)
        assert drive(t)[1] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_values():
    assert ConstantDrive(**WHERE, value=2.0)(0.3) == (2.0, 0.0)
    assert RampDrive(**WHERE, rate=3.0)(0.3) == pytest.approx((0.9, 3.0))
    ramp = RampDrive(**WHERE, rate=3.0, duration=0.4)
    assert ramp(0.0) == pytest.approx((0.0, 0.0), abs=1e-12) and ramp(0.4) == pytest.approx((0.6, 3.0))
    assert ramp(1.0) == pytest.approx((3.0 * (1.0 - 0.2), 3.0))
    assert SineDrive(**WHERE, amplitude=2.0, frequency=3.0)(0.0) == pytest.approx((0.0, 12 * np.pi))
    table = TableDrive(**WHERE, times=(0.1, 0.3, 0.6), values=(1.0, 4.0, 2.0))
    assert [table(t)[0] for t in (0.0, 0.1, 0.3, 0.6, 0.9)] == pytest.approx([1.0, 1.0, 4.0, 2.0, 2.0])
    assert [table(t)[1] for t in (0.0, 0.1, 0.6, 0.9)] == pytest.approx([0.0] * 4)
