"""A request to stop that one rank gets stops all of them, at the same place, and the run goes on from there."""

import os
import signal

import numpy as np
import pytest
from helpers import CHORD_JOB

import hpcred
from hpcred.files.point_store import PointStore
from hpcred.parallel.stopping import Stopped, listening, stop_if_asked

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_all_ranks_stop_where_one_was_asked(comm, number):
    with listening():
        stop_if_asked(comm, "nothing")
        if comm.rank == comm.size - 1:
            os.kill(os.getpid(), number)
        with pytest.raises(Stopped, match="after point 1"):
            stop_if_asked(comm, "point 1")
    stop_if_asked(comm, "no longer listened to")
    with listening():
        stop_if_asked(comm, "a later run")


def test_signals_mean_what_they_meant_when_nobody_listens(comm):
    before = signal.getsignal(signal.SIGTERM)
    with listening(False):
        assert signal.getsignal(signal.SIGTERM) is before
    with listening():
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.mpi(ranks=(1, 2))
def test_a_stopped_search_goes_on_and_gives_the_same_model(comm, folder, monkeypatch):
    job = CHORD_JOB.partition("[[basis]]")[0].replace("[frame]", "tolerance = 1e-7\nband = [1.0, 300.0]\n[frame]")
    with hpcred.linkage(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(job)
    comm.Barrier()
    undisturbed = hpcred.reduce_job(folder / "job.toml", overrides=["output='undisturbed.h5'"], comm=comm)
    save = PointStore.save

    def save_and_ask(self, *state):
        save(self, *state)
        if comm.rank == comm.size - 1:
            os.kill(os.getpid(), signal.SIGUSR1)

    with monkeypatch.context() as patch:
        patch.setattr(PointStore, "save", save_and_ask)
        with pytest.raises(Stopped, match="after point 1"):
            hpcred.reduce_job(folder / "job.toml", overrides=[f"store='{folder / 'points'}'"], comm=comm)
    assert not (folder / "result.h5").exists()
    again = hpcred.reduce_job(folder / "job.toml", overrides=[f"store='{folder / 'points'}'"], comm=comm)
    # the columns of the first point; its factor is made again for modes that no load moves, where the search goes on
    assert again.record.components[0].from_store and not undisturbed.record.components[0].from_store
    grid = np.linspace(1.0, 300.0, 40)
    one, other = (hpcred.frequency_response(hpcred.read_result(item.output, comm).reduced, grid)
                  for item in (undisturbed, again))  # fmt: skip
    assert hpcred.relative_error(one, other).max() < 1e-6
