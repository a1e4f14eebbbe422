#!/bin/bash
# The same sweep without a queue, one run after the other:  jobs/sweep.sh job.toml jobs/sweep.txt [ranks]
set -euo pipefail
while read -r -a keys; do
    mpiexec -n "${3:-2}" python -m hpcred reduce "$1" "${keys[@]/#/--set=}" < /dev/null
done < "$2"
