"""What a scientist writes first: a model of matrices, its reduction, responses, files and other libraries."""

from dataclasses import dataclass, is_dataclass, replace
from html import escape
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import scipy.sparse
import typer.main
from docs_pages import reference

import hpcred
from hpcred.analysis import Campbell, CriticalSpeed
from hpcred.cli.main import app
from hpcred.linalg.blocks import from_dense, local_rows
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
@pytest.mark.costly
def test_a_given_damping_matrix_counts_unless_told_otherwise(comm):
    fom = hpcred.SecondOrderModel(M, D, K, B)
    found = fom.frequency_response(F, damping=hpcred.NoDamping())
    assert np.abs(found - dense(0 * D)).max() < 1e-9 * np.abs(found).max()
    rom = hpcred.reduce(fom, hpcred.Modes(count=N - 2), damping=hpcred.NoDamping())
    assert not rom.D.any() and any("kind = 'given' takes" in item for item in rom.record.warnings)
    bare = hpcred.SecondOrderModel(M, None, K, B)
    assert bare.D is None and hpcred.reduce(bare, hpcred.Modes(count=3)).record.damping == hpcred.NoDamping()


def test_damping_may_be_left_out_but_not_the_stiffness():
    fom = hpcred.SecondOrderModel(M=M, K=K, B=B)
    assert fom.D is None
    same = hpcred.SecondOrderModel(M, None, K, B)
    np.testing.assert_array_equal(fom.frequency_response(F[:2]), same.frequency_response(F[:2]))
    with pytest.raises(InputError, match=r"K is missing; the order is M, D, K"):
        hpcred.SecondOrderModel(M, K)
    with pytest.raises(InputError, match=r"K: found an array .*, expected a square matrix; the order is M, D, K, B"):
        hpcred.SecondOrderModel(M, K, B)


@pytest.mark.parametrize(("make", "says"), [
    (lambda: hpcred.reduce(None, tol=1e-3), r"reduce: unknown keyword 'tol' \(did you mean 'tolerance'\?\)"),
    (lambda: hpcred.Rayleigh(alfa=2.0), r"Rayleigh: unknown keyword 'alfa' \(did you mean 'alpha'\?\)"),
    (lambda: hpcred.Krylov(freqency=1.0), "did you mean 'frequency'"),
    (lambda: hpcred.Interface(name="a", nodes=(1,), kimd="rigid"), "did you mean 'kind'"),
    (lambda: hpcred.Simulation(end=1.0, step=3), "did you mean 'steps'"),
    (lambda: hpcred.SecondOrderModel(M=M, K=K, input_name=["a"]), "did you mean 'input_names'"),
])  # fmt: skip
def test_misspelt_keywords_of_settings_are_suggested(make, says):
    with pytest.raises(InputError, match=says):
        make()


def test_every_public_class_with_fields_checks_its_keywords():
    classes = [item for item in reference.public_names().values() if is_dataclass(item)]
    assert len(classes) > 50
    for item in classes:
        with pytest.raises(InputError, match=f"{item.__name__}: unknown keyword 'no_such_key'"):
            item(no_such_key=1)


def test_commands_are_found_under_their_names():
    """But `report`, the name of a room, and those whose name is that of a function on objects."""
    others = {"report", "example"}
    for name in set(typer.main.get_command(app).commands) - others:
        assert callable(getattr(hpcred, name)) and name in dir(hpcred)
    assert hpcred.info is hpcred.workflows.describe_file
    for word, meant in (("inof", "info"), ("reprot_file", "report_file")):
        with pytest.raises(AttributeError, match=f"did you mean '{meant}'"):
            getattr(hpcred, word)
    for function, other in ((hpcred.reduce, "reduce_job"), (hpcred.campbell, "campbell_file")):
        with pytest.raises(InputError, match=f"found 'a.h5', expected an object in memory; .*hpcred.{other}"):
            function("a.h5")


@pytest.mark.mpi(ranks=(1, 2))
def test_what_notebooks_show(comm):
    fom = hpcred.SecondOrderModel(M, D, K, B, name="a < b")
    shown = fom._repr_html_() if comm.rank == 0 else ""  # notebooks call it on one rank
    assert comm.rank or ("a &lt; b" in shown and f"<td style='text-align:left'>{N}</td>" in shown)
    rom = hpcred.reduce(fom, tolerance=1e-4, band=(0, 300))
    accuracy = rom.record.accuracy
    for text in (f"{rom.size} coordinates", escape(accuracy.sentence), accuracy.directions[0].output):
        assert text in rom._repr_html_()
    assert accuracy._repr_html_().count("<tr>") == 1 + min(5, len(accuracy.directions))
    fom.close()
    assert "closed" in fom._repr_html_()


