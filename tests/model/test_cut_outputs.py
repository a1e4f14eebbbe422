"""Section forces of a cut, against the balance of forces, moments and inertia of one side."""

from dataclasses import replace

import numpy as np
import pytest

import hpcred
from hpcred import InputError
from hpcred.body.units import in_units
from hpcred.model.outputs.cuts import cut_output_of
from hpcred.model.units import unit_of_response
from hpcred.outputs import CutOutput, MotionOutput
from tests.helpers import bar

POINT = (0.045, 0.01, 0.02)


def cantilever(comm, clamped=True):
    """A block along x, clamped at x = 0 or free, with forces at its free end, and the sets on both sides of x = 0.045,
    and of all nodes."""
    model = hpcred.solid((8, 3, 3), None, 4, clamped=clamped, comm=comm)
    dofs = model.dofs
    masks = {"TIP": dofs.position[:, 0] > 0.045, "ROOT": dofs.position[:, 0] < 0.045, "ALL": dofs.node > 0}
    # each number on one rank: nodes of this model are not divided among ranks
    return model.with_fields(sets={name: np.unique(dofs.node[mask]) for name, mask in masks.items()})


def resultants(model, point, rows=None):
    """Force and moment (6, p) about a point of all inputs, which are unit forces at nodes, from their names."""
    comm, dofs, columns = model.comm, model.dofs, []
    for name in model.input_names:
        node, direction = name.split(":")
        mine = dofs.position[dofs.node == int(node)][:1]
        place = np.concatenate(comm.allgather(mine))[0]
        force = np.eye(3)["xyz".index(direction)]
        columns.append([*force, *np.cross(place - point, force)])
    return np.array(columns).T


