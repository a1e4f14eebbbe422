"""hpcred for Spack 1.0 and later, from a checkout; see docs/install.md. Untried."""

from spack_repo.builtin.build_systems.python import PythonPackage

from spack.package import depends_on, license, version


class Hpcred(PythonPackage):
    """Reduced flexible bodies by moment matching, in parallel."""

    license("BSD-3-Clause")
    version("develop")

    depends_on("python@3.10:", type=("build", "run"))
    depends_on("py-setuptools@61:", type="build")
    depends_on("petsc+mpi+mumps")
    depends_on("py-h5py+mpi", type="run")
    for package in (
        "numpy", "mpi4py", "petsc4py@3.18:", "slepc4py@3.18:", "jinja2", "lazy-loader", "psutil", "pydantic@2:", "rich",
        "scipy", "typer", "xxhash@2:", "matplotlib",
    ):  # fmt: skip
        depends_on(f"py-{package}", type="run")
    depends_on("py-tomli", type="run", when="^python@:3.10")
