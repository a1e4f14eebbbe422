"""Mutation tests of the numerical rooms: `make mutants`.

A mutant is the package with one sign, factor, index, comparison, constant, term or call changed (see changes.py). The
tests that run the changed line should fail for it, those of its own module first; `--everywhere`: also on three ranks
and in the complex build. A mutant for which none fails has survived: a test is missing, or the change is none. The
latter are listed with a reason in same.txt, and not run.

Each mutant is a fork of a process that has loaded NumPy, SciPy and pytest (forks.py). It imports hpcred with the
changed module (changed.py), and starts MPI and PETSc for itself.
"""
