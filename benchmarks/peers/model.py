"""model.h5 for the peers."""

import h5py
import scipy.sparse as sp


def read(path):
    """K, M (n, n) as CSR, and B (n, p)."""
    with h5py.File(path) as file:
        group, size = file["matrices"], int(file.attrs["size"])
        pattern = group["indices"][:], group["indptr"][:]
        K, M = (sp.csr_matrix((group[key][:], *pattern), (size, size)) for key in ("K", "M"))
        return K, M, file["inputs/B"][:].T


def upper(matrix):
    part = sp.triu(matrix, format="csr")
    part.sort_indices()
    return part
