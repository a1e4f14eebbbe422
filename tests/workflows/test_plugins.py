"""Readers and writers of other packages, by entry points, on the command line; broken ones are named."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tomllib
from docs_pages import DOCS

import hpcred as package
from hpcred.cli.main import run
from hpcred.parallel.plugins import Registry
from hpcred.readers.registry import READERS
from hpcred.writers.registry import WRITERS

EXAMPLE = Path(__file__).parents[1] / "plugins" / "hpcred-example"
JOB = """model = "model.h5"
output = "result.h5"
inputs = [[3, "x"]]
[[basis]]
kind = "modes"
count = 2
"""
BROKEN = "import a_module_that_nobody_has\n"
WRONG = """import hpcred
from pathlib import Path

class Raises(hpcred.readers.Reader):
    def begins(self, start):
        return bool(1 / 0)
    def read_model(self, path, comm):
        pass

class Empty(hpcred.readers.Reader):
    def begins(self, start):
        return False

class Nothing(hpcred.readers.Reader):
    told_by = "%nothing"
    def begins(self, start):
        return start.startswith(b"%nothing")
    def read_model(self, path, comm):
        return {}

class Fails(hpcred.writers.Writer):
    suffix, needs = ".fails", "reduced"
    def write(self, target, source):
        raise KeyError("what")

class Npz(Fails):
    suffix = ".npz"
