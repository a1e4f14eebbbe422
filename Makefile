# make demo | install | test | test-slow | test-wheel | test-ccx | test-dolfinx | test-chromium | test-slurm | test-peers | test-cuda |
#      test-docs | test-linalg | test-pip | test-pip-complex | test-debian12 | test-debian13 | test-kernels | fuzz | mutants | kills | faults | coverage | docs | bench | bench-peers | lint
#
# On Debian 12 and 13, and systems with the same packages, `install` brings the missing system packages (as root or by
# sudo) and a virtual environment on top of them. For another PETSc (cluster module, conda) see docs/install.md.

# apt and dpkg take the patterns: MUMPS has its version in the name of its package
DEBIAN := python3-petsc4py python3-petsc4py-real python3-petsc4py-complex \
          python3-slepc4py python3-slepc4py-real python3-slepc4py-complex \
          python3-mpi4py python3-h5py python3-h5py-mpi python3-numpy python3-scipy python3-matplotlib \
          mpi-default-bin libmumps-ptscotch-[0-9]* libopenblas0-pthread python3-venv
KERNELS := $(if $(filter x86_64,$(shell uname -m)),Haswell Prescott)
SUDO   := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PYTHON := .venv/bin/python

# Open MPI refuses root and more ranks than cores unless told; both are normal in a container. Versions 4 and 5 have
# names of their own for the latter. On one machine it need not look for networks, which takes it 0.2 s at every start.
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
export OMPI_MCA_rmaps_base_oversubscribe := 1
export PRTE_MCA_rmaps_default_mapping_policy := :oversubscribe
export OMPI_MCA_pml ?= ob1
export OMPI_MCA_btl ?= ^tcp
export OPENBLAS_NUM_THREADS := 1
# mpiexec of Open MPI 4 adds no lines to the message of a rank that fails; in 5 nothing keeps it from that
export OMPI_MCA_orte_execute_quiet := 1
# else each process of the tests, and each rank, compiles all modules again
unexport PYTHONDONTWRITEBYTECODE

# OpenBLAS takes kernels of 2004 (Prescott) on a processor that it does not know, with which tests take a fifth longer
CORE := $(shell python3 -c 'import ctypes; f = ctypes.CDLL("libopenblas.so.0").openblas_get_corename; \
        f.restype = ctypes.c_char_p; print(f().decode())' 2>/dev/null)
BLAS := $(and $(filter Prescott,$(CORE)),$(shell grep -m1 -ow avx2 /proc/cpuinfo),Haswell)

.PHONY: install environment demo test fuzz mutants kills faults coverage test-slow test-wheel test-ccx test-dolfinx test-chromium test-slurm test-peers test-cuda docs test-docs \
        test-packages test-kernels test-linalg test-pip test-pip-complex test-debian12 test-debian13 bench bench-peers lint

# $(call apt,packages) installs those that are missing
define apt
@set -f; command -v dpkg-query >/dev/null || { echo "make: this is no Debian or Ubuntu; see docs/install.md" >&2; exit 2; }; \
missing=$$(for p in $(1); do dpkg-query -W -f='$${Status}\n' "$$p" 2>/dev/null | grep -q 'ok installed' || echo "$$p"; done); \
if [ -n "$$missing" ]; then \
    $(SUDO) apt-get update -qq && \
    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing; \
fi
endef

install: .venv/.ready

# The compiled packages come from Debian: pip takes only the others, and may bring no other version of these.
COMPILED := {"numpy", "scipy", "matplotlib", "mpi4py", "h5py", "petsc4py", "slepc4py"}
VERSIONS := from importlib import metadata; \
        found = {d.name: d.version for d in reversed(list(metadata.distributions()))}; \
        print(*(f"{name}=={found[name]}" for name in $(COMPILED) if name in found), sep="\n")
PURE     := import re, tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
        deps = p["dependencies"] + p["optional-dependencies"]["test"]; \
        print(*(d for d in deps if re.match("\\w+", d)[0] not in $(COMPILED) | {"scipy_dae"}), sep="\n")

# not where only the dates of the two files are new, as in a fresh copy of the work tree
.venv/.ready: pyproject.toml Makefile
	$(call apt,$(DEBIAN))
	@cat $^ | cmp -s - .venv/made-of || $(MAKE) --no-print-directory environment
	@.venv/bin/python -m compileall -q hpcred
	@touch $@

