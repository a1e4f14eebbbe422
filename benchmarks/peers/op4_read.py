"""pyYeti's reader of an OP4 file: seconds, memory and the sum of the values -> JSON."""

import json
import resource
import sys
import time
from importlib.metadata import version

from pyyeti.nastran import op4


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


before, start = peak(), time.perf_counter()
_, (matrix,), _, _ = op4.OP4().listload(sys.argv[1], sparse=True)
print(json.dumps({
    "seconds": time.perf_counter() - start, "bytes": (peak() - before) / matrix.nnz, "sum": float(matrix.data.sum()),
    "nonzeros": matrix.nnz, "version": version("pyyeti"),
}))  # fmt: skip
