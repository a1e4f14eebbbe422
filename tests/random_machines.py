"""Random machines of small bodies by seed, and the estimated and true errors of their responses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from scipy.linalg import eigh

import hpcred
from hpcred.assembly import MachineBody
from hpcred.assembly.coupling import machine_of
from hpcred.assembly.error import sensitivity
from hpcred.assembly.parts import part_of
from hpcred.reduction.result.accuracy import Accuracy
from hpcred.reduction.result.measure import Directions, drive_points

BAND = (0.0, 100.0)


def reduced_model(M, D, K, C, names, V, record):
    """The projection of a body with C = B^T on V."""
    parts = {key: V.T @ matrix @ V for key, matrix in (("M", M), ("D", D), ("K", K))}
    parts = {key: (part + part.T) / 2 for key, part in parts.items()}
    return hpcred.ReducedModel(**parts, B=V.T @ C.T, C=C @ V, frequencies=np.ones(V.shape[1]), input_names=names,
                               output_names=names, record=record)  # fmt: skip


def random_body(rng, free):
    """Matrices of masses in space, joined by springs, held by some of them or free; the directions of three of them."""
    count = int(rng.integers(5, 8))
    points = rng.normal(size=(count, 3))
    K = np.zeros((3 * count, 3 * count))

    def spring(i, j, along, stiffness):
        row = np.zeros(3 * count)
        row[3 * i : 3 * i + 3] = along
        if j is not None:
            row[3 * j : 3 * j + 3] = -along
        K[...] += stiffness * np.outer(row, row)

    for i in range(count):
        for j in range(i):
            if rng.random() < 0.7:
                along = points[i] - points[j]
                spring(i, j, along / np.linalg.norm(along), 10.0 ** rng.uniform(4.5, 6.5))
    for i in range(0 if free else 4):
        for along in np.eye(3):
            spring(i, None, along, 10.0 ** rng.uniform(4, 6))
    M = np.diag(np.repeat(10.0 ** rng.uniform(-0.5, 0.8, count), 3))
    zeta = 10.0 ** rng.uniform(-2.5, -1.3)
    D = 2 * zeta / (2 * np.pi * 40) * K
    nodes = rng.choice(count, 3, replace=False)
    C = np.eye(3 * count)[np.concatenate([[3 * n, 3 * n + 1, 3 * n + 2] for n in nodes])]
    names = tuple(f"{label}:{d}" for label in "abc" for d in "xyz")
    return M, D, K, C, names, {label: points[n] for label, n in zip("abc", nodes, strict=True)}


def truth_of(model, reduced, s):
    """The accuracy of a reduced body, by its full model."""
    H, Hr = model.transfer_function(s), reduced.transfer_function(s)
    drive = np.einsum("sii->si", Hr)
    frequencies = np.abs(s) / (2 * np.pi)
    measure = Directions().over(frequencies, Hr, drive, drive_points(reduced.B, reduced.C.T))
    each = measure.each(H - Hr, Hr, drive)
    eps = measure.total(each)
    directions = tuple(SimpleNamespace(output=name, largest=value) for name, value in zip(
        reduced.output_names, each.max(axis=(0, 2)).tolist(), strict=True))  # fmt: skip
    return Accuracy(
        tolerance=1e-3, band=BAND, reached=True, stopped="", largest=float(eps.max()), worst=0.0, mean=0.0, noise=0.0,
        measured="", uncompressed_size=0, highest=0.0, missing_modes=None, points=(), proofs=(),
        frequencies=tuple(frequencies), eps=tuple(eps), measure=measure,
        directions=directions,
    )  # fmt: skip


def random_bodies(rng, count):
    """Pairs (full, reduced) of results of random bodies."""
    found = []
    for k in range(count):
        M, D, K, C, names, places = random_body(rng, free=k > 0)
        size = len(M)
        squares, X = eigh(K, M)
        modes = int(min(max((squares < (2 * np.pi * BAND[1] * rng.uniform(1.1, 2.5)) ** 2).sum(), 6), size - 3))
        shifted = K - (2 * np.pi * rng.uniform(1, 100)) ** 2 * M if rng.random() < 0.7 else K + M * 1e3
        V = np.hstack([X[:, :modes], np.linalg.solve(shifted, C.T)[:, : int(rng.integers(2, 9))]])
        V = np.linalg.qr(V)[0]
        poles = np.sqrt(np.maximum(squares, 0)) / (2 * np.pi)
        grid = np.union1d(np.linspace(0.01, BAND[1], 250),
                          (poles[:, None] * (1 + np.linspace(-0.02, 0.02, 13))).ravel())  # fmt: skip
        s = 2j * np.pi * grid[(grid >= 0.01) & (grid <= BAND[1])]
        node = [SimpleNamespace(label=label, node=n, position=place, name=label)
                for n, (label, place) in enumerate(places.items(), 1)]  # fmt: skip
        record = SimpleNamespace(frame=hpcred.NoFrame(), damping=hpcred.GivenDamping(), accuracy=None, loads=(),
                                 interface_nodes=(), units="")  # fmt: skip
        full = reduced_model(M, D, K, C, names, np.eye(size), record)
        small = reduced_model(M, D, K, C, names, V, record)
        small = replace(small, record=SimpleNamespace(**vars(record) | {"accuracy": truth_of(full, small, s)}))
        found.append([SimpleNamespace(reduced=item, floating_frame=None, nodes=node) for item in (full, small)])
    return found


def random_machine(seed):
    """The machine of full bodies and of reduced ones, by a seed."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 4))
    bodies = [MachineBody(name=f"b{k}", result="-", position=tuple(rng.normal(size=3))) for k in range(count)]
    results = random_bodies(rng, count)
    joints = []
    for k in range(1, count):
        for label in "ab" if rng.random() < 0.5 else "a":
            ends = f"b{int(rng.integers(0, k))}.{label}", f"b{k}.{label if rng.random() < 0.5 else 'c'}"
            # bodies of three directions a node have no lever: the joint holds displacements alike
            if rng.random() < 0.5:
                joints.append(hpcred.assembly.RigidJoint(bodies=ends, directions="xyz"[: int(rng.integers(1, 4))]))
            else:
                law = hpcred.laws.Maxwell((float(rng.uniform(0.2, 3)),), (float(10 ** rng.uniform(-3, -1.5)),))
                stiffness, damping = 10.0 ** rng.uniform(3, 7, 3), 10.0 ** rng.uniform(0, 3, 3)
                joints.append(hpcred.assembly.BushingJoint(bodies=ends, stiffness=stiffness, damping=damping,
                                                  law=law if rng.random() < 0.4 else None))  # fmt: skip
    masses = [hpcred.assembly.PointMass(at="b1.c", mass=float(10 ** rng.uniform(-1, 1)))] if rng.random() < 0.5 else []
    parts = [[without_places(part_of(body, pair[side])) for body, pair in zip(bodies, results, strict=True)]
             for side in (0, 1)]  # fmt: skip
    return [machine_of(side, joints, masses) for side in parts]


def without_places(part):
    """The part with unknown places, so that joints have no levers, for which its nodes have no rotations."""
    return replace(part, places={node: np.full(3, np.nan) for node in part.places})


def estimated_and_true(seed):
    """Estimated and true errors of the reduced machine over the band, and the bound of the estimate without circles."""
    full, small = random_machine(seed)
    exact, reduced = (item.model(1 / (2 * np.pi * BAND[1]))[0] for item in (full, small))
    found = sensitivity(small, reduced, BAND)
    s = 2j * np.pi * found.frequencies
    # twice, by coordinates and by receptances: what only one of them has is round-off
    both = (exact.transfer_function(s) - reduced.transfer_function(s), full.response(s) - small.response(s))
    true = np.min([found.measure.total(np.abs(E) / found.scale) for E in both], axis=0)
    return found.curve(), true, found.measure.total(found.bounds(np.ones(len(small.parts)))[:, 0])
