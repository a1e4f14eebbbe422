"""The accuracy that is claimed, direction by direction, against dense truth; sizes beside other ways.

usage: python benchmarks/directions.py [body ...]

Bodies of up to 3,000 dofs, whose modes are all known. For each tolerance and solver: the size, the estimated error,
and the true one at fresh frequencies, beside poles and beside zeros of drive points; the worst drive point by itself
and the worst static compliance. "paper" is the size by the Frobenius norm (55) at the same tolerance, and the worst
drive point that it leaves; "Craig-Bampton" the size that has the same error as ours; "best" the number of singular
vectors of exact responses over their scales that does.
"""

import argparse
import json
import sys
from dataclasses import dataclass, field

from common import finish, job, workspace

TOLERANCES = (1e-2, 1e-4, 1e-6)
EYES = ("BIG_EYE", "SMALL_EYE")


@dataclass(frozen=True)
class Body:
    """A band (Hz), the frame, Rayleigh damping, and whether interfaces are there for Craig-Bampton."""

    band: tuple[float, float]
    free: bool = False
    rayleigh: tuple[float, float] | None = None
    interfaces: dict = field(default_factory=dict)


BODIES = {
    "crank": Body((0, 4000), True, interfaces={name: {"set": name} for name in EYES}),
    "lever": Body((0, 8000), True, interfaces={
        name: {"box": ((x, -1, -1), (x, 1, 1))} for name, x in (("left", 0.0), ("middle", 0.1), ("right", 0.24))
    }),
    "block": Body((0, 20000)),
    "plate": Body((0, 20000)),
    "linkage": Body((0, 300), True, (2.0, 1e-5)),
    "frame": Body((0, 9000)),
}  # fmt: skip


def model_of(name):
    """The model with its inputs."""
    import numpy as np
    import scipy.sparse as sp

    import hpcred
    from hpcred.examples import linkage

    if name == "linkage":
        return hpcred.linkage(inputs=(*linkage.SUPPORTS, linkage.LOAD))
    if name in ("block", "plate"):
        return hpcred.solid((10, 5, 4) if name == "block" else (16, 16, 1))
    if name == "frame":  # two clamped bars and a soft tie between their ends
        with hpcred.solid((16, 3, 2), inputs=3) as bar:
            K, M, B = sparse(bar.K), sparse(bar.M), bar.B.getDenseArray().real.copy()
        tie = np.zeros((2 * K.shape[0], 3))
        rows = np.arange(K.shape[0] - 3, K.shape[0])
        tie[rows, range(3)], tie[rows + K.shape[0], range(3)] = 1.0, -1.0
        both = sp.block_diag([K, K]) + 1e5 * sp.csr_matrix(tie @ tie.T)
        loads = np.kron(np.eye(2), B)
        return hpcred.SecondOrderModel.from_scipy(both.tocsr(), sp.block_diag([M, M]).tocsr(), inputs=loads, name=name)
    body = BODIES[name]
    made = hpcred.crank(2500) if name == "crank" else hpcred.solid((24, 4, 3), clamped=False)
    sets = [hpcred.Interface(name=key, nodes=hpcred.Nodes(**nodes)) for key, nodes in body.interfaces.items()]
    return made.with_interfaces(sets).with_inputs([(key, "all") for key in body.interfaces])


def sparse(mat):
    import scipy.sparse as sp

    rows, columns, values = mat.getValuesCSR()
    return sp.csr_matrix((values.real, columns, rows), shape=mat.getSize())


