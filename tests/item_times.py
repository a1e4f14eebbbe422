"""Processor seconds of each item, with those of the processes that it waits for: where the time of the suite goes.

HPCRED_TEST_TIMES names a file, to which each rank appends a line with seconds and item (`make test`: build/test-times).
`python tests/item_times.py FILE` shows the items above MOST that do not say `costly`, and the sums of files.
"""

import os
import resource
import sys
from collections import Counter
from pathlib import Path

import pytest

TIMES = os.environ.get("HPCRED_TEST_TIMES")
MOST = 2.0  # seconds of an item that is quick

started = {}


def processor_seconds():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(time.ru_utime + time.ru_stime for time in used)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    started[item.nodeid] = processor_seconds()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item):
    if TIMES and item.nodeid in started:
        costly = item.get_closest_marker("costly")
        seconds = processor_seconds() - started.pop(item.nodeid)
        with open(TIMES, "a") as file:  # one write a line, so that ranks do not mix
            file.write(f"{seconds:.2f}\t{'costly' if costly else ''}\t{item.nodeid}\n")


def main(path, shown=20):
    items, costly, files = Counter(), set(), Counter()
    for line in Path(path).read_text().splitlines():
        seconds, mark, name = line.split("\t")
        items[name] += float(seconds)
        files[name.partition("::")[0]] += float(seconds)
        costly |= {name} if mark else set()
    for name, seconds in items.most_common():
        if seconds > MOST and name not in costly:
            print(f"{seconds:7.1f} s  {name}")
    print(f"{sum(items.values()):7.0f} s in all, of {len(items)} items; the files that take most:")
    for name, seconds in files.most_common(shown):
        print(f"{seconds:7.1f} s  {name}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
