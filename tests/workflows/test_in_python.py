"""What a scientist writes first: a model of matrices, its reduction, responses, files and other libraries."""

from pathlib import Path

import numpy as np
import pytest
import scipy.sparse

import hpcred
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import PETSc

N = 60
K = scipy.sparse.diags([-np.ones(N - 1), 2 * np.ones(N), -np.ones(N - 1)], [-1, 0, 1], format="csr") * 1e6
M = scipy.sparse.eye(N, format="csr") * 0.1
D = 1e-5 * K + 2 * M
B = np.eye(N)[:, [10, 40]]
F = np.linspace(1, 300, 15)


def dense(D, C=B.T):
    """H by dense NumPy."""
    H = []
    for s in 2j * np.pi * F:
        H.append(C @ np.linalg.solve((s * s * M + s * D + K).toarray(), B))
    return np.array(H)


@pytest.mark.mpi(ranks=(1, 3))
def test_from_matrices_to_a_file_and_back(comm, folder):
    fom = hpcred.SecondOrderModel(M, D, K, B, B.T)
    assert fom.Ct is None and fom.input_names == ("input 1", "input 2")
    rom = hpcred.reduce(fom, tolerance=1e-4, band=(0, 300))
    full = fom.frequency_response(F)
    assert np.abs(full - dense(D)).max() < 1e-9 * np.abs(full).max()
    assert np.abs(rom.frequency_response(F) - full).max() < 1e-4 * np.abs(full).max()
    assert rom.record.damping == hpcred.GivenDamping() and "(tolerance 0.01 %) over 0 to 300 Hz" in str(rom)
    rom.save(folder / "rod.h5")
    again = hpcred.read_result(folder / "rod.h5", comm).reduced
    assert np.array_equal(again.K, rom.K) and again.record.damping == hpcred.GivenDamping()
    with pytest.raises(InputError, match="found a reduced model without its full model"):
        again.export(folder / "rod.SID_FEM")


@pytest.mark.mpi(ranks=(1, 3))
def test_a_given_damping_matrix_counts_unless_told_otherwise(comm):
    fom = hpcred.SecondOrderModel(M, D, K, B)
    found = fom.frequency_response(F, damping=hpcred.NoDamping())
    assert np.abs(found - dense(0 * D)).max() < 1e-9 * np.abs(found).max()
    rom = hpcred.reduce(fom, hpcred.Modes(count=N - 2), damping=hpcred.NoDamping())
    assert not rom.D.any() and any("kind = 'given' takes" in item for item in rom.record.warnings)
    bare = hpcred.SecondOrderModel(M, None, K, B)
    assert bare.D is None and hpcred.reduce(bare, hpcred.Modes(count=3)).record.damping == hpcred.NoDamping()


@pytest.mark.mpi(ranks=(1, 3))
def test_outputs_of_its_own_and_petsc_matrices(comm):
    C = np.eye(N)[[30, 40, 50]]
    rows = slice(*hpcred.SecondOrderModel(M, D, K, B).K.getOwnershipRange())
    mats = []
    for matrix in (M, D, K):
        mine = matrix.tocsr()[rows]
        mats.append(PETSc.Mat().createAIJ(((mine.shape[0], N), (mine.shape[0], N)), comm=comm,
                                          csr=(mine.indptr, mine.indices, mine.data)))  # fmt: skip
    for fom in (
        hpcred.SecondOrderModel(M, D, K, B, C, output_names=("a", "b", "c")),
        hpcred.SecondOrderModel(*mats, B[rows], C[:, rows], output_names=("a", "b", "c")),
    ):
        assert fom.output_names == ("a", "b", "c")
        found = fom.frequency_response(F)
        assert np.abs(found - dense(D, C)).max() < 1e-9 * np.abs(found).max()
    assert hpcred.SecondOrderModel(*mats, B[rows], B.T[:, rows]).Ct is None
    with pytest.raises(InputError, match="comm: found it beside PETSc matrices"):
        hpcred.SecondOrderModel(*mats, comm=comm)


@pytest.mark.parametrize("B, C, says", [
    (B[:, 0], None, r"SecondOrderModel: B: found an array \(60,\), expected \(60, inputs\)$"),
    (B.T, None, r"B: found an array \(2, 60\), expected \(60, inputs\); give B.T"),
    (B.T.tolist(), None, r"B: found an array \(2, 60\), expected \(60, inputs\); give B.T"),
    (B, B, r"C: found an array \(60, 2\), expected \(outputs, 60\); give C.T"),
])  # fmt: skip
def test_columns_that_do_not_fit_are_named(B, C, says):
    with pytest.raises(InputError, match=says):
        hpcred.SecondOrderModel(M, D, K, B, C)


def test_lists_are_matrices_too():
    fom = hpcred.SecondOrderModel(*(matrix.toarray().tolist() for matrix in (M, D, K)), B.tolist(), B.T.tolist())
    assert fom.Ct is None and np.abs(fom.frequency_response(F) - dense(D)).max() < 1e-9


def test_warnings_and_the_measure_are_printed():
    rom = hpcred.reduce(hpcred.SecondOrderModel(M, D, K, B), tolerance=1e-3, band=(0, 300), damping=hpcred.NoDamping())
    assert "\n  measured with the loss factor 0.002 (undamped)\n  warning: damping: none, though model has" in str(rom)


@pytest.mark.mpi(build="real")
def test_an_export_without_a_file_of_ones_own(comm, folder):
    fom = hpcred.linkage(comm)
    rom = hpcred.reduce(fom, tolerance=1e-3, band=(0, 300), frame=hpcred.Buckens())
    fom.close()
    report = rom.export(folder / "arm.SID_FEM")
    assert report["format"] == "sid" and report["output"] == str(folder / "arm.SID_FEM")
    comm.Barrier()
    assert [item.name for item in folder.iterdir()] == ["arm.SID_FEM"]
    assert len(hpcred.read_sid(folder / "arm.SID_FEM").coordinates) == rom.size
    for name, kind in (("arm_statespace.npz", "statespace-npz"), ("arm.npz", "npz"), ("arm_exudyn.npz", "exudyn")):
        assert rom.export(folder / name)["format"] == kind
    with pytest.raises(InputError, match="a.foo: found a name that ends in .foo, expected one of .sid_fem, .mat"):
        rom.export(folder / "a.foo")
    with pytest.raises(InputError, match="^linkage: "):
        rom.export(folder / "arm.pch", "nastran")


def test_a_state_space_of_scipy():
    rom = hpcred.reduce(hpcred.SecondOrderModel(M, D, K, B), tolerance=1e-4, band=(0, 300))
    ss = rom.to_state_space()
    for k, f in enumerate(F):
        s = 2j * np.pi * f
        H = ss.C @ np.linalg.solve(s * np.eye(len(ss.A)) - ss.A, ss.B) + ss.D
        assert np.abs(H - rom.frequency_response(F)[k]).max() < 1e-9 * np.abs(H).max()


@pytest.mark.mpi(ranks=(1, 2), build="real", costly=True)
@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_nothing_leaks_without_a_with_block(comm, count):
    """Of what a reduction makes, 0.9 MB once stayed: small matrices of one process that PETSc had put aside."""

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

    sizes = []
    for _ in range(count + 20):
        fom = hpcred.solid((5, 4, 4), inputs=2, comm=comm)
        hpcred.reduce(fom, tolerance=1e-2, band=(0, 3000))
        sizes.append(resident())
    assert sizes[-1] - sizes[19] < 10.0 + 0.01 * count  # MB
