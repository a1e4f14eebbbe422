"""Values from Python: plain ones of the declared types, or one sentence that names the key."""

from collections.abc import Sequence
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

import hpcred
from hpcred import (
    Adaptive,
    Buckens,
    Chord,
    Factoring,
    Interface,
    Krylov,
    ModalDamping,
    Modes,
    Nodes,
    Rayleigh,
    StaticCorrection,
)
from hpcred.cli.options import command
from hpcred.loads import Pressure
from hpcred.parallel.declared import Keywords, Option, flattened, spelled
from hpcred.settings import texts
from hpcred.simulation import ConstantForce, LineSpring


@pytest.mark.parametrize(
    ("given", "plain"),
    [
        (Krylov(np.float32(150), np.int64(2)), Krylov(150.0, 2)),
        (Krylov(np.array(150.0)), Krylov(150.0)),
        (Modes(index=np.arange(7, 10)), Modes(index=(7, 8, 9))),
        (Modes(index=(i for i in (7, 8, 9))), Modes(index=(7, 8, 9))),
        (Modes(band=[0, np.float64(300)]), Modes(band=(0.0, 300.0))),
        (ModalDamping(table=np.array([[0, 0.1], [2, 0.2]])), ModalDamping(table=((0.0, 0.1), (2.0, 0.2)))),
        (Chord([1, np.int32(7), "crank"]), Chord((1, 7, "crank"))),
        (Buckens([[1, np.str_("x")]]), Buckens(((1, "x"),))),
        (Factoring(out_of_core=Path("/tmp")), Factoring(out_of_core="/tmp")),
        (Interface(name="a", nodes=range(1, 4)), Interface(name="a", nodes=(1, 2, 3))),
        (Nodes(box=np.zeros((2, 3))), Nodes(box=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))),
    ],
)
def test_numbers_lists_and_paths_of_all_kinds_become_plain_ones(given, plain):
    assert given == plain and repr(given) == repr(plain)
    assert hash(given) == hash(plain)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Krylov("150"), "^krylov.frequency: found '150', expected a number$"),
        (lambda: Krylov(150.0, 1.5), "^krylov.order: found 1.5, expected a whole number$"),
        (lambda: Krylov(True), "^krylov.frequency: found True, expected a number$"),
        (lambda: Krylov(infinity="no"), "^krylov.infinity: found 'no', expected true or false$"),
        (lambda: Krylov(1.0, kind="modes"), "^krylov.kind: found 'modes', expected 'krylov'$"),
        (lambda: Modes(count=2.5), "^modes.count: found 2.5, expected a whole number$"),
        (lambda: Modes(band=300), r"^modes.band: found 300, expected \[a number, a number\]$"),
        (lambda: Modes(band=(0, 1, 2)), r"^modes.band: found \(0, 1, 2\), expected \[a number, a number\]$"),
        (lambda: Modes(index=(1.5,)), r"^modes.index: found \(1.5,\), expected a list of whole numbers$"),
        (lambda: Rayleigh(np.float32("nan")), "^damping.alpha: found nan, expected a finite number of 0 to 1e"),
        (lambda: ModalDamping(ratios=[]), "kind 'modal' needs exactly one of ratio"),
        (lambda: Buckens(3), r"^frame.supports: found 3, expected a list of \[a whole number, a text\]$"),
        (lambda: Factoring(solver="direct"), "^solver: found 'direct', expected LinearSolver, such as LinearSolver"),
        (lambda: Adaptive(tolerance="1e-4", band=(0, 1)), "^tolerance: found '1e-4', expected a number$"),
        (lambda: Adaptive(tolerance=1e-4, band=(0, 1), size=2.5), "^adaptive.size: found 2.5, expected a whole numb"),
        (lambda: Interface(name="a", nodes=(1,), kind="soft"), "^interface 'a': kind: found 'soft', expected 'averag"),
        (lambda: hpcred.Reduction(groups=1.5), "^groups: found 1.5, expected a whole number or a text$"),
        (lambda: ConstantForce("a", 3.0), r"^force.value: found 3.0, expected \[a number, a number, a"),
        (lambda: hpcred.Simulation(end=1, force=3), "^force: found 3, expected a list of ConstantForce or Sine"),
    ],
)
def test_other_types_are_refused_with_the_key(make, message):
    with pytest.raises(hpcred.InputError, match=message):
        make()


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        (([Krylov(9.0)], Buckens), {}, "^frame: found the class Buckens, expected NoFrame or Tangent or Chord or Buck"),
        (([Krylov(9.0)], "buckens"), {}, "^frame: found 'buckens', expected"),
        (([Krylov(9.0)], Rayleigh(2.0)), {}, r"^frame: found Rayleigh\(alpha=2.0, beta=0.0\), expected NoFrame"),
        (([Krylov(9.0)], None, 0.02), {}, "^damping: found 0.02, expected NoDamping or GivenDamping"),
        ((["krylov"],), {}, r"^basis: found \['krylov'\], expected a list of Component"),
        (([Krylov(9.0)],), {"band": (0, 9)}, "^band: found it without a tolerance"),
        ((), {"band": (0, 9), "tolerance": 0.1, "adaptive": Adaptive(tolerance=0.1, band=(0, 1))}, "^adaptive: found "),
        (([Krylov(9.0)],), {"store": "/tmp"}, "^store: found '/tmp', expected a Store"),
        (([Krylov(9.0)],), {"factoring": {"low_rank": 1e-8}}, "^factoring: found {'low_rank': 1e-08}, expected Factor"),
        (([Krylov(9.0)],), {"settings": {"drop_above": 1.0}}, "^settings: found {'drop_above': 1.0}, expected Reduct"),
    ],
)
def test_arguments_of_reduce_that_would_be_left_aside_are_refused(solid, arguments, keywords, message):
    with pytest.raises(hpcred.InputError, match=message):
        hpcred.reduce(solid, *arguments, **keywords)


