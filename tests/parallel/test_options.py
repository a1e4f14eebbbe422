"""PETSc options come from the command line, PETSC_OPTIONS and the home folder, and not from the working folder."""

import shutil
import subprocess
import sys

import pytest
from launch import TWO_BUILDS, mpi_environment

LIBRARY = "#include <stdio.h>\n__attribute__((constructor)) static void run(void) { fclose(fopen(\"ran\", \"w\")); }\n"
PROGRAM = """
import sys, hpcred
hpcred.start(*sys.argv[1:2], petsc_args=sys.argv[2:])
from petsc4py import PETSc
found = PETSc.Options().getAll()
if PETSc.COMM_WORLD.rank == PETSc.COMM_WORLD.size - 1:
    print(*(found.get(name) for name in ("work", "home", "variable", "line")), "of PETSc")
"""
RUNS = [("real" * TWO_BUILDS, 1), ("complex" * TWO_BUILDS, 2),
        *(pytest.param("complex" * TWO_BUILDS, 1, marks=pytest.mark.slow),
          pytest.param("real" * TWO_BUILDS, 2, marks=pytest.mark.slow))]  # fmt: skip


@pytest.fixture
def place(tmp_path):
    """A working folder whose options load a library that leaves the file `ran` there, and a home folder."""
    work, home = tmp_path / "work", tmp_path / "home"
    work.mkdir()
    home.mkdir()
    (home / ".petscrc").write_text("-home home\n-variable home\n-line home\n")
    text = "-work work\n-home work\n"
    if shutil.which("cc"):
        (tmp_path / "library.c").write_text(LIBRARY)
        subprocess.run(["cc", "-shared", "-fPIC", "-o", work / "library.so", tmp_path / "library.c"], check=True)
        text += f"-dll_prepend {work / 'library.so'}\n"
    for name in ("petscrc", ".petscrc"):
        (work / name).write_text(text)
    return work


def run(place, *program, ranks=1, **environment):
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    given = {"HOME": str(place.with_name("home")), "PETSC_OPTIONS": "-variable variable -line variable"} | environment
    return subprocess.run([*launcher, sys.executable, *program], cwd=place, capture_output=True, text=True,
                          env=mpi_environment(**given))  # fmt: skip


def told(found):
    """What the program printed; PETSc may say at its end that nothing used them."""
    return found.stdout.partition("of PETSc")[0].split()


@pytest.mark.parametrize("build, ranks", RUNS)
def test_each_place_is_above_the_one_before_it(place, build, ranks):
    found = run(place, "-c", PROGRAM, build, "-line", "line", ranks=ranks)
    assert told(found) == ["None", "home", "variable", "line"], found.stderr
    assert not (place / "ran").exists()


@pytest.mark.parametrize("build, ranks", RUNS)
def test_a_command_leaves_the_working_folder_alone(place, build, ranks):
    """And says nothing of options that it did not get."""
    scalar = ["--scalar", build] if build else []
    made = run(place, "-m", "hpcred", "example", "linkage", "-o", "model.h5", *scalar, ranks=ranks)
    assert (made.returncode, made.stdout.count("PETSc option")) == (0, 1), made.stderr  # those of home and environment
    assert "work" not in made.stdout and "skip" not in made.stdout
    assert not (place / "ran").exists()


def test_a_file_that_is_named_is_obeyed(place):
    found = run(place, "-c", PROGRAM, "", "-options_file", "petscrc")
    assert told(found) == ["work", "work", "variable", "variable"], found.stderr
    assert (place / "ran").exists() == bool(shutil.which("cc"))


def test_the_home_folder_can_be_skipped(place):
    found = run(place, "-c", PROGRAM, "", "-skip_petscrc")
    assert told(found) == ["None", "None", "variable", "variable"], found.stderr


def test_a_home_folder_without_options(place):
    found = run(place, "-c", PROGRAM, "", HOME="/nowhere")
    assert told(found) == ["None", "None", "variable", "variable"], found.stderr
