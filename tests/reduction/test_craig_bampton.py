"""Component modes against dense elimination, and interface coordinates that leave every response as it was."""


import numpy as np
import pytest
import scipy.linalg
from helpers import block_with_ends, dense_model, face, few_on_ranks, gather, rigid_motions_at, to_dense

import hpcred
from hpcred import Buckens, Chord, CraigBampton, Dofs, GivenDamping, Krylov, Modes, NoFrame, Rayleigh
from hpcred.model.frames import apply_frame
from hpcred.reduction import ConstraintModes, FixedInterfaceModes, Guyan, ResidualAttachment
from hpcred.reduction.interface_coordinates import elastic_part

pytestmark = pytest.mark.mpi

KINDS = pytest.mark.parametrize("kind, clamped", few_on_ranks(
    [("averaging", False), ("rigid", True), ("averaging", True), ("rigid", False)], 2))  # fmt: skip
FREQUENCIES = (300.0, 5000.0, 17000.0)


def dense_component_modes(model):
    """Fixed-interface omega^2 and the statically condensed stiffness, in the coordinates in which rigid sets follow."""
    framed = apply_frame(model)
    K, M, _ = dense_model(framed.model)
    G = to_dense(framed.model.Gt).T
    N = scipy.linalg.null_space(G)
    eigenvalues = scipy.linalg.eigvalsh(N.T @ K @ N, N.T @ M @ N)
    unit = np.linalg.pinv(G)
    psi = unit - N @ np.linalg.solve(N.T @ K @ N, N.T @ K @ unit)
    return eigenvalues, psi.T @ K @ psi


@KINDS
@pytest.mark.costly
def test_craig_bampton_in_interface_coordinates_is_the_textbook_form(comm, kind, clamped):
    """Against the null space of G in dense numpy; M = [M_bb M_bi; M_ib I], K = [K_bb 0; 0 omega^2], C = [I 0]."""
    frame = NoFrame() if clamped else Buckens()
    with block_with_ends(comm, kind, clamped, cells=(4, 2, 2)) as model:
        eigenvalues, static = dense_component_modes(model)
        count = 6 * len(model.interfaces)
        with hpcred.reduce(model, [CraigBampton(count=8)], frame, coordinates="interface") as rom:
            assert rom.size == count + 8
            assert rom.interfaces == model.interfaces
            assert np.allclose(np.diag(rom.K)[count:], eigenvalues[:8], rtol=1e-8)
            assert np.abs(rom.K[:count, :count] - static).max() < 1e-8 * np.abs(static).max()
            assert not rom.K[:count, count:].any()
            assert np.array_equal(rom.M[count:, count:], np.eye(8))
            assert np.abs(rom.C - np.eye(count, rom.size)).max() < 1e-10
            V, G = gather(rom.columns), to_dense(model.Gt).T
            K, M, _ = dense_model(model)
            assert np.abs(G @ V - np.eye(count, rom.size)).max() < 1e-10
            assert np.abs(V.T @ M @ V - rom.M).max() < 1e-9 * np.abs(rom.M).max()
            assert np.abs(V.T @ K @ V - rom.K).max() < 1e-9 * np.abs(rom.K).max()
            if not clamped:
                R = rigid_motions_at([item.position for item in rom.interfaces])
                assert np.abs(rom.K[:count, :count] @ R).max() < 1e-13 * np.abs(rom.K).max()
                total = R.T @ rom.M[:count, :count] @ R  # rigid motions are moved by constraint modes alone
                assert np.allclose(np.diag(total)[:3], M[::3, ::3].sum(), rtol=1e-9)


@KINDS
def test_any_basis_keeps_its_responses_in_interface_coordinates(comm, kind, clamped):
    """Krylov, modes with attachment modes: the same transfer function to 1e-10, with damping; for a free body that of
    the elastic part, and of the whole the response of the free model."""
    frame, damping = (NoFrame() if clamped else Buckens()), Rayleigh(20.0, 1e-7)
    with block_with_ends(comm, kind, clamped, cells=(4, 2, 2)) as model:
        for basis in ([Krylov(0.0, 0), Krylov(9000.0, 1)], [Modes(count=6), ResidualAttachment()]):
            with hpcred.reduce(model, basis, frame, damping) as modal:
                expected = hpcred.frequency_response(modal, FREQUENCIES)
            with hpcred.reduce(model, basis, frame, damping, coordinates="interface") as rom:
                found = hpcred.frequency_response(elastic_part(rom), FREQUENCIES)
                assert hpcred.relative_error(expected, found).max() < 1e-10
                whole = hpcred.frequency_response(rom, FREQUENCIES[:1])
        if not clamped:  # mass-proportional damping belongs to the deformation only
            undamped = hpcred.frequency_response(model, FREQUENCIES[:1], NoFrame())
            assert hpcred.relative_error(undamped, whole).max() < 1e-3


