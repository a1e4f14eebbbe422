"""A free body in parts or with hinges, inputs that only push it, and inputs in far-off units."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from helpers import close, columns_of, dense_model, few_on_ranks, gather

import hpcred
from hpcred.examples.linkage import Rod, beam_element
from hpcred.fe.dofs import Dofs
from hpcred.linalg.blocks import create_block, local_rows
from hpcred.model.frames import apply_frame
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.parallel.failures import ComputationError, InputError, Owned
from hpcred.parallel.petsc import is_complex
from hpcred.parallel.progress import Progress
from hpcred.reduction.components.modes import _without_rigid
from hpcred.reduction.run.run import Run

BAND = (0.0, 300.0)
WAYS = {
    "krylov": lambda model: hpcred.reduce(model, [hpcred.Krylov(150.0, 2)], hpcred.Buckens()),
    "krylov at rest": lambda model: hpcred.reduce(model, [hpcred.Krylov(0.0, 2)], hpcred.Buckens()),
    "lowest modes": lambda model: hpcred.reduce(model, [hpcred.Modes(count=4)], hpcred.Buckens()),
    "modes in a band": lambda model: hpcred.reduce(model, [hpcred.Modes(band=BAND)], hpcred.Buckens()),
    "tolerance": lambda model: hpcred.reduce(model, frame=hpcred.Buckens(), tolerance=1e-4, band=BAND),
    "responses": lambda model: hpcred.frequency_response(model, [10.0, 100.0], hpcred.Buckens()),
    "all responses": lambda model: hpcred.full_response(model, [10.0, 100.0], hpcred.Buckens()),
}
# by how the run's own factor, or its modes, show such motions; spectrum slicing is of the real build
UNCOUNTED = ("krylov at rest", "lowest modes", "tolerance", *["modes in a band"] * is_complex())


def beams(comm, kind):
    """Ten elements in a line: whole, in two parts, or with a hinge at node 6, which has a second rotation there."""
    nodes = np.linspace([0, 0, 0], [1, 0, 0], 11)
    size = 66 + (kind == "hinge")
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for e in range(10):
        rows = np.arange(6 * e, 6 * e + 12)
        if kind == "hinge" and e == 5:
            rows[4] = 66
        stiffness, mass = beam_element(nodes[e], nodes[e + 1], Rod())
        M[np.ix_(rows, rows)] += mass
        K[np.ix_(rows, rows)] += 0.0 if kind == "two parts" and e == 5 else stiffness
    node, direction = np.append(np.arange(66) // 6 + 1, 12), np.append(np.arange(66) % 6, 4).astype(np.int8)
    position = np.concatenate([np.repeat(nodes, 6, axis=0), nodes[5:6]])
    model = SecondOrderModel.from_scipy(
        K, M, dofs=Dofs(node[:size], direction[:size], position[:size]), comm=comm
    )
    return model.with_inputs([(1, "z"), (11, "z")])


@pytest.mark.mpi
@pytest.mark.parametrize("way", few_on_ranks(sorted(WAYS), 3))
@pytest.mark.costly
def test_a_body_with_more_free_motions_is_refused(comm, way):
    for kind, count in (("two parts", 6), ("hinge", 1)):
        with beams(comm, kind) as model:
            K, M, _ = dense_model(model)
            values = np.linalg.eigvalsh(np.linalg.solve(np.linalg.cholesky(M), np.linalg.solve(
                np.linalg.cholesky(M), K).T))  # fmt: skip
            assert (np.abs(values) < 1e-9 * values.max()).sum() == 6 + count
            many = "" if way in UNCOUNTED else f"{count} "
            with pytest.raises(InputError, match=f"K lets {many}more motions? happen without force than the 6"):
                WAYS[way](model)


@pytest.mark.mpi(build="real")
def test_modes_that_share_zero_with_the_rigid_motions(comm):
    """All seven modes at zero of a body with a hinge have six sevenths of rigid-body motions in them."""
    with beams(comm, "hinge") as model, Owned(comm) as owned:
        framed = apply_frame(model, hpcred.Buckens())
        run = owned.owns(Run(framed, Progress(comm, show=False), 1e-12))
        K, M, _ = dense_model(model)
        values, modes = scipy.linalg.eigh(K, M)
        R = gather(framed.rigid.R)
        hinge = modes[:, :7] @ scipy.linalg.null_space(R.T @ M @ modes[:, :7])
        turned = scipy.linalg.qr(np.column_stack([np.ones(7), np.eye(7)[:, 1:]]))[0]
        mixed = np.column_stack([hinge, R]) @ turned.T
        mine = slice(model.first_row, model.first_row + model.local_rows)
        block = create_block(model.K, 10)
        with local_rows(block) as rows:
            rows[...] = np.column_stack([mixed, modes[:, 7:10]])[mine]
        found, vectors = _without_rigid(run, np.append(np.zeros(7), values[7:10]), block)
        assert len(found) == 4 and abs(found[0]) < 1e-9 * values[7] and (found[1:] == values[7:10]).all()
        expected = np.column_stack([hinge, modes[:, 7:10]])
        assert np.abs(np.abs(expected.T @ M @ gather(vectors)) - np.eye(4)).max() < 1e-8


@pytest.mark.parametrize("way", WAYS)
def test_a_body_of_one_part_is_not_refused(comm, way):
    with beams(comm, "whole") as model:
        found = WAYS[way](model)
        if hasattr(found, "close"):
            found.close()


@pytest.mark.mpi
@pytest.mark.parametrize("kind", few_on_ranks(["hinge", "whole"]))
def test_a_free_body_without_frame(comm, kind):
    """Its response is infinite at 0 Hz, and not above."""
    with beams(comm, kind) as model:
        with pytest.raises(InputError, match="the response at 0 Hz is infinite, for the body is free"):
            hpcred.reduce(model, tolerance=1e-4, band=BAND)
        with hpcred.reduce(model, tolerance=1e-4, band=(30.0, 300.0)) as reduced:
            assert reduced.record.accuracy.reached


@pytest.mark.mpi
def test_a_single_load_on_a_free_body_without_frame(comm):
    """Its Krylov space has rigid motions at frequencies that are more than round-off of the largest."""
    with (
        hpcred.solid((6, 3, 2), clamped=False, comm=comm) as model,
        model.with_inputs([(1, "x")]) as loaded,
        pytest.raises(InputError, match="the response at 0 Hz is infinite, for the body is free"),
    ):
        hpcred.reduce(loaded, tolerance=1e-4, band=(0.0, 100.0))


@pytest.mark.mpi
def test_a_free_body_without_nodes(comm):
    """It is refused before a point is taken: a search with room for few columns would end without a reason."""
    few = hpcred.Adaptive(tolerance=1e-4, band=(0.0, 100.0), columns=12, factorisations=2)
    with (
        hpcred.solid((6, 3, 2), clamped=False, comm=comm) as model,
        model.with_inputs([1]) as loaded,
        loaded.with_fields(dofs=None) as bare,
    ):
        with pytest.raises(InputError, match="infinite, for the body is free; take frame 'buckens', which needs nodes"):
            hpcred.reduce(bare, adaptive=few)
        with hpcred.reduce(bare, adaptive=replace(few, band=(50.0, 100.0))) as reduced:
            assert reduced.record.accuracy is not None
    K = 2 * np.eye(90) - np.eye(90, k=1) - np.eye(90, k=-1)
    K[0, 0] = K[-1, -1] = 1
    for ground, free in ((0.0, True), (1e-7, False)):  # a soft spring, on which the body is not free
        K[4, 4] += ground
        with SecondOrderModel.from_scipy(K, np.eye(90), comm=comm) as model, model.with_inputs([1, 50]) as loaded:
            if free:
                with pytest.raises(InputError, match="the response at 0 Hz is infinite"):
                    hpcred.reduce(loaded, adaptive=replace(few, band=(0.0, 0.01)))
            else:
                hpcred.reduce(loaded, adaptive=replace(few, band=(0.0, 0.01))).close()


@pytest.mark.mpi
def test_loads_in_balance_on_a_free_body_without_frame(comm):
    """The response at 0 Hz is finite, of free directions that nothing pushes."""
    with beams(comm, "whole") as model:
        _, _, B = dense_model(model.with_inputs([(1, "x"), (11, "x")]))
        mine = slice(model.first_row, model.first_row + model.local_rows)
        with (
            model.with_input_columns((B[:, :1] - B[:, 1:])[mine], ["stretch"]) as stretched,
            hpcred.reduce(stretched, tolerance=1e-4, band=BAND) as reduced,
        ):
            assert reduced.record.accuracy.reached


@pytest.mark.mpi
def test_inputs_that_only_push_the_body(comm):
    """A load of inertia forces: M times a translation."""
    with beams(comm, "whole") as model:
        _, M, B = dense_model(model)
        push = M @ np.tile(np.eye(6)[2], 11)
        mine = slice(model.first_row, model.first_row + model.local_rows)
        with model.with_input_columns(np.column_stack([B[:, 0], push])[mine], ["force", "push"]) as both:
            with hpcred.reduce(both, [hpcred.Krylov(150.0, 1)], hpcred.Buckens()) as reduced:
                assert "the inputs push push the free body as a whole only" in reduced.record.warnings[0]
            found = hpcred.full_response(both, [10.0, 20.0], hpcred.Buckens())
            assert "as a whole only" in found.warnings[0]
        with (
            model.with_input_columns(push[mine, None], ["push"]) as only,
            pytest.raises(InputError, match="the inputs push push .* there is nothing to compute"),
        ):
            hpcred.reduce(only, [hpcred.Krylov(150.0, 1)], hpcred.Buckens())


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("scale", [*few_on_ranks([1e-280, 1e150]), pytest.param(1e-150, marks=pytest.mark.slow)])
@pytest.mark.costly
def test_inputs_in_far_off_units(comm, linkage, scale):
    """Reduced models and responses are those of inputs of size 1, in other units; both ways to scale are exact."""
    with linkage.with_inputs([(20, "z"), (1, "x")]) as model:
        B = columns_of(model.B)[model.first_row : model.first_row + model.local_rows]
        with model.with_input_columns(B * scale, model.input_names) as far:
            # outputs of size 1, so that a response has the scale once
            far = far.with_output_columns(B, model.input_names)
            for way in ("krylov", "tolerance"):
                with WAYS[way](model) as near, WAYS[way](far) as found:
                    assert np.abs(found.frequencies / near.frequencies - 1).max() < 1e-6
                    assert close(near.transfer_function(600j), found.transfer_function(600j) / scale) < 1e-6
            for way in ("responses", "all responses"):
                expected, values = WAYS[way](model), WAYS[way](far)
                expected, values = (getattr(item, "response", item) for item in (expected, values))
                assert close(expected, values / scale) < 1e-6
            far.close()


def test_a_response_beyond_all_numbers(linkage):
    with linkage.with_inputs([(20, "z")]) as model:
        B = columns_of(model.B) * 1e300
        with (
            model.with_input_columns(B, ["a"]) as far,
            pytest.raises(ComputationError, match="the response is beyond what double precision holds"),
        ):
            WAYS["responses"](far)
