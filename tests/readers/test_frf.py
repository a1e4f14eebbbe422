"""Frequency responses of other programs: units, quantities, shapes and names."""

import numpy as np
import pytest

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