@pytest.mark.costly
def test_craig_bampton_frequencies_lie_above_the_true_ones_and_come_down(comm):
    with block_with_ends(comm, clamped=True) as model:
        K, M, _ = dense_model(model)
        true = np.sqrt(scipy.linalg.eigvalsh(K, M)[:6]) / 2 / np.pi
        last = np.full(6, np.inf)
        for count in (0, 2, 6, 14):
            basis = [Guyan()] if count == 0 else [CraigBampton(count=count)]
            with hpcred.reduce(model, basis) as rom:
                found = rom.frequencies[:6]
            assert (found > true * (1 - 1e-10)).all()
            assert (found <= last * (1 + 1e-10)).all()
            last = found
        assert np.abs(last / true - 1).max() < 1e-2


@pytest.mark.mpi
@pytest.mark.costly
def test_names_of_one_method_are_one_method(comm):
    """Guyan is Craig-Bampton without modes; attachment modes are the Krylov block of the interface loads at 0 Hz."""
    pairs = [
        ([Guyan()], [ConstraintModes()]),
        ([ConstraintModes(), FixedInterfaceModes(count=3)], [CraigBampton(count=3)]),
        ([Modes(count=3), ResidualAttachment()], [Modes(count=3), Krylov(0.0, 0)]),
    ]
    for clamped in (True, False):
        with block_with_ends(comm, clamped=clamped, cells=(4, 2, 2)) as model:
            for one, other in pairs:
                roms = [hpcred.reduce(model, basis, None if clamped else Buckens()) for basis in (one, other)]
                assert np.allclose(roms[0].frequencies, roms[1].frequencies, rtol=1e-9)


@pytest.mark.costly
def test_fixed_interface_modes_in_a_band_are_all_of_it(comm):
    with block_with_ends(comm, clamped=True, cells=(4, 2, 2)) as model:
        frequencies = np.sqrt(dense_component_modes(model)[0]) / 2 / np.pi
        top = float(frequencies[18] + frequencies[19]) / 2
        with hpcred.reduce(model, [FixedInterfaceModes(band=(0.0, top))]) as rom:
            assert np.allclose(rom.frequencies, frequencies[:19], rtol=1e-8)


@pytest.mark.costly
def test_a_superelement_to_a_tolerance(comm, folder):
    """Free body: the error is that of the deformation, as said; the file is evaluated as any other."""
    with block_with_ends(comm) as model:
        with hpcred.reduce(model, frame=Buckens(), tolerance=1e-4, band=(0.0, 20000.0), coordinates="interface") as rom:
            assert rom.record.accuracy.reached
            assert rom.record.coordinates == "interface"
            assert [item.where for item in rom.record.components][-1] == "compressed"  # what is said is of this model
            assert np.array_equal(rom.frequencies[:6], np.zeros(6))
            hpcred.write_result(folder / "result.h5", rom, model)
        hpcred.write_model(folder / "model.h5", model)
        read = hpcred.read_result(folder / "result.h5", comm).reduced
        assert read.interfaces == rom.interfaces
        report = hpcred.evaluate(folder / "result.h5", folder / "model.h5", frequencies=FREQUENCIES)
        assert max(report["eps"]) < 1e-4
        assert hpcred.workflows.check_result(folder / "result.h5", folder / "model.h5", 3, seed=1)["passed"]


