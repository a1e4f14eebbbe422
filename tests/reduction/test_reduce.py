"""Dependent columns, dropped frequencies, memory after many reductions."""

import pytest

import hpcred
from hpcred import Krylov, Modes, StaticCorrection
from hpcred.examples import linkage as example

pytestmark = pytest.mark.mpi


def test_dependent_inputs_and_repeated_points_are_dropped_and_counted(solid):
    solid = solid.with_inputs([(45, "x"), (45, "z"), (45, "x"), (48, "y")])
    with hpcred.reduce(solid, [Krylov(400.0, 1), Krylov(400.0, 1), StaticCorrection()]) as rom:
        assert rom.size == 9
        kept = [(item.columns, item.kept) for item in rom.record.components]
        assert kept == [(4, 3), (3, 3), (3, 3), (3, 0), (3, 0), (3, 3)]


def test_drop_above_and_band_without_modes(linkage):
    with hpcred.reduce(linkage, [Modes(band=(0.0, 5.0)), Krylov(10.0, 3)], example.FRAME, drop_above=200.0) as rom:
        assert rom.record.components[0].columns == 0
        assert rom.frequencies.max() <= 200.0 and rom.size < 4


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.costly
def test_repeated_reductions_do_not_pile_up_memory(comm):
    """petsc4py frees nothing by itself."""
    from pathlib import Path

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

    with hpcred.solid((10, 8, 8), inputs=6, comm=comm) as model:
        sizes = []
        for _ in range(8):
            hpcred.reduce(model, [Krylov(100.0, 1), Modes(count=2)]).close()
            sizes.append(resident())
    # one run keeps more than 5 MB in its matrices, factor and vectors, and the allocator comes to rest only slowly
    assert sizes[-1] - sizes[3] < 4 * 5.0 / 2
