"""The script in examples/dolfinx, where DOLFINx is installed: matrices and nodes on several ranks, in both builds."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from helpers import to_dense

import hpcred
from hpcred.model.rigid_body.modes import misfit_of_nodes, rigid_body_quantities

SCRIPT = Path(__file__).parents[2] / "examples" / "dolfinx" / "bar.py"

pytestmark = [pytest.mark.dolfinx, pytest.mark.mpi]


@pytest.fixture(scope="module")
def bar():
    hpcred.start()  # so that the build of the tests is the one that DOLFINx finds
    pytest.importorskip("dolfinx")
    spec = importlib.util.spec_from_file_location("bar", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def lowest(K, M, count, shift):
    """Frequencies in Hz by dense matrices; of the pencil turned around, where the lowest are the most accurate."""
    found = scipy.linalg.eigh(M, K + shift * M, eigvals_only=True)[::-1][:count]
    return np.sqrt(np.abs(1 / found - shift)) / (2 * np.pi)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_free_bar(bar, degree):
    """Frequencies as of dense matrices on any number of ranks, hence the same on all, and near those of a beam."""
    V = bar.space((12, 1, 1), degree)
    with bar.body(V) as model:
        assert misfit_of_nodes(model) is None  # places belong to rows
        volume = bar.LENGTH * bar.WIDTH * bar.HEIGHT
        assert np.isclose(rigid_body_quantities(model).mass, bar.DENSITY * volume, rtol=1e-12)
        with hpcred.reduce(model, [hpcred.Modes(count=14)], hpcred.Buckens()) as reduced:
            found = reduced.frequencies[:8]
        K, M = to_dense(model.K), to_dense(model.M)
    assert np.allclose(found, lowest(K, M, 14, 1e6)[6:], rtol=5e-10)
    if degree == 2:
        assert np.allclose(found[:3], bar.slender_beam(3), rtol=0.015)


def test_a_clamped_bar(bar, comm):
    """Rows of boundary conditions, by the numbers that DOLFINx gives, are removed and their nodes kept."""
    V = bar.space((12, 1, 1))
    blocks = bar.fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    clamp = bar.fem.dirichletbc(np.zeros(3, bar.fem.Function(V).x.array.dtype), blocks, V)
    K, M = bar.matrices(V, [clamp])
    with pytest.raises(hpcred.InputError, match=r"with nothing beside the diagonal, the first is .*`held`"):
        hpcred.SecondOrderModel.from_petsc(K, M, nodes=bar.nodes(V))
    full = to_dense(K), to_dense(M)
    with hpcred.SecondOrderModel.from_petsc(K, M, nodes=bar.nodes(V), held=bar.rows(V, blocks)) as model:
        held = [np.concatenate(comm.allgather(part)) for part in (model.held.node, model.held.position[:, 0])]
        assert len(held[0]) == 27 and np.abs(held[1]).max() < 1e-14  # three by three nodes at the end
        tip = bar.nearest(model, (bar.LENGTH, 0.0, 0.0))
        with model.with_inputs([(tip, "z")]) as loaded, hpcred.reduce(loaded, [hpcred.Modes(count=6)]) as reduced:
            found = reduced.frequencies
    K.destroy()
    M.destroy()
    free = np.setdiff1d(np.arange(len(full[0])), np.flatnonzero(np.diag(full[0]) == 1.0))
    assert np.allclose(found, lowest(*(mat[np.ix_(free, free)] for mat in full), 6, 0.0), rtol=5e-10)
    bending = 1.875104069**2 * np.sqrt(bar.YOUNG / bar.DENSITY) / (2 * np.pi * bar.LENGTH**2) / np.sqrt(12)
    assert np.allclose(found[:2], bending * np.array([bar.HEIGHT, bar.WIDTH]), rtol=0.02)


@pytest.mark.parametrize("degree", [1, 2])
def test_elements_are_those_of_the_mesh(bar, comm, degree):
    """They fill the bar, in the order of VTK, and each stands on one rank."""
    V = bar.space((4, 2, 1), degree)
    with bar.body(V) as model:
        place = {}
        for nodes, places in comm.allgather((model.dofs.node[::3], model.dofs.position[::3])):
            place |= dict(zip(nodes.tolist(), places, strict=True))
        ((kind, cells),) = model.elements.items()
        corners = np.array([[place[node] for node in cell] for cell in cells.tolist()]).reshape(-1, cells.shape[1], 3)
    assert kind == ("tetra", "tetra10")[degree - 1]
    edges = corners[:, 1:4] - corners[:, :1]
    volume = comm.allreduce(np.abs(np.linalg.det(edges)).sum() / 6)
    assert np.isclose(volume, bar.LENGTH * bar.WIDTH * bar.HEIGHT, rtol=1e-12)
    if degree == 2:
        for middle, (one, other) in enumerate([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)], 4):
            assert np.allclose(2 * corners[:, middle], corners[:, one] + corners[:, other])


def test_the_script(bar, folder, comm, monkeypatch):
    monkeypatch.chdir(folder)
    bar.main(8)
    comm.Barrier()
    result = hpcred.read_result("bar.h5")
    assert np.allclose(result.reduced.frequencies[:2], bar.slender_beam(2), rtol=0.02)
    body = hpcred.writers.read_sid("bar.SID_FEM")
    assert body is not None and len(result.nodes) == 2
    assert sorted(path.name for path in folder.iterdir()) == ["bar.SID_FEM", "bar.h5", "bar.vtu"]
