"""The accuracy of a SENSORIS position, in each of its four forms, as one covariance matrix."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import WireError
from slamcu_core.sensoris.proto import base_pb2, spatial_pb2

Array = NDArray[np.float64]

UNKNOWN_ALTITUDE_VARIANCE_MM2 = (100 * 1000) ** 2
"""A planar filter knows nothing of height: 100 m (1 σ), stated so that no receiver takes it for exact."""

_MM2 = 1e6  # mm² in a m²


def write_covariance(target: base_pb2.Int64Matrix3x3, covariance_m2: tuple[float, float, float]) -> None:
    """Set a matrix in mm² to [xx, xy, yy] in m², rounded so that it stays positive definite."""
    xx, yy = (max(1, round(v * _MM2)) for v in (covariance_m2[0], covariance_m2[2]))
    most = math.isqrt(xx * yy - 1)
    xy = max(-most, min(most, round(covariance_m2[1] * _MM2)))
    target.a11.value, target.a22.value, target.a33.value = xx, yy, UNKNOWN_ALTITUDE_VARIANCE_MM2
    target.a12.value = target.a21.value = xy


def east_north_covariance(
    position: spatial_pb2.PositionAndAccuracy, default_std_m: float
) -> tuple[float, float, float]:
    """Return the covariance [xx, xy, yy] in m² of a geographic position. Raises as `horizontal_covariance` does."""
    if position.WhichOneof("accuracy") == "covariance":
        xx, xy, yy = _checked(position.covariance)
        return xx / _MM2, xy / _MM2, yy / _MM2
    covariance = horizontal_covariance(position, default_std_m)
    return float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])


def horizontal_covariance(position: spatial_pb2.PositionAndAccuracy, default_std_m: float) -> Array:
    """Return the covariance (3, 3) in m² of a position's accuracy, in the axes of the position.

    An ellipse's axes are read as standard deviations along them (the interface names no level of confidence, and this
    errs to the vague side) and are east-north, for its heading is from north. Without any, `default_std_m`.

    Raises WireError with reason ``bad-covariance`` where a standard deviation is not positive, or the horizontal part
    of a covariance is not symmetric and positive definite.
    """
    kind = position.WhichOneof("accuracy")
    if kind is None:
        return np.eye(3) * default_std_m**2
    if kind == "combined_std_dev":
        return np.eye(3) * _std_m("combined_std_dev", position.combined_std_dev.value) ** 2
    if kind == "std_dev":
        horizontal = _std_m("std_dev.horizontal", position.std_dev.horizontal.value)
        vertical = max(position.std_dev.vertical.value, 0) / 1e3
        return np.diag([horizontal, horizontal, vertical]) ** 2
    if kind == "covariance":
        return _matrix(position.covariance)
    ellipse = position.horizontal_confidence_ellipse_vertical_std_dev
    major = _std_m("horizontal_ellipse_major", ellipse.horizontal_ellipse_major.value)
    minor = _std_m("horizontal_ellipse_minor", ellipse.horizontal_ellipse_minor.value)
    heading = np.deg2rad(ellipse.horizontal_ellipse_major_heading.value / 100.0)
    along, across = np.array([np.sin(heading), np.cos(heading)]), np.array([np.cos(heading), -np.sin(heading)])
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = major**2 * np.outer(along, along) + minor**2 * np.outer(across, across)
    covariance[2, 2] = (max(ellipse.vertical.value, 0) / 1e3) ** 2
    return covariance


def _std_m(name: str, millimetres: int) -> float:
    if millimetres <= 0:
        raise WireError("bad-covariance", f"{name} is {millimetres} mm, expected a positive standard deviation")
    return millimetres / 1e3


def _matrix(matrix: base_pb2.Int64Matrix3x3) -> Array:
    _checked(matrix)
    rows = np.array(
        [
            [matrix.a11.value, matrix.a12.value, matrix.a13.value],
            [matrix.a21.value, matrix.a22.value, matrix.a23.value],
            [matrix.a31.value, matrix.a32.value, matrix.a33.value],
        ],
        float,
    )
    return rows / _MM2


def _checked(matrix: base_pb2.Int64Matrix3x3) -> tuple[float, float, float]:
    """Return the horizontal part [xx, xy, yy] in mm². Raises WireError unless it is a covariance."""
    xx, xy = float(matrix.a11.value), float(matrix.a12.value)
    yx, yy = float(matrix.a21.value), float(matrix.a22.value)
    if xy != yx or not (xx > 0 and xx * yy - xy * xy > 0):
        raise WireError(
            "bad-covariance",
            f"the covariance (a11, a12, a21, a22) = ({xx:g}, {xy:g}, {yx:g}, {yy:g}) mm² "
            "is not symmetric and positive definite",
        )
    return xx, xy, yy
