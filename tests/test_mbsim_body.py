"""benchmarks/mbsim_body.py on files as MBSim has them, of a small body of CalculiX."""

import gzip
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.linalg
from conftest import DATA
from docs_pages import load

import hpcred
from benchmarks.models.published import all_ranks

SCRIPT = Path(__file__).parents[1] / "benchmarks/mbsim_body.py"
MODES = 5


@pytest.fixture
def folder(tmp_path):
    """A body held at the nodes of its lowest x, with integrals of its lumped mass, written out node by node."""
    for suffix in ("sti", "mas"):
        packed = DATA / f"calculix/quadratic.{suffix}.gz"
        (tmp_path / f"calculix.{suffix}").write_bytes(gzip.decompress(packed.read_bytes()))
    (tmp_path / "calculix.dof").write_bytes((DATA / "calculix/quadratic.dof").read_bytes())
    (tmp_path / "calculix.frd").write_bytes((DATA / "calculix/quadratic_text.frd").read_bytes())
    with hpcred.readers.load_export(tmp_path / "calculix.sti", all_ranks(None), "body") as model:
        n = model.size
        M, K = (scipy.sparse.csr_matrix(mat.getValuesCSR()[::-1]).toarray() for mat in (model.M, model.K))
        place = model.dofs.position[::3]
        assert (model.dofs.direction == np.tile(range(3), n // 3)).all() and (np.diff(model.dofs.node[::3]) > 0).all()
    free = np.repeat(place[:, 0] > place[:, 0].min(), 3)
    values, vectors = scipy.linalg.eigh(M[free][:, free], K[free][:, free])  # M may be singular
    shapes = np.zeros((n, MODES))
    shapes[free] = vectors[:, : -MODES - 1 : -1]
    weight = M[::3, ::3].diagonal()
    weight = weight * M[::3, ::3].sum() / weight.sum()
    moved = shapes.reshape(-1, 3, MODES)
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    written = {
        "mass": weight.sum(), "nodal relative position": place.ravel(), "stiffness matrix": shapes.T @ K @ shapes,
        "nodal shape matrix of translation": shapes, "position integral": weight @ place,
        "position position integral": np.einsum("n,na,nb", weight, place, place),
        "shape function integral": np.einsum("n,nak->ak", weight, moved),
        "position shape function integral": np.einsum("n,na,nbk->abk", weight, place, moved).reshape(9, MODES),
        "shape function shape function integral": np.vstack(
            [np.einsum("n,nk,nl", weight, moved[:, a], moved[:, b]) for a, b in pairs]),
    }  # fmt: skip
    with h5py.File(tmp_path / "input_data.h5", "w") as file:
        for key, value in written.items():
            file[key] = value
    return tmp_path


def test_integrals_of_either_mass(folder, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)  # as where it is started
    rows = {row.pop("quantity"): row for row in load(SCRIPT).compared(folder)}
    assert len(rows) == 9
    exact = [key for key in rows if "lumped mass" not in rows[key]]
    assert len(exact) == 4 and all(rows[key]["consistent mass"] < 1e-6 for key in exact)
    lumped = [row["lumped mass"] for row in rows.values() if "lumped mass" in row]
    assert len(lumped) == 5 and max(lumped) < 1e-10
    assert rows["position position integral"]["consistent mass"] > 1e-4  # the lumped mass has other moments
