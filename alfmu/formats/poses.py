"""Poses as numbers: a rotation matrix (3, 3) and a position (3,) [m]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_NOISE = 4e-16
"""Round-off of an entry over the largest of its vector: cos(pi/2) is 6e-17 in floating point."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a frame in another: `turn` rotates from its axes to those of the other."""

    place: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.eye(3))

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.at(other.place), self.turn @ other.turn)

    def at(self, point: Array) -> Array:
        """Transform a point of the frame to the other's axes."""
        return self.place + self.turn @ point

    @property
    def inverse(self) -> Pose:
        return Pose(-self.turn.T @ self.place, self.turn.T)


def vector(numbers: Sequence[float]) -> Array:
    return np.array(numbers, dtype=float)


def about(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) by an angle [rad] about a direction."""
    return _exact(Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix())


def of_quaternion(wxyz: Sequence[float]) -> Array:
    """Return the rotation (3, 3) of a quaternion, its real part first."""
    w, x, y, z = wxyz
    return _exact(Rotation.from_quat((x, y, z, w)).as_matrix())


def turned(sequence: str, angles: Sequence[float]) -> Array:
    """Return the rotation by three angles [rad] about moving axes (xyz) or fixed axes (XYZ)."""
    turn = np.eye(3)
    for letter, angle in zip(sequence, angles, strict=True):
        each = about(np.eye(3)["xyz".index(letter.lower())], angle)
        turn = turn @ each if letter.islower() else each @ turn
    return turn


def quaternion(turn: Array) -> Array:
    """Return Euler parameters (4,) of a rotation, the first nonnegative."""
    x, y, z, w = Rotation.from_matrix(turn).as_quat()
    return vector((w, x, y, z)) * (1.0 if w >= 0 else -1.0)


def cleaned(values: Array) -> Array:
    """Round numbers to 15 digits, which removes round-off of rotations by right angles."""
    size = np.abs(values).max(initial=0.0)
    flat = [float(f"{x:.15g}") if abs(x) > 4 * _NOISE * size else 0.0 for x in values.ravel().tolist()]
    return np.array(flat).reshape(values.shape)


def _exact(turn: Array) -> Array:
    """Return a rotation in which entries within round-off of 0 or 1 are set to it."""
    nearest = np.round(turn)
    return np.where(np.abs(turn - nearest) < _NOISE, nearest, turn)