class Truth:
    """Exact responses of a body by all of its elastic modes, with the damping that it is measured with."""

    def __init__(self, model, body, damping):
        import numpy as np
        import scipy.linalg

        eigenvalues, shapes = scipy.linalg.eigh(sparse(model.K).toarray(), sparse(model.M).toarray())
        first = 6 if body.free else 0
        self.eigenvalues, self.damping = eigenvalues[first:], damping
        self.L = (shapes.T @ model.B.getDenseArray().real)[first:]
        self.frequencies = np.sqrt(self.eigenvalues) / (2 * np.pi)
        self.band = body.band

    def inverse(self, f, eigenvalues=None):
        """A(s)^-1 (S, m) of modes."""
        import numpy as np

        s, damping, eigenvalues = 2j * np.pi * f, self.damping, self.eigenvalues if eigenvalues is None else eigenvalues
        a, b = 1 + 1j * damping.eta + s * damping.beta, s * s + s * damping.alpha
        return 1 / (a[:, None] * eigenvalues + b[:, None])

    def response(self, f, eigenvalues=None, L=None):
        """H (S, p, p), of the body or of other modes."""
        import numpy as np

        L = self.L if L is None else L
        parts = np.array_split(f, 1 + len(f) * len(L) // 2**20)
        return np.concatenate([np.einsum("mi,sm,mj->sij", L, self.inverse(part, eigenvalues), L, optimize=True)
                               for part in parts])  # fmt: skip

    def look_at(self, rom):
        """Fresh frequencies, some beside poles of both models and beside zeros of drive points."""
        import numpy as np

        low, high = self.band
        dense = np.linspace(low, high, 8001)
        size = np.abs(np.concatenate([self.inverse(part) @ self.L**2 for part in np.array_split(dense, 50)])).T
        dips = dense[1:-1][((size[:, 1:-1] < size[:, 2:]) & (size[:, 1:-1] < size[:, :-2])).any(axis=0)]
        centres = np.concatenate([self.frequencies, rom.frequencies, dips])
        centres = centres[(centres > low) & (centres < high)]
        offsets = 1e-3 * np.array([-30, -10, -3, -1, -0.3, 0, 0.3, 1, 3, 10, 30])
        fresh = np.random.default_rng(1).uniform(low, high, 300)
        f = np.unique(np.concatenate([[low, high], fresh, np.outer(centres, 1 + offsets).ravel()]))
        return f[(f >= low) & (f <= high)]

    def errors(self, rom, measure):
        """Of every response of a reduced model at look_at(); and at 0 Hz."""
        import numpy as np
        import scipy.linalg

        f = self.look_at(rom)
        eigenvalues, V = scipy.linalg.eigh(rom.K, rom.M)
        elastic = eigenvalues > 1e-9 * eigenvalues[-1]
        L = (V.T @ rom.B)[elastic]
        H, Hr = self.response(f), self.response(f, eigenvalues[elastic], L)
        return measure.each(H - Hr, H, np.einsum("fii->fi", H))

    def best(self, measure, error):
        """Singular vectors of exact states over their scales, as few as have an error."""
        import numpy as np

        low, high = self.band
        centres = self.frequencies[self.frequencies < high]
        f = np.unique(np.concatenate([np.linspace(low, high, 100), np.outer(centres, [0.999, 1, 1.001]).ravel()]))
        H = self.response(f)
        drive = np.einsum("fii->fi", H)
        g = measure.scales(H, drive)[1]
        X = np.hstack([self.L * (column[:, None] / scale) for column, scale in zip(self.inverse(f), g, strict=True)])
        both = np.hstack([X.real, X.imag])
        U = np.linalg.eigh(both @ both.T)[1][:, ::-1]
        for k in range(1, U.shape[1]):
            K = U[:, :k].T @ (self.eigenvalues[:, None] * U[:, :k])
            eigenvalues, V = np.linalg.eigh(K)
            L = (U[:, :k] @ V).T @ self.L
            Hr = self.response(f, eigenvalues, L)
            if measure.each(H - Hr, H, drive).max() <= error:
                return k
        return U.shape[1]


def measured(name):
    """In a job of its own: rows of the table."""
    import numpy as np

    import hpcred
    from hpcred.reduction.small.damping import measured_damping

    body, rows = BODIES[name], []
    frame = hpcred.Buckens() if body.free else None
    damping = hpcred.Rayleigh(*body.rayleigh) if body.rayleigh else None
    given = {"frame": frame, "damping": damping, "band": body.band}
    solvers = ("direct",) if name in ("linkage", "frame") else ("direct", "multigrid")
    with model_of(name) as model:
        truth = Truth(model, body, measured_damping(damping or hpcred.NoDamping(), 1e-3, body.band)[0])
        for tolerance in TOLERANCES:
            for solver in solvers:
                factoring = hpcred.Factoring(solver=hpcred.LinearSolver(kind=solver))
                with hpcred.reduce(model, tolerance=tolerance, factoring=factoring, **given) as rom:
                    accuracy, size = rom.record.accuracy, rom.size
                    each = truth.errors(rom, accuracy.measure)
                with hpcred.reduce(model, tolerance=tolerance, measure="paper", factoring=factoring, **given) as rom:
                    paper, hidden = rom.size, truth.errors(rom, accuracy.measure)
                own = np.einsum("fii->fi", each)
                most = float(each.max())
                rows.append({
                    "body": name, "dofs": model.size, "asked": tolerance, "solver": solver,
                    "reached": "yes" if accuracy.reached else accuracy.stopped, "size": size,
                    "estimated": accuracy.largest, "true": most, "estimated / true": accuracy.largest / most,
                    "drive point": float(own.max()), "static": float(own[0].max()),
                    "paper": paper, "its drive point": float(np.einsum("fii->fi", hidden).max()),
                    "Craig-Bampton": craig_bampton(model, body, given, truth, accuracy.measure, most),
                    "best": truth.best(accuracy.measure, accuracy.largest),
                })  # fmt: skip
    print(json.dumps(rows))


def craig_bampton(model, body, given, truth, measure, error):
    """The smallest size that has the error, with up to 60 fixed-interface modes; "-" without interfaces."""
    import hpcred

    given = {key: value for key, value in given.items() if key != "band"}
    if not body.interfaces:
        return "-"
    for count in (*range(1, 12), *range(12, 61, 3)):
        with hpcred.reduce(model, [hpcred.CraigBampton(count=count)], **given) as rom:
            if truth.errors(rom, measure).max() <= error:
                return rom.size
            size = rom.size
    return f"> {size}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bodies", nargs="*", choices=[[], *BODIES], default=[])
    given = parser.parse_args()
    rows = []
    with workspace() as folder:
        for name in given.bodies or BODIES:
            rows += job(1, folder, "--measured", name)
    finish("directions", rows)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measured"]:
        measured(sys.argv[2])
    else:
        main()
