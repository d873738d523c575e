"""Positions in every frame and accuracy that the interface has, as longitude, latitude and covariance."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.geometry import LocalFrame
from slamcu_core.reports import MeasuredPosition
from slamcu_core.sensoris import decode_message
from slamcu_core.sensoris.orientation import rotation_matrix
from slamcu_core.sensoris.proto import data_pb2, spatial_pb2

Message = data_pb2.DataMessage
Position = spatial_pb2.PositionAndAccuracy


def place_of(message: Message) -> Position:
    box = message.event_group[0].traffic_regulation_category.traffic_sign[0].rectangular_box_and_accuracy
    return box.center_orientation_size.center_position_and_accuracy


def set_geographic(position: Position, lon: float, lat: float) -> None:
    position.geographic_wgs84.longitude.value = round(lon * 1e8)
    position.geographic_wgs84.latitude.value = round(lat * 1e8)


def read(message: Message) -> MeasuredPosition:
    position = decode_message(message).passes[0].position
    assert position is not None
    return position


def east_north(position: MeasuredPosition) -> tuple[float, float]:
    east, north = LocalFrame(2.1, 48.9).to_local(position.lon, position.lat)
    return float(east), float(north)


@pytest.fixture
def origin(foreign: Message) -> data_pb2.EventGroup.Envelope.Origin:
    """An origin at 2.1, 48.9, and the sign 30 m along x, 4 m along y of it."""
    place = place_of(foreign)
    place.metric_event_group.x.value, place.metric_event_group.y.value = 30_000, 4_000
    origin = foreign.event_group[0].envelope.origin
    set_geographic(origin.position_and_accuracy, 2.1, 48.9)
    return origin


@pytest.fixture
def vehicle(foreign: Message) -> spatial_pb2.RotationAndAccuracy:
    """A pose at 2.1, 48.9 of the sign's instant, and the sign 30 m ahead, 4 m to the left; returns its orientation."""
    place = place_of(foreign)
    place.metric_vehicle.x.value, place.metric_vehicle.y.value = 30_000, 4_000
    pose = foreign.event_group[0].localization_category.vehicle_position_and_orientation.add()
    pose.envelope.timestamp.posix_time.value = 1_777_622_400_001
    set_geographic(pose.position_and_accuracy, 2.1, 48.9)
    return pose.orientation_and_accuracy


def test_without_orientation_an_event_group_is_east_north_up(
    foreign: Message, origin: data_pb2.EventGroup.Envelope.Origin
) -> None:
    assert east_north(read(foreign)) == pytest.approx((30.0, 4.0), abs=1e-3)


def test_an_event_group_may_be_turned(foreign: Message, origin: data_pb2.EventGroup.Envelope.Origin) -> None:
    origin.orientation_and_accuracy.euler_vehicle.yaw.value = 9000  # x north, y west

    assert east_north(read(foreign)) == pytest.approx((-4.0, 30.0), abs=1e-3)


def test_the_uncertainty_of_the_origin_is_added(foreign: Message, origin: data_pb2.EventGroup.Envelope.Origin) -> None:
    place_of(foreign).covariance.a11.value = 40_000  # 0.2 m along x
    place_of(foreign).covariance.a22.value = 90_000  # 0.3 m along y
    origin.position_and_accuracy.combined_std_dev.value = 1000
    origin.orientation_and_accuracy.euler_vehicle.yaw.value = 9000
    origin.orientation_and_accuracy.std_dev.yaw.value = 100  # one degree moves 30 m by 0.52 m

    xx, xy, yy = read(foreign).covariance_m2

    turn = math.radians(1.0) ** 2
    assert xx == pytest.approx(0.09 + 1.0 + turn * 900.0, rel=1e-6)
    assert yy == pytest.approx(0.04 + 1.0 + turn * 16.0, rel=1e-6)
    assert xy == pytest.approx(turn * 120.0, rel=1e-6)


def test_an_event_group_that_is_not_turned_adds_no_uncertainty_of_its_direction(
    foreign: Message, origin: data_pb2.EventGroup.Envelope.Origin
) -> None:
    place_of(foreign).covariance.a11.value = 40_000
    place_of(foreign).covariance.a22.value = 90_000
    origin.position_and_accuracy.combined_std_dev.value = 1000

    assert read(foreign).covariance_m2 == pytest.approx((0.04 + 1.0, 0.0, 0.09 + 1.0), rel=1e-6)


@pytest.mark.parametrize(
    ("yaw", "expected"), [(0, (30.0, 4.0)), (9000, (-4.0, 30.0)), (18000, (-30.0, -4.0)), (27000, (4.0, -30.0))]
)
def test_vehicle_axes_are_those_of_the_same_instant(
    foreign: Message, vehicle: spatial_pb2.RotationAndAccuracy, yaw: int, expected: tuple[float, float]
) -> None:
    vehicle.euler_vehicle.yaw.value = yaw

    assert east_north(read(foreign)) == pytest.approx(expected, abs=1e-3)


