"""What info says of a model: inertia counts, mass, centre of mass."""


import numpy as np
import pytest
import scipy.linalg
import scipy.sparse

import hpcred
from hpcred.examples import linkage as example
from hpcred.model.frames import apply_frame
from hpcred.parallel.petsc import is_complex

pytestmark = pytest.mark.mpi


@pytest.mark.skipif(is_complex(), reason="inertia needs a real build")
def test_inspection(comm, linkage):
    report = hpcred.inspect(linkage, [300.0], band_top=300.0, verify=True)
    assert report["rigid_body_modes"] == 6
    assert report["mass_kg"] == pytest.approx(5.39798, abs=1e-5)
    assert report["mass_matrix"] == "positive definite"
    assert report["elastic_modes_below_hz"][0] == [300.0, 7]
    framed = apply_frame(linkage, example.FRAME)
    supported = hpcred.inspect(framed.model, [600.0], band_top=300.0)
    assert supported["rigid_body_modes"] == 0
    assert supported["elastic_modes_below_hz"] == [[600.0, 13]]
    assert supported["size_hint"] == 14


@pytest.mark.skipif(is_complex(), reason="inertia needs a real build")
@pytest.mark.parametrize(
    ("eigenvalue", "said"), [(-3e-11, "singular"), (-1e-6, "indefinite"), (1e-6, "positive definite")]
)
def test_a_mass_matrix_that_its_digits_made_negative_is_singular(comm, eigenvalue, said):
    """Each pair of dofs has 2 and the eigenvalue, in units of its own; the last one is not coupled."""
    half, units = 1 + eigenvalue / 2, np.array([1.0, 1e3, 1e-3, 1.0, 30.0])
    pair = np.array([[half, 2 - half], [2 - half, half]])
    M = scipy.sparse.csr_matrix(scipy.linalg.block_diag(*(unit * pair for unit in units), np.eye(1)))
    with hpcred.SecondOrderModel.from_scipy(scipy.sparse.eye(11, format="csr"), M, comm=comm) as model:
        assert hpcred.inspect(model, verify=True)["mass_matrix"] == said


@pytest.mark.parametrize("key, said", [("M", "indefinite"), ("K", "no negative direction found")])
def test_what_is_told_without_a_factor(comm, monkeypatch, key, said):
    """Two rows whose sum or difference has the other sign; nothing is factored that nobody asks for."""
    monkeypatch.setattr("hpcred.analysis.summary.ShiftedSolver", None)
    mats = {"K": np.eye(3), "M": np.eye(3)}
    mats[key][0, 1] = mats[key][1, 0] = 2.0
    with hpcred.SecondOrderModel.from_scipy(**mats, comm=comm) as model:
        report = hpcred.inspect(model)
    assert report["mass_matrix"].startswith(said)
    assert [line for line in report["warnings"] if f": {key} " in line]


def test_mass_and_inertia_of_a_block(comm):
    with hpcred.solid((4, 3, 2), (0.4, 0.2, 0.1), 3, clamped=False, comm=comm) as model:
        report = hpcred.inspect(model)
    mass = 7850 * 0.4 * 0.2 * 0.1
    assert report["mass_kg"] == pytest.approx(mass)
    assert np.allclose(report["centre_of_mass_m"], [0.2, 0.1, 0.05])
    # the consistent mass matrix integrates trilinear fields exactly
    expected = mass / 12 * np.array([0.2**2 + 0.1**2, 0.4**2 + 0.1**2, 0.4**2 + 0.2**2])
    assert np.allclose(np.diag(report["inertia_kg_m2"]), expected)


@pytest.mark.skipif(is_complex(), reason="inertia needs a real build")
def test_rigid_body_modes_are_counted_without_nodes(comm):
    """They are none of the elastic modes."""
    with hpcred.linkage(comm) as model, model.with_fields(dofs=None) as bare:
        report = hpcred.inspect(bare, [300.0])
    assert report["modes_at_zero"] == 6
    assert report["elastic_modes_below_hz"] == [[300.0, 7]]
