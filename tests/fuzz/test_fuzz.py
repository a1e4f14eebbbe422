"""A fixed small selection of the cases of `make fuzz`, and what holds the generators and second readings themselves."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from hpcred import InputError
from hpcred.settings.job_file import Job
from hpcred.settings.simulation_file import SimulationJob
from hpcred.settings.sweep_file import _File

from . import arrays, beside, containers, matrices, meshes, readings, tables
from .generators import KINDS, make
from .judge import INTERNAL, REFUSED, RIGHT, WRONG, Case, run_case, same
from .mutations import damaged_text


@pytest.mark.parametrize("kind, number", [(kind, place % 2) for place, kind in enumerate(KINDS)])
def test_selection(kind, number):
    """The first or the second case of each kind."""
    case = make(kind, 1, number)
    verdict, why = run_case(case)
    assert verdict in (RIGHT, REFUSED), (case.note, why)


@pytest.mark.slow
def test_on_two_ranks():
    assert run_case(make("DMIG", 2, 0), 2)[0] in (RIGHT, REFUSED)


def test_a_case_is_the_same_each_time():
    for kind in (*matrices.KINDS, *arrays.KINDS, *meshes.KINDS, "SID"):
        one, other = make(kind, 3, 4), make(kind, 3, 4)
        assert (one.note, one.files) == (other.note, other.files)


def test_the_second_readings_read_what_was_meant():
    """Numbers of the generators come back from the texts, to the digits written."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        matrix = matrices.matrix(rng)
        near = {"rtol": 1e-5, "atol": 1e-30}
        assert np.allclose(readings.matrix_market(matrices.matrix_market(matrix, rng)), matrix, **near)
        assert np.allclose(readings.harwell_boeing(matrices.harwell_boeing(matrix, rng)), matrix, **near)
        assert np.allclose(readings.op4(matrices.op4("A", matrix, rng)), matrix, **near)
        assert np.allclose(readings.coordinates(matrices.coordinates(matrix, rng)), matrix, **near)
        assert np.allclose(readings.triangle(matrices.triangle(matrix)), matrix, **near)
        labels = matrices.labels_of(matrices.places(rng))
        abaqus = readings.matrix_input(matrices.labelled(matrix, labels, rng))
        nastran = readings.dmig(matrices.dmig("A", matrix, labels, rng), b"A")
        for entries in (abaqus, nastran):
            number = {label: k for k, label in enumerate(labels, 1)}
            found = [(number[i], number[j], value) for i, j, value in entries]
            assert np.allclose(readings.dense(matrix.shape, found), matrix, rtol=1e-2, atol=1e-30)


def test_the_second_readings_of_arrays_and_nodes_read_what_was_meant():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        matrix, where = matrices.matrix(rng, symmetric=False), matrices.places(rng)
        form = matrices.chosen(rng, "csr", "csc", "coo")
        assert np.array_equal(arrays.read_npz(arrays.npz(form, (9, 9), arrays.pieces(matrix, form, rng), rng)), matrix)
        assert np.array_equal(arrays.read_petsc(arrays.petsc("", (9, 9), arrays.pieces(matrix, "csr"), rng)), matrix)
        sparse = ("csc", (9, 9), arrays.pieces(matrix, "csc"))
        found = arrays.read_matlab(arrays.matlab({"K": sparse, "M": matrix}))
        assert all(np.array_equal(found[key], matrix) for key in "KM")
        for kind, (write, read) in meshes.GRAMMAR.items():
            content = write(where, rng)
            found = read(content)
            assert found.keys() - {"sets"} == where.keys()
            if kind == "Abaqus assembly":  # sets of the part, and of the assembly
                labels = sorted([list(where)[0], list(where)[-1]])
                assert found["sets"]["set bar-1.END"].tolist() == labels
                assert found["sets"]["set Both"].tolist() == sorted({*labels, list(where)[1]})
            elif b"CORD2" not in content:
                assert all(np.allclose(found[label], place, atol=6e-5) for label, place in where.items())
    moved = meshes.node_readings.moved([b"0.5, 0., 0.", b"0., 0., 0., 0., 0., 1., 90."])
    assert np.allclose(moved(np.array([1.0, 2.0, 3.0])), [-2.0, 1.5, 3.0])
    cylinder = "CORD2C,5,0,1.,0.,0.,1.,0.,1.\n,2.,0.,0.\nGRID,3,5,2.,90.,4.\n"
    assert np.allclose(meshes.node_readings.bulk(cylinder.encode())[3], [1.0, 2.0, 4.0])