def test_a_vehicle_may_itself_be_placed_in_a_turned_event_group(
    foreign: Message, vehicle: spatial_pb2.RotationAndAccuracy
) -> None:
    group = foreign.event_group[0]
    set_geographic(group.envelope.origin.position_and_accuracy, 2.1, 48.9)
    group.envelope.origin.orientation_and_accuracy.euler_vehicle.yaw.value = 9000
    pose = group.localization_category.vehicle_position_and_orientation[0].position_and_accuracy
    pose.metric_event_group.x.value, pose.metric_event_group.y.value = 100_000, 0  # 100 m north
    vehicle.euler_event_group.yaw.value = 27000  # so it looks east again

    assert east_north(read(foreign)) == pytest.approx((30.0, 104.0), abs=1e-2)


def test_a_vehicle_on_the_globe_may_be_turned_as_its_event_group_is(
    foreign: Message, vehicle: spatial_pb2.RotationAndAccuracy
) -> None:
    origin = foreign.event_group[0].envelope.origin
    set_geographic(origin.position_and_accuracy, 2.2, 48.8)
    origin.orientation_and_accuracy.euler_vehicle.yaw.value = 9000
    vehicle.euler_event_group.yaw.value = 9000  # north by the group, so west

    assert east_north(read(foreign)) == pytest.approx((-30.0, -4.0), abs=1e-3)


@given(
    yaw=st.integers(0, 35999),
    pitch=st.integers(-8900, 8900),
    roll=st.integers(-17999, 17999),
)
def test_euler_angles_and_their_quaternion_are_the_same_rotation(yaw: int, pitch: int, roll: int) -> None:
    euler = spatial_pb2.RotationAndAccuracy()
    angles = euler.euler_vehicle
    angles.yaw.value, angles.pitch.value, angles.roll.value = yaw, pitch, roll
    half = [math.radians(angle / 200.0) for angle in (yaw, pitch, roll)]
    (cy, cp, cr), (sy, sp, sr) = map(math.cos, half), map(math.sin, half)
    quaternion = spatial_pb2.RotationAndAccuracy()
    q = quaternion.quaternion_vehicle
    scale = 1e12  # only the direction of a quaternion counts
    q.w.value = round(scale * (cr * cp * cy + sr * sp * sy))
    q.x.value = round(scale * (sr * cp * cy - cr * sp * sy))
    q.y.value = round(scale * (cr * sp * cy + sr * cp * sy))
    q.z.value = round(scale * (cr * cp * sy - sr * sp * cy))

    matrix = rotation_matrix(euler)

    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert np.allclose(rotation_matrix(quaternion), matrix, atol=1e-9)


def set_combined(place: Position) -> None:
    place.combined_std_dev.value = 500


def set_std_dev(place: Position) -> None:
    place.std_dev.horizontal.value, place.std_dev.vertical.value = 500, 2000


def set_covariance(place: Position) -> None:
    place.covariance.a11.value = place.covariance.a22.value = 250_000
    place.covariance.a33.value = 1


def set_ellipse(place: Position) -> None:
    ellipse = place.horizontal_confidence_ellipse_vertical_std_dev
    ellipse.horizontal_ellipse_major.value = ellipse.horizontal_ellipse_minor.value = 500
    ellipse.horizontal_ellipse_major_heading.value = 1234


@pytest.mark.parametrize("state", [set_combined, set_std_dev, set_covariance, set_ellipse])
def test_the_same_accuracy_in_each_of_its_forms(foreign: Message, state: Callable[[Position], None]) -> None:
    state(place_of(foreign))

    assert read(foreign).covariance_m2 == pytest.approx((0.25, 0.0, 0.25), abs=1e-12)


def test_an_ellipse_points_by_the_compass_whatever_the_axes(
    foreign: Message, origin: data_pb2.EventGroup.Envelope.Origin
) -> None:
    ellipse = place_of(foreign).horizontal_confidence_ellipse_vertical_std_dev
    ellipse.horizontal_ellipse_major.value, ellipse.horizontal_ellipse_minor.value = 2000, 1000
    ellipse.horizontal_ellipse_major_heading.value = 9000  # to the east
    origin.orientation_and_accuracy.euler_vehicle.yaw.value = 3300

    assert read(foreign).covariance_m2 == pytest.approx((4.0, 0.0, 1.0), abs=1e-9)


def test_a_gaussian_stands_for_its_mean(foreign: Message) -> None:
    place_of(foreign).geographic_wgs84.longitude.gaussian_distribution.mean.value = 215_000_000

    assert read(foreign).lon == 2.15


def test_across_the_date_line(foreign: Message, origin: data_pb2.EventGroup.Envelope.Origin) -> None:
    set_geographic(origin.position_and_accuracy, 179.9999, 0.0)

    assert read(foreign).lon == pytest.approx(-179.99983, abs=1e-5)
