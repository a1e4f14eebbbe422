#!/bin/sh
# pip.sh [petsc-complex]: the wheel of hpcred with its extra `all`, or with the complex PETSc in place of the real one, in
# a new environment without system packages (build/pip): the demo on 2 ranks, the ten lines of README, and tests on 1 and
# 2 ranks. A user's PETSc and MPI have no part in it.
set -eu
cd "$(dirname "$0")/../.."
folder=$PWD/build/pip${1:+-$1} extras=${1:-petsc},plots,simulate,fast

for name in ${PYTHON312:-python3.14 python3.13 python3.12 python3}; do
    python=$(command -v "$name") && "$python" -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null &&
        break
    python=
done
libc=$(getconf GNU_LIBC_VERSION 2>/dev/null | cut -d' ' -f2)
if [ -z "$python" ] || [ "$(uname -sm)" != "Linux x86_64" ] || [ "$(printf '%s\n' 2.34 "${libc:-0}" | sort -V | head -1)" != 2.34 ]; then
    echo "test-pip is left out: it needs Python 3.12 or later with venv (PYTHON312 names one), and glibc 2.34 on x86_64" >&2
    exit 0
fi

rm -rf "$folder" && mkdir -p "$folder/source"
"$python" -m venv "$folder"
unset PYTHONPATH PIP_PYTHON PIP_TARGET PETSC_DIR PETSC_ARCH SLEPC_DIR PETSC_OPTIONS HPCRED_SCALAR
export PATH="$folder/bin:$PATH"
tar cf - --exclude=__pycache__ hpcred pyproject.toml MANIFEST.in README.md LICENSE | tar xf - -C "$folder/source"
pip wheel -q --no-deps -w "$folder/dist" "$folder/source"
pip install -q "$(echo "$folder"/dist/*.whl)[$extras]" pytest pyyaml

# beside nothing that could be taken for the package
rm -rf "$folder/source" && mkdir "$folder/tests"
tar cf - --exclude=__pycache__ tests docs examples README.md pyproject.toml | tar xf - -C "$folder/tests"
cd "$folder/tests"
python -c 'import hpcred; assert "site-packages" in hpcred.__file__, hpcred.__file__'
mpiexec -n 2 hpcred
pytest -q -p no:cacheprovider -m "not slow" "tests/docs/test_tutorials.py::test_what_a_page_shows_is_what_its_commands_print[README]" \
    tests/linalg/test_blocks.py tests/linalg/test_basis.py tests/linalg/test_solvers.py tests/parallel/test_startup.py \
    tests/reduction/test_reduce.py
