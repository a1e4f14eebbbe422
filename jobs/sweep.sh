#!/bin/bash
# The same sweep without a queue, and its table:   jobs/sweep.sh jobs/sweep.toml [options of hpcred sweep]
# Ctrl-C ends all runs; the same command goes on with what is left.
set -euo pipefail
sweep=${1:?usage: jobs/sweep.sh jobs/sweep.toml [--parallel 2]}
python=${HPCRED_PYTHON:-python}
# no modules of the working folder, which may be another user's (Python 3.11 and later)
export PYTHONSAFEPATH=1
safely=$("$python" -c 'import sys; print("-P" * (sys.version_info >= (3, 11)))')
"$python" $safely -m hpcred sweep "$sweep" "${@:2}"
"$python" $safely -m hpcred collect "$sweep" -o "${sweep%.toml}.csv"