environment:
	@echo "make: packages of PyPI into .venv, which takes minutes"
	@/usr/bin/python3 -m venv --clear --system-site-packages .venv
	@/usr/bin/python3 -c '$(VERSIONS)' > .venv/constraints.txt
	@/usr/bin/python3 -c '$(PURE)' > .venv/requirements.txt
	@.venv/bin/python -m pip install -q -c .venv/constraints.txt -r .venv/requirements.txt
	@.venv/bin/python -m pip install -q --no-deps scipy_dae pyyeti pyNastran  # they ask for another numpy or h5py than they need
	@.venv/bin/python -m pip install -q --no-deps --config-settings editable_mode=compat -e .
	@echo "export OMPI_MCA_orte_execute_quiet=1" >> .venv/bin/activate
	@[ "$$(id -u)" != 0 ] || echo "export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1" >> .venv/bin/activate
	@cat pyproject.toml Makefile > .venv/made-of

demo: install
	mpiexec -n 2 $(PYTHON) -m hpcred

QUICK := "not slow and not ccx and not dolfinx and not chromium and not slurm and not docs and not wheel"

# exudyn needs a libGL, tests of FMUs compile
test-packages: install
	$(call apt,gcc libc6-dev libgl1)

TIMES := $(CURDIR)/build/test-times

ifneq ($(BLAS),)
test test-slow test-linalg: export OPENBLAS_CORETYPE ?= $(BLAS)
# peers with MKL use AVX-512 where there is some
bench bench-peers: export OPENBLAS_CORETYPE ?= $(if $(shell grep -m1 -ow avx512bw /proc/cpuinfo),SkylakeX,$(BLAS))
endif

# the processor time of each item goes to TIMES
test: test-packages
	@mkdir -p $(dir $(TIMES)) && rm -f $(TIMES)
	HPCRED_TEST_TIMES=$(TIMES) $(PYTHON) -m pytest --beside -m $(QUICK) $(BUT_SHARES)
	@$(PYTHON) tests/item_times.py $(TIMES)

test-slow: test-packages
	$(PYTHON) -m pytest -m slow

# the wheel and the source distribution, in environments that have nothing else
test-wheel: install
	$(PYTHON) -m pytest -m wheel

# the numerical rooms with other kernels of OpenBLAS, whose round-off differs: those of processors without AVX-512, and
# the oldest (`make -j2 -O test-kernels` runs them beside each other). Each test runs with one of them, as a checksum of
# its name decides; with `SHARE=` it runs with both. With `OF=4 PART=k` the first has share k + 1 of four, the other the
# next; `make test ONCE=1` with the same numbers leaves these shares out
test-kernels: $(addprefix test-kernel-,$(KERNELS))

OF    := 2
PART  := 0
share = $(shell echo $$((($(PART) + $(1)) % $(OF) + 1)))/$(OF)
SHARE = --share $(call share,$(if $(filter Haswell,$*),0,1))
BUT_SHARES = $(if $(and $(ONCE),$(KERNELS)),--but-share $(call share,0) --but-share $(call share,1))

test-kernel-%: install
	OPENBLAS_CORETYPE=$* $(PYTHON) -m pytest -q $(SHARE) -m $(QUICK) -k "not 2-ranks and not 3-ranks and not complex" \
	    tests/linalg tests/reduction tests/analysis tests/fe tests/model

# the quickest that tells whether hpcred works with the PETSc of a system, on 1 and 2 ranks
test-linalg: test-packages
	$(PYTHON) -m pytest -q --beside -m $(QUICK) -k "not 3-ranks" tests/linalg tests/parallel

# the wheel with what pip alone brings, where Python is 3.12 or later; tests/systems/pip.sh says why it leaves out a system
test-pip:
	tests/systems/pip.sh

test-pip-complex:
	tests/systems/pip.sh petsc-complex

# a bare system in build/, as a new user has it
test-debian12:
	$(SUDO) tests/systems/debian.sh bookworm make demo test

test-debian13:
	$(SUDO) tests/systems/debian.sh trixie make demo test

# Cases made by rule, run and judged (tests/fuzz/__init__.py): right, refused, internal error, wrong; the last two
# must be zero. What fails is kept in fuzz-failures/. KINDS=DMIG,model runs only the kinds of cases that begin so.
SECONDS := 600
SEED    := $(shell date +%s)
KINDS   :=

