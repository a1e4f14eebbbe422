"""rom.plot() and model.plot_modes(): what the figures show, against the numbers themselves."""

import sys

import numpy as np
import pytest
from helpers import bar

import hpcred
from hpcred import Chord, InputError, Krylov, Modes, Rayleigh
from hpcred.parallel.petsc import MPI

pytestmark = pytest.mark.mpi
FRAME = Chord(nodes=(1, 7, 14), axes="yxz")


@pytest.fixture(scope="module")
def model():
    with hpcred.linkage() as found:
        yield found


def curves(axes):
    return {line.get_label(): line.get_xydata().T for line in axes.lines}


@pytest.mark.costly
def test_responses_with_their_peaks_units_and_error(model):
    with hpcred.reduce(model, tolerance=1e-4, band=(0, 300), frame=FRAME, damping=Rayleigh(2.0, 1e-5)) as rom:
        figure = rom.plot()
        size, phase, error = figure.axes
        (label, (f, H)), = curves(size).items()  # fmt: skip
        exact = hpcred.frequency_response(rom, f)[:, 0, 0]
        accuracy = rom.record.accuracy
    assert label == "20:z/20:z" and size.get_ylabel() == "|H| (m/N)" and error.get_xlabel() == "frequency (Hz)"
    np.testing.assert_allclose(H, np.abs(exact), rtol=1e-9)
    fine = np.linspace(23, 25, 20001)  # of the first resonance
    assert H.max() == pytest.approx(np.abs(hpcred.frequency_response(rom, fine)).max(), rel=1e-3)
    np.testing.assert_allclose(error.lines[0].get_xydata().T, [accuracy.frequencies, accuracy.eps])
    assert error.lines[1].get_ydata()[0] == 1e-4
    assert figure._repr_png_().startswith(b"\x89PNG")


@pytest.mark.costly
def test_chosen_pairs_band_and_models_without_accuracy(model):
    with model.with_inputs([(20, "z"), (20, "rx")]) as loaded, loaded.with_outputs([(12, "z"), (20, "z")]) as seen:
        rom = hpcred.reduce(seen, [Modes(count=8), Krylov(frequency=0.0, order=0)], FRAME)
    rom.close()
    size, phase = rom.plot().axes
    assert list(curves(size)) == ["20:z/20:z"]  # the drive point
    size, phase = rom.plot(["12:z/20:rx", "20:z/20:z"], band=(5, 40)).axes
    assert list(curves(size)) == ["12:z/20:rx (m/(N m))", "20:z/20:z (m/N)"]
    assert size.get_ylabel() == "|H| (m/(N m), m/N)" and size.get_xlim() == (5, 40)
    for arguments, says in (
        ({"pairs": "1:x/2:y"}, "found '1:x/2:y', expected output/input"), ({"band": (9, 3)}, "expected 0 <= lower"),
        ({"pairs": "foo.xyz"}, r"'foo.xyz', which looks like a file; .* plot\(...\).savefig\('foo.xyz'\)"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            rom.plot(**arguments)


@pytest.mark.costly
def test_the_lowest_elastic_modes(model):
    expected = hpcred.natural_modes(model, 10)
    expected.close()
    figure = model.plot_modes(3)
    assert (figure is None) == bool(MPI.COMM_WORLD.rank)
    if figure is not None:
        pictures = [axes for axes in figure.axes if axes.images and axes.get_title()[:1].isdigit()]
        shown = [float(axes.get_title().split()[1]) for axes in pictures]
        assert shown == pytest.approx(expected.frequencies[6:9], rel=1e-3)
        assert all(np.ptp(axes.images[0].get_array()) > 0.5 for axes in pictures)
    figure = model.plot_modes(1, frame=FRAME)
    if figure is not None:
        assert figure.axes[0].get_title().startswith("1:")


def test_small_models_and_models_without_nodes(comm):
    with bar(comm, 1.0, 2) as small:
        figure = small.plot_modes(2)
        assert (figure is None) == bool(MPI.COMM_WORLD.rank)
        with pytest.raises(InputError, match="count: found 0, expected at least 1"):
            small.plot_modes(0)
    with hpcred.SecondOrderModel.from_scipy(2 * np.eye(6), np.eye(6)) as bare, pytest.raises(
        InputError, match="has no nodes to draw"
    ):
        bare.plot_modes()


@pytest.mark.costly
def test_pyplot_knows_nothing_and_matplotlib_may_be_missing(model, monkeypatch):
    from matplotlib._pylab_helpers import Gcf

    with hpcred.reduce(model, [Modes(count=8)], FRAME) as rom:
        known = Gcf.get_num_fig_managers()
        rom.plot()
        model.plot_modes(1)
        assert Gcf.get_num_fig_managers() == known
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
        for draw in (rom.plot, model.plot_modes):
            with pytest.raises(InputError, match="figures need matplotlib: pip install"):
                draw()
