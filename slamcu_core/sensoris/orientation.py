"""SENSORIS rotations as matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import WireError
from slamcu_core.sensoris.proto import base_pb2, spatial_pb2

Array = NDArray[np.float64]


def integer(value: base_pb2.Int64Value, default: int | None = None) -> int | None:
    """Return the integer of a SENSORIS value: what it says, or the mean of the Gaussian that it gives instead."""
    if stated := value.value:
        return stated
    if value.HasField("value"):
        return 0
    gaussian = value.gaussian_distribution
    return gaussian.mean.value if gaussian.HasField("mean") else default


def rotation_matrix(rotation: spatial_pb2.RotationAndAccuracy) -> Array:
    """Return the matrix (3, 3) that takes vectors from the rotated axes to the reference axes.

    Euler angles turn about z (yaw), then the new y (pitch), then the new x (roll), each in degrees with exponent 2.

    Raises WireError if no rotation is given or a quaternion has no length.
    """
    kind = rotation.WhichOneof("euler_quaternion")
    if kind is None:
        raise WireError("unresolvable-position", "an orientation has neither Euler angles nor a quaternion")
    if kind in ("euler_vehicle", "euler_event_group"):
        euler = getattr(rotation, kind)
        yaw, pitch, roll = (
            np.deg2rad((integer(angle, 0) or 0) / 100.0) for angle in (euler.yaw, euler.pitch, euler.roll)
        )
        return _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    quaternion = getattr(rotation, kind)
    q = np.array([float(integer(v, 0) or 0) for v in (quaternion.w, quaternion.x, quaternion.y, quaternion.z)])
    length = float(np.linalg.norm(q))
    if length == 0.0:
        raise WireError("unresolvable-position", "a quaternion of length 0, expected 1")
    w, v = q[0] / length, q[1:] / length
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross)


def yaw_variance(rotation: spatial_pb2.RotationAndAccuracy) -> float:
    """Return the variance of the yaw in rad², 0 where the sender states none."""
    kind = rotation.WhichOneof("accuracy")
    if kind == "covariance":
        return float(np.deg2rad(1.0) ** 2 * max(rotation.covariance.a11.value, 0) / 100.0)
    hundredths = rotation.std_dev.yaw.value if kind == "std_dev" else rotation.combined_std_dev.value
    return float(np.deg2rad(hundredths / 100.0) ** 2)


def _about(axis: int, angle: float) -> Array:
    """Return the right-handed rotation (3, 3) about one axis."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [k for k in range(3) if k != axis] if axis != 1 else [2, 0]
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix
