"""Measurement models: the Jacobian against differences, inversion, field of view, occlusion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.drive import Detection, Mount, Occluder, Sensor, SensorKind
from slamcu_core.errors import SlamcuError
from slamcu_core.models import SensorModel, occlusion_probability, visibility_probability

KINDS = st.sampled_from([SensorKind.RANGE_BEARING, SensorKind.POSITION])
POSES = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
AHEAD = st.tuples(st.floats(3, 80), st.floats(-1.2, 1.2))


def _model(kind: SensorKind) -> SensorModel:
    return SensorModel(Sensor("camera", kind=kind, mount=Mount(1.8, 0.3, 5.0)))


def _point(model: SensorModel, pose: np.ndarray, ahead: tuple[float, float]) -> np.ndarray:
    place, direction = model.origin(pose)
    return place + ahead[0] * np.array([np.cos(direction + ahead[1]), np.sin(direction + ahead[1])])


@given(KINDS, POSES, AHEAD)
def test_the_feature_jacobian_is_the_derivative_of_the_measurement(
    kind: SensorKind, at: tuple[float, float, float], ahead: tuple[float, float]
) -> None:
    model, pose = _model(kind), np.array(at)
    point = _point(model, pose, ahead)
    step = 1e-5
    numerical = np.stack(
        [
            model.innovation(model.predict(pose, point + step * axis), model.predict(pose, point - step * axis))
            / (2 * step)
            for axis in np.eye(2)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(model.feature_jacobian(pose, point).matrix, numerical, atol=1e-6)


@given(KINDS, POSES, AHEAD)
def test_inverting_a_measurement_gives_the_point_back(
    kind: SensorKind, at: tuple[float, float, float], ahead: tuple[float, float]
) -> None:
    model, pose = _model(kind), np.array(at)
    point = _point(model, pose, ahead)
    np.testing.assert_allclose(model.invert(pose, model.predict(pose, point)), point, atol=1e-8)


def test_range_noise_grows_with_range_and_the_bearing_innovation_is_wrapped() -> None:
    model = SensorModel(Sensor("camera", range_std_m=0.3, range_std_rel=0.05, bearing_std_rad=0.006))
    np.testing.assert_allclose(np.sqrt(model.noise([40.0, 0.0])), [2.3, 0.006])
    nu = model.innovation(np.array([10.0, 3.1]), np.array([10.0, -3.1]))
    assert nu[1] == pytest.approx(6.2 - 2 * np.pi)


def test_a_detection_without_what_its_sensor_measures_is_refused() -> None:
    with pytest.raises(SlamcuError, match="range and bearing"):
        _model(SensorKind.RANGE_BEARING).measurements([Detection("traffic_sign", x=1.0, y=2.0)])
    with pytest.raises(SlamcuError, match="x and y"):
        _model(SensorKind.POSITION).measurements([Detection("traffic_sign", range=1.0, bearing=2.0)])


def test_visibility_is_the_weight_of_the_particles_that_see_it() -> None:
    sensor = Sensor("camera", fov_deg=40, min_range_m=2, max_range_m=80)
    distance = np.array([[50.0, 50.0], [90.0, 70.0], [1.0, 50.0]])
    bearing = np.deg2rad([[0.0, 19.0], [0.0, 0.0], [0.0, 21.0]])
    np.testing.assert_allclose(visibility_probability(sensor, distance, bearing, np.array([0.25, 0.75])), [1, 0.75, 0])


@pytest.mark.parametrize(
    ("distance", "bearing", "hidden"),
    [(60.0, 0.0, True), (60.0, 0.30, False), (10.0, 0.0, False), (60.0, 0.03, True)],
    ids=["behind", "beside", "before", "behind its side"],
)
def test_a_truck_hides_what_stands_behind_it(distance: float, bearing: float, hidden: bool) -> None:
    truck = Occluder(range=20.0, bearing=0.0, width=2.5)
    chance = occlusion_probability([truck], np.array([distance]), np.array([bearing]), np.array([0.003]))[0]
    assert chance > 0.9 if hidden else chance < 0.1


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_a_truck_behind_the_car_hides_on_both_sides_of_straight_back(turns: int) -> None:
    truck = Occluder(range=20.0, bearing=np.pi - 0.02, width=2.5)
    bearing = np.array([0.02 - np.pi + 2 * np.pi * turns])
    assert occlusion_probability([truck], np.array([60.0]), bearing, np.array([0.003]))[0] > 0.9
