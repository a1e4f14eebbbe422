"""Edges of the measure: outputs that are round-off, laws with a branch point at 0 Hz, loads and static responses that
pass zero in ranges of parameters, and complete models."""

from fractions import Fraction
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from adaptive_models import chain, tied_chains, unit, up_to
from helpers import to_dense
from random_models import random_case, responses

import hpcred
from hpcred.fe.dofs import Dofs
from hpcred.model.frames import apply_frame
from hpcred.model.operator import Operator
from hpcred.parallel.failures import Owned
from hpcred.parallel.progress import Progress
from hpcred.reduction.parametric.zeros import _opposite, beside_zeros
from hpcred.reduction.result.measure import MEASURES, Directions
from hpcred.reduction.run.run import Run
from hpcred.reduction.search import silent_outputs
from hpcred.reduction.search.outcome import directions_of
from hpcred.reduction.search.projections import Projections
from hpcred.reduction.small.error_estimate import Comparison, grid, largest, measure_over
from hpcred.reduction.small.pseudo_modal import InputsOutputs, Proportional, diagonalised


def clamped_beam(n):
    """K and M of a beam of n elements, with deflection and rotation of each node in turn."""
    h, (K, M) = 1.0 / n, np.zeros((2, 2 * n + 2, 2 * n + 2))
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]) / h**3  # fmt: skip
    m = h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                            [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])  # fmt: skip
    for i in range(0, 2 * n, 2):
        K[i : i + 4, i : i + 4] += k
        M[i : i + 4, i : i + 4] += m
    return K[2:-2, 2:-2], M[2:-2, 2:-2]


