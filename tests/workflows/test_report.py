"""Reports: what is said and drawn is what the result files and the full model say, and nothing comes from a network."""

import base64
import csv
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from helpers import LINKAGE_JOB, MODES_JOB, block_with_ends, reduce_linkage, refused

import hpcred as package
from hpcred.cli.main import run
from hpcred.report.figures import COLOURS, pair_figure
from hpcred.report.page import KINDS
from hpcred.workflows.report import report_file
from hpcred.workflows.report_sheets import sheets_of

TOLERANCE_JOB = "tolerance = 1e-3\nband = [0.0, 300.0]\nreport = true\n" + LINKAGE_JOB.replace('[1, "x"]', '[1, "z"]')
ASSETS = files("hpcred.report") / "assets"


class Page(HTMLParser):
    """Texts, addresses, and whether every tag is closed."""

    def __init__(self, text):
        super().__init__()
        self.texts, self.addresses, self.open, self.data = [], [], [], ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.addresses += [value for key, value in attrs if key in ("src", "href", "action", "data")]
        self.kind = dict(attrs).get("type")
        if tag not in ("meta", "link", "input", "br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        if self.open and self.open[-1] == "script":
            self.data = text if self.kind == "application/json" else self.data
        elif text.strip():
            self.texts.append(text.strip())


def unpacked(value):
    """What packed() was given."""
    return np.frombuffer(base64.b64decode(value["bdata"]), dtype=KINDS[value["dtype"]]).reshape(value["shape"])


def page_of(path):
    text = Path(path).read_text(encoding="utf-8")
    return Page(text), text


@pytest.fixture(scope="module")
def linkage_report(tmp_path_factory):
    """Two results of the linkage, reduced to a tolerance and by modes, in one report with the full model."""
    folder = tmp_path_factory.mktemp("report")
    reduce_linkage(folder, TOLERANCE_JOB)
    modal = MODES_JOB.replace('"result.h5"', '"mod<al.h5"').replace('[1, "x"]', '[1, "z"]')
    (folder / "modal.toml").write_text(modal.replace("[frame]", "band = [0.0, 300.0]\n[frame]", 1))
    assert run(["reduce", str(folder / "modal.toml")]) == 0
    target = {"output": folder / "report.html", "csv": folder / "tables", "svg": folder / "figures"}
    shutil.copy(folder / "result.html", folder / "report.html")  # what is there is replaced
    older = {"tables/error_measured_result.csv": "f_hz,eps\n", "figures/error.svg": '<?xml version="1.0"?><svg/>'}
    for name, text in older.items():
        (folder / name).parent.mkdir()
        (folder / name).write_text(text)
    drawn = []

    def draw_first(path, curves, *more, **keywords):
        drawn.append([label for label, _, _ in curves])
        pair_figure(path, curves, *more, **keywords) if len(drawn) == 1 else path.write_text("<svg/>" * 20)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hpcred.workflows.report_files.pair_figure", draw_first)
        told = report_file([folder / "result.h5", folder / "mod<al.h5"], folder / "model.h5", solves=5, **target)
    assert drawn == 3 * [["result", "full model", "mod<al"]]
    return folder, told


def test_the_page_is_whole_and_needs_no_network(linkage_report):
    page, text = page_of(linkage_report[0] / "report.html")
    assert [address for address in page.addresses if not address.startswith(("data:", "#"))] == []
    for name in ("plotly-basic.min.js", "three.min.js"):
        library = (ASSETS / name).read_text(encoding="utf-8")
        assert text.count(library) == 1
        text = text.replace(library, "")
    assert set(re.findall(r"https?://[^\"' )]*", text)) == {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert "@import" not in text and "url(" not in text and '<section id="stress">' not in text
    assert "mod<al" in page.texts and "mod<al<" not in text  # names of users are not taken as tags


def test_units_that_were_converted_are_named(tmp_path, monkeypatch):
    """In the record, in Python and on the page."""
    monkeypatch.chdir(tmp_path)
    with (
        package.linkage() as model,
        package.in_si(model, package.units_of("mm,t,s")) as converted,
        converted.with_inputs([(20, "z")]) as loaded,
        package.reduce(loaded, [package.Modes(index=(7, 8, 9))], package.Buckens()) as rom,
    ):
        rom.save("rod.h5")
        assert rom.record.units == converted.converted_from and rom.record.units in rom._repr_html_()
    report_file(["rod.h5"], output="rod.html")
    page, _ = page_of("rod.html")
    assert f"kg, m, s, converted from {rom.record.units}" in " ".join(page.texts)


def test_what_is_drawn_is_what_the_files_say(linkage_report):
    folder, told = linkage_report
    page, _ = page_of(folder / "report.html")
    data = json.loads(page.data)
    full = package.read_model(folder / "model.h5").with_inputs([(20, "z"), (1, "z")])
    for name, drawn in zip(("result", "mod<al"), data["results"], strict=True):
        result = package.read_result(folder / f"{name}.h5")
        reduced, record = result.reduced, result.reduced.record
        f = unpacked(drawn["frequencies"])
        assert drawn["name"] == name and f[0] > 0 and f[-1] == 300 and (np.diff(f) > 0).all()
        H = package.frequency_response(reduced, f)
        exact = unpacked(drawn["full_frequencies"])
        expected = package.frequency_response(full, exact, record.frame, record.damping)
        names = ("20:z", "1:z")
        shown = [pair["name"].split("/") for pair in drawn["pairs"]]
        assert {frozenset(pair) for pair in shown} == {frozenset(("20:z",)), frozenset(("1:z",)), frozenset(names)}
        for pair, (output, given) in zip(drawn["pairs"], shown, strict=True):
            i, j = names.index(output), names.index(given)
            assert np.array_equal(unpacked(pair["re"]) + 1j * unpacked(pair["im"]), H[:, i, j])
            seen = unpacked(pair["full_re"]) + 1j * unpacked(pair["full_im"])
            assert np.abs(seen - expected[:, i, j]).max() < 1e-9 * np.abs(expected).max()
        measure = "directions" if record.accuracy is None else record.accuracy.measure
        eps = package.relative_error(expected, package.frequency_response(reduced, exact), measure)
        assert unpacked(drawn["measured_eps"]) == pytest.approx(eps, rel=1e-3, abs=1e-9)
        each = np.abs(1 - H[np.searchsorted(f, exact[-1])] / expected[-1])  # at the end of the band
        assert "Directions of" in " ".join(page.texts) and np.isfinite(each).all()
        assert np.array_equal(unpacked(drawn["pseudo"]), reduced.frequencies)
        assert f"{reduced.size} coordinates" in page.texts
        modes = unpacked(drawn["modes"])
        assert modes[:6] == pytest.approx(package.read_result(folder / "mod<al.h5").reduced.frequencies[:6], rel=1e-9)
    accuracy = package.read_result(folder / "result.h5").reduced.record.accuracy
    drawn = data["results"][0]
    assert np.array_equal(unpacked(drawn["eps"]), accuracy.eps) and drawn["tolerance"] == 1e-3
    assert [point["estimate"] for point in drawn["points"]] == [point.estimate for point in accuracy.points]
    assert any(accuracy.sentence in text for text in page.texts)
    body = package.read_result(folder / "result.h5").floating_frame
    assert f"{body.mass:.6g}" in page.texts
    assert not drawn["full_as_before"] and data["results"][1]["full_as_before"] and not data["several_full"]


def test_a_stiff_direction_that_the_eps_of_the_paper_hides_is_named_in_red_and_shown_first(folder):
    """Along its axis a rod is a thousand times stiffer than in bending: 1e-2 of all leaves nothing right there."""
    bearings = [package.Interface(name=name, nodes=package.Nodes(set=name)) for name in ("BIG_EYE", "SMALL_EYE")]
    with (
        package.crank(dofs=600) as rod,
        rod.with_interfaces(bearings) as jointed,
        jointed.with_inputs([(name, "all") for name in ("BIG_EYE", "SMALL_EYE")]) as loaded,
    ):
        package.write_model(folder / "model.h5", loaded)
        asked = {"tolerance": 1e-2, "band": (0, 2000), "frame": package.Buckens()}
        for measure in ("paper", "directions"):
            with package.reduce(loaded, measure=measure, **asked) as rom:
                package.write_result(folder / f"{measure}.h5", rom, loaded)
                accuracy = rom.record.accuracy
            for full in (None, folder / "model.h5"):
                report_file([folder / f"{measure}.h5"], full, output=folder / "rod.html", solves=5, modes=1)
                page = page_of(folder / "rod.html")[0]
                text = (folder / "rod.html").read_text()
                first = json.loads(page.data)["results"][0]["pairs"][0]["name"]
                if measure == "paper":
                    (sentence,) = accuracy.warnings
                    assert any(f"paper: {sentence}" in item for item in page.texts) and "claim missed" in text
                    assert accuracy.beyond[0].largest > 0.5
                    assert first in ("BIG_EYE:x/BIG_EYE:x", "SMALL_EYE:x/SMALL_EYE:x")
                else:
                    assert not accuracy.warnings and "claim missed" not in text
                if full is None:
                    worst = accuracy.directions[0]
                    assert first == f"{worst.output}/{worst.input}"


def test_bodies_move_as_the_shapes_say(linkage_report):
    folder, _ = linkage_report
    drawn = json.loads(page_of(folder / "report.html")[0].data)["results"][0]["shape"]
    points, marks = unpacked(drawn["points"]), unpacked(drawn["marks"])
    with package.read_result(folder / "result.h5").shapes() as shapes:
        assert drawn["mark_names"] == ["1", "20"] and drawn["names"] == list(shapes.names[:10])
        at = np.searchsorted(shapes.nodes, [1, 20])
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        assert np.diff(points[marks], axis=0) == pytest.approx(np.diff(shapes.points[at], axis=0), abs=1e-6)
        assert np.abs(middle).max() < 1e-6
        for k, field in enumerate(drawn["fields"]):
            u = shapes.displacement(k)
            assert unpacked(field)[marks] == pytest.approx(u[at] / np.linalg.norm(u, axis=1).max(), abs=1e-6)
            assert np.linalg.norm(unpacked(field), axis=1).max() == pytest.approx(1)
    assert unpacked(drawn["triangles"]).max() < len(points) and len(unpacked(drawn["outline"])) == 19


def test_interface_nodes_are_drawn_where_their_set_moves(folder, comm):
    """Reference nodes, which are no nodes of the mesh; a free body opens with its first elastic shape."""
    with block_with_ends(comm) as model:
        basis = [package.CraigBampton(count=3)]
        with package.reduce(model, basis, package.Buckens(), coordinates="interface") as rom:
            package.write_result(folder / "result.h5", rom, model)
    report_file([folder / "result.h5"], output=folder / "r.html", modes=2)
    page, _ = page_of(folder / "r.html")
    drawn = json.loads(page.data)["results"][0]["shape"]
    assert drawn["mark_names"] == ["left", "right"] and drawn["start"] == 6 and len(drawn["fields"]) == 8
    points, marks = unpacked(drawn["points"]), unpacked(drawn["marks"])
    for field in map(unpacked, drawn["fields"]):
        for mark, x in zip(marks, (points[:, 0].min(), points[:, 0].max()), strict=True):
            face = np.setdiff1d(np.flatnonzero(np.abs(points[:, 0] - x) < 1e-6), marks)
            assert len(face) == 12 and points[mark] == pytest.approx(points[face].mean(axis=0), abs=1e-6)
            assert field[mark] == pytest.approx(field[face].mean(axis=0), abs=1e-5)


def test_inputs_at_nodes_and_at_interfaces(folder, comm):
    inputs = [(1, "z"), ("left", "x"), (12, "y")]
    with (
        block_with_ends(comm) as model,
        model.with_inputs(inputs) as loaded,
        package.reduce(loaded, [package.Modes(count=3)], package.Buckens()) as rom,
    ):
        package.write_result(folder / "result.h5", rom, loaded)
    report_file([folder / "result.h5"], output=folder / "r.html", modes=1)
    page, _ = page_of(folder / "r.html")
    assert "1, 12, left" in page.texts


def test_results_beside_each_other_have_one_damping_and_one_full_response(folder, comm):
    """One to a tolerance, undamped and measured with a loss factor, and one by modes without a band of its own."""
    with package.linkage(comm) as model:
        package.write_model(folder / "model.h5", model)
        keywords = {"tolerance": 1e-3, "band": (0.0, 300.0)}, {"basis": [package.Modes(count=8)]}
        for name, chosen in zip(("automatic", "modes"), keywords, strict=True):
            with package.reduce(model, frame=package.Buckens(), **chosen) as rom:
                package.write_result(folder / f"{name}.h5", rom, model)
    files = [folder / "modes.h5", folder / "automatic.h5"]
    one, two = sheets_of(files, folder / "model.h5", solves=3, comm=comm)
    assert one.measured.loss_factor == two.measured.loss_factor == 0.002 and one.words == two.words
    assert one.band == two.band == (0.0, 300.0)
    assert two.full is one.full and two.full_as_before and not one.full_as_before
    with package.read_model(folder / "model.h5") as model:
        damping = package.Structural(0.002)
        H = package.frequency_response(model, one.full.frequencies, package.Buckens(), damping)
    assert np.allclose(H, one.full.response, rtol=1e-6, atol=1e-9 * np.abs(H).max())
    for sheet in (one, two):
        reduced = replace(sheet.reduced, loss_factor=0.002)
        accuracy = sheet.record.accuracy
        measure = "directions" if accuracy is None else accuracy.measure
        error = package.relative_error(H, package.frequency_response(reduced, one.full.frequencies), measure)
        assert sheet.errors.eps == pytest.approx(error, rel=1e-3, abs=1e-9)
    report_file(files, output=folder / "r.html")
    page, _ = page_of(folder / "r.html")
    words = "all curves: responses and errors are measured with the loss factor 0.002 (undamped)"
    assert any(text.startswith(words) for text in page.texts)


def test_tables_and_figures(linkage_report):
    folder, told = linkage_report
    assert all(Path(name).stat().st_size > 100 for name in told["files"])
    assert sorted(path.name for path in (folder / "figures").iterdir()) == [
        "error.svg", "response_1z-1z.svg", "response_20z-1z.svg", "response_20z-20z.svg", "shapes_mod_al.svg",
        "shapes_result.svg",
    ]  # fmt: skip
    with open(folder / "tables/error_measured_result.csv", encoding="utf-8") as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    drawn = json.loads(page_of(folder / "report.html")[0].data)["results"][0]
    assert [row["eps"] for row in rows] == unpacked(drawn["measured_eps"]).tolist()


def test_errors_of_one_result_have_one_colour(linkage_report):
    drawn = (linkage_report[0] / "figures/error.svg").read_text()
    used = {colour for colour in COLOURS if colour in drawn}
    assert used == set(COLOURS[:2])  # two results; the tolerance is no third one


def test_a_flat_body_has_the_inertia_that_is_known(folder):
    """Masses that differ in x, y and z leave some entries open; 2 kg at a distance of 0.5 m do not."""
    nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    dofs = package.Dofs(
        node=np.array([1, 1, 2, 2]), direction=np.array([0, 1, 0, 1]), position=np.repeat(nodes, 2, axis=0)
    )
    K = np.array([[3.0, 0, -1, 0], [0, 2, 0, -1], [-1, 0, 3, 0], [0, -1, 0, 2]])
    with package.SecondOrderModel.from_scipy(
        scipy.sparse.csr_matrix(K), scipy.sparse.identity(4), dofs=dofs
    ) as model:
        package.write_model(folder / "flat.h5", model)
    (folder / "job.toml").write_text('model = "flat.h5"\ninputs = [[2, "y"]]\n[[basis]]\nkind = "modes"\ncount = 2')
    assert run(["reduce", str(folder / "job.toml")]) == 0
    report_file([folder / "result.h5"], output=folder / "report.html", band=(0.0, 1.0))
    said = "xx not known, yy not known, zz 0.5, xy not known, xz 0, yz 0"
    assert said in page_of(folder / "report.html")[0].texts


def test_a_job_may_ask_for_a_report(linkage_report):
    folder, _ = linkage_report
    page, _ = page_of(folder / "result.html")
    (drawn,) = json.loads(page.data)["results"]
    assert drawn["name"] == "result" and "modes" not in drawn


def test_a_model_without_nodes_has_a_report(folder):
    with package.solid((3, 2, 2), inputs=1) as labelled, labelled.with_fields(dofs=None) as model:
        package.write_model(folder / "plain.h5", model)
    (folder / "job.toml").write_text(
        'model = "plain.h5"\ninputs = [1]\nband = [0.0, 500.0]\n[[basis]]\nkind = "static_correction"'
    )
    assert run(["reduce", str(folder / "job.toml")]) == 0
    report_file([folder / "result.h5"], output=folder / "report.html")
    page, _ = page_of(folder / "report.html")
    assert json.loads(page.data)["results"][0]["shape"] is None
    assert any("no basis with node coordinates" in text for text in page.texts)


@pytest.mark.mpi
def test_on_any_number_of_ranks(reduced_linkage, comm):
    result = reduced_linkage()
    report_file([result], result.with_name("model.h5"), output=result.with_name("a.html"), solves=3, band=(0.0, 100.0))
    data = json.loads(page_of(result.with_name("a.html"))[0].data)
    assert max(unpacked(data["results"][0]["measured_eps"])) < 1.0 and data["band"] == [0.0, 100.0]


@pytest.mark.parametrize("words", [
    "report result.h5", *(pytest.param(words, marks=pytest.mark.slow)
                          for words in ("info result.h5", "export result.h5 --format npz"))])  # fmt: skip
def test_where_nothing_is_solved_ranks_do_not_wait_for_each_other(hpcred, tmp_path, words):
    """PETSc starts when it is first needed, on all ranks together."""
    reduce_linkage(tmp_path, MODES_JOB)
    found = hpcred(*words.split(), ranks=2, timeout=120)
    assert found.returncode == 0, found.stderr


def test_reports_are_refused(linkage_folder, capsys):
    assert run(["reduce", "job.toml"]) == 0
    for words, says in (
        (("nowhere.h5",), "nowhere.h5: no such file"),
        (("model.h5",), "found an HDF5 file of format 'hpcred-model', expected 'hpcred-result'"),
        (("result.h5", "--pairs", "20:x/20:z"), "expected output/input of result, such as 20:z/20:z"),
        (("result.h5", "--full", "model.h5", "--solves", "1"), "solves: found 1, expected at least 2"),
        (("result.h5", "-o", "./result.h5"), "found a name that ends in .h5, expected .html"),
        (("result.h5", "-o", "nowhere/r.html"), "the folder nowhere does not exist"),
    ):
        assert says in refused(capsys, "report", *words)
