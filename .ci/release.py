"""Make a release: python .ci/release.py VERSION, in a clean checkout; the package `build` must be installed.

Sets the version in the files of CHANGES, builds the sdist and the wheel into dist/, and only
then commits and tags. A version that these files have already, and no tag, is built and tagged. Uploads nothing.
"""

import datetime
import re
import subprocess
import sys
from pathlib import Path

VERSION = re.compile(r"\d+\.\d+\.\d+")
UNRELEASED = "## Unreleased\n"
UNRELEASED_LINES = re.compile(rf"^{UNRELEASED}(.*?)(?=^## |\Z)", re.M | re.S)


class Refused(Exception):
    """The release cannot be made; nothing was changed."""


def release(root: Path, version: str, today: datetime.date, build) -> None:
    """Release the checkout `root` as `version`; `build()` makes the files in dist/. Raises Refused."""
    old = _version_of((root / "pyproject.toml").read_text())
    if not VERSION.fullmatch(version) or _numbers(version) < _numbers(old):
        raise Refused(f"VERSION: found '{version}', expected x.y.z, {old} or above")
    if changed := _git(root, "status", "--porcelain"):
        raise Refused(f"the checkout has changes; commit them or put them aside:\n{changed}")
    if _git(root, "tag", "--list", f"v{version}"):
        raise Refused(f"there is a tag v{version} already")
    texts = {}
    if version != old:
        texts = {name: change((root / name).read_text(), version, today) for name, change in CHANGES.items()}
    elif f"\n## {version} - " not in (changelog := (root / "CHANGELOG.md").read_text()):
        raise Refused(f"CHANGELOG.md: found no section '## {version} - ', though pyproject.toml has this version")
    elif (later := UNRELEASED_LINES.search(changelog)) and later[1].strip():
        raise Refused(
            f"CHANGELOG.md: found lines below '## Unreleased', which would be in v{version}; move them below it"
        )
    for name, text in texts.items():
        (root / name).write_text(text)
    try:
        build()
    except BaseException:
        if texts:
            _git(root, "checkout", "--", *texts)
        raise
    if texts:
        _git(root, "commit", "--quiet", "-m", f"Version {version}", "--", *texts)
    _git(root, "tag", "-a", f"v{version}", "-m", f"Version {version}")


def _version_of(project):
    return re.search(r'^version = "(.+)"$', project, re.M)[1]


def _numbers(version):
    return tuple(map(int, version.split(".")))


def _of_project(text, version, today):
    return re.sub(r'^version = ".+"$', f'version = "{version}"', text, count=1, flags=re.M)


def _of_citation(text, version, today):
    text = re.sub(r"^date-released: .*\n", "", text, flags=re.M)
    return re.sub(r"^version: .*$", f"version: {version}\ndate-released: {today}", text, count=1, flags=re.M)


def _of_changelog(text, version, today):
    """What is unreleased becomes the version, below a new empty part for what comes."""
    found = UNRELEASED_LINES.search(text)
    if found is None or not found[1].strip():
        raise Refused("CHANGELOG.md: found nothing below '## Unreleased', expected what the release changes")
    return f"{text[: found.start()]}{UNRELEASED}\n## {version} - {today}\n{text[found.start(1) :]}"


def _of_recipe(text, version, today):
    return re.sub(r'^  version: ".+"$', f'  version: "{version}"', text, count=1, flags=re.M)


def _of_page(text, version, today):
    text = re.sub(r"^(  version = ){.+}(,?)$", rf"\1{{{version}}}\2", text, count=1, flags=re.M)
    return re.sub(r"^(  year    = ){.+}(,?)$", rf"\1{{{today.year}}}\2", text, count=1, flags=re.M)


CHANGES = {
    "pyproject.toml": _of_project, "CITATION.cff": _of_citation, "CHANGELOG.md": _of_changelog,
    "packaging/conda/recipe.yaml": _of_recipe, "docs/cite.md": _of_page,
}  # fmt: skip


def _git(root, *words):
    return subprocess.run(["git", "-C", str(root), *words], check=True, capture_output=True, text=True).stdout


def main(version):
    root = Path(__file__).parents[1]
    build = [sys.executable, "-m", "build", "--outdir", str(root / "dist"), str(root)]
    try:
        release(root, version, datetime.date.today(), lambda: subprocess.run(build, check=True))
    except Refused as refusal:
        sys.exit(f"release: {refusal}")
    print(f"dist/ has version {version}; the commit and the tag v{version} are here only: git push --follow-tags")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
