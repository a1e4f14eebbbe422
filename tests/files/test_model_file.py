"""Model files keep what they are given."""


import h5py
import numpy as np
import pytest
from foreign import gathered
from helpers import columns_of, to_dense

import hpcred
from hpcred.fe.dofs import Dofs
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.parallel.petsc import MPI

pytestmark = pytest.mark.mpi
PROPERTIES = {
    "elements__line": [[1, 2]], "element_properties__line": [[1, 0, 0]], "element_types": [b"B31"],
    "element_program": b"Abaqus", "materials": b"[]",
}  # fmt: skip


def test_model_file_keeps_everything(comm, folder):
    with hpcred.linkage(comm) as model:
        model = model.with_inputs([(20, "z"), (1, "rx")])
        model = model.with_outputs([(5, "y")])
        K, M, B = to_dense(model.K), to_dense(model.M), columns_of(model.B)
        hpcred.write_model(folder / "a.h5", model)
    with hpcred.read_model(folder / "a.h5", comm) as model:
        for mat, expected in ((model.K, K), (model.M, M)):
            assert np.array_equal(to_dense(mat), expected)
        assert np.array_equal(columns_of(model.B), B)
        assert model.input_names == ("20:z", "1:rx") and model.output_names == ("5:y",)
        assert np.flatnonzero(columns_of(model.Ct)[:, 0]).tolist() == [25]
        assert (model.dofs.node == (np.arange(120) // 6 + 1)[model.first_row :][: model.local_rows]).all()
        assert model.held is None and model.sets == {} and model.remarks == ()


def chain(comm, **more):
    """Nodes 2 to 5 of a chain along x; node 1, and node 5 but for x, are held."""
    K = np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1)
    node, position = np.arange(2, 6), np.arange(1.0, 5.0)[:, None] * [1.0, 0, 0]
    dofs = Dofs(node, np.zeros(4, np.int8), position)
    places = np.array([[0.0, 0, 0]] * 3 + [[4.0, 0, 0]] * 2)
    held = Dofs(np.array([1, 1, 1, 5, 5]), np.array([0, 1, 2, 1, 2], np.int8), places)
    mine = slice(comm.rank, None, comm.size)
    elements = {"line": np.array([[1, 2], [2, 3], [3, 4], [4, 5]])[mine]}
    return SecondOrderModel.from_scipy(
        K, np.eye(4), comm=comm, dofs=dofs, held=held.take(mine), elements=elements, **more
    )  # fmt: skip


def test_held_dofs_sets_and_remarks_are_kept(comm, folder):
    sets = {"all": np.array([1, 2, 3])[comm.rank :: comm.size], "part/1.A b%": np.full(int(comm.rank == 0), 4)}
    with chain(comm, sets=sets, remarks=("ten digits", "größer")) as model:
        hpcred.write_model(folder / "a.h5", model)
    with hpcred.read_model(folder / "a.h5", comm) as model:
        node, direction, position = gathered(comm, model.held.node, model.held.direction, model.held.position)
        order = np.lexsort((direction, node))
        assert node[order].tolist() == [1, 1, 1, 5, 5] and direction[order].tolist() == [0, 1, 2, 1, 2]
        assert position[order][:, 0].tolist() == [0, 0, 0, 4, 4]
        assert model.remarks == ("ten digits", "größer")
        assert set(model.sets) == set(sets)
        assert sorted(gathered(comm, model.sets["all"])[0]) == [1, 2, 3]
        assert gathered(comm, model.sets["part/1.A b%"])[0].tolist() == [4]
        with pytest.raises(hpcred.InputError, match="node 1 of a.h5 has no dof: .* holds it in x, y, z"):
            model.with_inputs([(1, "x")])
        with pytest.raises(hpcred.InputError, match="node 5 of a.h5 has no dof in direction y, which is held"):
            model.with_inputs([(5, "y")])
        with pytest.raises(hpcred.InputError, match="node 6 does not exist"):
            model.with_inputs([(6, "y")])


@pytest.mark.parametrize("name", [".", "..", "/", "a/../b", "%2E", " ", "\0", "\udcff", "é" * 300])
def test_names_of_sets_that_mean_something_to_hdf5(comm, folder, name):
    with chain(comm, sets={name: np.array([2])[comm.rank :]}) as model:
        hpcred.write_model(folder / "a.h5", model)
    with hpcred.read_model(folder / "a.h5", comm) as model:
        assert set(model.sets) == {name} and gathered(comm, model.sets[name])[0].tolist() == [2]


def test_a_set_without_a_name_is_refused(comm, folder):
    with chain(comm, sets={"": np.array([2])}) as model, pytest.raises(hpcred.InputError, match="without a name"):
        hpcred.write_model(folder / "a.h5", model)
    comm.Barrier()
    assert not list(folder.iterdir())


def by_hand(folder, comm, attributes=None, **changed):
    """A model.h5 of nodes 1 and 2 with three dofs each, as a script of a user writes it; None leaves a thing out."""
    content = {
        "matrices/indptr": np.arange(7), "matrices/indices": np.arange(6), "matrices/K": np.arange(2.0, 8.0),
        "matrices/M": np.ones(6), "dofs/node": np.repeat([1, 2], 3), "dofs/direction": np.tile([0, 1, 2], 2),
        "dofs/position": np.repeat([[0.0, 0, 0], [1, 0, 0]], 3, axis=0), "inputs/B": np.eye(6)[:2],
    }  # fmt: skip
    content |= {key.replace("__", "/"): item for key, item in changed.items()}
    attributes = {"format": "hpcred-model", "version": 1, "size": 6} | (attributes or {})
    if comm.rank == 0:
        with h5py.File(folder / "a.h5", "w") as file:
            file.attrs.update({key: item for key, item in attributes.items() if item is not None})
            for key, item in content.items():
                if item is not None:
                    file[key] = item
    comm.Barrier()
    return folder / "a.h5"


def test_a_file_that_a_script_wrote(comm, folder):
    path = by_hand(folder, comm, {"format": np.bytes_("hpcred-model")}, dofs__position=np.repeat(
        np.array([[0, 0, 0], [1, 0, 0]], ">f4"), 3, axis=0))  # fmt: skip
    with hpcred.read_model(path, comm) as model:
        assert np.array_equal(to_dense(model.K), np.diag(np.arange(2.0, 8.0)))
        assert model.input_names == ("input 1", "input 2")


@pytest.mark.parametrize(
    "attributes, changed, says",
    [
        ({"version": None}, {}, "found no attribute 'version', expected 1"),
        ({"rows_per_block": 4}, {}, "found 6 rows in blocks of 4"),
        ({"rows_per_block": 0}, {}, "found 6 rows in blocks of 0"),
        ({}, {"matrices__K": np.eye(6)}, r"/matrices/K is .* expected real of shape \(6,\); 'files' in"),
        ({}, {"matrices__M": None}, "/matrices/M is missing; 'files' in the documentation lists all arrays"),
        ({}, {"matrices__indptr": np.arange(0, 14, 2), "matrices__indices": np.repeat(np.arange(6), 2),
              "matrices__K": np.ones(12), "matrices__M": np.ones(12)}, "twice in the row of dof 1"),
        ({}, {"dofs__direction": np.zeros(6, int)}, "found two rows of node 1, x, expected one"),
        ({}, {"dofs__position": np.eye(6)[:, :3]}, "expected one place for all rows of a node"),
        ({}, {"elements__TET4": [[1, 2, 1, 2]]}, "found elements of the kind 'TET4'"),
        ({}, PROPERTIES | {"materials": b'[{"name": "a", "young": '}, "/materials: Invalid JSON"),
        ({}, PROPERTIES | {"materials": b'[{"name": "a", "young": -1}]'}, "'a': young: found -1, expected a positive"),
        ({}, PROPERTIES | {"materials": None}, "/materials is missing"),
        ({}, PROPERTIES, "element properties: found the material 0 of line, expected less than 0"),
    ],
)  # fmt: skip
def test_a_file_that_a_script_wrote_wrong_is_refused(comm, folder, attributes, changed, says):
    with pytest.raises(hpcred.InputError, match=f"a.h5: .*{says}"):
        hpcred.read_model(by_hand(folder, comm, attributes, **changed), comm)


def test_nodes_that_are_held_stand_still_in_shapes_and_exports(comm, folder):
    """All nodes and elements are in pictures, and a held node can be an interface."""
    with (
        chain(comm) as model,
        model.with_inputs([(5, "x")]) as loaded,
        hpcred.reduce(loaded, [hpcred.Modes(count=2)]) as rom,
    ):
        (here,) = hpcred.node_shapes(loaded, rom.columns, [1])
        assert not here.phi.any() and here.position.tolist() == [0, 0, 0]
        hpcred.write_result(folder / "r.h5", rom, loaded)
    if comm.rank == 0:
        result = hpcred.read_result(folder / "r.h5", MPI.COMM_SELF)
        with result.shapes() as shapes:
            assert shapes.nodes.tolist() == [1, 2, 3, 4, 5]
            assert shapes.points[:, 0].tolist() == [0, 1, 2, 3, 4]
            assert len(shapes.cells["line"]) == 4
            moved = shapes.displacement(0)
            assert not moved[0].any() and not moved[:, 1:].any()
            # the first mode of four equal masses on springs, held at one end
            ratio = moved[1:, 0] / moved[-1, 0]
            assert np.allclose(ratio, np.sin(np.arange(1, 5) * np.pi / 9) / np.sin(4 * np.pi / 9), atol=1e-9)
        body = result.body([1, 5])
        assert not body.nodes[0].phi.any() and body.nodes[1].phi[0].any() and not body.nodes[1].phi[1:].any()
        with pytest.raises(hpcred.InputError, match="node 7 does not exist"):
            result.body([7])


@pytest.mark.costly
def test_names_of_node_sets_choose_the_nodes_of_a_body(comm, folder, linkage):
    """A set stands for its nodes that have dofs; an interface comes before a set of the same name."""
    sets = {"tip": np.array([20, 3, 70])[comm.rank :: comm.size], "eye": np.full(int(comm.rank == 0), 4),
            "mesh only": np.full(int(comm.rank == 0), 70)}  # fmt: skip
    with (
        linkage.with_fields(sets=sets) as bare,
        bare.with_interfaces([hpcred.Interface(name="eye", nodes=(1, 7, 14), node=99)]) as model,
        model.with_inputs([("eye", "x"), (20, "z")]) as loaded,
        hpcred.reduce(loaded, [hpcred.Modes(count=3)], hpcred.Buckens()) as rom,
    ):
        hpcred.write_result(folder / "r.h5", rom, loaded)
    if comm.rank == 0:
        result = hpcred.read_result(folder / "r.h5", MPI.COMM_SELF)
        body, numbered = result.body(["eye", "tip", 4, 3]), result.body([99, 20, 3, 4])
        assert sorted(shape.node for shape in body.nodes) == [3, 4, 20, 99] and body.nodes[0].name == "eye"
        phi = {shape.node: shape.phi for shape in numbered.nodes}
        assert all(np.array_equal(shape.phi, phi[shape.node]) for shape in body.nodes)
        known = "no interface or node set of this name; interfaces: eye; node sets: eye, mesh only, tip"
        with pytest.raises(hpcred.InputError, match=known):
            result.body(["tips"])
        with pytest.raises(hpcred.InputError, match="no node of the set 'mesh only' has dofs"):
            result.body(["mesh only"])