def test_a_campbell_diagram_draws_and_shows_itself():
    """Two modes of a rotor that split with its speed, one of which crosses it."""
    omega = np.linspace(0.0, 800.0, 9)
    poles = 1j * (500.0 + np.array([0.25, -0.25]) * omega[:, None]) - 1.0
    crossing = CriticalSpeed(order=1.0, mode=1, value=400.0, frequency=63.66, damping_ratio=2.5e-3,
                                    whirl="backward")  # fmt: skip
    found = Campbell(parameter="omega", unit="rad/s", values=omega, poles=poles, orbits=np.full((9, 2), np.nan),
                            highest=200.0, orders=(1.0,), critical_speeds=(crossing,))  # fmt: skip
    figure = found.plot()
    assert figure.axes[0].get_title() == found.sentence == "stable for omega = 0 to 800 rad/s"
    drawn = [line.get_ydata() for line in figure.axes[0].lines]
    assert any(len(y) == 9 and np.allclose(y, poles[:, 0].imag / 2 / np.pi) for y in drawn)
    html = found._repr_html_()
    assert all(f"<td>{word}</td>" in html for word in ("400", "63.66", "0.25", "backward")) and found.sentence in html
    assert figure._repr_png_()[:4] == b"\x89PNG"


def test_machines_and_driven_responses_show_themselves(tmp_path, monkeypatch):
    """In a line or a few, not as arrays; names as they are, also where they look like HTML."""
    monkeypatch.chdir(tmp_path)
    with hpcred.SecondOrderModel(M, D, K, B, name="a < b") as fom:
        found = hpcred.full_response(fom, np.linspace(1.0, 300.0, 9))
        rom = hpcred.reduce(fom, tolerance=1e-4, band=(0, 300))
    assert str(found).startswith(found.sentences[0]) and "array" not in repr(found)
    assert escape(found.sentences[0]) in found._repr_html_() and "9, 1 to 300 Hz" in found._repr_html_()
    # the verdict of a reduction comes first
    assert rom._repr_html_().index(escape(rom.record.accuracy.sentence)) < rom._repr_html_().index("reduced model")
    assert str(rom).startswith(rom.record.accuracy.sentence)
    # random loads and shocks
    named = replace(rom, output_names=("<i>", *rom.output_names[1:]))
    random = hpcred.analysis.random_response(named, [1.0, 300.0], np.ones((2, B.shape[1])))
    assert "array" not in repr(random) and f"{random.rms[0]:.6g}" in repr(random)
    html = random._repr_html_()
    assert "<td>&lt;i&gt;</td>" in html and f"<td>{random.rms[0]:.6g}</td>" in html
    shock = hpcred.analysis.shock_spectrum(*hpcred.analysis.half_sine(10.0, 0.011), [10.0, 100.0])
    assert "array" not in repr(shock) and f"largest {shock.maximax.max():.6g}" in repr(shock)


SHAPES = np.random.default_rng(3).standard_normal((N, 3))


@dataclass(frozen=True)
class Given(hpcred.reduction.Component):
    """Given columns, of which each rank gives its rows."""

    kind: Literal["given_for_test"] = "given_for_test"

    def columns(self, inputs, rigid):
        return 3

    def extend(self, basis, run):
        rows = slice(*run.model.K.getOwnershipRange())
        mine = SHAPES[rows]
        assert basis.extend(mine[:, 0]).kept == 1 and basis.extend(mine[:, 1:]).kept == 2
        assert basis.extend(from_dense(mine, run.model.K)).kept == 0
        assert from_dense(mine).getSizes() == from_dense(mine, run.model.K).getSizes()
        with pytest.raises(InputError, match=r"expected \(\d+, columns\), the rows of this rank"):
            basis.extend(mine[:-1])
        with pytest.raises(InputError, match="not real or not finite"):
            basis.extend(1j * mine)
        if run.model.comm.size > 1:
            with pytest.raises(InputError, match="found 1 on one rank and 2 on another"):
                basis.extend(mine[:, : 1 + (run.model.comm.rank > 0)])


@pytest.mark.mpi(ranks=(1, 3))
def test_components_on_plain_arrays(comm):
    """Their span is that of the basis."""
    with (
        hpcred.SecondOrderModel(M, None, K, B) as fom,
        hpcred.reduce(fom, [Given()]) as rom,
        local_rows(rom.columns) as rows,
    ):
        V = np.concatenate(comm.allgather(rows.real.copy()))
    assert V.shape == (N, 3) and np.abs(V - SHAPES @ np.linalg.lstsq(SHAPES, V, rcond=None)[0]).max() < 1e-9


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
@pytest.mark.costly
def test_an_export_without_a_file_of_ones_own(comm, folder):
    fom = hpcred.linkage(comm)
    rom = hpcred.reduce(fom, tolerance=1e-3, band=(0, 300), frame=hpcred.Buckens())
    fom.close()
    report = rom.export(folder / "arm.SID_FEM")
    assert report["format"] == "sid" and report["output"] == str(folder / "arm.SID_FEM")
    comm.Barrier()
    assert [item.name for item in folder.iterdir()] == ["arm.SID_FEM"]
    assert len(hpcred.writers.read_sid(folder / "arm.SID_FEM").coordinates) == rom.size
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


@pytest.mark.mpi(ranks=(1, 2), build="real")
@pytest.mark.costly
@pytest.mark.parametrize(("count", "most"), [(8, 4.0), pytest.param(1000, 20.0, marks=pytest.mark.slow)])  # MB
def test_nothing_leaks_without_a_with_block(comm, count, most):
    """Of what a reduction makes, 0.9 MB once stayed: small matrices of one process that PETSc had put aside."""

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

    sizes = []
    for _ in range(count + 6):
        fom = hpcred.solid((5, 4, 4), inputs=2, comm=comm)
        hpcred.reduce(fom, tolerance=1e-2, band=(0, 3000))
        sizes.append(resident())
    assert sizes[-1] - sizes[5] < most