@pytest.mark.mpi
@pytest.mark.parametrize("factor", [1.0, 1e3])
def test_what_symmetry_forbids_is_left_out_and_named(comm, factor, monkeypatch):
    """The rotation of the middle, and the difference of two mirrored places; in any unit of rotation."""
    monkeypatch.setattr(silent_outputs, "AT_A_TIME", 2)
    K, M = clamped_beam(20)
    units = np.where(np.arange(len(K)) % 2, factor, 1.0)
    middle = 2 * (20 // 2 - 1)
    Ct = unit(len(K), middle + 1, middle - 4, middle - 6)
    Ct[middle + 6, 2] = -1.0
    with hpcred.SecondOrderModel.from_scipy(
        K * units[:, None] * units, M * units[:, None] * units, comm=comm, inputs=unit(len(K), middle),
        outputs=Ct * units[:, None],
    ) as model, hpcred.reduce(model, tolerance=1e-4, band=(0, 30.0)) as rom:  # fmt: skip
        accuracy = rom.record.accuracy
    assert accuracy.reached and accuracy.measure.silent == (0, 2)
    assert accuracy.silent == tuple(rom.output_names[j] for j in (0, 2))
    (warning,) = (text for text in rom.record.warnings if text.startswith("outputs: "))
    assert warning.startswith(f"outputs: {accuracy.silent[0]}, {accuracy.silent[1]}: no input moves them")


@pytest.mark.parametrize("tie", [1e-8, 1e-13, 0.0])
def test_an_isolated_output_is_no_round_off(comm, tie):
    """A sensor 260 dB away has all its digits; without a tie it has nothing but round-off."""
    n, K = 12, np.zeros((24, 24))
    K[:n, :n], K[n:, n:] = chain(n)[0], 1.3 * chain(n)[0]
    e = unit(24, 7)[:, 0] - unit(24, n + 4)[:, 0]
    K += tie * np.abs(K).max() * np.outer(e, e)
    top, C = up_to(K, np.eye(24), 6)[1], unit(24, 5, n + 9).T
    with (hpcred.SecondOrderModel.from_scipy(K, np.eye(24), comm=comm, inputs=unit(24, 2), outputs=C.T) as model,
          hpcred.reduce(model, tolerance=1e-3, band=(0.0, top)) as rom):  # fmt: skip
        accuracy = rom.record.accuracy
    assert accuracy.silent == (() if tie else (rom.output_names[1],))
    if not tie:
        return
    s, full = 2j * np.pi * np.linspace(0, top, 401), 1 + 1j * accuracy.loss_factor
    states = np.array([np.linalg.solve(x * x * np.eye(24) + full * K, unit(24, 2)) for x in s])
    small = np.array([rom.C @ np.linalg.solve(x * x * rom.M + full * rom.K, rom.B) for x in s])
    error = accuracy.measure.eps(C @ states - small, C @ states, states[:, 2]).max()
    assert accuracy.reached and accuracy.noise < 1e-9
    assert error <= 1.02 * accuracy.largest


@pytest.mark.parametrize("tie", [1e-10, 1e-12])
def test_an_isolated_output_beside_interface_coordinates(comm, tie):
    """A sensor on a second block, which a soft spring ties to the one with the interface; against dense solves."""
    with hpcred.solid((3, 2, 1), (0.4, 0.1, 0.1), comm=comm) as one:
        n, where = one.size, one.dofs
        K, M = (np.kron(np.diag([1.0, factor]), to_dense(mat)) for mat, factor in ((one.K, 1.3), (one.M, 1.0)))
    e = unit(2 * n, 20)[:, 0] - unit(2 * n, n + 14)[:, 0]
    K += tie * np.abs(K).max() * np.outer(e, e)
    dofs = Dofs(np.append(where.node, where.node + 1000), np.tile(where.direction, 2),
                np.vstack([where.position, where.position + [0.0, 0.3, 0.0]]))  # fmt: skip
    end = tuple(int(node) for node in np.unique(where.node[where.position[:, 0] > 0.39]))
    Ct = unit(2 * n, 30, n + 22)
    given = {"dofs": dofs, "inputs": np.zeros((2 * n, 0)), "outputs": Ct, "comm": comm}
    with hpcred.SecondOrderModel.from_scipy(K, M, **given) as bare:
        face = hpcred.Interface(name="end", nodes=end, kind="averaging")
        with bare.with_interfaces([face]) as jointed, jointed.with_inputs([("end", "all")]) as model:
            band = (0.0, 1.1 * np.sqrt(scipy.linalg.eigvalsh(K, M)[8]) / 2 / np.pi)
            B = model.B.getDenseArray().copy()
            rom = hpcred.reduce(model, tolerance=1e-3, band=band, coordinates="interface")
    accuracy, s = rom.record.accuracy, 2j * np.pi * np.linspace(*band, 101)
    full = 1 + 1j * accuracy.loss_factor
    states = np.array([np.linalg.solve(x * x * M + full * K, B) for x in s])
    small = np.array([rom.C @ np.linalg.solve(x * x * rom.M + full * rom.K, rom.B) for x in s])
    error = accuracy.measure.eps(Ct.T @ states - small, Ct.T @ states, np.einsum("ip,sip->sp", B, states)).max()
    assert accuracy.reached and accuracy.silent == ()
    assert error <= 1.02 * (accuracy.largest + accuracy.noise)


def test_projections_on_pseudo_modes_keep_the_digits_of_an_isolated_output(comm):
    """Two chains with a tie of 1e-13 on an orthonormal basis without any order: round-off of its columns, and of their
    product with the pseudo-modes, couples the chains more than the tie does."""
    n, K = 12, np.zeros((24, 24))
    K[:n, :n], K[n:, n:] = chain(n)[0], 1.3 * chain(n)[0]
    e = unit(24, 7)[:, 0] - unit(24, n + 4)[:, 0]
    K += 1e-13 * np.abs(K).max() * np.outer(e, e)
    S, Ct = np.linspace(0.01, 0.3, 20), unit(24, n + 9)
    with Owned(comm) as owned:
        model = owned.owns(hpcred.SecondOrderModel.from_scipy(K, np.eye(24), inputs=unit(24, 2), outputs=Ct, comm=comm))
        framed = apply_frame(model)
        run = owned.owns(Run(framed, Progress(comm, show=False), 1e-9))
        basis, first = run.new_basis(24), model.first_row
        mixed = np.linalg.qr(np.random.default_rng(3).normal(size=(24, 24)))[0]
        basis.extend(mixed[first : first + model.local_rows])
        projections = Projections(run, basis, Proportional(eta=0.02), damped=False)
        projections.note_silent((), quiet=True)
        projections.rotate(projections.model().vectors)
        found = projections.model().response(S)
    exact = [Ct.T @ np.linalg.solve((1 + 0.02j) * K - (2 * np.pi * f) ** 2 * np.eye(24), unit(24, 2))
             for f in S]  # fmt: skip
    assert np.abs(found - exact).max() < 1e-11 * np.abs(exact).max()


def test_between_the_tie_and_nothing_all_outputs_count(comm):
    K, M = tied_chains(1e-7)
    given = {"comm": comm, "inputs": unit(80, 5), "outputs": unit(80, 30, 47)}
    with (hpcred.SecondOrderModel.from_scipy(K, M, **given) as model,
          hpcred.reduce(model, tolerance=1e-3, band=(0.0, 8.0)) as rom):  # fmt: skip
        assert rom.record.accuracy.silent == () and rom.record.warnings == ()


@pytest.mark.parametrize("exponent", [0.2, 0.9])
def test_nothing_is_hidden_between_0_hz_and_the_first_points(exponent):
    """Where a part with a fractional law is much stiffer than the rest, the response changes far below the band."""
    rng = np.random.default_rng(3)
    K, _ = chain(8)
    X = rng.normal(size=(8, 3))
    law = hpcred.laws.FractionalKelvinVoigt(low=0.0, rise=1.0, time=1e-3, exponent=exponent)
    part = hpcred.Viscoelastic(1e6 * K.max() * X @ X.T, law)
    io = InputsOutputs(np.eye(2)[:, :1], np.eye(2)[:, 1:])
    outer = diagonalised(K, unit(8, 1, 6), None, Proportional(beta=1e-6), io, Operator.of(added=[part]))
    band = (0.0, float(outer.frequencies[4]))
    measure = measure_over(Directions(), band, outer)
    pair = Comparison(outer, outer, np.eye(8), measure).within(np.linalg.qr(rng.normal(size=(8, 5)))[0])
    found = largest(pair, grid([pair.outer, pair.inner], band))[1].max()
    dense = pair.curve(np.geomspace(1e-60, band[1], 3000))
    assert dense.max() <= 1.05 * found


def test_directions_have_errors_of_their_own_whatever_the_measure():
    model = SimpleNamespace(input_names=("in",), output_names=("near", "far"))
    io = InputsOutputs(np.eye(3)[:, :1], np.eye(3)[:, 1:])
    outer = diagonalised(chain(8)[0], unit(8, 1, 2, 6), None, Proportional(beta=1e-6), io)
    band = (0.0, float(outer.frequencies[4]))
    pair = Comparison(outer, outer, np.eye(8), MEASURES["paper"]).within(np.eye(8)[:, :5])
    frequencies = grid([pair.outer, pair.inner], band)
    found = directions_of(pair, frequencies, band, model)
    beside = pair.by(measure_over(MEASURES["directions"], band, outer))
    assert found == directions_of(beside, frequencies, band, model)
    assert max(item.largest for item in found) == pytest.approx(beside.curve(frequencies).max(), rel=1e-12)


@pytest.mark.parametrize("outputs", [unit(6, 4, 2).T, None])
def test_a_load_that_vanishes_somewhere(outputs):
    e, (K, _) = unit(6, 0), chain(6)
    top = up_to(K, np.eye(6), 2)[1]

    def reduced(reference):
        with hpcred.SecondOrderModel(np.eye(6), 1e-4 * K, K, e, outputs) as model:
            family = hpcred.ParametricModel(
                model, [hpcred.Parameter("b", (-2.0, 2.0), reference)], [hpcred.Term("B", e, "b")]
            )
            search = hpcred.ParameterSearch(points=5)
            return hpcred.reduce(
                family, tolerance=1e-2, band=(0.0, top), damping=hpcred.GivenDamping(), parameter_search=search
            )

    assert reduced(None).record.accuracy.reached  # where b = -1 is a training point
    with pytest.raises(hpcred.InputError, match="all loads are zero at the reference values, b = -1, by the factors"):
        reduced(-1.0)


def test_points_on_both_sides_of_each_zero():
    """Of values along a line: the two beside each change of sign, of most of them where there are several."""
    places = np.linspace(0, 1, 11)[:, None]
    values = np.cos(2 * np.pi * (places + 0.01))[:, :, None]
    assert _opposite(places, values) == [(2, 3), (7, 8)]
    assert _opposite(places, np.hstack([values, 10 + values, 10 + values])) == []
    assert _opposite(places, np.hstack([values, 10 + values, values])) == [(2, 3), (7, 8)]


@pytest.mark.parametrize("of", ["B", "C"])
@pytest.mark.parametrize("far, narrow", [(1e-3, True), (1e2, False)])
def test_points_where_an_input_or_output_hardly_has_a_response(comm, of, far, narrow):
    """Of a small part and a large one with the factor p - 0.28: around 0.28, at both sides of the smallest median. What
    is wide the points between which it is would see."""
    K, n = chain(10)[0], 10
    L = np.column_stack([unit(n, 0), far * unit(n, 9), unit(n, 1)])
    band = (0.1 * up_to(K, np.eye(n), 3)[1], up_to(K, np.eye(n), 3)[1])

    def model(p):
        one, changing = np.array([[1.0], [0.0], [0.0]]), np.array([[0.0], [1.0], [p - 0.28]])
        io = InputsOutputs(changing, one) if of == "B" else InputsOutputs(one, changing)
        return diagonalised(K, L, None, Proportional(eta=0.01), io)

    def smallest(p):
        (h,), (g,) = measure_over(Directions(), band, model(p)).floors
        return g if of == "B" else h

    parameters = [hpcred.Parameter("p", (0.0, 1.0))]
    form = SimpleNamespace(parametric=SimpleNamespace(comm=comm, parameters=parameters))
    projections = SimpleNamespace(form=form, at=lambda point: SimpleNamespace(model=partial(model, *point)))
    found = np.sort([p for (p,) in beside_zeros(projections, [(k / 16,) for k in range(17)], band)])
    if not narrow:
        assert not len(found)
        return
    along = 0.28 + np.linspace(-0.002, 0.002, 201)
    floors = np.array([smallest(p) for p in along])
    assert floors.min() < 0.1 * min(smallest(4 / 16), smallest(5 / 16))  # which training points do not see
    assert found[0] < along[floors.argmin()] < found[-1]
    assert min(smallest(p) for p in found) < 1.5 * floors.min()


def test_a_complete_model_has_few_frequencies():
    """Its error is round-off, which has maxima everywhere."""
    K, M = chain(4)
    damping = hpcred.Caughey((0.1, 1e-5, 1e-12))  # whose error is a plain difference
    with (hpcred.SecondOrderModel(M, None, K, unit(4, 0)) as model,
          hpcred.reduce(model, tolerance=1e-4, band=up_to(K, M, 3), damping=damping) as rom):  # fmt: skip
        assert rom.size == 4 and len(rom.record.accuracy.frequencies) < 1500


@pytest.mark.parametrize("damper, eta", [(1e-6, 0.0), (1e-13, 0.0), (0.0, 1e-3)])
def test_the_truth_of_soft_modes_beside_stiff_ones(damper, eta):
    """Two masses on a spring that is softer than theirs by 1e-11, at their lowest resonance, in fractions."""
    k, soft = 1e5 / 3, 1e-6 / 7
    K, M = np.array([[k + soft, -k], [-k, k]]), np.diag([1.3, 0.7])
    D, B = np.diag([damper, 0.0]), np.array([[1.0], [0.0]])
    f = np.sqrt(soft / 2.0) / (2 * np.pi) * np.array([0.9, 1.0 - 1e-6, 1.0, 1.1])
    of, drive = responses({"K": K, "M": M, "D": D, "B": B, "C": B.T}, [], eta, f)
    for omega, value in zip((2j * np.pi * f).imag, of[:, 0, 0], strict=True):
        w, (a, b, c) = Fraction(omega), (Fraction(x) for x in K[[0, 0, 1], [0, 1, 1]])
        real = a - w * w * Fraction(1.3), c - w * w * Fraction(0.7)
        loss = [Fraction(eta) * x for x in (a, b, c)]
        loss[0] += w * Fraction(damper)
        # (p + i q) and (r + i t) are the numerator and the determinant
        p, q = real[1], loss[2]
        r = real[0] * real[1] - loss[0] * loss[2] - b * b + loss[1] * loss[1]
        t = real[0] * loss[2] + real[1] * loss[0] - 2 * b * loss[1]
        size = r * r + t * t
        true = complex(float((p * r + q * t) / size), float((q * r - p * t) / size))
        assert value == pytest.approx(true, rel=1e-10)
    np.testing.assert_array_equal(of[:, :, 0], drive)


def test_what_is_estimated_of_soft_mounts_is_true():
    """The stiffness at a resonance is 1e-9 of that of the springs, and the damping ratio 1e-7."""
    case = random_case("soft-mounts", 9017)
    with case.reduced() as rom:
        accuracy = rom.record.accuracy
        true, _ = case.largest_error(rom, np.random.default_rng(9017))
        assert accuracy.reached and true <= 1.02 * (accuracy.largest + accuracy.noise)


def isolated(tie, of):
    """Two chains with a weak tie, an input in one and outputs in both, over a spring of one of them, the tie or a mass.
    """
    n, K = 12, np.zeros((24, 24))
    K[:n, :n], K[n:, n:] = chain(n)[0], 1.3 * chain(n)[0]
    e, spring = unit(24, 7)[:, 0] - unit(24, n + 4)[:, 0], unit(24, 3)[:, 0] - unit(24, 4)[:, 0]
    T = tie * np.abs(K).max() * np.outer(e, e)
    K = K + T
    changed = {"spring": ("K", 0.3 * K.max() * np.outer(spring, spring)), "tie": ("K", T),
               "mass": ("M", 0.3 * np.diag(unit(24, 3)[:, 0]))}[of]  # fmt: skip
    top, D = up_to(K, np.eye(24), 6)[1], 2e-5 * K + 0.1 * np.eye(24)
    return K, D, (0.0, top), changed


def errors_of_outputs(rom, K, D, band, changed, b, B, C):
    """The largest errors (r,) of the outputs of two chains at a value of the parameter, by solves."""
    matrices = {"K": K, "M": np.eye(len(K)), "D": D, "B": B, "C": C}
    matrices[changed[0]] = matrices[changed[0]] + b * changed[1]
    f, at = np.linspace(*band, 201), rom.at(b=b)
    H, drive = responses(matrices, [], 0.0, f)
    small = responses({key: getattr(at, key) for key in "KMDBC"}, [], 0.0, f)[0]
    measure = Directions().over(f, H, drive, (np.full(len(C), -1), np.ones(len(C))))
    return measure.each(H - small, H, drive).max(axis=(0, 2))


def reduced_isolated(tie, of, rows, comm, tolerance=1e-3):
    K, D, band, changed = isolated(tie, of)
    B, Ct = unit(24, 2), unit(24, *rows)
    with hpcred.SecondOrderModel.from_scipy(K, np.eye(24), D, comm=comm, inputs=B, outputs=Ct) as model:
        family = hpcred.ParametricModel(model, [hpcred.Parameter("b", (0.0, 1.0))], [hpcred.Term(*changed, "b")])
        rom = hpcred.reduce(
            family, tolerance=tolerance, band=band, parameter_search=hpcred.ParameterSearch(points=3)
        )  # fmt: skip
    return rom, lambda b: errors_of_outputs(rom, K, D, band, changed, b, B, Ct.T)


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("tie, of, rows", [
    (1e-12, "spring", (5, 21)), *(pytest.param(*case, marks=pytest.mark.slow) for case in
                                  ((1e-10, "spring", (21,)), (1e-12, "tie", (5, 21)), (1e-12, "mass", (21,)))),
])  # fmt: skip
def test_an_isolated_output_over_parameters(comm, tie, of, rows):
    """A sensor 240 dB away, by itself or beside another output, is neither round-off nor beyond it at any value."""
    rom, errors = reduced_isolated(tie, of, rows, comm)
    accuracy = rom.record.accuracy
    assert accuracy.reached and not accuracy.silent
    assert max(errors(b).max() for b in (0.0, 0.5, 1.0)) <= 1.02 * (accuracy.largest + accuracy.noise)


@pytest.mark.slow
def test_an_output_below_round_off_at_all_values_is_left_out(comm):
    rom, errors = reduced_isolated(1e-15, "spring", (5, 21), comm)
    accuracy = rom.record.accuracy
    assert accuracy.reached and accuracy.silent == (rom.output_names[1],)
    assert errors(0.3)[0] <= 1.02 * (accuracy.largest + accuracy.noise)


@pytest.mark.slow
def test_an_isolated_output_that_mixed_columns_do_not_know_is_limited_by_round_off(comm):
    rom, errors = reduced_isolated(1e-13, "spring", (5, 21), comm)
    accuracy = rom.record.accuracy
    assert not accuracy.reached and accuracy.stopped == "limited by round-off"
    assert max(errors(b).max() for b in (0.0, 0.5, 1.0)) <= 1.3 * (accuracy.largest + accuracy.noise)


def test_what_is_left_out_between_values_is_estimated(comm):
    """An output that is felt by 1e-8, where each visit leaves out columns that hardly matter."""
    rom, errors = reduced_isolated(1e-8, "spring", (21,), comm)
    accuracy = rom.record.accuracy
    assert accuracy.reached
    assert max(errors(b).max() for b in (0.0, 0.5, 1.0)) <= 3 * (accuracy.largest + accuracy.noise)


QUICK = (
    ("silent", 1), ("vanishing", 58), ("signs", 53), ("soft-mounts", 7), ("free-parts", 6020), ("hidden-modes", 0),
)  # fmt: skip
SLOW = (
    ("silent", 4), ("silent", 28), ("silent", 89), ("silent", 6011), ("silent", 7016), ("vanishing", 1),
    ("signs", 2), ("signs", 1040), ("signs", 6022), ("signs", 50001), ("soft-mounts", 7010), ("soft-mounts", 7012),
)  # fmt: skip


@pytest.mark.parametrize("kind, seed", [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW)])
def test_random_models(kind, seed):
    """A few of benchmarks/hunt.py."""
    case = random_case(kind, seed)
    search = hpcred.ParameterSearch(points=9) if (kind, seed) in QUICK else None
    with case.reduced(parameter_search=search) as rom:
        accuracy = rom.record.accuracy
        assert accuracy.reached
        assert case.largest_error(rom, np.random.default_rng(seed))[0] <= 1.02 * case.tolerance


