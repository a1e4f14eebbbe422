"""Frequency responses of other programs: units, quantities, shapes and names."""

import gc
import io
import os
import resource
import zipfile

import numpy as np
import pytest
import scipy.io
import scipy.sparse

import hpcred
from hpcred.files.response_file import lost_channels
from hpcred.readers.frf import read_frf

F = np.array([1.0, 2.0, 4.0])


def responses(outputs, inputs, **more):
    """Responses of random numbers."""
    H = np.random.default_rng(1).normal(size=(len(F), len(outputs), len(inputs), 2)) @ [1.0, 1j]
    return hpcred.files.Responses(frequencies=F, response=H, input_names=inputs, output_names=outputs, **more)


@pytest.fixture
def sets(tmp_path, comm):
    """The datasets of a universal file of a node with displacements and rotations, and how to write them anew."""
    import pyuff

    names = ("a:x", "a:rz")
    given = responses(names, names)
    path = tmp_path / "r.unv"
    hpcred.files.write_responses(path, given, comm)
    file = pyuff.UFF(str(path))
    return given, file.read_sets(), lambda made: pyuff.UFF(str(path)).write_sets(made, mode="overwrite"), path


@pytest.mark.peers("pyuff")
def test_units_of_rotations_and_moments(sets):
    """mm and mN: displacements are 1e3 of those in m, moments 1e6 of those in N m, rotations the same."""
    given, found, write, path = sets
    of = {"force": 1e3, "length": 1e3}
    for item in found:
        if item["type"] == 164:
            item |= of
        else:
            item["data"] *= (1e3 if item["rsp_dir"] == 1 else 1.0) / (1e3 if item["ref_dir"] == 1 else 1e6)
    assert [item["ordinate_axis_units_lab"] for item in found[1:]] == ["m", "m", "rad", "rad"]
    assert [item["orddenom_axis_units_lab"] for item in found[1:]] == ["N", "N m", "N", "N m"]
    write(found)
    assert read_frf(path).response == pytest.approx(given.response, rel=1e-6)


@pytest.mark.peers("pyuff")
def test_unknown_quantities_and_pairs_that_are_there_twice(sets):
    _, found, write, path = sets
    write([*found, found[-1]])
    with pytest.raises(hpcred.InputError, match="found the response a:rz/a:rz twice"):
        read_frf(path)
    found[-1]["ordinate_spec_data_type"] = 0
    write(found)
    with pytest.raises(hpcred.InputError, match=r"quantity 0 \(unknown\), expected displacements \(8\).*export it"):
        read_frf(path)


@pytest.mark.peers("pyuff")
def test_names_leave_the_numbers_of_other_nodes(tmp_path, comm):
    import pyuff

    path = tmp_path / "r.unv"
    given = responses(("tip:x", "1:x", "stress of 1"), ("tip:x",))
    hpcred.files.write_responses(path, given, comm)
    numbers = [item["rsp_node"] for item in pyuff.UFF(str(path)).read_sets() if item["type"] == 58]
    assert numbers == [2, 1] and read_frf(path).output_names == ("tip:x", "1:x")
    assert "leaves out stress of 1, which belong to no node" in lost_channels(path, given)[0]
    assert not lost_channels(tmp_path / "r.npz", given) and not lost_channels(path, responses(("a:x",), ("a:x",)))


@pytest.mark.peers("pyuff")
def test_places_of_nodes_in_two_datasets(tmp_path, comm):
    """As of programs that write one for each part of a body."""
    import pyuff

    path = tmp_path / "r.unv"
    places = {"1": (1, np.array([0.5, 0.0, 0.0])), "2": (2, np.array([0.0, 0.25, 1.0]))}
    given = responses(("1:x", "2:x"), ("1:x",), places=places)
    hpcred.files.write_responses(path, given, comm)
    units, nodes, *others = pyuff.UFF(str(path)).read_sets()
    halves = [nodes | {key: nodes[key][k : k + 1] for key in ("node_nums", "def_cs", "disp_cs", "color", "x", "y", "z")}
              for k in (0, 1)]  # fmt: skip
    pyuff.UFF(str(path)).write_sets([units, *halves, *others], mode="overwrite")
    found = read_frf(path).places
    assert {name: (number, tuple(place)) for name, (number, place) in found.items()} == {
        name: (number, tuple(place)) for name, (number, place) in places.items()}  # fmt: skip


def test_shapes_of_arrays(tmp_path):
    """(F, r) of one input; (r, F) has another order, and lists of nodes have one length."""
    path, names = tmp_path / "m.npz", {"input_names": ["a:x"], "output_names": ["a:x", "a:y"]}
    H = np.arange(6).reshape(3, 2)
    np.savez(path, frequencies=F, H=H, **names)
    assert (read_frf(path).response[:, :, 0] == H).all()
    np.savez(path, frequencies=F, H=H.T, **names)
    with pytest.raises(hpcred.InputError, match=r"found responses \(2, 3\), expected one for each of 3 frequencies"):
        read_frf(path)
    np.savez(path, frequencies=F, H=H, **names, node_names=["a", "b"], nodes=[1, 2], positions=np.zeros((1, 3)))
    with pytest.raises(hpcred.InputError, match=r"found 2 node_names, 2 nodes and positions \(1, 3\)"):
        read_frf(path)


