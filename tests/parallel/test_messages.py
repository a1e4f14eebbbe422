"""Messages go to the logger "hpcred", whose handlers and levels decide; without any a terminal shows what it did."""

import io
import logging
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers import damped

import hpcred
from hpcred.cli.main import run
from hpcred.parallel import failures
from hpcred.parallel.messages import LOGGER
from hpcred.parallel.progress import Progress

JOB = """
model = "model.h5"
output = "result.h5"
damping = {kind = "none"}
basis = [{kind = "modes", count = 3}]
"""


class Kept(logging.Handler):
    """A handler of a user's."""

    def __init__(self):
        super().__init__()
        self.records = []

    def emit(self, record):
        self.records.append(record)

    def of(self, level):
        return [record.getMessage() for record in self.records if record.levelno == level]


@pytest.fixture
def kept(logger):
    logger.addHandler(handler := Kept())
    return handler


@contextmanager
def reduced(solid):
    """A reduction that says what it does, and warns of a damping matrix that is left out."""
    with damped(solid)[0] as model, hpcred.reduce(model, hpcred.Modes(count=3), damping=hpcred.NoDamping()) as found:
        yield found


@pytest.mark.mpi
def test_a_handler_gets_progress_and_each_warning_once_on_rank_0(solid, kept, capsys):
    LOGGER.setLevel(logging.INFO)
    with reduced(solid) as found:
        warnings = list(found.record.warnings)
    assert any("damping: none" in item for item in warnings)
    assert kept.of(logging.WARNING) == (warnings if solid.comm.rank == 0 else [])
    assert bool(kept.of(logging.INFO)) == (solid.comm.rank == 0)
    assert not capsys.readouterr().err


@pytest.mark.mpi(ranks=(1,), build="real")
def test_levels_choose_what_a_handler_gets(solid, kept):
    for level, known in ((logging.NOTSET, {logging.WARNING}), (logging.WARNING, {logging.WARNING}),
                         (logging.ERROR, set())):  # fmt: skip
        kept.records.clear()
        LOGGER.setLevel(level)  # not set: that of the root logger, which is WARNING
        with reduced(solid):
            assert {record.levelno for record in kept.records} == known


def test_a_workflow_logs_what_its_result_warns_of_once(solid, kept, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with damped(solid)[0] as model:
        hpcred.write_model("model.h5", model)
    Path("job.toml").write_text(JOB)
    warnings = list(hpcred.reduce_job("job.toml").record.warnings)
    assert warnings and kept.of(logging.WARNING) == warnings
    kept.records.clear()
    assert hpcred.info("result.h5")["warnings"] == kept.of(logging.WARNING) == warnings


def test_without_a_handler_a_session_shows_what_progress_is_asked_for(comm, logger, capsys):
    silent, shown = Progress(comm, show=False), Progress(comm, show=True)
    for progress in (silent, shown):
        progress.say("a stage")
        progress.tell("a line")
        progress.warn("a doubt")
        progress.found({"warnings": ["a doubt: 3", "of the result"]})
    first, *others = capsys.readouterr().err.splitlines()
    assert first.endswith(" MB] a stage") and others == ["a line", "warning: a doubt"]


def silenced_by_level(logger):
    logger.setLevel(logging.CRITICAL + 1)


def silenced_by_null_handler(logger):
    logger.addHandler(logging.NullHandler())


def silenced_by_being_disabled(logger):
    logger.disabled = True


def silenced_with_all_others(logger):
    logging.disable()


@pytest.mark.parametrize(
    "silence", [silenced_by_level, silenced_by_null_handler, silenced_by_being_disabled, silenced_with_all_others]
)
def test_every_message_can_be_silenced(comm, logger, capsys, silence):
    silence(logger)
    progress = Progress(comm, show=True)
    progress.say("a stage")
    progress.warn("a doubt")
    failures._say(hpcred.InputError("an error that ends a job"))
    assert not capsys.readouterr().err


def test_a_level_alone_leaves_warnings_out_of_progress(comm, logger, capsys):
    logger.setLevel(logging.WARNING)
    progress = Progress(comm, show=True)
    progress.say("a stage")
    progress.warn("a doubt")
    assert capsys.readouterr().err == "warning: a doubt\n"


def test_what_ends_a_job_is_critical(kept, capsys):
    failures._say(hpcred.InputError("model: found a\nb"))
    assert kept.of(logging.CRITICAL) == ["error: model: found a b"] and not capsys.readouterr().err


def test_lines_follow_a_stream_that_is_replaced_as_in_notebooks(comm, logger, monkeypatch):
    progress = Progress(comm, show=True)
    monkeypatch.setattr(sys, "stderr", cell := io.StringIO())
    progress.tell("in this cell")
    monkeypatch.setattr(sys, "stderr", another := io.StringIO())
    progress.tell("in another")
    assert (cell.getvalue(), another.getvalue()) == ("in this cell\n", "in another\n")


def test_the_command_line_is_the_same_whatever_the_root_logger_has(logger, monkeypatch, capsys):
    """A plug-in may have called logging.basicConfig."""
    told = []
    for handlers in ([], [logging.StreamHandler(sys.stderr)]):
        monkeypatch.setattr(logging.getLogger(), "handlers", handlers)
        assert run(["info", "missing.h5"]) == 2
        told.append(capsys.readouterr().err)
    assert told[0] == told[1] and told[0].startswith("hpcred: error: missing.h5")
