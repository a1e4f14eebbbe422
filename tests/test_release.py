"""`make release` in a repository of its own."""

import datetime
import shutil
import subprocess

import pytest
from docs_pages import ROOT, load

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
program = load(ROOT / ".ci" / "release.py")
TODAY = datetime.date(2027, 1, 31)
FILES = {
    "pyproject.toml": '[project]\nname = "a"\nversion = "0.9.1"\n[tool.x]\nversion = "7"\n',
    "CITATION.cff": "cff-version: 1.2.0\nversion: 0.9.1\ndate-released: 2026-01-01\ntitle: a\n",
    "packaging/conda/recipe.yaml": 'context:\n  version: "0.9.1"\n',
    "docs/cite.md": "  version = {0.9.1},\n  year    = {2026}\n}\n  year    = {2006}\n",
    "CHANGELOG.md": "# Changelog\n\n## Unreleased\n### Added\n- New.\n\n## 0.9.1 - 2026-01-01\n- Old.\n",
}


def git(folder, *words):
    return subprocess.run(["git", "-C", folder, *words], check=True, capture_output=True, text=True).stdout


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    for who in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{who}_NAME", "a")
        monkeypatch.setenv(f"GIT_{who}_EMAIL", "a@example.org")
    (tmp_path / "packaging/conda").mkdir(parents=True)
    (tmp_path / "docs").mkdir()
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-q", "-m", "a")
    return tmp_path


def test_a_release(checkout):
    seen = []
    program.release(checkout, "0.10.0", TODAY, lambda: seen.append((checkout / "pyproject.toml").read_text()))
    assert seen == ['[project]\nname = "a"\nversion = "0.10.0"\n[tool.x]\nversion = "7"\n']
    assert (checkout / "CITATION.cff").read_text() == (
        "cff-version: 1.2.0\nversion: 0.10.0\ndate-released: 2027-01-31\ntitle: a\n"
    )
    assert (checkout / "CHANGELOG.md").read_text() == (
        "# Changelog\n\n## Unreleased\n\n## 0.10.0 - 2027-01-31\n### Added\n- New.\n\n## 0.9.1 - 2026-01-01\n- Old.\n"
    )
    cited = (checkout / "docs/cite.md").read_text()
    assert cited == "  version = {0.10.0},\n  year    = {2027}\n}\n  year    = {2006}\n"
    assert (checkout / "packaging/conda/recipe.yaml").read_text() == 'context:\n  version: "0.10.0"\n'
    assert git(checkout, "tag", "--points-at", "HEAD") == "v0.10.0\n" and git(checkout, "status", "--porcelain") == ""
    with pytest.raises(program.Refused, match="nothing below '## Unreleased'"):
        program.release(checkout, "0.11.0", TODAY, lambda: None)


@pytest.mark.parametrize("version", ["", "0.9.0", "0.8.12", "1.0", "1.0.0rc1", "v1.0.0"])
def test_versions_that_are_refused(checkout, version):
    with pytest.raises(program.Refused, match="expected x.y.z, 0.9.1 or above"):
        program.release(checkout, version, TODAY, lambda: None)


def test_a_version_that_the_files_have_is_built_and_tagged_once(checkout):
    with pytest.raises(program.Refused, match="lines below '## Unreleased', which would be in v0.9.1"):
        program.release(checkout, "0.9.1", TODAY, lambda: None)
    (checkout / "CHANGELOG.md").write_text(FILES["CHANGELOG.md"].replace("### Added\n- New.\n", ""))
    git(checkout, "commit", "-q", "-am", "a")
    program.release(checkout, "0.9.1", TODAY, lambda: None)
    assert git(checkout, "tag", "--points-at", "HEAD") == "v0.9.1\n"
    assert git(checkout, "log", "--format=%s") == "a\na\n" and git(checkout, "status", "--porcelain") == ""
    with pytest.raises(program.Refused, match="tag v0.9.1 already"):
        program.release(checkout, "0.9.1", TODAY, lambda: None)


def test_a_version_without_a_section_is_refused(checkout):
    text = FILES["CHANGELOG.md"].replace("## 0.9.1", "## 0.9.0")
    (checkout / "CHANGELOG.md").write_text(text)
    git(checkout, "commit", "-q", "-am", "b")
    with pytest.raises(program.Refused, match="no section '## 0.9.1"):
        program.release(checkout, "0.9.1", TODAY, lambda: None)


def test_a_release_needs_a_clean_checkout_and_a_build(checkout):
    (checkout / "new").write_text("")
    with pytest.raises(program.Refused, match="has changes.*\n.*new"):
        program.release(checkout, "1.0.0", TODAY, lambda: None)
    (checkout / "new").unlink()
    with pytest.raises(ZeroDivisionError):
        program.release(checkout, "1.0.0", TODAY, lambda: 1 / 0)
    assert git(checkout, "status", "--porcelain") == "" and git(checkout, "log", "--format=%s") == "a\n"
    git(checkout, "tag", "v1.0.0")
    with pytest.raises(program.Refused, match="tag v1.0.0 already"):
        program.release(checkout, "1.0.0", TODAY, lambda: None)
    assert {name: (checkout / name).read_text() for name in FILES} == FILES