@pytest.mark.parametrize(
    "root, goods", [(Job, tables.JOBS), (SimulationJob, tables.MOTIONS), (_File, tables.SWEEPS)]
)  # fmt: skip
def test_every_dataclass_stands_in_a_good_file(root, goods):
    seen = {owner for text in goods for _, _, owner in tables.keys_of(root, tables.tomllib.loads(text))}
    assert tables.dataclasses_of(root) <= seen


def test_damage_happens():
    good = matrices.matrix_market(matrices.matrix(np.random.default_rng(1)), np.random.default_rng(1))
    copies = {damaged_text(good, np.random.default_rng(seed))[1] for seed in range(200)}
    assert len(copies - {good}) > 170


SMALL = b"%%MatrixMarket matrix coordinate real general\n2 2 2\n1 1 1.0\n2 2 2.0\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    "files, expected, verdict",
    [
        ({}, {"K": np.diag([1.0, 2])}, RIGHT), ({}, {"K": np.diag([1.0, 3])}, WRONG), ({}, None, WRONG),
        ({"K.mtx": SMALL[:-5]}, None, REFUSED), ({"K.mtx": b"\0"}, {}, REFUSED),
    ],
)  # fmt: skip
def test_verdicts(files, expected, verdict):
    command = ["convert", "-K", "K.mtx", "-M", "M.mtx", "-o", "m.h5"]
    case = Case("", {"K.mtx": SMALL, "M.mtx": SMALL, **files}, command, expected, matrices.model_numbers)
    for ranks in (0, 1) if verdict == REFUSED and expected is None else (0,):
        assert run_case(case, ranks)[0] == verdict
    case.good = True
    assert run_case(case)[0] == (WRONG if verdict == REFUSED else verdict)


@pytest.mark.parametrize(
    "fault", [lambda: 1 / 0, lambda: os.write(2, b"said by a library\n"), lambda: Path("left.h5").touch(), sys.exit]
)  # fmt: skip
def test_what_is_neither_right_nor_a_sentence_is_seen(monkeypatch, fault):
    def faulty(*arguments, **keywords):
        fault()
        raise InputError("a sentence")

    monkeypatch.setattr("hpcred.workflows.convert.load_source", faulty)
    command = ["convert", "-K", "K.mtx", "-M", "K.mtx", "-o", "m.h5"]
    assert run_case(Case("", {"K.mtx": SMALL}, command, {}, matrices.model_numbers))[0] == INTERNAL


def in_the_seal(good):
    """A copy with a letter of the text of the seal changed, which HDF5 never sees."""
    at = good.rindex(b'"end"')
    return good[:at] + b'"End"' + good[at + 5 :]


@pytest.mark.parametrize("kind", containers.KINDS)
def test_a_seal_that_is_not_checked_is_seen(monkeypatch, kind):
    command = containers.COMMANDS[kind][-1]
    case = containers.damaged(kind, command, "", in_the_seal(containers.files()[kind]))
    assert run_case(case)[0] == REFUSED
    monkeypatch.setattr("hpcred.files.opened_hdf5.is_broken", lambda path: False)
    assert run_case(case)[0] == WRONG


def test_a_seal_of_the_store_that_is_not_checked_is_seen(monkeypatch):
    monkeypatch.setattr(beside, "bytes_changed", lambda good, rng: ("", in_the_seal(good)))
    case = make("point store", 1, 0)
    assert run_case(case)[0] == RIGHT
    monkeypatch.setattr("hpcred.files.opened_hdf5.is_broken", lambda path: False)
    assert run_case(case)[0] == WRONG


def test_what_differs_by_more_than_round_off_is_seen():
    """A mode of another run of the eigensolver, to its tolerance of 1e-10, has another zero."""
    mode, other = {"V": np.array([1.0, 0.0])}, {"V": np.array([1.0, 4e-10])}
    assert same(other, mode) and not same(other, mode, 2)
    assert same({"V": np.array([1.0, 1e-7])}, mode, 2) and same({"V": np.array([1.0 + 1e-7, 0.0])}, mode, 2)