GOOD = {"frequencies": F, "H": np.arange(12).reshape(3, 2, 2) + 1j, "input_names": ["a:x", "a:y"],
        "output_names": ["a:x", "b:x"]}  # fmt: skip
AT_A = {"node_names": ["a"], "nodes": [7.0], "positions": np.zeros((1, 3))}


def as_npz(path, **more):
    np.savez(path, **{**GOOD, **more})


def as_mat(path, packed=True, **more):
    """As MATLAB saves it, names as a cell."""
    data = {key: np.array(value, dtype=object) if key.endswith("names") and isinstance(value, list) else value
            for key, value in {**GOOD, **more}.items()}  # fmt: skip
    scipy.io.savemat(path, data, do_compression=packed)


FORMATS = pytest.mark.parametrize(("save", "ending"), [(as_npz, ".npz"), (as_mat, ".mat")])


@FORMATS
def test_arrays_are_read_in_their_order_with_their_places(tmp_path, save, ending):
    path = tmp_path / f"m{ending}"
    save(path, H=np.asfortranarray(GOOD["H"]), **AT_A)
    found = read_frf(path)
    assert (found.response == GOOD["H"]).all() and (found.frequencies == F).all()
    assert found.input_names == ("a:x", "a:y") and found.places["a"][0] == 7
    save(path, input_names=np.array(["a:x", "ab:y"]))  # rows of a matrix of letters in MATLAB
    assert read_frf(path).input_names == ("a:x", "ab:y")


@FORMATS
@pytest.mark.parametrize(("change", "words"), [
    ({"H": np.full((3, 2, 2), "1")}, "found H of the type"), ({"H": np.ones((3, 2, 2), bool)}, "H of the type bool"),
    ({"frequencies": F + 1j}, "frequencies of the type complex128, expected real"),
    ({"frequencies": np.array(["1", "2", "3"])}, "found frequencies of the type"),
    ({"input_names": np.array([1.0, 2.0])}, "found input_names of the type float64"),
    ({"input_names": ["a:x", "b\x1b[31m:x"]}, "no letters"), ({"input_names": ["a:x", ""]}, "the name ''"),
    ({"H": np.full((3, 2, 2), np.nan)}, "not finite"), ({"H": np.full((3, 2, 2), np.inf * 1j)}, "not finite"),
    ({"H": np.full((3, 2, 2), 1e31)}, "above 1e[+]30"), ({"frequencies": [1.0, 2.0, 1e31]}, "do not ascend"),
    ({"frequencies": [0.0], "H": np.ones((1, 2, 2)), "output_names": ["acceleration a:x", "b:x"]}, "no displacements"),
    ({"frequencies": [1e-300, 1.0, 2.0], "output_names": ["velocity a:x", "acceleration b:x"]}, "no displacements"),
    (AT_A | {"nodes": [7.5]}, "whole numbers"), (AT_A | {"nodes": [np.nan]}, "whole numbers"),
    (AT_A | {"positions": np.full((1, 3), np.inf)}, "infinite"),
    (AT_A | {"positions": np.zeros((1, 3, 1))}, "expected as many of each"),
])  # fmt: skip
def test_arrays_of_other_kinds_are_refused(tmp_path, save, ending, change, words):
    path = tmp_path / f"m{ending}"
    save(path, **change)
    with pytest.raises(hpcred.InputError, match=words):
        read_frf(path)


def test_archives_that_claim_more_than_they_have(tmp_path):
    path = tmp_path / "m.npz"
    as_npz(path)
    for shape, words in (((10**11,), "MB are free"), ((-3,), "shape")):
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
        with zipfile.ZipFile(path) as old:
            kept = {name: old.read(name) for name in old.namelist()}
        with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
            for name, text in kept.items():
                archive.writestr(name, head.getvalue() if name == "H.npy" else text)
        with pytest.raises(hpcred.InputError, match=words):
            read_frf(tmp_path / "bad.npz")


@pytest.mark.parametrize("save", [as_npz, as_mat, lambda path: as_mat(path, packed=False)])
def test_damaged_arrays_are_refused_or_read_in_the_same_shape(tmp_path, save):
    """SciPy crashes on some."""
    path, draw = tmp_path / ("m.npz" if save is as_npz else "m.mat"), np.random.default_rng(5)
    save(path)
    whole = path.read_bytes()
    for place in draw.integers(len(whole), size=80):
        for text in (whole[:place], whole[:place] + whole[place + draw.integers(1, 20) :],
                     whole[:place] + bytes([whole[place] ^ 1 << draw.integers(8)]) + whole[place + 1 :]):  # fmt: skip
            path.write_bytes(text)
            try:
                assert read_frf(path).response.shape == (3, 2, 2)
            except hpcred.InputError as error:
                assert "m." in str(error) and "\n" not in str(error)