def test_a_gyroscopic_damping_matrix_stays_unsymmetric(comm):
    with block_with_ends(comm, clamped=True, cells=(4, 2, 2)) as model:
        K, M, _ = dense_model(model)
        D = 20.0 * M
        D[5, 40], D[40, 5] = 300.0, -300.0
        given = hpcred.SecondOrderModel.from_scipy(K, M, D, comm, dofs=everywhere(model))
        given = given.with_interfaces([item.definition for item in model.interfaces]).with_inputs([("right", "all")])
        basis = [Krylov(0.0, 1)]
        with hpcred.reduce(given, basis, damping=GivenDamping()) as modal:
            expected = hpcred.frequency_response(modal, FREQUENCIES)
        with hpcred.reduce(given, basis, damping=GivenDamping(), coordinates="interface") as rom:
            assert np.abs(rom.D - rom.D.T).max() > 1e-3 * np.abs(rom.D).max()
            assert hpcred.relative_error(expected, hpcred.frequency_response(rom, FREQUENCIES)).max() < 1e-10


def test_a_damping_law_does_not_brake_the_rigid_motion_of_interface_coordinates(comm):
    """alpha M + beta K of the deformation alone, by its modes: docs/damping.md says so."""
    alpha, beta = 20.0, 1e-6
    with (
        block_with_ends(comm, cells=(4, 2, 2)) as model,
        hpcred.reduce(model, [CraigBampton(count=3)], Buckens(), Rayleigh(alpha, beta), coordinates="interface") as rom,
    ):
        count = 6 * len(rom.interfaces)
        R = np.zeros((rom.size, 6))
        R[:count] = rigid_motions_at([item.position for item in rom.interfaces])
        assert np.abs(rom.D @ R).max() < 1e-9 * np.abs(rom.D).max() * np.abs(R).max()
        eigenvalues, X = scipy.linalg.eigh(rom.K, rom.M)
        damping = X.T @ rom.D @ X
        assert np.allclose(np.diag(damping)[6:], alpha + beta * eigenvalues[6:], rtol=1e-8)


def everywhere(model):
    """The labels of all rows on all ranks."""
    parts = model.comm.allgather(model.dofs)
    return Dofs(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("node", "direction", "position")))


def test_component_modes_know_the_interfaces_in_any_frame(comm):
    """A free block held by a chord frame: constraint modes there are static shapes of the held body."""
    with block_with_ends(comm, cells=(4, 2, 2)) as model:
        frame = Chord(nodes=(1, 19, 3))
        with hpcred.reduce(model.with_inputs([("right", "all")]), [ResidualAttachment()], frame) as rom:
            expected = hpcred.frequency_response(model.with_inputs([("right", "all")]), [0.0], frame)
            assert hpcred.relative_error(expected, hpcred.frequency_response(rom, [0.0])).max() < 1e-8


def test_what_has_no_interface_coordinates_is_refused(comm):
    with block_with_ends(comm, cells=(4, 2, 2)) as model, hpcred.solid((4, 2, 2), comm=comm) as plain:
        partly = plain.with_interfaces([face("end", 0.04, kind="rigid", directions=("x", "y"))])
        for words, target, basis, keywords in (
            (r"needs at least one \[\[interface\]\]", plain, [Modes(count=3)], {"coordinates": "interface"}),
            (r"craig_bampton needs at least one \[\[interface\]\]", plain, [CraigBampton(count=3)], {}),
            ("6 rigid-body motions without force", model, [Krylov(900.0)], {"coordinates": "interface"}),
            ("K of solid is singular.*'buckens'", model, [Guyan()], {}),
            ("cannot move interface '(left|right)' in direction", model, [Modes(count=3)],
             {"coordinates": "interface", "frame": Buckens()}),
            ("its set moves it in x, y, rx, ry, rz only", partly, [Guyan()], {}),
            ("expected 'modal' or 'interface'", model, [Guyan()], {"coordinates": "physical"}),
        ):  # fmt: skip
            with pytest.raises(hpcred.InputError, match=words):
                hpcred.reduce(target, basis, **keywords)


def test_component_modes_come_from_a_store(comm, tmp_path):
    """Without a factor, and as they were computed; more modes, and those without the interfaces, are others."""
    store = hpcred.PointStore(comm.bcast(str(tmp_path)))
    basis = [CraigBampton(count=4), ResidualAttachment()]
    with block_with_ends(comm, "averaging", True, cells=(4, 2, 2)) as model:
        records, responses = [], []
        for kept, components in ((None, basis), (store, basis), (store, basis), (store, [CraigBampton(count=6)]),
                                  (store, [Modes(count=4)])):  # fmt: skip
            with hpcred.reduce(model, components, store=kept) as rom:
                records.append(rom.record)
                responses.append(np.array([rom.transfer_function(2j * np.pi * f) for f in FREQUENCIES]))
    plain, first, second, more, free = records
    assert len(plain.factorisations) == len(first.factorisations) == len(more.factorisations) == 1
    assert not second.factorisations and second.factorisations_saved == 1 and len(free.factorisations) == 1
    assert [item.from_store for item in second.components] == [True] * 3
    assert [item.from_store for item in more.components] == [True, False]
    for response in responses[1:3]:
        assert np.abs(response - responses[0]).max() < 1e-12 * np.abs(responses[0]).max()


