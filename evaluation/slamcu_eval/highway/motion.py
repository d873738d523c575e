"""How a vehicle moves along the road, and what its odometry and satellite receiver say of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from slamcu_core.drive import GnssFix, InitialPose, Odometry
from slamcu_eval.highway.parameters import VehicleParameters
from slamcu_eval.highway.world import World

Array = NDArray[np.float64]

_LANE_CHANGE_S = 5.0
_LANE_WEIGHTS = (0.3, 0.45, 0.25)  # how often a fast car is in the right, middle and left lane
_WANDER_KNOT_S = 2.5


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The true path of a vehicle (middle of the rear axle), sampled at the rate of its odometry."""

    t: Array  # (K,) s
    s: Array  # (K,) m along the road
    offset: Array  # (K,) m left of its centre line
    xy: Array  # (K, 2) m in the world's frame
    heading: Array  # (K,) rad, unwrapped
    speed: Array  # (K,) m/s

    def pose(self, t: ArrayLike) -> Array:
        """Return the poses (..., 3) of x, y, heading at times of shape (...)."""
        t = np.asarray(t, float)
        return np.stack([np.interp(t, self.t, v) for v in (self.xy[:, 0], self.xy[:, 1], self.heading)], axis=-1)


@dataclass(frozen=True, slots=True)
class MotionErrors:
    """The constants that a vehicle's odometry has wrong; truth, never written to a log."""

    speed_scale: float
    gyro_scale: float
    gyro_bias: float  # rad/s at the start


def drive_along(world: World, p: VehicleParameters, rng: np.random.Generator) -> Trajectory:
    """Drive the whole road once: speed between its bounds, lane keeping, lane changes."""
    dt = 1.0 / p.odometry_rate_hz
    count = int(world.length_m / p.min_speed / dt) + 2
    t = np.arange(count, dtype=np.float64) * dt
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(15.0, 50.0, int(t[-1] / 15.0) + 2))])
    # 1 % inside the bounds, because the outer lane of a curve is longer than the centre line.
    progress = np.interp(t, knots, rng.uniform(1.01 * p.min_speed, 0.99 * p.max_speed, knots.size))
    s = np.concatenate([[0.0], np.cumsum((progress[1:] + progress[:-1]) / 2 * dt)])
    keep = s <= world.length_m
    t, s, progress = t[keep], s[keep], progress[keep]
    offset, sideways = _lateral(t, world.lane_offsets, p, rng)
    forward = progress * (1.0 - world.road.curvature_at(s) * offset)
    heading = world.road.heading_at(s) + np.arctan2(sideways, forward)
    return Trajectory(t, s, offset, world.road.place(s, offset), heading, np.hypot(forward, sideways))


def _lateral(t: Array, lanes: tuple[float, ...], p: VehicleParameters, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return offset from the centre line (m) and its rate (m/s): lane changes on a quintic, and a smooth wander."""
    weights = np.array(_LANE_WEIGHTS) if len(lanes) == len(_LANE_WEIGHTS) else np.ones(len(lanes))
    lane = int(rng.choice(len(lanes), p=weights / weights.sum()))
    offset, rate = np.full_like(t, lanes[lane]), np.zeros_like(t)
    begin = rng.exponential(p.lane_change_interval_s)
    while begin < t[-1] - _LANE_CHANGE_S and len(lanes) > 1:
        neighbours = [n for n in (lane - 1, lane + 1) if 0 <= n < len(lanes)]
        share = weights[neighbours] / weights[neighbours].sum()
        target = int(rng.choice(neighbours, p=share))
        phase = np.clip((t - begin) / _LANE_CHANGE_S, 0.0, 1.0)
        step = lanes[target] - lanes[lane]
        offset += step * phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
        rate += step * 30.0 * phase**2 * (1.0 - phase) ** 2 / _LANE_CHANGE_S
        lane = target
        begin += 2 * _LANE_CHANGE_S + rng.exponential(p.lane_change_interval_s)
    knots = np.arange(0.0, t[-1] + 2 * _WANDER_KNOT_S, _WANDER_KNOT_S)
    wander = CubicSpline(knots, gauss_markov(knots.size, 0.5, p.lane_wander_std_m, rng))
    return offset + wander(t), rate + wander(t, 1)


def gauss_markov(count: int, keep: float, std: float, rng: np.random.Generator) -> Array:
    """Return a stationary first-order Gauss-Markov sequence: std, and correlation `keep` from step to step."""
    noise = rng.normal(0.0, std * np.sqrt(1.0 - keep**2), count)
    if count:
        noise[0] = rng.normal(0.0, std)
    return np.array(list(accumulate(noise.tolist(), lambda last, new: keep * last + new)), dtype=np.float64)


def measure_odometry(
    path: Trajectory, p: VehicleParameters, rng: np.random.Generator
) -> tuple[list[Odometry], MotionErrors]:
    """Return what wheel ticks and gyroscope say: scale errors, a wandering bias and white noise."""
    errors = MotionErrors(
        speed_scale=float(rng.normal(0.0, p.speed_scale_std)),
        gyro_scale=float(rng.normal(0.0, p.gyro_scale_std)),
        gyro_bias=float(rng.normal(0.0, p.gyro_bias_std)),
    )
    count, dt = path.t.size - 1, 1.0 / p.odometry_rate_hz
    speed = (path.speed[1:] + path.speed[:-1]) / 2  # of the step that begins at t: a record holds from t on
    turn = np.diff(path.heading) / dt
    bias = errors.gyro_bias + np.cumsum(rng.normal(0.0, p.gyro_bias_walk * np.sqrt(dt), count))
    speed = speed * (1.0 + errors.speed_scale) + rng.normal(0.0, p.speed_noise_std, count)
    turn = turn * (1.0 + errors.gyro_scale) + bias + rng.normal(0.0, p.gyro_noise_std, count)
    times = np.round(path.t[:-1], 4).tolist()
    records = [
        Odometry(t=t, speed=v, yaw_rate=w)
        for t, v, w in zip(times, np.round(speed, 3).tolist(), np.round(turn, 5).tolist(), strict=True)
    ]
    return records, errors


def measure_gnss(
    path: Trajectory, world: World, p: VehicleParameters, rng: np.random.Generator
) -> tuple[list[GnssFix], InitialPose]:
    """Return the satellite fixes and a start pose that is as wrong as a fix is."""
    step = 1.0 / p.gnss_rate_hz
    times = np.round(np.arange(0.0, path.t[-1], step), 4)
    keep = float(np.exp(-step / p.gnss_bias_time_s))
    error = np.stack([gauss_markov(times.size, keep, p.gnss_bias_std_m, rng) for _ in range(2)], axis=-1)
    error += rng.normal(0.0, p.gnss_noise_std_m, error.shape)
    pose = path.pose(times)
    lon, lat = (np.round(v, 8) for v in world.frame.to_geographic(pose[:, :2] + error))
    std = round(float(np.hypot(p.gnss_bias_std_m, p.gnss_noise_std_m)), 2)
    fixes = [
        GnssFix(t=t, lon=x, lat=y, std_m=std)
        for t, x, y in zip(times[1:].tolist(), lon[1:].tolist(), lat[1:].tolist(), strict=True)
    ]
    true_heading = float(world.compass(pose[0, 2], lon[0]))
    heading = round((true_heading + rng.normal(0.0, p.start_heading_std_deg)) % 360.0, 2) % 360.0
    start = InitialPose(float(lon[0]), float(lat[0]), heading, std, p.start_heading_std_deg)
    return fixes, start
