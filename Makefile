# make demo | test | fuzz | coverage | test-slow | test-ccx | test-dolfinx | test-chromium | test-slurm | docs | test-docs | bench | lint | install
#
# On Debian, `install` brings the missing system packages (as root or by sudo) and a virtual environment on top
# of them. To use an existing PETSc instead (cluster module, conda), see "Installing" in README.md.

DEBIAN := python3-petsc4py python3-petsc4py-real python3-petsc4py-complex \
          python3-slepc4py python3-slepc4py-real python3-slepc4py-complex \
          python3-mpi4py python3-h5py-mpi python3-numpy python3-scipy python3-matplotlib \
          mpi-default-bin libmumps-ptscotch-5.5 libopenblas0-pthread python3-venv
SUDO   := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PYTHON := .venv/bin/python

# Open MPI refuses root and more ranks than cores unless told; both are normal in a container. On one machine it need
# not look for networks, which takes it 0.2 s at every start.
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
export OMPI_MCA_rmaps_base_oversubscribe := 1
export OMPI_MCA_pml ?= ob1
export OPENBLAS_NUM_THREADS := 1

.PHONY: install demo test fuzz coverage test-slow test-ccx test-dolfinx test-chromium test-slurm docs test-docs bench lint

install: .venv/.ready

# The compiled packages come from Debian and are built for numpy 1: pip takes only the others, and
# nothing may bring numpy 2 or another h5py.
PURE := import re, tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
        deps = p["dependencies"] + p["optional-dependencies"]["test"]; \
        debian = {"numpy", "scipy", "matplotlib", "mpi4py", "h5py", "petsc4py", "slepc4py", "tomli"}; \
        print(*(d for d in deps if re.match("\\w+", d)[0] not in debian), sep="\n")

.venv/.ready: pyproject.toml Makefile
	@missing=$$(for p in $(DEBIAN); do dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || echo $$p; done); \
	if [ -n "$$missing" ]; then \
	    $(SUDO) apt-get update -qq && \
	    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing; \
	fi
	/usr/bin/python3 -m venv --clear --system-site-packages .venv
	echo "numpy<1.25" > .venv/constraints.txt
	.venv/bin/python -c '$(PURE)' > .venv/requirements.txt
	.venv/bin/python -m pip install -q -c .venv/constraints.txt -r .venv/requirements.txt
	.venv/bin/python -m pip install -q --no-deps -e .
	.venv/bin/python -m compileall -q hpcred
	@touch $@

demo: install
	mpiexec -n 2 $(PYTHON) -m hpcred

test: install
	$(PYTHON) -m pytest --beside -m "not slow and not ccx and not dolfinx and not chromium and not slurm and not docs"

test-slow: install
	$(PYTHON) -m pytest -m slow

# Cases made by rule, run and judged (tests/fuzz/__init__.py): right, refused, internal error, wrong; the last two
# must be zero. What fails is kept in fuzz-failures/. KINDS=DMIG,model runs only the kinds of cases that begin so.
SECONDS := 600
SEED    := $(shell date +%s)
KINDS   :=

fuzz: install
	PYTHONPATH=tests $(PYTHON) -m fuzz --seconds $(SECONDS) --seed $(SEED) --kinds "$(KINDS)"

# lines of hpcred/ that the tests on one rank run; TESTS=tests/formats measures those of some tests only
TESTS := tests

coverage: install
	$(PYTHON) -m coverage run -m pytest -q -k "not 2-ranks and not 3-ranks and not complex" \
	    -m "not slow and not ccx and not dolfinx and not chromium and not slurm and not docs" $(TESTS)
	$(PYTHON) -m coverage report

# CalculiX and gmsh compute the example in examples/calculix
test-ccx: install
	@which ccx gmsh >/dev/null && $(PYTHON) -c "import gmsh" 2>/dev/null || { $(SUDO) apt-get update -qq && \
	    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    calculix-ccx gmsh python3-gmsh; }
	$(PYTHON) -m pytest -m ccx

# DOLFINx, in both builds, assembles the matrices of examples/dolfinx
test-dolfinx: install
	@dpkg-query -W python3-dolfinx-real python3-dolfinx-complex >/dev/null 2>&1 || { $(SUDO) apt-get update -qq && \
	    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    python3-dolfinx python3-dolfinx-real python3-dolfinx-complex; }
	$(PYTHON) -m pytest -m dolfinx

# reports in a browser without a screen
test-chromium: install
	@which chromium >/dev/null || { $(SUDO) apt-get update -qq && \
	    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium; }
	$(PYTHON) -m pytest -m chromium

# SLURM on this machine as this user, in a temporary folder: the scripts of jobs/ are submitted to it
test-slurm: install
	@PATH="$$PATH:/usr/sbin" which slurmctld slurmd sbatch munged >/dev/null || { $(SUDO) apt-get update -qq && \
	    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    slurmctld slurmd slurm-client munge; }
	$(PYTHON) -m pytest -m slurm -v

.venv/.docs-ready: .venv/.ready
	.venv/bin/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")' \
	    > .venv/docs-requirements.txt
	.venv/bin/python -m pip install -q -c .venv/constraints.txt -r .venv/docs-requirements.txt
	@touch $@

# the site, into build/site
docs: .venv/.docs-ready
	NO_MKDOCS_2_WARNING=1 $(PYTHON) -m mkdocs build --strict --quiet
	@echo build/site/index.html

test-docs: .venv/.docs-ready
	$(PYTHON) -m pytest -m docs

# the peers need numpy 2 and MKL, in an environment of their own
.venv-peers/.ready: Makefile
	/usr/bin/python3 -m venv --clear .venv-peers
	.venv-peers/bin/python -m pip install -q numpy scipy==1.17.1 h5py pypardiso==0.4.7 pymor==2026.1.1 pyyeti==1.4.7 \
	    ansys-mapdl-reader==0.56.0
	@touch $@

bench: install .venv-peers/.ready
	benchmarks/run.sh benchmark-results

lint: install
	.venv/bin/ruff check .
