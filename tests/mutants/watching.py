"""A plugin of pytest under coverage: a context and the time of each test; HPCRED_WATCHED names the file of times."""

import json
import os

import coverage
import pytest

seconds, failed, every = {}, [], []


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    every.extend(item.nodeid for item in items)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    coverage.Coverage.current().switch_context(item.nodeid)
    return (yield)


def pytest_runtest_logreport(report):
    seconds[report.nodeid] = seconds.get(report.nodeid, 0.0) + report.duration
    if report.failed:
        failed.append(report.nodeid)


def pytest_sessionfinish():
    with open(os.environ["HPCRED_WATCHED"], "w") as file:
        json.dump({"seconds": seconds, "failed": failed, "every": every}, file)
