"""Bands that look wrong: in rad/s, and above what bearings transmit."""

import numpy as np
import pytest

import hpcred
from hpcred.reduction.checks import warnings_of_band


def said(model, upper):
    return " ".join(warnings_of_band(model, (0.0, upper)))


@pytest.mark.mpi
def test_a_band_in_radians_is_asked_about(comm):
    with hpcred.solid((3, 2, 2), (0.3, 0.2, 0.2), comm=comm) as model:
        for upper, meant in {25132.7: 4000, 8e3 * np.pi: 4000, 6283.0: 1000, 9424.78: 1500, 1884.9556: 300}.items():
            assert f"2 pi times {meant};" in said(model, upper), upper
        for upper in (4000.0, 25000.0, 300.0, 6280.0, 8191.0, 12345.0, 1234.5):
            assert "2 pi" not in said(model, upper), upper


def test_few_numbers_are_round_ones_times_two_pi_by_accident():
    random = np.random.default_rng(1)
    from hpcred.reduction.checks import _in_radians

    for digits in range(4, 9):
        drawn = [float(f"{10**value:.{digits - 1}e}") for value in random.uniform(2, 5, 4000)]
        assert sum(_in_radians(value) is not None for value in drawn) < 0.012 * len(drawn)


@pytest.mark.mpi
def test_a_band_above_what_bearings_transmit_is_asked_about(comm):
    """Steel has shear waves of 3207 m/s, which at 1 MHz are 3 mm long; the eyes of the rod are centimetres wide."""
    with hpcred.crank(600, comm=comm) as model:
        eyes = [hpcred.Interface(name=name, nodes=hpcred.Nodes(set=name)) for name in ("BIG_EYE", "SMALL_EYE")]
        with model.with_interfaces(eyes) as held:
            assert "bearing" not in said(held, 50e3)
            assert "waves of shear are shorter than the smallest bearing" in said(held, 1e6)
