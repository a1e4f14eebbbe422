"""Models moved by their last digits are reduced to the same size with the same verdict, as by other kernels of a BLAS.

Left out are tolerances within a factor of ten of the round-off of a model: there round-off decides, and is said to.
"""

import numpy as np
import pytest
import scipy.sparse
from adaptive_models import chain, hard_cases, massless_along, random_case, unit
from helpers import dense_model, face

import hpcred
from hpcred import Buckens, InputError, Rayleigh, SecondOrderModel

SIZE = 1e-14  # of what each entry is moved by, relative


def moved(matrix, random):
    """A symmetric matrix with other last digits."""
    upper = scipy.sparse.triu(scipy.sparse.csr_matrix(matrix)).tocoo()
    upper.data *= 1 + SIZE * random.uniform(-1, 1, upper.nnz)
    return upper + scipy.sparse.triu(upper, 1).T


def outcomes(K, M, comm, given, prepare=lambda model: [], D=None, moves=2, **asked):
    """What reductions of a model and of so many beside it end with: verdict and size, or what was refused."""
    found = set()
    for seed in range(moves + 1):
        random = np.random.default_rng(seed)
        beside = (moved(K, random), moved(M, random)) if seed else (K, M)
        opened = []
        try:
            opened.append(SecondOrderModel.from_scipy(*beside, D, comm, **given))
            opened += prepare(opened[0])
            with hpcred.reduce(opened[-1], **asked) as rom:
                found.add((rom.record.accuracy.reached, rom.size))
        except InputError as error:
            found.add(str(error).partition(":")[2][:60])
        finally:
            for model in reversed(opened):
                model.close()
    return found


def of_case(case, tolerance, comm, moves=2):
    given = {"inputs": case.B, "input_names": [f"u{i}" for i in range(case.B.shape[1])]}
    if case.Ct is not None:
        given |= {"outputs": case.Ct, "output_names": [f"y{i}" for i in range(case.Ct.shape[1])]}
    asked = {"D": case.D, "moves": moves, "damping": case.damping, "tolerance": tolerance, "band": case.band}
    return outcomes(case.K, case.M, comm, given, **asked)


@pytest.mark.parametrize("kind, asked", [
    ("averaging", {"static": "exact"}), ("rigid", {"coordinates": "interface"}),
    pytest.param("averaging", {"coordinates": "interface"}, marks=pytest.mark.slow),
    pytest.param("rigid", {"static": "exact"}, marks=pytest.mark.slow),
])  # fmt: skip
def test_equal_directions_of_a_square_section(comm, kind, asked):
    """The size was 17 or 18, and 23 or 24, as the compression parted a pair of equal singular values."""
    with hpcred.solid((3, 2, 2), clamped=False, comm=comm) as model:
        (K, M, _), dofs = dense_model(model), model.dofs
    ends = [face("left", 0.0, kind=kind), face("right", 0.03, kind=kind)]

    def prepare(model):
        jointed = model.with_interfaces(ends)
        return [jointed, jointed.with_inputs([(end.name, "all") for end in ends])]

    found = outcomes(K, M, comm, {"dofs": dofs}, prepare, frame=Buckens(), tolerance=1e-4, band=(0.0, 2e4), **asked)
    assert len(found) == 1 and found.pop()[0]


@pytest.mark.parametrize("part", [1.0, 1e-3])
@pytest.mark.parametrize("t", [(0.0, 1.0), (0.6, 0.8)], ids=["axis", "skew"])
def test_loads_along_directions_without_mass(comm, t, part):
    t, across = np.array(t), np.array([-t[1], t[0]])
    found = of_case(massless_along(t, across + part * t), 1e-9, comm)
    assert len(found) == 1 and found.pop()[0] is True


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, *range(2, 9)))])
def test_chains_with_masses_that_are_missing(comm, seed):
    random = np.random.default_rng(seed)
    n = int(random.integers(10, 60))
    K, M = chain(n, rng=random, spread=0.3 * random.random())
    none = random.choice(n, max(1, n // 6), replace=False)
    M[none, none] = 0.0
    loaded = random.choice(np.setdiff1d(np.arange(n), none), 2, replace=False)
    given = {"inputs": unit(n, *loaded), "input_names": ["u", "v"]}
    found = outcomes(K, M, comm, given, damping=Rayleigh(0.0, 2e-7), tolerance=1e-3, band=(0.0, 60.0))
    assert len(found) == 1 and found.pop()[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [k for k in range(32) if k not in (1, 16)])
def test_random_models(comm, seed):
    assert len(of_case(*random_case(seed, 80), comm, moves=4)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["load near a node", "chains tied 1e-2", "chains tied 1e-8", "double modes", "tiny",
                                  "double modes, centre", "cancelling loads", "nearly equal loads", "light oscillators",
                                  "other outputs", "narrow band", "stiffness jump", "quiet band"])  # fmt: skip
def test_difficult_models(comm, name):
    assert len(of_case(hard_cases()[name](), 1e-3, comm, moves=4)) == 1
