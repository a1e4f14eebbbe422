#!/bin/sh
# All benchmarks whose tables stand on the pages, those of most value first: results as <name>.json, and what each says as
# <name>.txt, in the folder of results; then the tables of README and docs. Each has a limit of minutes, about three times
# what it takes on two quiet cores, and all together have one; what failed or was left out is said at the end, and in the
# exit status. Published models come from the folder HPCRED_SHARED_DATA (benchmarks/models).
# usage: benchmarks/run.sh [folder] [minutes]
here=$(cd "$(dirname "$0")" && pwd)
python="$here/../.venv/bin/python"
mkdir -p "${1:-benchmark-results}"
cd "${1:-benchmark-results}" || exit
rm -f ./*.json # of an earlier run
end=$(($(date +%s) + 60 * ${2:-600}))
: > seconds.txt
: > failed.txt

# run LIMIT NAME LABEL [arguments]: a benchmark for so many minutes at most
run() {
    limit=$((60 * $1)) name=$2 label=$3 start=$(date +%s)
    shift 3
    left=$((end - start))
    if [ "$left" -lt 5 ]; then
        echo "$label: no time was left" >> failed.txt
        return
    fi
    [ "$left" -ge "$limit" ] || limit=$left
    folder=$(mktemp -d) # of one that is cut off much may be left
    TMPDIR=$folder timeout --foreground -k 10 "$limit" "$python" "$here/$name.py" "$@" > "$label.txt" 2> "$label.log"
    status=$?
    rm -rf "$folder"
    took="$(($(date +%s) - start)) s"
    echo "$label $took" >> seconds.txt
    if [ $status = 0 ]; then
        cat "$label.txt"
        echo "$label: $took"
    else
        echo "$label: exit status $status after $took, see $label.log" | tee -a failed.txt
    fi
}

# what has seconds in its tables, one after the other
run 20 search search block block-1 cube
run 25 accuracy accuracy
run 10 solids solids 27k 112k
run 6 modes modes
run 6 reading reading
run 8 interpolation interpolation
run 10 sweep sweep 27k
run 8 growth growth
run 10 simulations simulations
run 4 ansys_full ansys_full
run 4 op4 op4
run 8 published published
run 6 shapes shapes 16 cube "housing, hexa" "housing, tetrahedra of 10" "flat tetra" B-bar "bar 100"

# what has none: two at a time
(
    run 10 interfaces bearings bearings --ranks 1
    run 5 boundary boundary
    run 5 bounds bounds
) &
(
    run 30 directions directions
    run 20 machines machines --exponents 1.4 1.5 1
) &
wait
run 8 adaptive adaptive linkage linkage-mimo solid free plate
run 6 rotor rotor --cells 20 3 3 --speeds 5
run 6 extrapolation extrapolation
run 5 growth growth-multigrid multigrid
run 10 rivals_large rivals_large
run 15 million million --cells 69

"$python" "$here/tables.py" . || echo "tables" >> failed.txt
if [ -s failed.txt ]; then
    echo "failed or left out:"
    cat failed.txt
    exit 1
fi
