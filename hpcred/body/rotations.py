"""Convert between quaternions, rotation vectors and rotation matrices, and compute their rates."""

import numpy as np

from ..model.rotation import skew

SMALL = 1e-3  # rad; below it, series have no error that double precision could show
IDENTITY = np.eye(3)
NO_AXIS = 1e-7  # rad; below it, a rotation has no axis that could be told from round-off


def rotation(p: np.ndarray) -> np.ndarray:
    """Return a (3, 3) from body to inertial axes of a quaternion (w, x, y, z) of any length; (k, 3, 3) of (k, 4)."""
    if p.ndim > 1:
        return _scipy().from_quat(p[..., [1, 2, 3, 0]]).as_matrix()  # SciPy puts the scalar last
    w, x, y, z = p.tolist()  # one alone, as each evaluation of equations of motion has it, in a tenth of SciPy's time
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array([
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ])  # fmt: skip


def quaternion(vector) -> np.ndarray:
    """Return the unit quaternion (w, x, y, z) of a rotation vector (3,) in rad."""
    return np.roll(_scipy().from_rotvec(vector).as_quat(), 1)


def quaternion_rate(p: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Return p' of a body that turns with omega (3,) in body axes."""
    return 0.5 * rate_of_quaternion(p) @ omega


def rate_of_quaternion(p: np.ndarray) -> np.ndarray:
    """Return Q (4, 3): p' = Q omega / 2, and omega = 2 Q^T p' of a unit quaternion."""
    w, x, y, z = p.tolist()
    return np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a x b (3,), in a fraction of numpy's time."""
    (a, b, c), (x, y, z) = a.tolist(), b.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def of_vector(vector) -> np.ndarray:
    """Return the rotation matrix exp(skew(vector)) of a rotation vector (3,), exactly; (k, 3, 3) of (k, 3)."""
    return exponential(vector)[0] if np.ndim(vector) == 1 else _scipy().from_rotvec(vector).as_matrix()


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
    return exponential(vector)[1]


def exponential(vector) -> tuple[np.ndarray, np.ndarray]:
    """Return of_vector and rate_matrix of a vector (3,)."""
    W, (sine, first, second) = skew(vector), _coefficients(vector)[:3]
    square = W @ W
    return IDENTITY + sine * W + first * square, IDENTITY + first * W + second * square


def _coefficients(vector):
    """Return sin a / a, (1 - cos a) / a^2 and (a - sin a) / a^3, and the slopes of the latter two by a, over a."""
    square = float(np.dot(vector, vector))
    if square < SMALL**2:
        return (1 - square / 6 + square**2 / 120, 1 / 2 - square / 24, 1 / 6 - square / 120,
                square / 180 - 1 / 12, square / 1260 - 1 / 60)  # fmt: skip
    a = np.sqrt(square)
    sine, first = np.sin(a) / a, (1 - np.cos(a)) / square
    second = (1 - sine) / square
    return sine, first, second, (sine - 2 * first) / square, (first - 3 * second) / square


def rate_derivative(vector, moment) -> np.ndarray:
    """Return the derivative (3, 3) of J(vector)^T moment by the vector, with J = rate_matrix; that of J(vector) y is
    minus it at -vector."""
    _, first, second, first_slope, second_slope = _coefficients(vector)
    W, T = skew(vector), skew(moment)
    turned = W @ moment
    return (
        first * T - second * (skew(turned) + W @ T)
        + np.outer(second_slope * (W @ turned) - first_slope * turned, vector)
    )  # fmt: skip


def _scipy():
    from scipy.spatial.transform import Rotation  # here, since a reduction turns nothing and should start at once

    return Rotation
