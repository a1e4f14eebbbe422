"""Reports in headless Chromium: no errors, all plots drawn, and the slider of the shapes moves the picture."""

import os
import re
import shutil
import subprocess
import tempfile
import time

import numpy as np
import pytest
from bodies import block
from helpers import block_with_ends, reduce_linkage
from mpi4py import MPI
from PIL import Image

import hpcred as package
from hpcred.report.page import body_for_page
from hpcred.workflows import report

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = [pytest.mark.chromium, pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")]
OPTIONS = [
    "--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1280,3600", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--enable-logging=stderr", "--v=0",
    "--virtual-time-budget=20000",
]  # fmt: skip


def browse(page, *options):
    """Open a page, and return its text when it is drawn; what it wrote to its console must not be an error."""
    with tempfile.TemporaryDirectory() as profile:
        found = subprocess.run(
            [CHROMIUM, *OPTIONS, f"--user-data-dir={profile}", *options, f"file://{page}"], capture_output=True,
            timeout=300, env={**os.environ, "HOME": profile},
        )  # fmt: skip
    said = [line for line in found.stderr.decode(errors="replace").splitlines() if "CONSOLE" in line]
    assert not said
    return found.stdout.decode(errors="replace")


def screenshot(page, name):
    browse(page, f"--screenshot={page.with_name(name)}")
    return np.asarray(Image.open(page.with_name(name)).convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def linkage_page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    reduce_linkage(folder)
    package.report_file([folder / "result.h5"], folder / "model.h5", output=folder / "report.html", solves=5)
    return folder / "report.html"


def test_plots_are_drawn(linkage_page):
    text = browse(linkage_page, "--dump-dom")
    assert re.search(r'data-ready="\d+"', text) and 'data-bodies="1"' in text
    for name in ("response", "error", "spectrum", "stages"):
        part = text[text.index(f'id="{name}"') :][:20_000]
        assert 'class="main-svg"' in part
    assert text.count('class="scatterlayer') >= 3 and text.count('class="point"') > 10
    assert "pseudo-mode 1: 33.3047 Hz</output>" in text
    legend = re.findall(r'class="legendundefined"[^>]*fill: (rgb[^;]*);', text[text.index('id="stages"') :])
    assert len(legend) > 5 and len(set(legend)) == len(legend)  # a colour for each stage


def test_the_slider_moves_the_picture(linkage_page):
    """The same page with a script that does what a hand would do."""
    before = screenshot(linkage_page, "before.png")
    text = linkage_page.read_text(encoding="utf-8")
    hand = "<script>const s=document.querySelector('.mode');s.value=4;s.dispatchEvent(new Event('input'));</script>"
    moved = linkage_page.with_name("moved.html")
    moved.write_text(text.replace("</body>", f"{hand}</body>"), encoding="utf-8")
    after = screenshot(moved, "after.png")
    again = screenshot(linkage_page, "again.png")
    changed = np.flatnonzero((np.abs(after - before).max(axis=2) > 60).any(axis=1))
    coloured = (np.ptp(before, axis=2) > 60).sum()
    assert coloured > 5000 and (np.abs(again - before).max(axis=2) > 60).sum() < 200
    assert (np.abs(after - before).max(axis=2) > 60).sum() > 2000 and np.ptp(changed) < 600  # the view and its title
    by_address = screenshot(linkage_page.parent / "report.html#mode=4", "by_address.png")
    assert (np.abs(by_address - after).max(axis=2) > 60).sum() < 200


@pytest.fixture(scope="module")
def moving_page(tmp_path_factory):
    """A report of a rod with stress modes and a motion, whose stress is largest at 0.2 s."""
    folder = tmp_path_factory.mktemp("moving")
    inputs = [(1, "x"), (7, "z")]
    with (
        package.crank(600) as rod,
        rod.with_inputs(inputs) as model,
        package.reduce(model, [package.Modes(index=(7, 8, 9))], package.Buckens()) as rom,
    ):
        rom.save(folder / "rod.h5", stress=package.stress_modes(model, rom.columns))
    rows = [[0.0, 0, 0, 0], [0.1, 1e-4, 0, 0], [0.2, 2e-3, 1e-3, 0], [0.3, 0, 1e-4, 1e-4]]
    text = "t,q1,q2,q3\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    (folder / "motion.csv").write_text(text)
    package.report_file([folder / "rod.h5"], motion=folder / "motion.csv", output=folder / "report.html")
    return folder / "report.html"


def test_stress_is_coloured_and_its_motion_steps(moving_page):
    text = moving_page.read_text(encoding="utf-8")
    hand = """<script>const c = document.getElementById("colour"), t = document.querySelector(".moving .mode");
    c.value = "stress"; c.dispatchEvent(new Event("change"));
    t.value = 2; t.dispatchEvent(new Event("input"));</script>"""
    moved = moving_page.with_name("moved.html")
    moved.write_text(text.replace("</body>", f"{hand}</body>"), encoding="utf-8")
    before, after = browse(moving_page, "--dump-dom"), browse(moved, "--dump-dom")
    assert 'data-bodies="2"' in before and "0.2 s</output>" in before and "0.1 s</output>" in after
    pictures = screenshot(moving_page, "before.png"), screenshot(moved, "after.png")
    rows = np.flatnonzero((np.abs(pictures[0] - pictures[1]).max(axis=2) > 60).any(axis=1))
    assert np.ptp(rows) > 600  # both bodies have other colours


def test_the_page_is_dark_where_the_browser_is(moving_page):
    browse(moving_page, "--blink-settings=preferredColorScheme=0", f"--screenshot={moving_page.with_name('dark.png')}")
    dark = np.asarray(Image.open(moving_page.with_name("dark.png")).convert("L")).astype(int)
    light = screenshot(moving_page, "light.png").mean(axis=2)
    assert np.median(dark) < 60 and np.median(light) > 220 and (dark > 150).mean() > 0.005  # with light words


def test_interfaces_inside_a_body_are_seen_and_named(tmp_path):
    """A free body in interface coordinates opens with its first elastic shape; marks lie over what hides them."""
    with block_with_ends(MPI.COMM_SELF) as model:
        basis = [package.CraigBampton(count=3)]
        with package.reduce(model, basis, package.Buckens(), coordinates="interface") as rom:
            package.write_result(tmp_path / "result.h5", rom, model)
    package.report_file([tmp_path / "result.h5"], output=tmp_path / "report.html")
    text = browse(tmp_path / "report.html", "--dump-dom")
    assert re.search(r'<span class="tag"[^>]*>left</span>.*<span class="tag"[^>]*>right</span>', text, re.S)
    assert re.search(r"pseudo-mode 07: [0-9.]+ Hz</output>", text)
    picture = screenshot(tmp_path / "report.html", "page.png")[:1450]  # above the plots
    orange = np.abs(picture - [213, 94, 0]).max(axis=2) < 12
    rows, columns = np.nonzero(orange)
    assert 60 < orange.sum() < 400 and np.ptp(rows) < 200 < np.ptp(columns) < 600  # two discs


def test_large_surfaces_open(linkage_page, monkeypatch):
    """50,000 nodes and 10 shapes: below 30 MB, and drawn. The time is printed, not asserted."""

    class Plate:
        points, cells = block(158, 157, 1, (1.0, 1.0, 0.02))
        nodes, mark_names, mark_points = np.arange(len(points)), ["corner"], np.zeros((1, 3))
        names, frequencies, has_stress = [f"shape {k + 1}" for k in range(10)], np.arange(1.0, 11.0), False

        def displacement(self, k):
            x, y, _ = self.points.T
            return np.stack([0 * x, 0 * x, np.sin((k + 1) * 3 * x) * np.cos(k * y)], axis=1)

        def mark_displacement(self, k):
            return np.zeros((1, 3))

    Plate.cells = {"hexahedron": Plate.cells}

    def take(sheet, modes, most):
        sheet.body, sheet.body_sentence = body_for_page(Plate(), modes, most)

    monkeypatch.setattr(report, "_take_body", take)
    page = linkage_page.with_name("large.html")
    told = package.report_file([linkage_page.with_name("result.h5")], output=page)
    assert told["megabytes"] < 30
    start = time.perf_counter()
    text = browse(page, "--dump-dom")
    ready = int(re.search(r'data-ready="(\d+)"', text)[1])
    print(f"{told['megabytes']:.1f} MB, ready after {ready} ms, {time.perf_counter() - start:.1f} s of the browser")
    assert "50244 nodes on the surface" in text and "thinned" not in text.partition("<script")[0]


def test_names_are_text_in_plots(linkage_page):
    """Of links and letters in bold, which Plotly would make of them, nothing is there, nor of entities."""
    name = '<a href="https:x">a<b>b&lt;'.replace("/", "")
    shutil.copy(linkage_page.with_name("result.h5"), linkage_page.with_name(f"{name}.h5"))
    package.report_file([linkage_page.with_name(f"{name}.h5")], output=linkage_page.with_name("names.html"))
    text = browse(linkage_page.with_name("names.html"), "--dump-dom")
    stages = text[text.index('id="stages"') :]
    assert name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;") in stages
    assert "https:x</a>" not in text and 'font-weight: bold' not in stages and "<a " not in stages
