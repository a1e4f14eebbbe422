"""The solid bends like a beam."""

import numpy as np
import pytest
from helpers import block_from

import hpcred
from hpcred import InputError, Modes
from hpcred.body import Preload
from hpcred.body.preload import preloaded
from hpcred.fe import ElementProperties
from hpcred.fe.solids import Solids
from hpcred.model.material_stiffness import material_stiffness

pytestmark = pytest.mark.mpi


@pytest.mark.costly
def test_a_slender_block_bends_like_a_beam(comm):
    """Cantilever of Euler and Bernoulli: f1 = 1.8751^2 / (2 pi L^2) sqrt(E I / (rho A))."""
    first = 1.875104**2 / (2 * np.pi) * np.sqrt(2e11 * 0.02**2 / 12 / 7850)
    model = hpcred.solid((200, 2, 2), (1.0, 0.02, 0.02), 1, young=2e11, poisson=0.0, comm=comm)
    with model, hpcred.reduce(model, [Modes(count=2)]) as rom:
        assert np.allclose(rom.frequencies, first, rtol=0.03)


@pytest.mark.costly
def test_elements_of_a_clamped_block_keep_their_held_nodes(comm, folder):
    """Those of K: their assembly is K, and their stress beside the clamp that of the free block with the same motion,
    also after model.h5; preload and geometric stiffness find the strain energy of K."""
    with hpcred.solid((6, 2, 3), inputs=3, comm=comm) as made:
        hpcred.write_model(folder / "model.h5", made)
    with (
        hpcred.read_model(folder / "model.h5", comm) as model,
        hpcred.solid((6, 2, 3), clamped=False, comm=comm) as free,
    ):
        assert comm.allreduce(len(model.elements["hexahedron"])) == 36 and model.node_count == 72
        rest = material_stiffness(model, "solid")
        rest.axpy(-1.0, model.K)
        assert rest.norm() < 1e-12 * model.K.norm()
        assert Solids(model).warnings() == []
        # node 1 lies beside the clamp; the free block has the held nodes first
        whole = np.zeros((free.size, 1))
        whole[36:, 0] = np.random.default_rng(3).standard_normal(model.size)
        stresses = []
        for item, moved, nodes in ((model, whole[36:], [1, 73]), (free, whole, [13, 1])):
            columns = block_from(item.K, moved)
            found = hpcred.stress_modes(item, columns, nodes)
            assert found.remarks == ()
            node, stress = (np.concatenate(comm.allgather(part), axis=axis)
                            for part, axis in ((found.node, 0), (found.stress, 1)))  # fmt: skip
            stresses.append(stress[0, [node.tolist().index(number) for number in nodes]])
            columns.destroy()
        assert np.allclose(*stresses, rtol=1e-9, atol=1e-9 * np.abs(stresses[0]).max())
        spinning = preloaded(model, Preload(omega=(0.0, 0.0, 100.0)))
        basis = [Modes(count=1)]
        with spinning, hpcred.reduce(model, basis) as still, hpcred.reduce(spinning, basis) as spun:
            assert 0 < spun.frequencies[0] / still.frequencies[0] - 1 < 1e-3


@pytest.mark.costly
def test_elements_that_are_missing_are_said_where_stresses_need_them(comm):
    """At the nodes beside them only: in stress modes, and in reductions with stresses as outputs."""
    with hpcred.solid((6, 2, 3), inputs=3, comm=comm) as model:
        cells = model.elements["hexahedron"]
        kept = {"hexahedron": cells[cells.max(axis=1) <= model.node_count]}
        properties = ElementProperties.of_one(comm, kept, model.properties.materials[0])
        with model.with_fields(elements=kept, properties=properties, held=None) as lacking:
            assert comm.allreduce(len(kept["hexahedron"])) == 30
            says = "stress: the forces of the solid elements of solid are not those of K at 12 nodes"
            assert [text.partition(",")[0] for text in Solids(lacking).warnings()] == [says]
            for node, count in ((1, 1), (30, 0)):
                measured = lacking.with_outputs([hpcred.outputs.StressOutput(node=node, stress="xx")])
                with measured, hpcred.reduce(measured, [Modes(count=3)]) as rom:
                    told = [text for text in rom.record.warnings if text.startswith("stress: the forces")]
                    assert len(told) == len(hpcred.stress_modes(lacking, rom.columns, [node]).remarks) == count


def test_a_block_of_about_so_many_dofs():
    """Of the shape of the default one."""
    for dofs in (300, 3000, 20_000):
        for clamped in (True, False):
            with hpcred.solid(dofs=dofs, clamped=clamped) as model:
                assert abs(model.size - dofs) < 0.45 * dofs
    with pytest.raises(InputError, match="dofs: found it beside cells"):
        hpcred.solid((2, 2, 2), dofs=300)