@pytest.mark.mpi
def test_a_basis_may_be_one_component_or_anything_that_gives_some(solid):
    two = (Krylov(100.0), StaticCorrection())
    for basis, found in ((two[0], two[:1]), (list(two), two), ((item for item in two), two)):
        with hpcred.reduce(solid, basis) as rom:
            assert rom.size == 3 * len(found) and rom.record.basis == found


@pytest.mark.mpi
def test_closed_models_and_others_are_refused(solid, comm):
    with hpcred.solid((2, 2, 2), inputs=1, comm=comm) as closed:
        pass
    closed.close()
    for function in (
        lambda model: hpcred.reduce(model, [Krylov(9.0)]),
        lambda model: hpcred.frequency_response(model, [1.0]),
        lambda model: hpcred.full_response(model, [1.0, 2.0]),
        hpcred.natural_modes,
        hpcred.inspect,
        hpcred.inspect,
        lambda model: hpcred.write_model("never.h5", model),
    ):
        with pytest.raises(hpcred.InputError, match="^solid: this model was closed"):
            function(closed)
        with pytest.raises(hpcred.InputError, match="^model: found 3, expected SecondOrderModel"):
            function(3)
    for method in (str, lambda model: model.with_inputs([1]), lambda model: model.shared()):
        with pytest.raises(hpcred.InputError, match="^solid: this model was closed"):
            method(closed)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("frequencies", "message"),
    [
        ([np.nan], "^frequencies: found nan, expected a finite number"),
        ([-1.0], "^frequencies: found -1, expected 0 to"),
        (["10"], r"^frequencies: found \['10'\], expected a list of numbers"),
        ([[1.0, 2.0]], "expected a list of numbers"),
        (None, "^frequencies: found None, expected a list of numbers"),
    ],
)
def test_frequencies_that_are_none_are_refused(solid, frequencies, message):
    with hpcred.reduce(solid, Krylov(100.0)) as rom:
        for model in (solid, rom):
            with pytest.raises(hpcred.InputError, match=message):
                hpcred.frequency_response(model, frequencies)
        with pytest.raises(hpcred.InputError, match="^frame, damping: a reduced model has those"):
            hpcred.frequency_response(rom, 1.0, Buckens())
    with pytest.raises(hpcred.InputError, match=message):
        hpcred.full_response(solid, frequencies)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pressure(name="oil", on=(3, 3)), "^load 'oil': on: expected at least one number of a node, an"),
        (lambda: Pressure(name="oil", on=(0,)), "^load 'oil': on: found 0, expected 1 to 2.14748e"),
        (lambda: Pressure(name="oil", on="BORE", value=0), "^load 'oil': value: found 0.0, which is no load"),
        (lambda: hpcred.ModalDamping(table=((1.0, 0.1), (2.0, -1.0))), "^damping.table: found -1, expected 0 to 1000$"),
        (lambda: hpcred.Chord(nodes=(1, "a", 0)), "^frame.nodes: found 0, expected 1 to"),
        (lambda: LineSpring(node=1, at=(0, 0, 0), stiffness=-1), "^spring.stiffness: found -1.0, expected noth"),
        (lambda: hpcred.Nodes(sphere=((0, 0, 1e99), 1)), r"^nodes.sphere: found 1e\+99, expected -1e\+09 to 1e\+09 m$"),
    ],
)
def test_checks_in_annotations_are_those_of_the_kind_that_a_value_has(make, message):
    """Also of items of tuples; a name of a set is no list of nodes."""
    Pressure(name="oil", on="BOOK")
    with pytest.raises(hpcred.InputError, match=message):
        make()


@dataclass(frozen=True, kw_only=True)
class Grid(Keywords):
    points: int = 3
    band: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Ends(Keywords):
    lowest: Annotated[float, Option("A number.", "HZ", names=("--from",))] = 0.0
    targets: Annotated[Sequence[int], Option("Numbers.", None, texts.whole_numbers, "1,2")] = (1, 2)
    within: float = 1.0


def test_a_command_takes_annotated_keywords_as_options():
    """Texts are parsed, and what is not given is as by default; what has no annotation is no option."""

    @command
    def take(*, ends: Ends):
        return ends

    assert list(signature(take).parameters) == ["lowest", "targets"]
    assert signature(take).parameters["targets"].default == "1,2"
    assert take(lowest=2.0, targets="7,8") == Ends(lowest=2.0, targets=[7, 8])
    assert take(lowest=0.0, targets=None) == Ends() and Ends().changed() == []
    assert Ends(lowest=2.0, targets=[7]).changed() == ["--from", "--targets"]
    assert Ends(lowest=2.0).given == {"lowest": 2.0, "targets": (1, 2), "within": 1.0}
    with pytest.raises(hpcred.InputError, match="^--targets: found 'a', expected numbers"):
        take(lowest=0.0, targets="a")


@spelled
@flattened
def over(model, *, grid: Grid, last: bool = False):
    return model, grid, last


def test_fields_of_keywords_are_keywords_of_a_function():
    """With their names, types and defaults, before and behind others."""
    assert over("a") == ("a", Grid(), False)
    assert over("a", last=True, points=5) == ("a", Grid(points=5), True)
    assert list(signature(over).parameters) == ["model", "points", "band", "last"]
    assert signature(over).parameters["points"].default == 3
    with pytest.raises(hpcred.InputError, match=r"over: unknown keyword 'point' \(did you mean 'points'\?\)"):
        over("a", point=5)