def test_matlab_files_of_other_versions_and_sparse_matrices(tmp_path):
    path = tmp_path / "m.mat"
    scipy.io.savemat(path, {"H": np.ones((3, 1)), "frequencies": F}, format="4")
    with pytest.raises(hpcred.InputError, match="expected one that save wrote with '-v7'"):
        read_frf(path)
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
    with pytest.raises(hpcred.InputError, match="version 7.3, expected one that save wrote with '-v7'"):
        read_frf(path)
    as_mat(path, H=scipy.sparse.csc_matrix(np.ones((3, 1))))
    with pytest.raises(hpcred.InputError, match="found no H, expected"):
        read_frf(path)


@pytest.mark.parametrize("name", ["m.npz", "m.mat", "m.unv", "m.h5"])
def test_pipes_are_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(hpcred.InputError, match="pipe or a device"):
        read_frf(tmp_path / name)


@pytest.fixture
def text_of(sets):
    """A universal file of text, and its lines."""
    given, found, write, path = sets
    write([item | {"binary": 0} if item["type"] == 58 else item for item in found])
    assert read_frf(path).response == pytest.approx(given.response, rel=1e-9)
    return path, path.read_bytes().splitlines(keepends=True)


@pytest.mark.peers("pyuff")
@pytest.mark.parametrize(("change", "words"), [
    (lambda lines: lines[:-3], "the file is cut off"), (lambda lines: lines[:-2] + lines[-1:], "2 numbers of a respon"),
    (lambda lines: [b"text\n", *lines], "outside of a dataset"),
    (lambda lines: [*lines[:-2], lines[-2].replace(b"e", b"", 1), lines[-1]], "different lengths|cannot be read"),
    (lambda lines: [*lines[:-2], lines[-2][:5] + lines[-2][6:], lines[-1]], "different lengths"),
    (lambda lines: [*lines[:3], b" 0.0 1.0 1.0 1.0\n", *lines[5:]], "164|cannot be read"),
    (lambda lines: [*lines[:3], b"  0.0  -1.0  1.0\n", *lines[4:]], "units"),
])  # fmt: skip
def test_damaged_universal_files_are_refused(text_of, change, words):
    path, lines = text_of
    path.write_bytes(b"".join(change(lines)))
    with pytest.raises(hpcred.InputError, match=words):
        read_frf(path)


@pytest.mark.peers("pyuff")
def test_places_are_those_of_global_systems(tmp_path, comm):
    """Which pyuff does not look at."""
    path, places = tmp_path / "r.unv", {"a": (3, np.array([1.0, 2.0, 3.0]))}
    hpcred.files.write_responses(path, responses(("a:x",), ("a:x",), places=places), comm)
    number, position = read_frf(path).places["a"]
    assert number == 3 and position == pytest.approx([1.0, 2.0, 3.0])
    head = b"         3         0         0        11"
    assert path.read_bytes().count(head) == 1
    path.write_bytes(path.read_bytes().replace(head, head.replace(b"0         0", b"0         5")))
    with pytest.raises(hpcred.InputError, match="displacements in the global system"):
        read_frf(path)


@pytest.mark.peers("pyuff")
def test_binary_functions_say_how_long_they_are(tmp_path, comm):
    """So that readers of nodes find what is behind them; pyuff itself writes the bytes wrongly."""
    import pyuff

    from hpcred.readers.nodes.uff import datasets

    path = tmp_path / "r.unv"
    hpcred.files.write_responses(path, responses(("a:x", "b:x"), ("a:x",)), comm)
    assert [int(line.split()[4]) for line in path.read_bytes().splitlines() if b"58b" in line] == [24 * len(F)] * 2
    assert [number for number, *_ in datasets(path, comm)] == [164, 58, 58]
    found = pyuff.UFF(str(path)).read_sets()
    pyuff.UFF(str(path)).write_sets(found, mode="overwrite")
    assert [number for number, *_ in datasets(path, comm)] == [164, 58, 58]


@pytest.mark.peers("pyuff")
@pytest.mark.parametrize("name", ["r.unv", "r.npz", "r.csv", "r.h5"])
def test_responses_that_are_not_finite_are_not_written(tmp_path, comm, name):
    """pyuff makes zeros of them."""
    given = responses(("a:x",), ("a:x",))
    given.response[1] = np.nan
    with pytest.raises(hpcred.ComputationError, match="response has 1 of 3 numbers that are not finite"):
        hpcred.files.write_responses(tmp_path / name, given, comm)
    given.frequencies, given.response = F[:1], np.ones((1, 1, 1))
    if name == "r.unv":
        with pytest.raises(hpcred.InputError, match=r"output .*r.unv: found one frequency"):
            hpcred.files.write_responses(tmp_path / name, given, comm)
    assert not list(tmp_path.iterdir())


@pytest.mark.peers("pyuff")
@pytest.mark.parametrize("name", ["r.unv", "r.npz", "r.csv"])
def test_a_full_disk_is_one_sentence(tmp_path, comm, capfd, name):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(hpcred.ComputationError, match=f"{name}: the disk is full"):
            hpcred.files.write_responses(tmp_path / name, responses(("a:x",), ("a:x",)), comm)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    gc.collect()
    assert not list(tmp_path.iterdir()) and capfd.readouterr().err == ""