fuzz: install
	PYTHONPATH=tests $(PYTHON) -m fuzz --seconds $(SECONDS) --seed $(SEED) --kinds "$(KINDS)"

# The numerical rooms with one place changed at a time: a change that no test notices wants a test (tests/mutants).
# ROOM=reduction/components/krylov.py takes one module. MUTANTS: how many, evenly from the modules. SEED: of the choice.
ROOM    := linalg,fe,model,reduction,body,simulation,analysis,assembly
MUTANTS := 200

mutants: install
	PYTHONPATH=tests $(PYTHON) -m mutants --rooms "$(ROOM)" --count $(MUTANTS) --seed $(SEED)

# Signals at random moments, and calls of the system that fail or limits, of commands on one rank and on one of two:
# what is on the disk afterwards, and what they say (docs/robustness.md). COUNT: how many.
COUNT := 30

kills: install
	HPCRED_KILLS=$(COUNT) HPCRED_SEED=$(SEED) $(PYTHON) -m pytest -q -s -m slow tests/parallel/test_signals.py -k random_moments

faults: test-packages
	HPCRED_SYSTEM_FAULTS=$(COUNT) HPCRED_SEED=$(SEED) $(PYTHON) -m pytest -q -s -m slow tests/test_system_faults.py -k many_calls

# lines of hpcred/ that the tests on one rank run; TESTS=tests/readers measures those of some tests only
TESTS := tests

coverage: install
	$(PYTHON) -m coverage run -m pytest -q -k "not 2-ranks and not 3-ranks and not complex" \
	    -m $(QUICK) $(TESTS)
	$(PYTHON) -m coverage report

# CalculiX and gmsh compute the example in examples/calculix
test-ccx: install
	$(call apt,calculix-ccx gmsh python3-gmsh)
	$(PYTHON) -m pytest -m ccx

# DOLFINx, in both builds, assembles the matrices of examples/dolfinx
test-dolfinx: install
	$(call apt,python3-dolfinx python3-dolfinx-real python3-dolfinx-complex)
	$(PYTHON) -m pytest -m dolfinx

# reports in a browser without a screen
test-chromium: install
	$(call apt,chromium)
	$(PYTHON) -m pytest -m chromium

# factors on a GPU of NVIDIA; the driver has to be there, of CUDA 13, or: make test-cuda CUDA=12
CUDA ?= 13
test-cuda: install
	$(PYTHON) -m pip install -q 'nvmath-python[cu$(CUDA)]>=1.0,<2'
	HPCRED_TEST_CUDA=1 $(PYTHON) -m pytest -m cuda

# SLURM on this machine as this user, in a temporary folder: the scripts of jobs/ are submitted to it
test-slurm: install
	$(call apt,slurmctld slurmd slurm-client munge)
	$(PYTHON) -m pytest -m slurm -v

# beside the packages of .venv, on the same numpy
build/peers/.ready: .venv/.ready
	/usr/bin/python3 -m venv --clear --system-site-packages build/peers
	$(PYTHON) -c 'import sysconfig; print("import site; site.addsitedir(%r)" % sysconfig.get_path("purelib"))' \
	    > $$(echo build/peers/lib/python3*/site-packages)/hpcred.pth
	build/peers/bin/python -m pip install -q -c .venv/constraints.txt pymor==2026.1.1 meshio==5.3.5
	build/peers/bin/python -m pip install -q OMSimulator || \
	    echo "make: OMSimulator is left out: its package downloads the program from openmodelica.org" >&2
	@touch $@

# files and models in the programs of others, none of which may be missing
test-peers: test-packages build/peers/.ready
	HPCRED_TEST_PEERS=1 build/peers/bin/python -m pytest -m peers

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
	    ansys-mapdl-reader==0.56.0 "exudyn==1.13.6; platform_machine == 'x86_64'"
	@touch $@

# all tables of README and docs from one run of so many minutes at most
MINUTES := 90

bench: install .venv-peers/.ready
	benchmarks/run.sh benchmark-results $(MINUTES)

# against other methods and other programs: every table of one run in one folder
bench-peers: install .venv-peers/.ready
	benchmarks/run_peers.sh peer-results

lint: install
	.venv/bin/ruff check .

# sets the version, builds the sdist and the wheel into dist/, commits and tags; uploads nothing (.ci/release.py)
.PHONY: release
release: install
	$(PYTHON) .ci/release.py "$(VERSION)"
