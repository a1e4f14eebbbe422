"""The store of expansion points: what comes from it is what would be computed, on any ranks, after any interruption."""

import contextlib
import errno
import os
import shutil

import h5py
import numpy as np
import pytest
from adaptive_models import hard_cases, tied_chains, unit
from helpers import block_with_ends, few_on_ranks, gather

import hpcred as package
from hpcred import (
    Adaptive,
    Buckens,
    Caughey,
    Chord,
    Factoring,
    Krylov,
    LinearSolver,
    Modes,
    PointStore,
    Rayleigh,
    SecondOrderKrylov,
    StaticCorrection,
    Structural,
    Tangent,
)
from hpcred.files import hdf5, room
from hpcred.linalg.conjugate_gradients import NegativeCurvature
from hpcred.linalg.solvers.multigrid import MultigridSolver
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.failures import ComputationError
from hpcred.parallel.petsc import MPI, is_complex
from hpcred.reduction import ConstraintModes
from hpcred.reduction.run.notes import Notes

BAND = (0.0, 300.0)
FREQUENCIES = np.linspace(5, 295, 30)
MIXTURE = (
    Modes(index=(7, 8, 9)), Krylov(frequency=40.0, order=1), SecondOrderKrylov(frequency=150.0, order=2),
    Krylov(frequency=90.0, decay=3.0, order=1), StaticCorrection(), SecondOrderKrylov(decay=0.0, order=1),
)  # fmt: skip
DAMPED = Rayleigh(2.0, 1e-5)


def reduced(model, store=None, basis=(), frame=None, damping=None, **more):
    """The reduced model as arrays, its basis and frequency response among them, and its record."""
    with package.reduce(model, basis, frame, damping, store=store, **more) as rom:
        omega = 2 * np.pi * FREQUENCIES[:, None, None]
        H = rom.C @ np.linalg.solve(rom.K - omega**2 * rom.M + 1j * omega * rom.D, rom.B[None])
        return {"K": rom.K, "D": rom.D, "B": rom.B, "C": rom.C, "V": gather(rom.columns), "H": H}, rom.record


def same(one, other, to=0.0):
    """Whether two reduced models agree, to the last bit, or their responses to a relative difference."""
    if not to:
        return all(np.array_equal(one[key], other[key]) for key in one)
    return one["K"].shape == other["K"].shape and np.abs(one["H"] - other["H"]).max() <= to * np.abs(one["H"]).max()


def tolerance_of(comm):
    """MUMPS adds in another order each time when there are several ranks."""
    return 0.0 if comm.size == 1 else 1e-10


@pytest.mark.mpi
@pytest.mark.costly
def test_what_comes_from_the_store_is_what_was_computed(comm, folder):
    """Every kind of component, to the last bit: nothing is factored, and all is said to come from the store."""
    store = PointStore(folder / "a" / "b", comm)
    with package.linkage(comm) as model:
        first, record = reduced(model, store, MIXTURE, Buckens(), DAMPED)
        assert not record.factorisations_saved and not any(item.from_store for item in record.components)
        made = len(record.factorisations)
        second, record = reduced(model, store, MIXTURE, Buckens(), DAMPED)
        assert same(first, second)
        assert not record.factorisations and record.factorisations_saved == made == 5
        assert all(item.from_store for item in record.components) and not record.warnings
        alone, record = reduced(model, None, MIXTURE, Buckens(), DAMPED)
        assert same(first, alone, tolerance_of(comm)) and len(record.factorisations) == made
    rows = package.list_store(folder / "a" / "b", check=True, comm=comm)
    assert len(rows) == 6 and all(row["valid"] for row in rows)


