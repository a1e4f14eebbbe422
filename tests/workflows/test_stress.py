"""Stress modes in result.h5 by the key `stress` of a job."""

import base64
import json
import re
import shutil

import numpy as np
import pytest
from foreign import gathered
from helpers import refused

import hpcred
from hpcred.body.recovery import von_mises
from hpcred.cli.main import run
from hpcred.parallel.failures import InputError
from hpcred.report.surface import surface_of
from hpcred.workflows import report_files, stress_state

JOB = """model = "crank.h5"
output = "r.h5"
inputs = [[1, "x"], [7, "z"]]
%s
[frame]
kind = "buckens"
[[basis]]
kind = "modes"
count = 9
"""


def job(folder, comm, lines, **properties):
    with hpcred.crank(600, comm=comm) as model, model.with_fields(**properties) as changed:
        hpcred.write_model(folder / "crank.h5", changed)
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB % lines)
    comm.Barrier()
    return folder / "job.toml"


@pytest.fixture(scope="module")
def reduced(comm, module_folder):
    """A folder with crank.h5, a job with stresses of all nodes, and its r.h5."""
    hpcred.reduce_job(job(module_folder, comm, "stress = true"), comm=comm)
    return module_folder


@pytest.fixture(scope="module")
def bare(reduced, comm):
    """Of the same job, a result without stresses."""
    hpcred.reduce_job(reduced / "job.toml", overrides=["stress=false", "output='bare.h5'"], comm=comm)
    return reduced / "bare.h5"


@pytest.mark.mpi
@pytest.mark.costly
def test_a_job_writes_stresses_of_all_nodes_or_of_some(comm, reduced, folder):
    """They are those of the basis in the same file, whatever the rank."""
    result = hpcred.read_result(reduced / "r.h5", comm)
    found = result.stress_modes()
    with hpcred.read_model(reduced / "crank.h5", comm) as model:
        from hpcred.files.result_file import read_basis

        basis = read_basis(reduced / "r.h5", model)
        own = hpcred.stress_modes(model, basis)
        basis.destroy()
    node, stress = gathered(comm, own.node)[0], np.concatenate(comm.allgather(own.stress), axis=1)
    assert np.array_equal(found.node, node) and found.source == own.source and result.reduced.record.warnings == ()
    assert np.allclose(found.stress, stress, rtol=0, atol=1e-9 * np.abs(stress).max())
    some = result.stress_modes([17, 3])
    assert some.node.tolist() == [3, 17] and np.array_equal(some.stress, found.stress[:, [2, 16]])
    with pytest.raises(InputError, match=r"r.h5: no stress of node 9999; it has those of \d+ nodes"):
        result.stress_modes([3, 9999])
    comm.Barrier()
    less = ['stress=["SMALL_EYE", 1]', f"output='{folder}/s.h5'"]
    hpcred.reduce_job(reduced / "job.toml", overrides=less, comm=comm)
    few = hpcred.read_result(folder / "s.h5", comm).stress_modes()
    assert few.node[0] == 1 and 3 < len(few.node) < len(node)
    scale = np.abs(stress).max()
    same = np.abs(few.stress) - np.abs(found.stress[:, np.searchsorted(node, few.node)])  # signs of modes are free
    assert np.abs(same).max() < 1e-6 * scale


@pytest.mark.mpi
@pytest.mark.costly
def test_results_without_stresses_say_how_to_get_them(comm, bare):
    with pytest.raises(InputError, match=r"bare.h5: no stress modes; reduce with stress = true, or let the"):
        hpcred.read_result(bare, comm).stress_modes()


@pytest.mark.mpi(build="real")
def test_models_without_materials_are_refused_before_the_reduction(comm, folder):
    path = job(folder, comm, "stress = true", properties=None)
    with pytest.raises(InputError, match=r"crank.h5: stress: found elements whose types and materials are not known"):
        hpcred.reduce_job(path, comm=comm)
    with pytest.raises(InputError, match=r"stress: crank.h5 has no node set 'EYE'; it has BIG_EYE, SMALL_EYE"):
        hpcred.reduce_job(job(folder, comm, 'stress = ["EYE"]'), comm=comm)
    assert not (folder / "r.h5").exists()


