"""Second-order bitangential Hermite interpolation by pyMOR: model.h5, frequencies -> JSON."""

import json
import sys
import time

import numpy as np
import scipy.sparse as sp
from model import read
from pymor.core.logger import set_log_levels
from pymor.models.iosys import SecondOrderModel
from pymor.reductors.interpolation import SOBHIReductor

set_log_levels({"pymor": "WARNING"})
path, points, check = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
start = time.perf_counter()
K, M, B = read(path)
fom = SecondOrderModel.from_matrices(M.tocsc(), sp.csc_matrix(K.shape), K.tocsc(), B, B.T)
directions = np.tile(np.eye(B.shape[1]), (len(points), 1))
sigma = 2j * np.pi * np.repeat(points, B.shape[1])
rom = SOBHIReductor(fom).reduce(sigma, directions, directions)
seconds = time.perf_counter() - start
response = [rom.transfer_function.eval_tf(2j * np.pi * f).real.tolist() for f in check]
print(json.dumps({"seconds": seconds, "response": response, "size": rom.order}))
