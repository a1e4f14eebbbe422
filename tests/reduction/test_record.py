"""What tells the model of a result from another one."""

import json
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import block_with_ends
from pydantic import TypeAdapter

import hpcred
from hpcred import GivenDamping, NoDamping
from hpcred.reduction.record import SAME, difference_of
from hpcred.reduction.tolerance.accuracy import Point


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_signatures_differ_where_their_largest_part_would_notice(size):
    expected = {"M": (size, 1e-3 * size), "K": (1e6 * size,)}
    record = SimpleNamespace(signature=expected, damping=NoDamping())
    near, far = size * (1e-3 + 0.5 * SAME), size * (1e-3 + 2 * SAME)
    assert difference_of({**expected, "M": (size, near)}, record) is None
    assert difference_of({**expected, "M": (size, far)}, record) == "M"
    assert difference_of({**expected, "K": (1e6 * size * (1 - 2 * SAME),)}, record) == "K"
    assert difference_of({"M": expected["M"]}, record) == "K"
    assert difference_of({**expected, "M": (size,)}, record) == "M"


def test_damping_counts_where_it_was_used():
    expected = {"M": (1.0,), "D": (2.0,)}
    for damping, found in ((NoDamping(), None), (GivenDamping(), "D")):
        record = SimpleNamespace(signature=expected, damping=damping)
        assert difference_of({"M": (1.0,), "D": (np.pi,)}, record) == found


def test_what_a_search_may_take_and_what_older_records_leave_out():
    """The defaults of Limits, and those of fields that results of earlier versions do not have."""
    limits = hpcred.Limits()
    assert (limits.factorisations, limits.columns, limits.zeta0) == (14, 600, 1e-3)
    known = {item.name: item.default for kind in (hpcred.Accuracy, Point) for item in fields(kind)}
    assert known["loss_factor"] == 0.0 and known["unproven"] == ""
    assert not (known["beside_damping"] or known["multigrid"] or known["from_store"])


BEFORE = {  # names in records of earlier versions
    "components": "ingredients", "estimated": "said", "measured": "exact", "uncertainty": "own",
    "uncompressed_size": "big_size", "warnings": "doubts",
}  # fmt: skip


def as_before(value, inside=""):
    """A record as plain data with the names of earlier versions."""
    if isinstance(value, list):
        return [as_before(item, inside) for item in value]
    if not isinstance(value, dict):
        return value
    changed = {"": {"components"}, "accuracy": {"uncompressed_size"}, "interface_nodes": {"warnings"},
               "proofs": {"estimated", "measured", "uncertainty"}}.get(inside, ())  # fmt: skip
    return {BEFORE[key] if key in changed else key: as_before(item, key) for key, item in value.items()}


def test_records_of_earlier_versions_are_read(comm):
    with block_with_ends(comm) as model:
        record = hpcred.reduce(model, frame=hpcred.Buckens(), tolerance=1e-2, band=(0.0, 20000.0)).record
    text = TypeAdapter(hpcred.Record).dump_json(record).decode()
    older = json.dumps(as_before(json.loads(text)))
    for now, before in BEFORE.items():
        assert f'"{now}":' in text and f'"{before}":' in older and f'"{before}":' not in text
    found = TypeAdapter(hpcred.Record).validate_json(older)
    assert found == record and TypeAdapter(hpcred.Record).dump_json(found).decode() == text