"""


def installed(folder, name, modules, points):
    """The metadata of a package and its modules, as an installer leaves them, in a folder of PYTHONPATH."""
    metadata = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    groups = [f"[{group}]\n" + "".join(f"{key} = {place}\n" for key, place in table.items())
              for group, table in points.items()]  # fmt: skip
    (metadata / "entry_points.txt").write_text("\n".join(groups))
    for module, text in modules.items():
        (folder / f"{module}.py").write_text(text)
    return folder


@pytest.fixture
def example(tmp_path):
    """The folder of the example package, to be put on PYTHONPATH."""
    with open(EXAMPLE / "pyproject.toml", "rb") as file:
        points = tomllib.load(file)["project"]["entry-points"]
    return installed(tmp_path / "site", "hpcred-example", {
        "hpcred_example": (EXAMPLE / "hpcred_example.py").read_text()}, points)  # fmt: skip


@pytest.fixture
def broken(tmp_path):
    """As example, of packages of which nothing works."""
    folder = installed(tmp_path / "broken", "hpcred-broken", {"hpcred_broken": BROKEN}, {
        "hpcred.readers": {"a": "hpcred_broken:A"}, "hpcred.writers": {"unloadable": "hpcred_broken:B"}})  # fmt: skip
    return installed(folder, "hpcred-wrong", {"hpcred_wrong": WRONG}, {
        "hpcred.readers": {"b": "hpcred_wrong:Raises", "c": "hpcred_wrong:Empty", "d": "hpcred_wrong:Path",
                           "nothing": "hpcred_wrong:Nothing"},
        "hpcred.writers": {"fails": "hpcred_wrong:Fails", "npz": "hpcred_wrong:Npz"}})  # fmt: skip


@contextmanager
def of_packages_in(folder, monkeypatch):
    """Let this process find the packages in a folder, as a new one does that has it on PYTHONPATH."""
    # what this process finds is kept, and looked for before the folder is there
    assert not any(item.name == "flexible" for registry in (READERS, WRITERS) for item in registry.others)
    with monkeypatch.context() as changed:
        changed.syspath_prepend(folder)
        for registry in (READERS, WRITERS):
            changed.setattr(registry, "others", Registry.others.func(registry))
            changed.setattr(registry, "_loaded", {})
        yield


def springs(path, count=4):
    """A chain of masses on springs along x, held at its left end, in the format of the example package."""
    K = 2e4 * np.eye(count) - 1e4 * (np.eye(count, k=1) + np.eye(count, k=-1))
    lines = ["%springs", *(f"node {k + 1} {0.1 * k} 0 0" for k in range(count))]
    for key, matrix in (("K", K), ("M", 0.5 * np.eye(count))):
        lines += [f"{key} {i + 1} 1 {j + 1} 1 {matrix[i, j]}" for i, j in zip(*matrix.nonzero(), strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return K, 0.5 * np.eye(count)


@pytest.mark.parametrize("ranks", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_package_brings_a_reader_and_a_writer(hpcred, tmp_path, example, ranks, monkeypatch, capsys):
    K, M = springs(tmp_path / "chain.txt")
    (tmp_path / "job.toml").write_text(JOB)

    def call(*words, status=0):
        done = hpcred(*words, ranks=ranks, PYTHONPATH=str(example))
        assert done.returncode == status, done.stdout + done.stderr
        return " ".join((done.stdout + done.stderr).split())

    def here(*words, status=0):
        """The same without a process, on one rank."""
        capsys.readouterr()
        with of_packages_in(example, monkeypatch):
            monkeypatch.chdir(tmp_path)
            assert run([*words]) == status
        told = capsys.readouterr()
        return " ".join((told.out + told.err).split())

    once = call if ranks > 1 else here
    table = here("convert", "--list-formats")
    assert "springs (of" in table and "hpcred-example)" in table and "%springs" in table
    assert "size 4" in once("convert", "chain.txt", "model.h5")
    with package.read_model(tmp_path / "model.h5") as model:
        assert model.dofs.node.tolist() == [1, 2, 3, 4] and np.allclose(model.dofs.position[:, 0], [0.0, 0.1, 0.2, 0.3])
    assert "K chain.txt: 4 x 4, 10 entries" in here("info", "chain.txt")
    here("reduce", "job.toml")
    reduced = package.read_result(tmp_path / "result.h5").reduced
    expected = np.sqrt(np.linalg.eigvalsh(K / M[0, 0])[:2]) / (2 * np.pi)
    assert np.allclose(reduced.frequencies, expected, rtol=1e-10)
    assert "flexible (hpcred-example)" in once("export", "--help")
    said = call("export", "result.h5", "--format", "flexible", "--nodes", "3")
    assert "result.flex: 2 coordinates, nodes 3" in said and "note: inputs, outputs and damping are left out" in said
    assert "with result_nodes.flex" in said
    assert np.array_equal(np.loadtxt(tmp_path / "result.flex", comments="%")[:2], reduced.K)
    assert "about result, mass 2 in m, kg, s" in here("info", "result.flex")
    again = here("export", "result.h5", "-o", "result.flex", "--nodes", "3,1", "--units", "mm,t,s")
    assert "result.flex existed and was replaced" in again and "result_nodes.flex exists and will be replaced" in again
    assert "mass 0.002 in" in (tmp_path / "result.flex").read_text()
    assert (tmp_path / "result_nodes.flex").read_text().splitlines()[1:] == ["3 200.0 0.0 0.0", "1 0.0 0.0 0.0"]
    refusals = (
        (("--format", "flexible", "-o", "chain.txt"), "chain.txt: found a file of another kind there, which is not"),
        (("--format", "sid", "-o", "result.flex"), "result.flex: found a file of another kind there, which is not"),
        (("--format", "flexible", "-o", "model.h5"), "found an HDF5 file of format 'hpcred-model' there, which is not"),
        (("--format", "flexible", "--modes", "1"), "'flexible' shows all shapes or none"),
        (("--format", "flexibel"), "(did you mean 'flexible'?)"),
    )  # fmt: skip
    for words, says in refusals:
        assert says in here("export", "result.h5", *words, status=2)
    (tmp_path / "chain.txt").write_text("%springs\nspring 1 2\n")
    assert "chain.txt: line 2: found 'spring', expected node, K or M" in here("convert", "chain.txt", "m.h5", status=2)
    assert sorted(path.name for path in tmp_path.glob("*.*")) == [
        "chain.txt", "job.toml", "model.h5", "result.flex", "result.h5", "result_nodes.flex"]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 3])
def test_a_broken_package_is_named_and_everything_else_works(hpcred, tmp_path, example, broken, ranks):
    springs(tmp_path / "chain.txt")
    (tmp_path / "job.toml").write_text(JOB)
    (tmp_path / "stranger.txt").write_text("hello\n")
    (tmp_path / "nothing.txt").write_text("%nothing\n")

    def call(*words, status=0):
        done = hpcred(*words, ranks=ranks, PYTHONPATH=f"{broken}:{example}")
        assert done.returncode == status, done.stdout + done.stderr
        return " ".join((done.stdout + done.stderr).split())

    sentences = (
        "the package hpcred-broken has a reader 'a' that cannot be used (ModuleNotFoundError: No module named "
        "'a_module_that_nobody_has'); update or remove the package",
        "'b' of the package hpcred-wrong failed (ZeroDivisionError: division by zero); tell its authors",
        "has a reader 'c' that cannot be used (TypeError: Empty has neither read_matrix nor read_model)",
        "has a reader 'd' that cannot be used (TypeError: found <class 'pathlib.Path'>, expected a class derived from",
    )
    for text in (call("convert", "chain.txt", "model.h5"), call("convert", "stranger.txt", "m.h5", status=2)):
        assert all(text.count(sentence) == 1 for sentence in sentences)
    table = call("convert", "--list-formats")
    assert "warning: the package hpcred-broken has a reader 'a' that cannot be used" in table and "springs" in table
    assert "'nothing' of the package hpcred-wrong gave dict, expected hpcred.readers.Parts" in call(
        "convert", "nothing.txt", "m.h5", status=2)  # fmt: skip
    assert "hpcred-" not in call("reduce", "job.toml")
    assert "result.npz: 2 coordinates" in call("export", "result.h5", "--format", "npz")  # ours, not hpcred-wrong's
    assert "writer 'unloadable' that cannot be used (ModuleNotFoundError" in call(
        "export", "result.h5", "--format", "unloadable", status=2)  # fmt: skip
    assert "'fails' of the package hpcred-wrong failed (KeyError: 'what')" in call(
        "export", "result.h5", "-o", "x.fails", status=1)  # fmt: skip
    call("export", "result.h5", "--format", "flexible")
    assert not (tmp_path / "x.fails").exists() and (tmp_path / "result.flex").exists()


def test_nothing_of_others_is_looked_at_where_our_own_will_do(hpcred, tmp_path, broken):
    """Nor is any reader loaded by a job that names a model file."""
    with package.solid((2, 1, 1), inputs=1) as model:
        package.write_model(tmp_path / "model.h5", model)
    (tmp_path / "job.toml").write_text(JOB.replace('[[3, "x"]]', "[1]"))
    (tmp_path / "run.py").write_text(
        "import sys, importlib.metadata\n"
        "found = importlib.metadata.entry_points\n"
        "def never(group, **more):\n"
        "    assert not group.startswith('hpcred')\n"
        "    return found(group=group, **more)\n"
        "importlib.metadata.entry_points = never\n"
        "from hpcred.cli.main import run\n"
        "assert run(['reduce', 'job.toml']) == 0\n"
        "rooms = ('hpcred.readers.registry', 'hpcred.readers.matrix_formats', 'hpcred.writers.base')\n"
        "assert not [name for name in rooms if name in sys.modules]\n"
        "assert run(['info', 'model.h5']) == 0\n"
        "assert run(['export', 'result.h5', '--format', 'statespace-npz']) == 0\n"
        "assert 'hpcred.writers.base' in sys.modules\n"
    )
    done = hpcred(program=["run.py"], PYTHONPATH=str(broken))
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_documentation_quotes_the_example():
    text = (EXAMPLE / "hpcred_example.py").read_text()
    for page, part in (("formats.md", "reader"), ("exports.md", "writer")):
        assert f'hpcred_example.py:{part}"\n```' in (DOCS / page).read_text()
        assert f"[start:{part}]" in text and f"[end:{part}]" in text