@pytest.mark.mpi
def test_at_rest_it_is_the_load_of_the_side(comm):
    model = cantilever(comm)
    cut = model.with_outputs([CutOutput(cut="TIP", about=POINT), CutOutput(cut="TIP", component="my")])
    assert cut.output_names[:2] == ("cut TIP at 0.045 0.01 0.02:fx", "cut TIP at 0.045 0.01 0.02:fy")
    assert cut.output_names[6:] == ("cut TIP:my",)
    H = hpcred.frequency_response(cut, [0.0])[0].real
    assert H[:6] == pytest.approx(resultants(model, POINT), abs=1e-9)
    # of the nodes at x = 0.05, the first behind the cut, in the middle of the section
    assert H[6] == pytest.approx(resultants(model, (0.05, 0.015, 0.015))[4], abs=1e-9)
    # of all nodes it is the force on the support
    of_all = model.with_outputs([CutOutput(cut="ALL", about=POINT)])
    assert hpcred.frequency_response(of_all, [0.0])[0].real == pytest.approx(resultants(model, POINT), abs=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("clamped", [True, False])
def test_in_motion_it_is_the_load_less_the_inertia_of_the_side(comm, clamped):
    model = cantilever(comm, clamped)
    frequencies = np.array([400.0, 5500.0])
    found = hpcred.frequency_response(model.with_outputs([CutOutput(cut="TIP", about=POINT)]), frequencies)
    # R_S^T M q'', from the displacements of all dofs
    every = hpcred.frequency_response(model.with_outputs(list(range(1, model.size + 1))), frequencies)
    dofs, M = model.dofs, model.M.convert("dense")
    side, place = np.isin(dofs.node, np.concatenate(comm.allgather(model.sets["TIP"]))), dofs.position - POINT
    R = np.zeros((len(side), 6))
    R[np.arange(len(side)), dofs.direction] = 1.0
    R[:, 3:] = np.array([np.cross(np.eye(3), arm)[:, axis] for arm, axis in zip(place, dofs.direction, strict=True)])
    R[~side] = 0.0
    inertia = comm.allreduce(R.T @ M.getDenseArray().real) @ every * -((2 * np.pi * frequencies) ** 2)[:, None, None]
    balance = resultants(model, POINT) - inertia
    assert np.abs(inertia).max() > 0.1
    assert np.abs(found - balance).max() < 1e-7 * np.abs(balance).max()


@pytest.mark.mpi
def test_a_beam_that_is_held_at_its_end(comm):
    """Axial and shear force, torsion and bending moments of a cantilever of 1 m, at its third node, x = 0.5."""
    model = bar(comm, 1.0, 4).with_inputs([(5, "all")])
    dofs = model.dofs
    model = model.with_fields(sets={"TIP": np.unique(dofs.node[dofs.node >= 3])})
    cut = model.with_outputs([CutOutput(cut="TIP")])
    H = hpcred.frequency_response(cut, [0.0], hpcred.Tangent(node=1))[0].real
    expected = np.eye(6)  # forces and moments at the tip go through
    expected[4, 2], expected[5, 1] = -0.5, 0.5  # M = r x F with r = (0.5, 0, 0)
    assert np.abs(H - expected).max() < 1e-7


@pytest.mark.mpi
@pytest.mark.costly
def test_under_the_tolerance_and_in_files(comm, folder):
    model = cantilever(comm)
    hpcred.write_model(folder / "m.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(
            'model = "m.h5"\noutput = "r.h5"\nband = [0.0, 6000.0]\ntolerance = 1e-4\n'
            'outputs = [{cut = "TIP", component = "fz"}, {cut = "TIP", about = [0.045, 0.01, 0.02], component = "mx"}]'
        )
    comm.Barrier()
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    reduced = hpcred.read_result(folder / "r.h5", comm).reduced
    assert reduced.output_names == ("cut TIP:fz", "cut TIP at 0.045 0.01 0.02:mx") and reduced.record.accuracy.reached
    found = hpcred.evaluate(folder / "r.h5", folder / "m.h5", frequencies=[0.0, 2000.0, 5999.0], comm=comm)
    assert found["eps_max"] <= 1e-4


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.costly
@pytest.mark.parametrize("coordinates", ["modal", "interface"])
def test_a_free_body_to_a_tolerance(comm, coordinates):
    model = cantilever(comm, clamped=False)
    node = 1
    if coordinates == "interface":
        nodes, node = hpcred.Nodes(set="TIP"), "A"
        model = model.with_interfaces([hpcred.Interface(name="A", nodes=nodes, kind="averaging")])
    velocity = MotionOutput(node=node, direction="all", quantity="velocity")
    model = model.with_outputs([CutOutput(cut="TIP"), velocity])
    damping, settings = hpcred.Structural(0.01), hpcred.Reduction(coordinates=coordinates)
    reduced = hpcred.reduce(
        model, tolerance=1e-3, band=(0.0, 4000.0), frame=hpcred.Buckens(), settings=settings, damping=damping
    )
    assert reduced.record.accuracy.reached
    check = hpcred.check_reduced(reduced, model, 4, seed=5)  # of the elastic part
    assert check.passed, check.sentence


@pytest.mark.mpi
@pytest.mark.costly
def test_bodies_in_other_units(comm):
    targets = [
        CutOutput(cut="TIP", component="fz"), CutOutput(cut="TIP", component="mx"),
        hpcred.outputs.StressOutput(node=60, stress="xx"),
        *(MotionOutput(node=128, direction="z", quantity=name) for name in ("velocity", "acceleration")),
    ]  # fmt: skip
    model = cantilever(comm).with_outputs(targets)
    rom = hpcred.reduce(model, [hpcred.Modes(count=6), hpcred.StaticCorrection()])
    body = hpcred.body.body_of(model, rom)
    # kN, kN mm, GPa, mm/ms and mm/ms^2 of kN
    factors = np.array([1.0, 1e3, 1e-6, 1e3, 1.0])[:, None]
    H = rom.frequency_response([2000.0]) * factors
    other = in_units(body, hpcred.model.units_of("mm-kg-ms")).reduced
    assert (np.abs(other.frequency_response([2.0]) - H) < 1e-9 * np.abs(H).max(axis=2, keepdims=True)).all()
    renamed = replace(rom, output_names=("mine", *rom.output_names[1:]))
    with pytest.raises(InputError, match=r"units: mine may be a force or a moment"):
        in_units(replace(body, reduced=renamed), hpcred.model.units_of("mm-kg-ms"))


def test_names_and_units():
    for output in (CutOutput(cut="A b:c", component="fx"), CutOutput(cut="T", about=(0.1, -1e-9, 3.0), component="mz")):
        assert cut_output_of(*output.names) == output
    assert cut_output_of("20:z") is None and cut_output_of("cut T:rx") is None
    assert unit_of_response("cut T:fx", "20:z") == "N/N" and unit_of_response("cut T:mx", "20:z") == "(N m)/N"
    assert unit_of_response("cut T:fx", "20:rz") == "N/(N m)"


@pytest.mark.mpi(build="real")
def test_cuts_that_cannot_be_are_refused(comm):
    with pytest.raises(InputError, match=r"outputs.component: found 'qx', expected 'all' or 'fx'"):
        CutOutput(cut="TIP", component="qx")
    with pytest.raises(InputError, match=r"outputs.about: found \(0.0, nan, 0.0\), expected three finite numbers in m"):
        CutOutput(cut="TIP", about=(0.0, np.nan, 0.0))
    model = cantilever(comm)
    for name, sentence in (
        ("TOP", r"outputs: cut 'TOP'.set: solid has no set 'TOP'.*it has ALL, ROOT, TIP"),
        ("ROOT", r"outputs: cut 'ROOT': this side has supports.*on the other side"),
    ):
        with pytest.raises(InputError, match=sentence):
            model.with_outputs([CutOutput(cut=name)])
    with pytest.raises(InputError, match=r"outputs: cut 'ALL': no element connects its nodes to others"):
        cantilever(comm, clamped=False).with_outputs([CutOutput(cut="ALL")])
    more = {"TIP": np.append(model.sets["TIP"], 10**6) if comm.rank == 0 else model.sets["TIP"]}
    with pytest.raises(InputError, match=r"outputs: cut 'TIP': 1 of the \d+ nodes of the set have no row in solid"):
        model.with_fields(sets=more).with_outputs([CutOutput(cut="TIP")])
    with pytest.raises(InputError, match=r"inputs"):
        model.with_inputs([CutOutput(cut="TIP")])
