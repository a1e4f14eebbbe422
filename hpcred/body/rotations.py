"""Convert between quaternions, rotation vectors and rotation matrices, and compute their rates."""

import numpy as np

from ..model.rotation import skew

SMALL = 1e-3  # rad; below it, series have no error that double precision could show
NO_AXIS = 1e-7  # rad; below it, a rotation has no axis that could be told from round-off


def rotation(p: np.ndarray) -> np.ndarray:
    """Return a (3, 3) from body to inertial axes of a quaternion (w, x, y, z) of any length; (k, 3, 3) of (k, 4)."""
    return _scipy().from_quat(p[..., [1, 2, 3, 0]]).as_matrix()  # SciPy puts the scalar last


def quaternion(vector) -> np.ndarray:
    """Return the unit quaternion (w, x, y, z) of a rotation vector (3,) in rad."""
    return np.roll(_scipy().from_rotvec(vector).as_quat(), 1)


def quaternion_rate(p: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Return p' of a body that turns with omega (3,) in body axes."""
    w, x, y, z = p
    matrix = np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])
    return 0.5 * matrix @ omega


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a x b (3,), in a fraction of numpy's time."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def of_vector(vector) -> np.ndarray:
    """Return the rotation matrix exp(skew(vector)) of a rotation vector (3,), exactly (Rodrigues)."""
    return _scipy().from_rotvec(vector).as_matrix()


def vector_of(matrix) -> np.ndarray:
    """Return the rotation vector (3,) of a matrix, or (k, 3) of (k, 3, 3); not longer than pi."""
    return _scipy().from_matrix(matrix).as_rotvec()


def continuous(vectors) -> np.ndarray:
    """Return the same rotations in time, as vectors that may be longer than pi: (nt, ..., 3) of (nt, ..., 3).

    Each differs by whole turns about its axis and is as near as possible to the one before it. Beside a full turn,
    rotations about other axes have no vector near that: a single such time does not change the number of turns.
    """
    rotations = np.array(vectors, dtype=float)
    if not len(rotations):
        return rotations
    steps = np.linalg.norm(np.diff(rotations, axis=0), axis=-1).reshape(len(rotations) - 1, -1)
    turning = np.flatnonzero((steps > 3.0).any(axis=1))  # steps below pi need no turns
    if not turning.size:
        return rotations
    last, lost = rotations[turning[0]], np.zeros(rotations.shape[1:-1], dtype=bool)
    for i in range(turning[0] + 1, len(rotations)):
        near = _nearest(rotations[i], last)
        far = np.linalg.norm(near - last, axis=-1) > np.pi
        near = np.where((far & lost)[..., None], _nearest(rotations[i], rotations[i - 1]), near)
        last = np.where((far & ~lost)[..., None], last, near)
        rotations[i], lost = near, far & ~lost
    return rotations


def _nearest(vector, other):
    """Return `vector` (..., 3) with whole turns about its axis, as near as possible to `other` (..., 3)."""
    angle, length = (np.linalg.norm(turn, axis=-1, keepdims=True) for turn in (vector, other))
    axis = np.where(angle > NO_AXIS, vector / np.maximum(angle, NO_AXIS), other / np.maximum(length, NO_AXIS))
    turns = np.round(((other - vector) * axis).sum(axis=-1, keepdims=True) / (2 * np.pi))
    return vector + 2 * np.pi * turns * axis


def rate_matrix(vector) -> np.ndarray:
    """Return J (3, 3): exp(skew(vector)) turns with J vector' in the axes that it turns in (left Jacobian of the
    rotations).

    J = I + (1 - cos a) / a^2 W + (a - sin a) / a^3 W^2 with W = skew(vector) and a its angle.
    """
    W, a = skew(vector), float(np.linalg.norm(vector))
    if a < SMALL:
        first, second = 1 / 2 - a * a / 24, 1 / 6 - a * a / 120
    else:
        first, second = (1 - np.cos(a)) / a**2, (a - np.sin(a)) / a**3
    return np.eye(3) + first * W + second * W @ W


def _scipy():
    from scipy.spatial.transform import Rotation  # here, since a reduction turns nothing and should start at once

    return Rotation
