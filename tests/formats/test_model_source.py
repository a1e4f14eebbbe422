"""Files of other programs become a model."""

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import DATA
from foreign import gathered, write
from helpers import columns_of, to_dense

import hpcred
from hpcred import Buckens, Modes
from hpcred.formats.model_source import Source, abaqus_source, load_export, load_source

pytestmark = pytest.mark.mpi


BLOCKS = {"blockC3D8": [438.775, 438.775, 555.888, 967.04], "blockC3D10": [451.333, 452.01, 607.87, 1026.459]}


@pytest.mark.parametrize("name", BLOCKS)
def test_block_of_abaqus(comm, folder, name):
    """Real matrices: mass and frequencies as the program that wrote them gave."""
    with load_source(abaqus_source(DATA / f"{name}.inp"), comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    with hpcred.read_model(folder / "model.h5", comm) as model:
        report = hpcred.inspect(model)
        assert report["mass_kg"] == pytest.approx(11600)
        assert report["rigid_body_modes"] == 6
        assert np.allclose(report["centre_of_mass_m"], [2, 0.5, 0.5])
        model.set_inputs([(1, "x"), (20, "y")])
        for basis in ([Modes(count=4)], [Modes(band=(0.0, 1027.0))]):
            with hpcred.reduce(model, basis, Buckens()) as rom:
                assert np.allclose(rom.frequencies[:4], BLOCKS[name], atol=6e-4)


def test_nodes_in_any_order_and_dofs_with_gaps(comm, folder):
    """Rows that name their node and direction; node 30 has lost its y."""
    nodes = {10: (0.0, 0.0, 1.0), 30: (2.0, 0.0, 0.0), 20: (0.0, 3.0, 0.0)}
    rows = [(n, d) for n in (30, 10, 20) for d in (1, 2, 3) if (n, d) != (30, 2)]
    K = np.diag(np.arange(1.0, 9.0))
    if comm.rank == 0:
        for key in "KM":
            scipy.io.mmwrite(folder / f"{key}.mtx", scipy.sparse.coo_matrix(K), symmetry="symmetric")
        (folder / "nodes.txt").write_text("".join(f"{n} {x} {y} {z}\n" for n, (x, y, z) in nodes.items()))
        (folder / "dofs.txt").write_text("# node, direction\n" + "".join(f"{n}, {d}\n" for n, d in rows))
    comm.Barrier()
    source = Source(*(str(folder / f) for f in ("K.mtx", "M.mtx")), nodes=str(folder / "nodes.txt"),
                    dofs=str(folder / "dofs.txt"))  # fmt: skip
    with load_source(source, comm) as model:
        labels = comm.allgather((model.dofs.node, model.dofs.direction, model.dofs.position))
        node, direction, position = (np.concatenate(part) for part in zip(*labels, strict=True))
        assert list(zip(node, direction + 1, strict=True)) == rows
        assert np.array_equal(position, [nodes[n] for n, _ in rows])
        model.set_inputs([(30, "z")])
        assert columns_of(model.B)[:, 0].tolist() == [0, 1, 0, 0, 0, 0, 0, 0]
        with pytest.raises(hpcred.InputError, match="no dof in direction y; it has x, z"):
            model.set_inputs([(30, "y")])