@pytest.mark.parametrize("clamped", few_on_ranks([False, True]))
@pytest.mark.costly
def test_motions_of_interfaces_that_no_load_needs_stay_whatever_comes_first(comm, clamped):
    """Constraint modes of a basis beside a tolerance were compressed away, and the result was refused for lack of them;
    the rigid-body modes of a free body came on top of `size`."""
    frame, rigid = (NoFrame(), 0) if clamped else (Buckens(), 6)
    asked = {"tolerance": 1e-2, "band": (0.0, 10000.0)}
    with block_with_ends(comm, clamped=clamped, cells=(4, 2, 2)) as block, block.with_inputs([(20, "z")]) as model:
        count = 6 * len(model.interfaces)
        with hpcred.reduce(model, [CraigBampton(count=2)], frame, coordinates="interface", **asked) as rom:
            assert rom.record.accuracy.reached and rom.rigid_size == rigid
            moved = to_dense(model.Gt).T @ gather(rom.columns)
            assert np.abs(moved - np.eye(count, rom.size)).max() < 1e-8
        for size in (count, rom.size):
            limited = hpcred.Adaptive(size=size, **asked)
            with hpcred.reduce(model, [], frame, adaptive=limited, coordinates="interface") as other:
                assert other.size <= size
        with pytest.raises(hpcred.InputError, match=f"adaptive.size: found {count - 1}, expected at least {count}"):
            few = hpcred.Adaptive(size=count - 1, **asked)
            hpcred.reduce(model, [], frame, adaptive=few, coordinates="interface")


@pytest.mark.costly
def test_fixed_interface_modes_of_a_body_on_soft_springs_hold_the_interfaces(comm):
    """K^-1 f is 1e6 times the motion of the body held; the first correction leaves round-off of the former."""
    with block_with_ends(comm, cells=(4, 2, 2)) as free:
        K, M, _ = dense_model(free)
        sprung = hpcred.SecondOrderModel.from_scipy(K + 1e4 * M, M, comm=comm, dofs=everywhere(free))
        model = sprung.with_interfaces([item.definition for item in free.interfaces]).with_inputs([("right", "all")])
        with model, hpcred.reduce(model, [FixedInterfaceModes(count=6)]) as rom:
            V, G = gather(rom.columns), to_dense(model.Gt).T
            N = scipy.linalg.null_space(G)
            eigenvalues = scipy.linalg.eigvalsh(N.T @ (K + 1e4 * M) @ N, N.T @ M @ N)[:6]
            assert np.allclose((2 * np.pi * rom.frequencies) ** 2, eigenvalues, rtol=1e-11)
            assert np.abs(G @ V).max() < 1e-11 * np.abs(V).max()


def test_directions_that_depend_on_each_other_are_refused_and_others_are_not(comm):
    """A second node that follows the same face as the first, and one that follows two of its four rows of nodes."""
    rows = hpcred.Interface(name="rows", nodes=hpcred.Nodes(box=((0.035, -1.0, 0.015), (0.045, 1.0, 1.0))))
    with hpcred.solid((4, 3, 3), comm=comm) as model:
        with model.with_interfaces([face("one", 0.04), face("other", 0.04)]) as marked:
            given = marked.with_inputs([("one", "all")])
        with given, pytest.raises(hpcred.InputError, match="cannot be moved by itself; its motion depends on"):
            hpcred.reduce(given, [Guyan()])
        with model.with_interfaces([face("one", 0.04), rows]) as marked:
            given = marked.with_inputs([("one", "all")])
        with given, hpcred.reduce(given, [Guyan()], coordinates="interface") as rom:
            moved = to_dense(given.Gt).T @ gather(rom.columns)
            assert np.abs(moved - np.eye(12)).max() < 1e-9
