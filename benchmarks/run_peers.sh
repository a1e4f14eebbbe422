#!/bin/sh
# The comparisons with other methods and other programs one after the other: each table as <name>.json in the folder of
# results, and all of them in its tables.md. Published models come from the folder HPCRED_SHARED_DATA (benchmarks/models).
# usage: benchmarks/run_peers.sh [folder]
set -e
here=$(cd "$(dirname "$0")" && pwd)
python="$here/../.venv/bin/python"
mkdir -p "${1:-peer-results}"
cd "${1:-peer-results}"
: > tables.md
compare() {
    name=$1
    shift
    "$python" "$here/$name.py" "$@" > "$name.txt"
    cat "$name.txt" | tee -a tables.md
}
compare rivals
compare rivals_large
compare directions
compare boundary
compare size linkage
compare interpolation
compare modes
compare solids
compare op4
compare ansys_full
compare accuracy
compare reading
compare published
compare simulations