@pytest.mark.parametrize(("lines", "says"), [
    ("stress = true\nwrite_basis = false", r"stress: found it with write_basis = false; stresses belong to the basis"),
    ("stress = []", r"stress: found an empty list, expected nodes and names of node sets, true or false"),
    ("stress = [0]", r"stress: found 0, expected 1 to 2147483647|stress: found 0, expected 1 to 2.147"),
    ("stress = [1.5]", r"stress"), ('stress = "A"', r"stress"),
])  # fmt: skip
def test_other_values_of_the_key_are_refused(tmp_path, lines, says):
    (tmp_path / "job.toml").write_text(JOB % lines)
    with pytest.raises(InputError, match=says):
        hpcred.settings.read_job(tmp_path / "job.toml")


def unlike_any(count):
    """Coordinates over time whose largest stress is nowhere at an end."""
    return np.sin(np.arange(1, 8)[:, None] * np.arange(1, count + 1))


def unpacked(packed):
    kinds = {"f4": "<f4", "f8": "<f8", "u4": "<u4", "i2": "<i2"}
    array = np.frombuffer(base64.b64decode(packed["bdata"]), kinds[packed["dtype"]]).reshape(packed["shape"])
    return array / (2**15 - 1) if packed["dtype"] == "i2" else array


def _check_played(drawn, moved, q, whole, result, modes):
    """What the page plays: displacements and stresses of its instants at the surface, against all at once."""
    motion, shape = drawn["motion"], drawn["shape"]
    assert motion["times"] == moved.t[moved.shown].tolist()
    assert moved.shown[motion["start"]] == whole.max(axis=1).argmax()
    assert motion["largest"] == pytest.approx(whole.max() / 1e6) and motion["ticks"][0] == 0
    with result.shapes() as shapes:
        nodes, known = surface_of(shapes.points, shapes.cells).nodes, np.searchsorted(shapes.nodes, modes.node)
        fields, marks = zip(*(shapes.moved(q[i]) for i in moved.shown), strict=True)
        stress = np.full((len(moved.shown), len(shapes.nodes)), -1.0)
    fields = np.concatenate([np.array(fields)[:, nodes], np.array(marks)], axis=1)
    fields /= np.linalg.norm(fields, axis=2).max()
    stress[:, known] = whole[moved.shown] / whole.max()
    for k in range(len(fields)):
        assert np.allclose(unpacked(motion["fields"][k]), fields[k], atol=2e-4)
        drawn_stress = unpacked(motion["stresses"][k])
        assert np.allclose(drawn_stress[: len(nodes)], stress[k, nodes], atol=2e-4)
        assert (drawn_stress[len(nodes) :] == -1).all()
    assert len(shape["stresses"]) == len(shape["fields"])
    for values in map(unpacked, shape["stresses"]):
        assert values.max() == pytest.approx(1.0, abs=0.5) and values.min() >= -1