def test_models_are_kept_until_what_they_are_made_of_changes(comm):
    """Each kept one has the response of one that is made anew."""
    K, M = chain(20)
    D = np.diag(np.linspace(1.0, 3.0, 20))
    S = np.linspace(0.1, 5.0, 30)
    with Owned(comm) as owned:
        given = {"inputs": unit(20, 2), "outputs": unit(20, 9), "comm": comm}
        model = owned.owns(hpcred.SecondOrderModel.from_scipy(K, M, D, **given))
        run = owned.owns(Run(apply_frame(model), Progress(comm, show=False), 1e-9))
        basis, rows = run.new_basis(20), slice(model.first_row, model.first_row + model.local_rows)
        columns = np.random.default_rng(3).normal(size=(20, 12))
        projections = Projections(run, basis, Proportional(), damped=True)

        def anew(which):
            made = Projections(run, basis, projections.damping, damped=True)
            made.io = projections.io
            return made.model(which)

        projections.extend(columns[rows, :4])
        first = projections.model()
        assert projections.model() is first and projections.model(np.arange(4)) is first
        projections.extend(columns[rows, 4:8])
        assert projections.model(np.arange(4)) is first and len(projections.model()) == 8
        projections.note_silent((), quiet=True)
        assert projections.model().io is projections.io
        for change in (lambda: projections.add_loss_factor(0.1), lambda: projections.extend(columns[rows, 8:]),
                       lambda: projections.rotate(np.linalg.qr(columns[:12])[0])):  # fmt: skip
            change()
            for which in (np.arange(4), np.array([0, 2, 5]), None):
                assert np.allclose(projections.model(which).response(S), anew(which).response(S), rtol=1e-10, atol=0.0)
