#!/bin/bash
# The same sweep without a queue, and its table:   jobs/sweep.sh jobs/sweep.toml [options of hpcred sweep]
# Ctrl-C ends all runs; the same command goes on with what is left.
set -euo pipefail
sweep=${1:?usage: jobs/sweep.sh jobs/sweep.toml [--parallel 2]}
python=${HPCRED_PYTHON:-python}
"$python" -m hpcred sweep "$sweep" "${@:2}"
"$python" -m hpcred collect "$sweep" -o "${sweep%.toml}.csv"
