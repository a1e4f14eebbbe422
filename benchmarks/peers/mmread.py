"""scipy.io.mmread of a file: seconds, memory and the sum of the values -> JSON."""

import json
import resource
import sys
import time

import scipy
import scipy.io

start = time.perf_counter()
matrix = scipy.io.mmread(sys.argv[1])
seconds = time.perf_counter() - start
print(json.dumps({
    "seconds": seconds, "sum": float(matrix.data.sum()), "scipy": scipy.__version__,
    "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
}))  # fmt: skip