@pytest.mark.mpi
@pytest.mark.parametrize("frame", [Tangent(7), Chord((1, 7, 14), "yxz"), Chord((1, 7, 14))])
def test_entries_are_those_of_any_number_of_ranks(comm, folder, frame):
    """Made on one rank, read on all: with dofs removed, and with nodes turned, whose matrices differ in last digits."""
    basis = [Krylov(frequency=40.0, order=1), SecondOrderKrylov(frequency=250.0)]  # all of whose directions are clear
    package.start()  # PETSc, on all ranks together
    if comm.rank == 0:
        with package.linkage(MPI.COMM_SELF) as model:
            reduced(model, PointStore(folder, MPI.COMM_SELF), basis, frame, DAMPED)
    comm.Barrier()
    with package.linkage(comm) as model:
        found, record = reduced(model, PointStore(folder, comm), basis, frame, DAMPED)
        alone, _ = reduced(model, None, basis, frame, DAMPED)
    assert not record.factorisations and record.factorisations_saved == 2 and not record.warnings
    assert same(alone, found, 1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", few_on_ranks(["area", "rigid", "set", "at"]))
@pytest.mark.costly
def test_interfaces_of_other_nodes_have_columns_of_their_own(comm, folder, kind):
    """Of a set with other members, of one with weights by the faces around it, and of a reference node elsewhere."""
    models = []
    with package.solid((4, 2, 2), comm=comm) as block:
        labels, places = block.dofs.node, block.dofs.position
        nodes = [np.unique(labels[mask]) for mask in (places[:, 0] > 0.039, places[:, 1] > places[:, 1].max() - 1e-9)]
        for number in range(2):
            fields = {"sets": {"bearing": nodes[number if kind in ("set", "rigid") else 0]}}
            if kind == "area" and number:  # without the faces of half of the elements
                fields["elements"] = {key: part[::2] for key, part in block.elements.items()}
            asked = package.Interface(
                name="b", nodes=package.Nodes(set="bearing"), kind="rigid" if kind == "rigid" else "averaging",
                weights="area" if kind == "area" else "equal", at=(0.04, 0.0, 0.01 * number) if kind == "at" else None,
            )  # fmt: skip
            with block.with_fields(**fields) as other:
                models.append(other.with_interfaces([asked]).with_inputs([20]))
    store, basis = PointStore(folder, comm), [package.CraigBampton(count=3)]
    for model in models:
        found, record = reduced(model, store, basis)
        assert not any(item.from_store for item in record.components)
    assert same(found, reduced(models[1], None, basis)[0], 1e-9)
    assert models[0].digest_of("B") == models[1].digest_of("B")
    again, record = reduced(models[0], store, basis)
    assert all(item.from_store for item in record.components)


class Killed(ComputationError):
    pass


class Mortal(PointStore):
    """A store whose run ends after so many entries."""

    left = 0

    def save(self, model, key, entry, say):
        super().save(model, key, entry, say)
        self.left -= 1
        if self.left == 0:
            raise Killed("the run was killed")


JOBS = {
    "points": {"basis": MIXTURE, "frame": Buckens(), "damping": DAMPED},
    "tolerance": {"frame": Buckens(), "tolerance": 1e-4, "band": BAND},
    "tolerance and modes": {"frame": Chord((1, 7, 14), "yxz"), "basis": (Modes(count=2),), "damping": DAMPED,
                            "adaptive": Adaptive(tolerance=1e-6, band=BAND, points=(30.0, 220.0))},
}  # fmt: skip


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
@pytest.mark.parametrize("kind", ["points", pytest.param("tolerance", marks=pytest.mark.slow), "tolerance and modes"])
def test_a_run_that_is_killed_after_any_point_goes_on(comm, folder, kind):
    with package.linkage(comm) as model:
        whole, record = reduced(model, PointStore(folder / "whole", comm), **JOBS[kind])
        points, entries = len(record.factorisations), len(list((folder / "whole").iterdir()))
        store = Mortal(folder / "killed", comm)
        for _ in range(entries):
            store.left = 1
            with pytest.raises(Killed):
                reduced(model, store, **JOBS[kind])
        found, record = reduced(model, store, **JOBS[kind])
        assert same(whole, found, tolerance_of(comm))
        assert not record.factorisations and record.factorisations_saved == points
    assert not [row for row in package.list_store(folder / "killed", check=True, comm=comm) if not row["valid"]]


@pytest.mark.mpi
def test_a_run_that_is_killed_goes_on_on_other_ranks(comm, folder):
    job = JOBS["tolerance"]
    package.start()  # PETSc, on all ranks together
    if comm.rank == 0:
        with package.linkage(MPI.COMM_SELF) as model, contextlib.suppress(Killed):
            reduced(model, PointStore(folder / "whole", MPI.COMM_SELF), **job)
            store = Mortal(folder / "killed", MPI.COMM_SELF)
            store.left = len(list((folder / "whole").iterdir()))
            reduced(model, store, **job)
    comm.Barrier()
    with package.linkage(comm) as model:
        found, record = reduced(model, PointStore(folder / "killed", comm), **job)
        alone, expected = reduced(model, None, **job)
    assert record.factorisations_saved == len(expected.factorisations) and not record.factorisations
    assert record.accuracy.points[0].from_store and (is_complex() or record.accuracy.points[1].factor_of)
    assert same(alone, found, 1e-7 if is_complex() else 1e-10)  # far below the tolerance of 1e-4


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("kind, block", few_on_ranks(
    [("direct", 1), ("multigrid", 2), ("multigrid", 1)], 2))  # fmt: skip
@pytest.mark.costly
def test_a_search_that_failed_beside_its_basis_is_repeated_without_a_factor(comm, folder, monkeypatch, kind, block):
    """It goes the same way again, by a factor in the band or more blocks at 0 Hz, and does not try once more."""
    if kind == "direct" and is_complex():
        pytest.skip("without counts of modes a search takes a factor at each point")
    solver, calls = (ShiftedSolver if kind == "direct" else MultigridSolver), []
    solve = solver.solve_below

    def fails_at_a_block(self, *rest):
        calls.append(rest)
        if len(calls) == block:
            raise NegativeCurvature("the basis lacks a mode")
        solve(self, *rest)

    monkeypatch.setattr(solver, "solve_below", fails_at_a_block)
    given = {"tolerance": 1e-6, "band": (0.0, 30000.0), "factoring": Factoring(solver=LinearSolver(kind=kind))}
    with package.solid((4, 2, 3), inputs=1, comm=comm) as model:
        first, record = reduced(model, PointStore(folder, comm), **given)
        made, solves = len(record.factorisations), len(calls)
        assert solves >= block and record.accuracy.reached
        second, again = reduced(model, PointStore(folder, comm), **given)
    assert same(first, second) and len(calls) == solves
    assert not again.factorisations and again.factorisations_saved == made
    assert [point.factor_of for point in again.accuracy.points] == [
        point.factor_of for point in record.accuracy.points
    ]


def test_rough_solutions_of_multigrid_do_not_serve_searches_with_factors(folder):
    given, by_multigrid = {"tolerance": 1e-6, "band": (0.0, 30000.0)}, Factoring(solver=LinearSolver(kind="multigrid"))
    with package.solid((4, 2, 3), inputs=1) as model:
        rough, _ = reduced(model, PointStore(folder), factoring=by_multigrid, **given)
        found, record = reduced(model, PointStore(folder), **given)
        alone, expected = reduced(model, None, **given)
        again, repeated = reduced(model, PointStore(folder), factoring=by_multigrid, **given)
    assert same(alone, found) and len(record.factorisations) == len(expected.factorisations) > 0
    assert same(rough, again) and not repeated.factorisations


def test_a_factor_counts_once_in_a_row():
    notes = Notes()
    for mass in "abbccca":
        notes.needs(mass, "0")
    assert [mass for mass, _ in notes.needed] == ["a", "b", "c", "a"]


SEQUENCES = {
    "real": (Krylov(frequency=80.0, order=1), Krylov(frequency=80.0, order=4)),
    "complex": (Krylov(frequency=80.0, decay=5.0), Krylov(frequency=80.0, decay=5.0, order=3)),
    "infinity": (Krylov(infinity=True), Krylov(infinity=True, order=2)),
    "second order": (SecondOrderKrylov(frequency=80.0, order=1), SecondOrderKrylov(frequency=80.0, order=4)),
    "second order, static": (SecondOrderKrylov(decay=0.0), SecondOrderKrylov(decay=0.0, order=3)),
}


@pytest.mark.mpi
@pytest.mark.parametrize("sequence", few_on_ranks(list(SEQUENCES), 2))
def test_a_sequence_is_extended_from_where_it_ends(comm, folder, sequence):
    """By one factor, to what it is when made at once; then it serves the shorter one as well."""
    short, long = SEQUENCES[sequence]
    with package.linkage(comm) as model:
        before, _ = reduced(model, PointStore(folder / "one", comm), [short], Chord((1, 7, 14), "yxz"), DAMPED)
        found, record = reduced(model, PointStore(folder / "one", comm), [long], Chord((1, 7, 14), "yxz"), DAMPED)
        at_once, _ = reduced(model, PointStore(folder / "two", comm), [long], Chord((1, 7, 14), "yxz"), DAMPED)
        assert same(at_once, found, tolerance_of(comm))
        assert len(record.factorisations) == 1 and record.factorisations_saved == 0
        assert [item.from_store for item in record.components] == [
            j <= short.order for j in range(len(record.components))
        ]
        after, record = reduced(model, PointStore(folder / "one", comm), [short], Chord((1, 7, 14), "yxz"), DAMPED)
        assert same(before, after) and not record.factorisations


class OfAnEarlierVersion(PointStore):
    """A store as earlier versions wrote it, which called Krylov sequences chains."""

    def save(self, model, key, entry, say):
        super().save(model, key | {"kind": key["kind"].replace("krylov", "chain")}, entry, say)


@pytest.mark.mpi
def test_stores_of_earlier_versions_serve(comm, folder):
    basis = [Krylov(frequency=80.0, order=2)]
    with package.linkage(comm) as model:
        before, _ = reduced(model, OfAnEarlierVersion(folder, comm), basis, Buckens())
        names = comm.bcast([path.name for path in folder.iterdir()] if comm.rank == 0 else None)
        assert len(names) == 1 and names[0].startswith("chain-")
        found, record = reduced(model, PointStore(folder, comm), basis, Buckens())
        assert same(before, found) and not record.factorisations and record.factorisations_saved == 1
    (row,) = package.list_store(folder, check=True, comm=comm)
    assert row["valid"] and (row["kind"], row["point"], row["columns"]) == ("krylov", "80 Hz", found["K"].shape[0])


@pytest.mark.parametrize("case", ["linkage", "solid"])
def test_a_sweep_factors_each_point_once(comm, folder, case):
    """Damping, orders and mixtures; the highest order comes first, so that no sequence has to grow."""
    model = package.linkage(comm) if case == "linkage" else package.solid((4, 2, 3), inputs=3, comm=comm)
    frame = Buckens() if case == "linkage" else None
    dampings = [None, Rayleigh(2.0, 1e-5), Caughey((1.0, 1e-6, 1e-14)), Structural(0.02)]
    points = (100.0, 250.0) if case == "linkage" else (2000.0, 9000.0)
    made, saved, alone = [], 0, 0
    with model:
        for order in (1, 0):
            for damping in dampings:
                for before in ((), (Modes(count=3),)):
                    basis = [*before, *(Krylov(frequency=f, order=order) for f in points), StaticCorrection()]
                    _, record = reduced(model, PointStore(folder, comm), basis, frame, damping)
                    made += [item.mass for item in record.factorisations if item.mass != "inf"]  # which Caughey needs
                    saved += record.factorisations_saved
                    alone += len(points) + 1 + bool(before)
    assert len(made) - made.count("0.0") == len(set(made)) - 1 == 2  # K serves modes and the static correction
    assert len(made) + saved == alone and made.count("0.0") <= 2


def test_a_search_serves_others(comm, folder):
    """Another damping and a looser tolerance find all that they need; a tighter one extends the sequences."""
    store = PointStore(folder, comm)
    with package.solid((4, 2, 3), inputs=3, comm=comm) as model:
        given = {"band": (0.0, 30000.0), "store": store}
        counts = []
        damped = Rayleigh(10.0, 1e-7)
        for tolerance, damping in ((1e-5, None), (1e-3, None), (1e-5, damped), (1e-8, None), (1e-8, None)):
            found, record = reduced(model, damping=damping, tolerance=tolerance, **given)
            alone, expected = reduced(model, damping=damping, tolerance=tolerance, **(given | {"store": None}))
            assert same(alone, found, 1e-10)  # a proof is solved for beside the basis of the run that made it
            assert record.accuracy.reached == expected.accuracy.reached
            assert len(record.factorisations) + record.factorisations_saved == len(expected.factorisations)
            assert record.accuracy.factorisations == len(record.factorisations)
            counts.append(len(record.factorisations))
    assert counts[1] == counts[4] == 0, counts
    if not is_complex():  # whose points are counted, and one is enough
        assert counts[0] == 1 and counts[2] == 0, counts


@pytest.mark.parametrize("name", ["25 masses, 40 dashpots", "tied"])
def test_what_a_search_makes_from_its_basis_is_served_as_well(comm, folder, name):
    """Blocks from residuals, random columns, modes that no load moves: with the same history."""
    if name == "tied":
        if is_complex():
            pytest.skip("a complex build has no inertia")
        K, M = tied_chains(1e-9)
        model = package.SecondOrderModel.from_scipy(K, M, comm=comm)
        model = model.with_input_columns(unit(80, 5)[model.first_row : model.first_row + model.local_rows], ["f"])
        given = {"tolerance": 1e-4, "band": (0.0, 0.2)}
    else:
        case = hard_cases()[name]()
        model, given = case.model(comm), {"frame": case.frame, "damping": case.damping, "band": case.band}
        given |= {"tolerance": 1e-2}
    with model:
        first, record = reduced(model, PointStore(folder, comm), **given)
        second, again = reduced(model, PointStore(folder, comm), **given)
    assert same(first, second)
    assert record.factorisations and not again.factorisations


def changed_models(comm):
    """Models and jobs that differ in one thing from the first."""
    basis = [Krylov(frequency=100.0, order=1)]
    with package.linkage(comm) as model:
        indptr, indices, values = model.K.getValuesCSR()
        other = values.real.copy()
        if comm.rank == 0:
            other[np.abs(other).argmax()] *= 1 + 2**-51
        stiffer = package.SecondOrderModel.from_csr(
            comm, model.size, indptr, indices, {"K": other, "M": model.M.getValuesCSR()[2].real}, dofs=model.dofs
        ).with_inputs([(20, "z")])
        yield model, basis, {}
        yield model.with_inputs([(20, "y")]), basis, {}
        yield model, basis, {"frame": Chord((1, 7, 14), "yxz")}
        yield model, basis, {"deflation_tolerance": 1e-8}
        yield model, [Krylov(frequency=100.0 * (1 + 2**-50), order=1)], {}
        yield stiffer, basis, {}


@pytest.mark.mpi
@pytest.mark.costly
def test_nothing_is_served_to_another_job(comm, folder):
    for model, basis, changed in changed_models(comm):
        _, record = reduced(model, PointStore(folder, comm), basis, **({"frame": Buckens()} | changed))
        assert len(record.factorisations) == 1 and not record.factorisations_saved
    assert len(package.list_store(folder, comm=comm)) == 6


def flip(path, where):
    """Change one byte."""
    content = bytearray(path.read_bytes())
    content[where(content)] ^= 1
    path.write_bytes(content)


def cut(path):
    path.write_bytes(path.read_bytes()[:-1000])  # more than the seal


def of_another(path):
    """The entry of another point under this name."""
    other = next(item for item in sorted(path.parent.iterdir()) if item != path and item.name.startswith("krylov"))
    shutil.copy(other, path)


def with_nan(path):
    with h5py.File(path, "r+") as file:
        file["blocks/1"][3, 0] = np.nan


def narrower(path):
    with h5py.File(path, "r+") as file:
        values = file["blocks/0"][:-1]
        del file["blocks/0"]
        file["blocks/0"] = values


def of_another_version(path):
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 99


DAMAGES = {
    "a byte of a block": (lambda path: flip(path, lambda _: block_place(path) + 80), "does not have its checksum"),
    "a byte of the header": (lambda path: flip(path, lambda content: content.index(b'"facts"') + 1), "checksum"),
    "cut": (cut, "truncated|cut|not a readable"), "empty": (lambda path: path.write_bytes(b""), "found no HDF5 file"),
    "another entry": (of_another, "belongs to another key"), "nan": (with_nan, "not finite"),
    "a row less": (narrower, "has the shape"), "version": (of_another_version, "found version 99"),
}  # fmt: skip


def block_place(path):
    with h5py.File(path, "r") as file:
        return file["blocks/0"].id.get_offset()


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("damage", few_on_ranks(list(DAMAGES)))
def test_damaged_entries_are_made_again(comm, folder, damage):
    basis = [Krylov(frequency=100.0, order=1), Krylov(frequency=200.0, order=1)]
    harm, said = DAMAGES[damage]
    with package.linkage(comm) as model:
        store = PointStore(folder, comm)
        first, _ = reduced(model, store, basis, Buckens())
        if comm.rank == 0:
            harm(sorted(folder.iterdir())[0])
        comm.Barrier()
        broken = [row for row in package.list_store(folder, check=True, comm=comm) if not row["valid"]]
        assert len(broken) == 1
        second, record = reduced(model, store, basis, Buckens())
        assert len(record.factorisations) == 1 and same(first, second, tolerance_of(comm))
        assert len(record.warnings) == 1 and "is not used" in record.warnings[0]
        assert any(part in record.warnings[0] for part in said.split("|")), record.warnings
        assert all(row["valid"] for row in package.list_store(folder, check=True, comm=comm))
        third, record = reduced(model, store, basis, Buckens())
        assert not record.factorisations and not record.warnings


@pytest.mark.mpi
def test_a_full_disk_is_a_word_and_no_more(comm, folder, monkeypatch):
    """At the first rank, before anything is written; or at the last rank alone, in the middle."""

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    basis = [Krylov(frequency=100.0, order=1)]
    with package.linkage(comm) as model:
        alone, _ = reduced(model, None, basis, Buckens())
        for where, what in ((room, "_allocate"), (hdf5, "_put")):
            with monkeypatch.context() as patched:
                if what == "_allocate" or comm.rank == comm.size - 1:
                    patched.setattr(where, what, full)
                found, record = reduced(model, PointStore(folder, comm), basis, Buckens())
            assert same(alone, found, tolerance_of(comm))
            assert len(record.warnings) == 1 and "No space left on device" in record.warnings[0]
            comm.Barrier()
            assert not list(folder.iterdir())


@pytest.mark.mpi
def test_groups_of_ranks_write_and_read(comm, folder):
    with package.linkage(comm) as model:
        together, record = reduced(model, PointStore(folder, comm), MIXTURE, Buckens(), DAMPED, groups=comm.size)
        assert record.factorisations
        for groups in (comm.size, 1):
            found, record = reduced(model, PointStore(folder, comm), MIXTURE, Buckens(), DAMPED, groups=groups)
            assert not record.factorisations and same(together, found, tolerance_of(comm))
            assert all(item.from_store for item in record.components)


@pytest.mark.mpi(ranks=(3,))
def test_a_search_in_groups_uses_the_store(comm, folder):
    given = {"frame": Buckens(), "tolerance": 1e-4, "band": BAND, "groups": comm.size}
    with package.linkage(comm) as model:
        first, record = reduced(model, PointStore(folder, comm), **given)
        second, again = reduced(model, PointStore(folder, comm), **given)
    assert same(first, second, 1e-10)
    assert len(record.factorisations) == again.factorisations_saved >= 3 and not again.factorisations


@pytest.mark.mpi
def test_attachment_modes_are_listed_and_pruned(comm, folder):
    with block_with_ends(comm) as model:
        first, record = reduced(model, PointStore(folder, comm), [ConstraintModes()], Buckens())
        second, again = reduced(model, PointStore(folder, comm), [ConstraintModes()], Buckens())
    assert same(first, second, tolerance_of(comm)) and record.factorisations and not again.factorisations
    (row,) = package.list_store(folder, check=True, comm=comm)
    assert row["kind"] == "attachment modes" and row["point"] == "0 Hz" and row["columns"] == 12 and row["valid"]
    package.prune_store(folder, below=0.0, comm=comm)
    comm.Barrier()
    assert not list(folder.iterdir())


@pytest.mark.mpi
def test_two_sided_projections_have_entries_for_either_side(comm, folder):
    basis = [Krylov(frequency=500.0, order=1), Krylov(frequency=3000.0)]
    with package.solid((6, 3, 3), inputs=2, comm=comm) as model:
        model = model.with_outputs([(96, "z"), (40, "y")])
        given = {"projection": "two_sided", "allow_unstable": True}
        first, record = reduced(model, PointStore(folder, comm), basis, **given)
        second, again = reduced(model, PointStore(folder, comm), basis, **given)
    assert same(first, second) and len(package.list_store(folder, comm=comm)) == 4
    # both sides share the factor of a point that is used right before
    assert not again.factorisations and again.factorisations_saved == len(record.factorisations) == 2
