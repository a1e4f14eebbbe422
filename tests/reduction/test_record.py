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
from hpcred.reduction.result.accuracy import Point
from hpcred.reduction.result.record import difference_of


def test_a_record_knows_the_model_by_what_was_used_of_it():
    known = {"M": "m", "K": "k", "D": "d", "B": "b", "dofs": "n", "terms": "t"}
    frames, dampings = (hpcred.NoFrame(), hpcred.Buckens()), (NoDamping(), GivenDamping())
    for changed, frame, damping, found in (
        ("K", 0, 0, "K"), ("D", 0, 0, None), ("D", 0, 1, "D"), ("dofs", 0, 0, None), ("dofs", 1, 0, "dofs"),
        ("terms", 0, 0, "terms"), ("Ct", 0, 0, "Ct"),
    ):  # fmt: skip
        record = SimpleNamespace(digests=known, damping=dampings[damping], frame=frames[frame], interfaces=())
        assert difference_of(known, record) is None
        assert difference_of(known | {changed: "other"}, record) == found
        without = {key: value for key, value in known.items() if key != "terms"}
        assert difference_of(without, record) is None


def test_a_soft_spring_beside_stiff_ones_tells_models_apart(comm, folder):
    """1 N/m beside 1e10 N/m, which products with random vectors do not show."""
    k = np.array([1e10, 1e10, 1.0, 2.0])
    K = np.diag(k + np.roll(k, -1)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    models = [hpcred.SecondOrderModel.from_scipy(item, np.eye(4), comm=comm, inputs=np.eye(4)[:, 2:3])
              for item in (K, K + np.diag([0.0, 0.0, 1.0, 0.0]))]  # fmt: skip
    for name, model in zip("ab", models, strict=True):
        hpcred.write_model(folder / f"{name}.h5", model)
    with hpcred.reduce(models[0], [hpcred.Modes(count=1)]) as rom:
        rom.save(folder / "r.h5")
    hpcred.evaluate(folder / "r.h5", folder / "a.h5", frequencies=[0.01], comm=comm)
    with pytest.raises(hpcred.InputError, match="b.h5: its matrix K differs"):
        hpcred.evaluate(folder / "r.h5", folder / "b.h5", frequencies=[0.01], comm=comm)


def test_what_a_search_may_take_and_what_older_records_leave_out():
    """The defaults of Limits, and those of fields that results of earlier versions do not have."""
    limits = hpcred.reduction.Limits()
    assert (limits.factorisations, limits.columns, limits.zeta0) == (14, 600, 1e-3)
    known = {item.name: item.default for kind in (hpcred.reduction.Accuracy, Point) for item in fields(kind)}
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
    text = TypeAdapter(hpcred.reduction.Record).dump_json(record).decode()
    older = json.dumps(as_before(json.loads(text)))
    for now, before in BEFORE.items():
        assert f'"{now}":' in text and f'"{before}":' in older and f'"{before}":' not in text
    found = TypeAdapter(hpcred.reduction.Record).validate_json(older)
    assert found == record and TypeAdapter(hpcred.reduction.Record).dump_json(found).decode() == text
