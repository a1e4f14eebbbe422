#!/bin/sh
# All benchmarks one after the other; tables on the terminal, as <name>.json in the folder of results, and in docs/benchmarks.md.
# usage: benchmarks/run.sh [folder]
set -e
here=$(cd "$(dirname "$0")" && pwd)
python="$here/../.venv/bin/python"
mkdir -p "${1:-benchmark-results}"
cd "${1:-benchmark-results}"
for name in directions bounds boundary interpolation modes reading checksums op4 ansys_full solids million accuracy growth response interfaces sweep; do
    "$python" "$here/$name.py"
done
"$python" "$here/adaptive.py" linkage linkage-mimo solid free plate
"$python" "$here/size.py" linkage
"$python" "$here/recovery.py" 100000
"$python" "$here/growth.py" multigrid
"$python" "$here/shapes.py"
"$python" "$here/tables.py" .