def test_pictures_of_stresses_of_shapes_and_of_a_motion(reduced, bare, folder, comm, monkeypatch, capsys):
    """Against all stresses at once; the page has both pictures, the folder of figures too."""
    for path in (reduced / "r.h5", bare):
        shutil.copy(path, folder)
    monkeypatch.chdir(folder)
    result = hpcred.read_result("r.h5", comm)
    modes, q = result.stress_modes(), unlike_any(result.reduced.size)
    head = ",".join(["t", *(f"q{k + 1}" for k in range(q.shape[1]))])
    np.savetxt("motion.csv", np.column_stack([np.arange(len(q)) / 10, q]), delimiter=",", header=head, comments="")
    whole = von_mises(np.einsum("tm,msc->tsc", q, modes.stress))
    instant, place = np.unravel_index(whole.argmax(), whole.shape)
    monkeypatch.setattr(stress_state, "AT_ONCE", 2 * modes.stress[0].size)
    found = stress_state.stress_of_motion(result, "motion.csv", comm)
    assert np.allclose(found.worst, q[instant]) and 0 < instant < len(q) - 1
    assert found.title == (f"t = {instant / 10:.4g} s: von Mises stress up to {whole.max() / 1e6:.4g} MPa, at node "
                           f"{modes.node[place]}")  # fmt: skip
    with result.shapes() as shapes:
        points = shapes.points
        at = [int(np.searchsorted(shapes.nodes, int(name.removeprefix("node ")))) for name, _ in found.curves]
        known = np.searchsorted(shapes.nodes, modes.node)
    assert np.allclose(found.t, np.arange(len(q)) / 10) and len(at) == 4 and at[0] == known[place]
    peaks, far = np.full(len(points), -1.0), 0.1 * np.linalg.norm(np.ptp(points, axis=0))
    peaks[known] = whole.max(axis=0) / 1e6
    for k, (i, (_, values)) in enumerate(zip(at, found.curves, strict=True)):
        assert np.allclose(values, whole[:, np.searchsorted(known, i)] / 1e6)
        free = np.linalg.norm(points[:, None] - points[at[:k]], axis=2).min(axis=1, initial=np.inf) > far
        assert free[i] and values.max() == pytest.approx(peaks[free].max())
    found_stress, colours = found, []
    monkeypatch.setattr(report_files, "pair_figure", lambda path, *_, **__: path.touch())
    monkeypatch.setattr(report_files, "draw_shapes", lambda path, *_, colour="displacement", **__: (
        path.touch(), colours.append(colour)))  # fmt: skip
    found = hpcred.report_file(["r.h5"], motion="motion.csv", output="page.html", png="figures", comm=comm)
    drawn = {f"figures/{name}_r.png" for name in ("stress", "stress_of_motion", "stress_over_time")}
    assert drawn <= set(found["files"]) and colours == ["displacement", "stress"]
    text = (folder / "page.html").read_text()
    assert '<section id="stress">' in text and '<option value="stress">' in text and "<img" not in text
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)[1])
    _check_played(data["results"][0], found_stress, q, whole, result, modes)
    assert run(["export", "r.h5", "--format", "png", "--set", "png.colour=stress", "--modes", "2", "-o", "a.png"]) == 0
    assert (folder / "a.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(InputError, match=r"^--motion: found 2 results, expected the one that moved so"):
        hpcred.report_file(["r.h5", "r.h5"], motion="motion.csv", output="page.html", comm=comm)
    with pytest.raises(InputError, match="no stress modes; reduce with stress = true"):
        hpcred.report_file(["bare.h5"], motion="motion.csv", output="page.html", comm=comm)
    assert "no stress modes" in refused(capsys, "export", "bare.h5", "--format", "png", "--set", "png.colour=stress")


@pytest.mark.parametrize("coordinates", ["modal", "interface"])
def test_shapes_have_stresses_and_displacements_of_coordinates(folder, comm, coordinates):
    """Of interface coordinates shapes are mixtures; nodes without stress modes have NaN."""
    lines = 'stress = ["SMALL_EYE"]'
    if coordinates == "interface":
        lines += '\ncoordinates = "interface"\n[[interface]]\nname = "small"\nnodes = {set = "SMALL_EYE"}\n'
    path = job(folder, comm, lines)
    if coordinates == "interface":
        text = path.read_text().replace('inputs = [[1, "x"], [7, "z"]]\n', "")
        path.write_text(text.replace("count = 9", "index = [7, 8, 9]"))
    hpcred.reduce_job(path, comm=comm)
    result = hpcred.read_result(folder / "r.h5", comm)
    modes = result.stress_modes()
    with result.shapes() as shapes:
        for k in (0, len(shapes.names) - 1):
            q = shapes.coordinates_of(k)
            wanted = shapes.displacement(k)
            assert np.allclose(shapes.moved(q)[0], wanted, atol=1e-12 * np.abs(wanted).max())
            assert np.allclose(shapes.moved(q)[1], shapes.mark_displacement(k))
            found = shapes.stress(q)
            known = np.isin(shapes.nodes, modes.node)
            assert np.isnan(found[~known]).all() and known.any() and not known.all()
            assert np.allclose(found[known], np.einsum("m,msc->sc", q, modes.stress), rtol=1e-9, atol=1e-6)
