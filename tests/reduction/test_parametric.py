"""Reductions of models with parameters to a tolerance, against dense solves at other frequencies and values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from adaptive_models import chain, pair, unit
from helpers import block_with_ends, to_dense
from parametric_models import AffineCase, fresh_pairs, random_affine, random_viscoelastic

import hpcred
from hpcred import (
    Buckens,
    GivenDamping,
    InputError,
    ModalDamping,
    Modes,
    Parameter,
    ParametricModel,
    Rayleigh,
    Term,
    Viscoelastic,
)
from hpcred.analysis.error import as_compared
from hpcred.examples.linkage import FRAME, LOAD, SUPPORTS
from hpcred.laws import Fractional, Maxwell
from hpcred.model.interfaces.nodes import Nodes
from hpcred.parallel.decisions import shared_out
from hpcred.parallel.petsc import PETSc
from hpcred.reduction import parametric_reductor
from hpcred.reduction.parametric import compression
from hpcred.reduction.parametric.reduced import _modes
from hpcred.reduction.parametric.training import (
    corner_points,
    distances,
    fresh_points,
    low_discrepancy,
    place_of,
    points_around,
    training_points,
)
from hpcred.reduction.result.reduced_model import as_measured
from hpcred.reduction.search import outcome
from hpcred.reduction.small.pseudo_modal import InputsOutputs, diagonalised


def bushings(n=60, **more):
    """A chain whose two ends are held by springs that depend on parameters."""
    K, M = chain(n)
    ends = [1e4 * np.outer(e, e) for e in (pair(n, 0, n), pair(n, n - 1, n))]
    parameters = [Parameter("a", (0.0, 2.0)), Parameter("b", (0.01, 10.0))]
    terms = [("K", ends[0], "a^2"), ("K", ends[1], "sqrt(b)")]
    return AffineCase("bushings", K, M, unit(n, n // 3, 2 * n // 3), (0.0, 4.0), parameters, terms, **more)


def bushing(n, **more):
    """The same with the first parameter alone."""
    case = bushings(n, **more)
    del case.parameters[1:], case.terms[1:]
    return case


def rotor(n=25):
    """Masses in y and z on a shaft that spins: gyroscopic moments by omega, spin softening by its square."""
    K, M = chain(n)
    gyroscopic = np.kron(np.diag(np.linspace(0.2, 1.0, n)), np.array([[0.0, -1.0], [1.0, 0.0]]))
    bearings = 300 * np.kron(np.diag(np.arange(n) % 7 == 0), np.diag([1.0, 2.0]))
    K, M = np.kron(K, np.eye(2)) + bearings, np.kron(M, np.eye(2))
    D = 1e-3 * K + 0.05 * M
    terms = [("D", gyroscopic, "omega"), ("K", 0.02 * M, "-omega^2")]
    parameters = [Parameter("omega", (0.0, 10.0), reference=4.0, unit="rad/s")]
    loads = unit(2 * n, 2 * (n // 6) + 1, 6 * n // 5)
    return AffineCase("rotor", K, M, loads, (0.0, 5.0), parameters, terms, D=D, damping=GivenDamping())


def reduced(case, tolerance, comm, **more):
    with case.model(comm) as model:
        return hpcred.reduce(model, tolerance=tolerance, band=case.band, damping=case.damping, **more)


def check(case, rom, tolerance):
    """Hold what is said of the error against dense solves at fresh pairs."""
    accuracy = rom.record.accuracy
    worst = [(accuracy.worst, accuracy.parameters.worst)]
    true = case.eps(rom, [*fresh_pairs(case), *worst])
    assert accuracy.reached and true.max() <= tolerance
    assert accuracy.largest + accuracy.noise <= tolerance
    assert 0.4 <= true[-1] / accuracy.largest <= 1.2


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("make, tolerance", [
    pytest.param(bushings, 1e-4, id="bushings"), pytest.param(rotor, 1e-3, id="rotor", marks=pytest.mark.slow)])
def test_the_tolerance_holds_at_other_values(make, tolerance, comm):
    case = make()
    with reduced(case, tolerance, comm, parameter_search=hpcred.ParameterSearch(points=25)) as rom:
        check(case, rom, tolerance)
        accuracy = rom.record.accuracy
        assert rom.size < len(case.K) / 2 and f"{accuracy.parameters.ranges_in_words}, " in accuracy.sentence
        assert len(accuracy.parameters.points) <= 5
        name, value = next(iter(accuracy.parameters.points[-1].values.items()))
        assert f" Hz and {name} = {value:.6g}" in accuracy.sentence
        assert all(point.measured <= 0.3 * tolerance for point in accuracy.parameters.points[-2:])
        assert len(rom.record.factorisations) == sum(point.factorisations for point in accuracy.parameters.points)


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("seed", [5, pytest.param(16, marks=pytest.mark.slow)])
def test_random_models(seed, comm):
    case, tolerance = random_affine(seed, 30)
    with reduced(case, tolerance, comm) as rom:
        assert not rom.record.accuracy.reached or case.eps(rom, fresh_pairs(case, 20)).max() <= tolerance


@pytest.mark.slow
def test_a_mode_that_is_in_the_band_for_few_values(comm):
    """Its error was above the tolerance in 0.6 % of the ranges, between all points that were looked at."""
    case, tolerance = random_affine(1018, 40)
    rng = np.random.default_rng(4)
    with reduced(case, tolerance, comm) as rom:
        pairs = []
        for place in rng.random((300, 3)):
            values = {item.name: float(np.exp(np.interp(part, (0, 1), np.log(item.range))))
                      for item, part in zip(case.parameters, place, strict=True)}  # fmt: skip
            full = case.matrices(values)
            modes = scipy.linalg.eigvalsh(full["K"], full["M"])
            pairs += [(f, values) for f in np.sqrt(modes) / (2 * np.pi) if f < case.band[1]]
        assert rom.record.accuracy.reached and case.eps(rom, pairs).max() <= tolerance


def rubber(n, laws):
    """Viscoelastic links of a chain (n, n), one after the other."""
    return [Viscoelastic(3e3 * sum(np.outer(e, e) for e in (pair(n, j, j + 3) for j in range(5 * k, n - 3, 9))), law)
            for k, law in enumerate(laws)]  # fmt: skip


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("make, law", [
    (bushings, Fractional(low=0.0, high=4.0, time=0.05, exponent=0.6)),
    (rotor, Maxwell(factors=[1.0, 0.5], times=[0.3, 0.02])),
], ids=["fractional", "maxwell"])  # fmt: skip
def test_viscoelastic_parts_beside_parameters(make, law, comm):
    case = make(12)
    case.parts = rubber(len(case.K), [law])
    if make is bushings:
        case.terms.append(("M", np.diag(np.arange(12) % 4 == 0) * 0.3, "a"))
    with reduced(case, 1e-2, comm, parameter_search=hpcred.ParameterSearch(points=3)) as rom:
        check(case, rom, 1e-2)
        assert "viscoelastic parts of the model" in rom.record.accuracy.measured
        values = {item.name: item.range[1] for item in case.parameters}
        s = 2j * np.pi * np.array([0.3, 2.2])
        at = rom.at(**values)
        assert np.allclose(rom.transfer_function(s, **values), at.transfer_function(s), rtol=1e-9)
        squares = scipy.linalg.eigh(*(rom.matrices(values)[key] for key in "KM"), eigvals_only=True)
        assert np.allclose((2 * np.pi * at.frequencies) ** 2, squares, rtol=1e-9, atol=1e-9 * squares.max())


@pytest.mark.parametrize("seed", [2, pytest.param(0, marks=pytest.mark.slow)])
def test_random_models_with_viscoelastic_parts(seed, comm):
    case, tolerance = random_viscoelastic(seed, 25)
    with reduced(case, tolerance, comm, parameter_search=hpcred.ParameterSearch(points=5)) as rom:
        assert not rom.record.accuracy.reached or case.eps(rom, fresh_pairs(case, 20)).max() <= tolerance


def test_viscoelastic_parts_that_leave_modes_undamped_at_other_values(comm):
    """A mass beside the rubber, whose frequency is in the band where the term of M is small."""
    n = 14
    case = bushing(n)
    case.K, case.M = np.pad(case.K, (0, 1)), np.pad(case.M, (0, 1))
    case.K[n, n], case.M[n, n] = 250.0, 1.0  # 2.5 Hz without the term
    case.terms = [("M", np.diag(np.arange(n + 1) == n) * 1e3, "a")]
    case.B, case.band = np.vstack([case.B, [1.0, 1.0]]), (1.0, 4.0)
    case.parts = rubber(n + 1, [Maxwell(factors=[1.0], times=[0.05])])
    with reduced(case, 1e-2, comm, parameter_search=hpcred.ParameterSearch(points=3)) as rom:
        assert rom.record.accuracy.loss_factor == 2e-3
        assert "since the viscoelastic parts leave modes of the band" in rom.record.accuracy.measured


def test_the_terms_are_those_of_the_full_model(comm):
    """In M, D, K, B and C, with an output that is no input."""
    n, rng = 20, np.random.default_rng(1)
    K, M = chain(n)
    parts = {"M": np.diag(rng.uniform(0, 0.5, n)), "D": np.diag(rng.uniform(0, 3, n)),
             "K": 1e3 * np.outer(pair(n, 4, 9), pair(n, 4, 9)), "B": unit(n, 7), "C": unit(n, 11).T}  # fmt: skip
    factors = {"M": "p", "D": "p^2", "K": "1 - p", "B": "2*p", "C": "p - 0.5"}
    case = AffineCase("all", K, M, unit(n, 3), (0.0, 3.0), [Parameter("p", (0.0, 1.0))],
                      [(of, parts[of], factors[of]) for of in parts], D=0.1 * M, Ct=unit(n, 15),
                      damping=GivenDamping())  # fmt: skip
    with reduced(case, 1e-6, comm, parameter_search=hpcred.ParameterSearch(points=5)) as rom:
        V = np.vstack(comm.allgather(rom.columns.getMat().getDenseArray().real)) if comm.size == 1 else None
        values = {"p": 0.83}
        full, small = case.matrices(values), rom.matrices(values)
        assert [term.of for term in rom.terms] == list("MDKBC")
        for of in "MDK":
            assert np.abs(V.T @ full[of] @ V - small[of]).max() < 1e-9 * np.abs(full[of]).max()
        X = rom.turn(values)
        at = rom.at(**values)
        assert np.abs(X.T @ small["M"] @ X - np.eye(rom.size)).max() < 1e-12
        assert np.abs(X.T @ small["K"] @ X - at.K).max() < 1e-9 * np.abs(at.K).max()
        s = 2j * np.pi * np.array([0.3, 2.2])
        assert np.allclose(rom.transfer_function(s, **values), at.transfer_function(s), rtol=1e-9)
        assert np.allclose(rom.frequency_response([0.3, 2.2], **values), at.transfer_function(s), rtol=1e-9)
        assert np.allclose(rom.transfer_function(s), rom.base.transfer_function(s), rtol=1e-9)
        assert case.eps(rom, fresh_pairs(case, 20)).max() <= 1e-6
        moved = replace(rom, resultants=np.ones((1, 6)))  # of the inputs at the reference, p = 0.5
        assert moved.at(p=0.83).resultants is None and moved.at(p=0.5).resultants is moved.resultants
        with pytest.raises(InputError, match="found 1.5, expected 0 to 1, its range"):
            rom.at(p=1.5)


@pytest.mark.parametrize("damping", [Rayleigh(0.1, 1e-4), ModalDamping(ratio=0.02)], ids=lambda item: item.kind)
def test_damping_that_follows_the_matrices(damping, comm):
    """D of the reduced model at other values is what its M and K make of it there."""
    case = bushing(20, damping=damping)
    with reduced(case, 1e-2, comm, parameter_search=hpcred.ParameterSearch(points=5)) as rom:
        at = rom.at(a=1.7)
        omega = 2 * np.pi * at.frequencies
        expected = 0.1 + 1e-4 * omega**2 if damping.kind == "rayleigh" else 0.04 * omega
        assert np.allclose(at.D, np.diag(expected), atol=1e-9 * expected.max())
        # with modal ratios, which a full model has no response of, by the loss factor of the smallest
        eta = 0.04 if damping.kind == "modal" else 0.0
        other = as_compared(rom, case.band)[0]
        assert np.array_equal(other.D, rom.D * (not eta)) and other.loss_factor == eta
        s = 4j * np.pi
        H = rom.C @ np.linalg.solve(s * s * rom.M + s * other.D + (1 + 1j * eta) * rom.K, rom.B)
        assert np.allclose(other.transfer_function(s), H, rtol=1e-9)


def test_undamped_models_are_checked_with_the_loss_factor_of_their_error(comm):
    case, search = bushing(20), hpcred.ParameterSearch(points=5)
    with case.model(comm) as model, hpcred.reduce(
        model, tolerance=1e-2, band=case.band, parameter_search=search
    ) as rom:
        measured = as_measured(rom, rom.record.accuracy)
        assert measured.loss_factor == rom.record.accuracy.loss_factor > 0 and not measured.D.any()
        with model.at() as full:
            found = hpcred.check_reduced(rom, full, 3)
        assert max(found.measured) <= 1e-2


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("frame", [FRAME, Buckens()], ids=lambda item: item.kind)
def test_frames(frame, comm):
    """Terms have all dofs of the model, the basis those of the frame; against full solves in the frame."""
    free, damping, F = isinstance(frame, Buckens), Rayleigh(2.0, 1e-5), [30.0, 133.0, 290.0]
    with hpcred.linkage(inputs=(*SUPPORTS, LOAD) if free else (LOAD,)) as link:
        K, M = to_dense(link.K), to_dense(link.M)
        soft = np.diag(np.arange(len(K)) < 60) * 1.0
        terms = [Term("K", K, "e")] if free else [Term("K", soft @ K @ soft, "e"), Term("M", soft @ M @ soft, "e^2")]
        family = ParametricModel(link, [Parameter("e", (0.0, 0.5))], terms)
    search = hpcred.ParameterSearch(points=5)
    given = {"frame": frame, "damping": damping}
    with family, hpcred.reduce(family, tolerance=1e-4, band=(0, 300), parameter_search=search, **given) as rom:
        assert rom.record.accuracy.reached and rom.columns.getSizes()[0][1] == family.size
        for e in (0.07, 0.46):
            with family.at(e=e) as full:
                H = full.frequency_response(F, **given)
            off = rom.frequency_response(F, e=e) - H
            assert rom.record.accuracy.measure.eps(off, H, np.einsum("sii->si", H)).max() <= 1e-4


@pytest.mark.mpi
@pytest.mark.costly
def test_spin_softening_and_rigid_body_motions(comm):
    """It loads all rows, which says nothing against the nodes; of a free body it leaves no rigid-body modes."""
    search = hpcred.ParameterSearch(points=3, most=3)
    for clamped in (True, False):
        with hpcred.solid((3, 2, 2), size=(0.6, 0.06, 0.06), inputs=3, clamped=clamped, comm=comm) as body:
            softening = hpcred.rotation_terms(body, "x")[1]
            family = ParametricModel(body, [Parameter("omega", (0.0, 800.0))], [softening])
        with family, family.at(omega=400.0) as model:
            assert any("of a preloaded or spinning body" in item for item in hpcred.inspect(model)["warnings"])
            with hpcred.reduce(family, tolerance=0.1, band=(10.0, 500.0), parameter_search=search) as rom:
                assert not any("nodes" in item for item in rom.record.warnings)
            if not clamped:
                with pytest.raises(InputError, match="holds or pushes rigid-body motions, as springs to the ground"):
                    hpcred.reduce(family, tolerance=0.1, band=(0.0, 500.0), frame=Buckens())
    with hpcred.solid((3, 2, 2), inputs=3, clamped=True, comm=comm) as body:
        other = np.random.default_rng(1).permutation(body.size)  # rows in another order than the nodes
        terms = [Term("K", np.eye(body.size), "omega^2")]
        mixed = body.with_fields(K=permuted(body.K, other), M=permuted(body.M, other))
    with (mixed, ParametricModel(mixed, [Parameter("omega", (0.0, 1.0))], terms) as family,
          hpcred.reduce(family, Modes(count=2)) as rom):  # fmt: skip
        assert any("nodes or directions are not those of the rows" in item for item in rom.record.warnings)


def permuted(mat, order):
    """A matrix with rows and columns in another order, in the same layout."""
    dense = to_dense(mat)[np.ix_(order, order)]
    first, last = mat.getOwnershipRange()
    rows = scipy.sparse.csr_array(dense[first:last])
    csr = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data
    return PETSc.Mat().createAIJ(mat.getSizes(), csr=csr, comm=mat.comm)


@pytest.mark.parametrize("size", [1.0, 1e-12])
def test_interface_coordinates_stay_where_they_are(comm, size):
    """The first coordinates are the motions of the interfaces at all values, of which a superelement is made; also of a
    body so light that their masses are no more than round-off beside those of its modes, 1."""
    with block_with_ends(comm, clamped=True, cells=(3, 2, 2)) as whole:
        light = [size * mat for mat in (whole.K, whole.M)]
        model = whole.with_fields(K=light[0], M=light[1])
        family = ParametricModel(model, [Parameter("e", (0.0, 1.0))], [Term("K", to_dense(model.K), "e")])
    basis = [hpcred.CraigBampton(count=6)]
    with family, hpcred.reduce(family, basis, coordinates="interface") as rom:
        at, count = rom.at(e=0.7), 6 * len(rom.interfaces)
        assert count and (rom.turn({"e": 0.7}) == np.eye(rom.size)).all()
        turned = rom.in_coordinates(np.linalg.qr(np.random.default_rng(1).normal(size=(rom.size,) * 2))[0])
        H = at.transfer_function(5j)  # of light bodies round-off mixes the stiff coordinates with the others
        assert size < 1 or np.abs(turned.transfer_function(5j, e=0.7) - H).max() < 1e-8 * np.abs(H).max()
        assert np.abs(at.K - 1.7 / 1.5 * rom.K).max() < 1e-10 * np.abs(rom.K).max()
        assert np.abs(at.M - rom.M).max() < 1e-12 * np.abs(rom.M).max() and at.interfaces == rom.interfaces


@pytest.mark.mpi
def test_components_at_several_values(comm):
    """The deflection at 0 Hz is exact where its component was made, and only there."""
    case = bushings(30)
    case.terms.append(("M", np.eye(30), "b"))
    points = [{"a": 0.5, "b": 0.1}, {"a": 2.0, "b": 5.0}]
    basis = [hpcred.StaticCorrection(), Modes(count=3)]

    def off(rom, values):
        full = case.matrices(values)
        exact = full["C"] @ np.linalg.solve(full["K"], full["B"])
        return np.abs(rom.transfer_function(0.0, **values) - exact).max() / np.abs(exact).max()

    with case.model(comm) as model, hpcred.reduce(model, basis, parameter_points=points) as rom:
        assert rom.size == 10 and rom.record.accuracy is None
        assert np.abs(rom.M - np.eye(10)).max() < 1e-12
        assert max(off(rom, values) for values in points) < 1e-9
    with case.model(comm) as model, hpcred.reduce(model, basis) as rom:
        assert rom.size == 5
        assert off(rom, rom.reference) < 1e-9 < max(off(rom, values) for values in points) < 0.3


@pytest.mark.mpi
@pytest.mark.costly
def test_a_store_serves_again(comm, tmp_path):
    """And another model with the same matrices at the reference is another one."""
    folder = comm.bcast(str(tmp_path))
    case, others = bushing(12), bushing(12)
    others.parameters[0] = Parameter("a", (0.0, 2.0))
    others.terms[0] = ("K", others.terms[0][1], "2*a - 1")  # the same at 1
    responses = []
    for each in (case, case, others):
        more = {"store": hpcred.PointStore(folder, comm), "parameter_search": hpcred.ParameterSearch(points=3)}
        with reduced(each, 1e-2, comm, **more) as rom:
            responses.append(rom.transfer_function(3j, a=1.5))
            made = len(rom.record.factorisations)
            assert case is not each or made == 0 or len(responses) == 1
            assert each.eps(rom, fresh_pairs(each, 10)).max() <= 1e-2
    assert np.allclose(responses[0], responses[1], rtol=1e-9)
    assert not np.allclose(responses[0], responses[2], rtol=1e-3)


def test_limits_end_it_honestly(comm):
    case = bushing(24)
    search = hpcred.ParameterSearch(points=5)
    with case.model(comm) as model:
        adaptive = hpcred.Adaptive(tolerance=1e-8, band=case.band, columns=10)
        with hpcred.reduce(model, adaptive=adaptive, parameter_search=search) as rom:
            accuracy = rom.record.accuracy
            assert not accuracy.reached and "with 10 columns" in accuracy.stopped
            assert case.eps(rom, fresh_pairs(case, 20)).max() <= 3 * accuracy.largest
    with case.model(comm) as model:
        search = hpcred.ParameterSearch(points=4, most=3)
        with hpcred.reduce(model, tolerance=1e-10, band=case.band, parameter_search=search) as rom:
            assert len(rom.record.accuracy.parameters.points) <= 3


def test_a_size_that_was_asked_for(comm):
    case = bushing(24)
    search = hpcred.ParameterSearch(points=5)
    with case.model(comm) as model:
        adaptive = hpcred.Adaptive(tolerance=1e-4, band=case.band, size=6)
        with hpcred.reduce(model, adaptive=adaptive, parameter_search=search) as rom:
            assert rom.size == 6 and "with 6 coordinates" in rom.record.accuracy.sentence
            true = case.eps(rom, fresh_pairs(case, 20)).max()
            assert true <= 1.05 * rom.record.accuracy.largest


@pytest.mark.mpi(ranks=(1,))
@pytest.mark.costly
def test_a_size_that_suffices_is_no_limit(monkeypatch):
    """And the error that is said has what the compression leaves, the estimate and the larger noise."""
    case, search, found = bushing(24), hpcred.ParameterSearch(points=5), []

    def compress(*arguments):
        found.append(compression.compress(*arguments)._replace(noise=0.25))
        return found[-1]

    with case.model() as model:
        with monkeypatch.context() as patch:
            patch.setattr(parametric_reductor, "compress", compress)
            with hpcred.reduce(model, tolerance=1e-4, band=case.band, parameter_search=search) as rom:
                size, accuracy = rom.size, rom.record.accuracy
        assert accuracy.noise == 0.25 and 0 < accuracy.largest - found[0].errors.max() < 1e-4
        assert found[0].factor.shape[0] > size == found[0].factor.shape[1]
        adaptive = hpcred.Adaptive(tolerance=1e-4, band=case.band, size=size)
        with hpcred.reduce(model, adaptive=adaptive, parameter_search=search) as rom:
            assert rom.size == size and rom.record.accuracy.stopped == "reached"


def test_what_is_refused(comm):
    n = 8
    case = bushings(n)
    skew = np.triu(np.ones((n, n)))
    with case.model(comm) as model:
        for more, message in [
            ({}, "the list of components is empty, and no tolerance is asked for"),
            ({"basis": Modes(count=4), "parameter_search": hpcred.ParameterSearch()}, "found it without a tolerance"),
            ({"tolerance": 1e-3, "band": case.band, "parameter_points": [{"a": 1.0}]}, "found it beside a tolerance"),
            ({"basis": Modes(count=4), "parameter_points": [{"a": 9.0}]}, "found 9, expected 0 to 2"),
            ({"tolerance": 1e-3, "band": case.band, "static": "exact"}, "static: found 'exact'"),
            ({"tolerance": 1e-3, "band": case.band, "drop_above": 9.0}, "drop_above"),
        ]:
            with pytest.raises(InputError, match=message):
                hpcred.reduce(model, **more)
        with pytest.raises(InputError, match="parameter_search: found it for a model without parameters"):
            hpcred.reduce(model.model, tolerance=1e-3, band=case.band, parameter_search=hpcred.ParameterSearch())
    for of, matrix, more, message in [
        ("K", skew, {}, "the term of K with the factor 'a' is not symmetric"),
        ("M", skew, {}, "the term of M with the factor 'a' is not symmetric"),
        ("M", np.eye(n), {"frame": Buckens()}, "in the Buckens frame, whose rigid-body modes depend on M"),
        ("D", np.eye(n), {"damping": Rayleigh(1.0)}, "found 'rayleigh', which replaces D and so the 1 term of D"),
    ]:
        other = bushings(n)
        other.terms.append((of, matrix, "a"))
        with other.model(comm) as model, pytest.raises(InputError, match=message):
            hpcred.reduce(model, tolerance=1e-3, band=case.band, **more)
    for of, law, message in [
        ("K", Maxwell(factors=[1.0], times=[0.1]), "viscoelastic parts beside an unsymmetric term of K with"),
        ("D", Fractional(low=0.0, high=1.0, time=0.1, exponent=0.5), "the law of Kv1 is fractional, and M, D and K"),
    ]:
        other = bushings(n, D=0.1 * np.eye(n), damping=GivenDamping(), parts=rubber(n, [law]))
        other.terms.append((of, skew - skew.T, "a - 1"))  # nothing at the reference
        with other.model(comm) as model, pytest.raises(InputError, match=message):
            hpcred.reduce(model, tolerance=0.1, band=case.band, damping=GivenDamping(),
                          parameter_search=hpcred.ParameterSearch(points=4))  # fmt: skip
    for key, value in (("points", 1), ("most", 2)):
        with pytest.raises(InputError, match=f"parameter_search.{key}: found {value}, expected at least"):
            hpcred.ParameterSearch(**{key: value})


def held(factor, band, of="K", n=12):
    """A chain that a spring holds, or a mass of the middle, with a term that takes away as much of it as `factor`."""
    K = sum(1e4 * np.outer(pair(n, j, j + 1), pair(n, j, j + 1)) for j in range(n - 1))
    spring = 1e3 * np.outer(pair(n, 0, n), pair(n, 0, n))
    taken = spring if of == "K" else np.diag(1.0 * (np.arange(n) == 6))
    return AffineCase("held", K + spring, np.eye(n), unit(n, 3, 8), band, [Parameter("e", (0.0, 2.0), 0.25)],
                      [(of, taken, factor)])  # fmt: skip


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("factor, where", [("-e", "1"), ("-e/2", "2"), ("0.3 - e", "1.3"), ("-e^2/3", "1.732")])
def test_a_stiffness_that_is_singular_at_values_in_the_ranges(factor, where, comm):
    """Beside or between the training points. There the response at 0 Hz is infinite, and others are as they are."""
    with pytest.raises(InputError, match=f"^held: K is singular, .*, near e = {where}[0-9]*, where the response at 0"):
        reduced(held(factor, (0.0, 30.0)), 1e-4, comm)
    case = held(factor, (1.0, 30.0))
    with reduced(case, 1e-4, comm, parameter_search=hpcred.ParameterSearch(points=9)) as rom:
        pairs = [*fresh_pairs(case), (1.0, {"e": float(where)})]
        assert rom.record.accuracy.reached and case.eps(rom, pairs).max() <= 1e-4


def test_a_free_motion_that_nothing_pushes_is_no_matter(comm):
    """A mass by itself, whose spring is taken away."""
    case = held("-e", (0.0, 30.0))
    K, M = np.pad(case.K, (0, 1)), np.pad(case.M, (0, 1))
    K[-1, -1], M[-1, -1] = 1e3, 1.0
    case.K, case.M, case.B = K, M, np.pad(case.B, ((0, 1), (0, 0)))
    case.terms = [("K", np.diag(1e3 * (np.arange(13) == 12)), "-e")]
    with reduced(case, 1e-4, comm, parameter_search=hpcred.ParameterSearch(points=9)) as rom:
        assert rom.record.accuracy.reached and case.eps(rom, fresh_pairs(case)).max() <= 1e-4


def test_circulatory_forces_hold_what_springs_do_not(comm):
    """Of K that is not symmetric the sign of the determinant tells whether it is singular between two values."""
    turning = np.zeros((12, 12))
    turning[3, 8], turning[8, 3] = 4e3, -4e3
    case = held("-e", (0.0, 30.0))
    case.circulatory, case.D, case.damping = True, 0.5 * np.eye(12), GivenDamping()
    case.terms.append(("K", turning, "e"))
    all_k = [case.matrices({"e": e})["K"] for e in np.linspace(0, 2, 101)]
    assert all(np.linalg.det(K) > 0 for K in all_k) and np.linalg.eigvalsh(all_k[-1] + all_k[-1].T).min() < 0
    with reduced(case, 1e-3, comm, parameter_search=hpcred.ParameterSearch(points=5)) as rom:
        assert not rom.record.accuracy.reached or case.eps(rom, fresh_pairs(case)).max() <= 1e-3
    case.terms[-1] = ("K", turning, "e*(2 - e)/1000")
    with pytest.raises(InputError, match="K is singular, but for round-off, near e = 1"):
        reduced(case, 1e-3, comm)


@pytest.mark.mpi
@pytest.mark.parametrize("reference", [0.0, 2.0])
@pytest.mark.costly
def test_values_at_which_the_model_is_unstable(reference, comm):
    """Damping that turns negative within the range, which no K or M tells; both poles of the mode it acts on count."""
    case = held("0.1*e", (0.0, 30.0))
    case.parameters = [replace(case.parameters[0], reference=reference)]
    case.terms.append(("D", np.eye(12), "0.5 - e"))
    with case.model(comm) as model:
        rom = hpcred.reduce(model, Modes(count=4), damping=GivenDamping())
        found = [item for item in rom.record.warnings if "unstable at e = 2: 8 poles in the right" in item]
        assert len(found) == 1 and [len(rom.at(e=e).unstable_poles()) for e in (0.49, 0.51)] == [0, 8]
        rom.close()
    case.terms[-1] = ("D", np.eye(12), "3 - e")
    with case.model(comm) as model, hpcred.reduce(model, Modes(count=4), damping=GivenDamping()) as rom:
        assert not any("unstable" in item for item in rom.record.warnings)


@pytest.mark.mpi
def test_a_mass_that_is_gone_at_values_in_the_ranges_is_refused(comm):
    """All along, or in the reduced model alone."""
    case = held("-e/2", (0.0, 30.0), "M")
    message = "^at e = 2: the reduced mass matrix is not positive definite: terms of M leave some motions without mass"
    with pytest.raises(InputError, match=message):
        reduced(case, 1e-4, comm)
    with case.model(comm) as model, hpcred.reduce(model, [hpcred.StaticCorrection(), Modes(count=10)]) as rom:
        assert rom.at(e=1.9).size == rom.size == 12
        for use in (rom.at, lambda e: rom.turn({"e": e})):
            with pytest.raises(InputError, match=message):
                use(e=2.0)


@pytest.mark.parametrize("damping", [hpcred.NoDamping(), GivenDamping()], ids=lambda item: item.kind)
def test_terms_that_are_zero(damping, comm):
    """In matrices or factors: they change nothing."""
    case = held("0*e", (0.0, 30.0))
    case.D, case.damping = 0.5 * np.eye(12), damping
    case.terms += [("M", np.zeros((12, 12)), "e"), ("B", np.zeros((12, 2)), "e"), ("K", np.zeros((12, 12)), "1 - e")]
    case.terms += [("D", np.zeros((12, 12)), "e")] * (damping.kind == "given")
    with reduced(case, 1e-4, comm, parameter_search=hpcred.ParameterSearch(points=3)) as rom:
        assert rom.record.accuracy.reached and case.eps(rom, fresh_pairs(case, 10)).max() <= 1e-4
        s = 2j * np.pi * np.array([0.5, 7.0])
        assert rom.transfer_function(s, e=2.0) == pytest.approx(rom.transfer_function(s, e=0.0), rel=1e-9)


@pytest.mark.parametrize("noise, sharp, left", [(2e-5, False, 1e-9), (1e-6, True, 1e-9), (1e-6, False, 1e-6)])
def test_a_basis_is_projected_again_where_noise_matters_or_digits_lack(monkeypatch, noise, sharp, left):
    one, alone, turns = np.eye(2), SimpleNamespace(size=1), []
    monkeypatch.setattr(parametric_reductor, "turned", lambda *_: (SimpleNamespace(outer=None), one, 2 * one))
    monkeypatch.setattr(outcome, "ask_for_digits", lambda *_: (sharp, 0))
    monkeypatch.setattr(parametric_reductor, "changed", lambda *_: 1e-9)
    judge = SimpleNamespace(goal=1e-5, noise=noise)
    greedy = SimpleNamespace(
        parametric=SimpleNamespace(comm=alone), first=SimpleNamespace(judge=judge), run=None, reference={},
        searches=[SimpleNamespace(judge=judge)], projections=SimpleNamespace(rotate=turns.append, quiet=False),
        goal=SimpleNamespace(band=(0.0, 1.0)),
    )  # fmt: skip
    kept, found = parametric_reductor._project_again(greedy, one)
    assert found == left and len(turns) == (left < noise) and np.array_equal(kept, one * 2 ** len(turns))


def test_points_around_one():
    plane = [Parameter("a", (0.0, 2.0)), Parameter("b", (1.0, 100.0))]  # b by its logarithm
    assert points_around(plane, (1.0, 10.0), 0.25) == [(1.5, 10.0), (1.0, 31.6228), (0.5, 10.0), (1.0, 3.16228)]
    assert points_around(plane, (2.0, 1.0), 0.5) == [(2.0, 10.0), (1.0, 1.0)]


def test_larger_errors_are_sought_around_the_worst_points(monkeypatch):
    """Two peaks between the points, the higher one beside a lower point; steps climb both."""
    parameters = [Parameter("a", (0.0, 10.0)), Parameter("b", (0.0, 1.0))]
    form = SimpleNamespace(parametric=SimpleNamespace(parameters=parameters))
    inside = SimpleNamespace(args=[SimpleNamespace(form=form)])

    def height(point):
        place = np.array([point[0] / 10, point[1]])
        low, high = (((place - peak) ** 2).sum() for peak in ((0.45, 0.55), (0.9, 0.1)))
        return 1 / (1 + 20 * low) + 1.4 / (1 + 30 * high)

    monkeypatch.setattr(compression, "_errors", lambda _, points, band: (
        np.array([height(point) for point in points]), np.ones(len(points))))  # fmt: skip
    points = training_points(parameters, 9)
    errors = np.array([height(point) for point in points])
    more, found, where = compression._look_around(inside, points, errors, (0.0, 1.0))
    assert points[int(errors.argmax())] == (5.0, 0.5) and errors.max() < 1.1 and found.max() > 1.4
    assert found == pytest.approx([height(point) for point in more])
    assert len(more) == len(found) == len(where) <= 4 * 4 * 5


@pytest.mark.parametrize("modes", [[3], [0, 3]], ids=["one end", "two ends"])
def test_points_where_a_pole_is_at_an_end_of_the_band(modes, comm):
    case = bushings(12)
    points = training_points(case.parameters, 16)

    def stiffness(point):
        full = case.matrices(dict(zip("ab", point, strict=True)))
        root = np.linalg.inv(np.linalg.cholesky(full["M"]))
        return root @ full["K"] @ root.T

    def frequencies(points):
        return np.array([np.sqrt(np.linalg.eigvalsh(stiffness(point))) / (2 * np.pi) for point in points])

    ends = np.mean([frequencies(points).min(axis=0)[modes], frequencies(points).max(axis=0)[modes]], axis=0)
    band = (0.0, *ends)[-2:]

    io = InputsOutputs(*[np.eye(1)] * 2)
    parametric = SimpleNamespace(parameters=case.parameters, comm=comm)
    projections = SimpleNamespace(
        form=SimpleNamespace(parametric=parametric, theta=lambda point: point),
        at=lambda point: SimpleNamespace(model=lambda: diagonalised(stiffness(point), np.ones((12, 1)), io=io)),
    )
    found = compression.at_ends_of_band(projections, points, band)
    off = frequencies(found)[:, :, None] / ends - 1
    places = np.abs(off).min(axis=1).argmin(axis=1)
    near = np.array([each[np.abs(each).argmin()] for each in (one[:, k] for one, k in zip(off, places, strict=True))])
    assert set(places) == set(range(len(ends))) and len(found) >= 4 * len(ends)
    assert (np.abs(near) < 0.01).all() and (np.where(ends[places] == band[1], -near, near) >= 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_entry_of_a_mode_is_positive(seed):
    A = np.random.default_rng(seed).normal(size=(6, 6))
    K, M = A @ A.T, np.diag(np.arange(1.0, 7.0))
    found = _modes({"M": M, "K": K}, {}, SimpleNamespace(M=M, K=K))
    assert pytest.approx(np.eye(6), abs=1e-12) == found.X.T @ M @ found.X
    assert pytest.approx(np.diag(found.stiffnesses), abs=1e-10) == found.X.T @ K @ found.X
    assert (found.X[np.abs(found.X).argmax(axis=0), range(6)] > 0).all()


def test_training_points_fill_the_ranges():
    line = [Parameter("p", (-1.0, 3.0))]
    assert training_points(line, 5) == [(-1.0,), (0.0,), (1.0,), (2.0,), (3.0,)]
    decades = [Parameter("p", (1.0, 1e4))]
    assert np.allclose(training_points(decades, 5), [[1], [10], [100], [1e3], [1e4]])
    assert place_of(decades, (100.0,)) == pytest.approx([0.5])
    many = [Parameter(name, (0.0, 1.0)) for name in "abc"]
    points = np.array(training_points(many))
    assert len(points) == 100 and {(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)} <= set(map(tuple, points))
    # 13 points without corners missed the error in one of them by a factor of 2
    assert {(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)} <= set(training_points(many, 13)) and corner_points(many, 7) == []
    assert len(corner_points(many, 8)) == 8
    cells = {tuple(cell) for cell in np.floor(points[8:] * 2.999).astype(int)}
    assert len(cells) == 27
    assert not set(fresh_points(many, 0, 8)) & set(fresh_points(many, 8, 8))
    assert np.allclose(distances(line, [(-1.0,), (2.0,)], [(0.0,), (3.0,)]), [0.25, 0.25])


@pytest.mark.mpi
def test_what_is_shared_out_comes_in_order(comm):
    assert shared_out(comm, lambda item: item**2, list(range(7))) == [0, 1, 4, 9, 16, 25, 36]


class Keys(hpcred.PointStore):
    """Keeps nothing but the keys of blocks for all values."""

    def load(self, model, key, say, most=None):
        return None

    def save(self, model, key, entry, say):
        if "visited" in key:
            self.keys = [*getattr(self, "keys", []), repr(key)]


@pytest.mark.slow
def test_a_store_tells_blocks_of_other_bands_and_terms_apart(tmp_path, comm):
    """Blocks for all values belong to the band and to the terms, also to those that are zero at the reference."""
    one = replace(rotor(16), parameters=[Parameter("omega", (0.0, 10.0), reference=0.0)])
    weaker = [(of, 0.9 * matrix, factor) for of, matrix, factor in one.terms]
    found = []
    for case in (one, replace(one, terms=weaker), replace(one, band=(0.0, 4.99))):
        store = Keys(tmp_path)
        with reduced(case, 0.1, comm, store=store, parameter_search=hpcred.ParameterSearch(points=3, most=3)):
            found.append(set(store.keys))
    assert found[0] and not found[0] & found[1] and not found[0] & found[2]


@pytest.mark.parametrize(
    "damping", [Rayleigh(10.0, 1e-6), ModalDamping(ratios=(0.01, 0.05, 0.02, 0.03, 0.01, 0.06))],
    ids=lambda item: item.kind,
)
def test_damping_leaves_rigid_body_motion_in_interface_coordinates_alone(damping):
    ends = [hpcred.Interface(name=name, nodes=Nodes(box=((low, -1.0, -1.0), (high, 1.0, 1.0))))
            for name, low, high in (("left", -1.0, 1e-6), ("right", 0.39999, 1.0))]  # fmt: skip
    with hpcred.solid((4, 2, 2), size=(0.4, 0.04, 0.06), clamped=False) as block, block.with_interfaces(ends) as body:
        parameters, terms = [Parameter("e", (0.0, 1.0))], [hpcred.Term("K", 0.5 * to_dense(body.K), "e")]
        with hpcred.ParametricModel(body, parameters, terms) as model:
            basis = [hpcred.reduction.ConstraintModes(), Modes(count=6)]
            rom = hpcred.reduce(model, basis, Buckens(), damping, coordinates="interface")
            assert rom.matrices({})["D"] == pytest.approx(rom.D, abs=1e-9 * np.abs(rom.D).max())
            R = np.linalg.svd(rom.K)[0][:, -6:]  # of all values, as K(e) = (1 + e / 2) K
            D = rom.matrices({"e": 0.9})["D"]
            assert np.abs(D @ R).max() < 1e-6 * np.abs(D).max()
            rom.close()


def test_where_larger_errors_are_looked_for():
    """The worst values, each two first steps away from the others, and none with half of the largest error."""
    errors = {0.0: 1.0, 0.1: 0.9, 0.5: 0.8, 0.55: 0.95, 0.71: 0.4, 0.9: 0.6}
    points = [(value,) for value in errors]
    found = compression._worst_apart([Parameter("a", (0.0, 1.0))], points, np.array(list(errors.values())))
    assert found == [(0.0,), (0.55,), (0.9,)]


def test_places_of_low_discrepancy():
    """Those of the golden ratio for one parameter, and of the plastic ratio for two (Roberts, 2018)."""
    golden, plastic = (1 + 5**0.5) / 2, 1.32471795724474602596
    assert np.allclose(low_discrepancy(1, 3)[:, 0], [(0.5 + k / golden) % 1 for k in (1, 2, 3)], rtol=1e-12)
    assert np.allclose(low_discrepancy(2, 9)[8], [(0.5 + 9 / plastic**k) % 1 for k in (1, 2)], rtol=1e-12)


@pytest.mark.parametrize("key, least", [("points", 2), ("most", 3)])
def test_the_least_that_a_search_takes(key, least):
    assert getattr(hpcred.ParameterSearch(**{key: least}), key) == least
    with pytest.raises(InputError, match=f"parameter_search.{key}: found {least - 1}, expected at least {least}"):
        hpcred.ParameterSearch(**{key: least - 1})
