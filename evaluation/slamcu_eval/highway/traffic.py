"""The other traffic: lorries that are overtaken and vans that overtake, which hide signs and carry painted ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Occluder
from slamcu_eval.highway.motion import Trajectory
from slamcu_eval.highway.parameters import TrafficParameters
from slamcu_eval.highway.signs import PAINTED, SignContent
from slamcu_eval.highway.world import World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_CLEARANCE_M = 0.6  # between the sides of two vehicles, at least
_EGO_WIDTH_M = 1.9
_VAN = (7.0, 2.1)  # m, length and width
_HEADWAY_S = 5.0  # between two encounters in the same lane
_BEHIND_M, _LEAD_IN_S = 25.0, 120.0


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A lorry or van near the ego vehicle, over the camera frames in which it may matter."""

    frames: NDArray[np.intp]  # (F,) indices of camera frames
    rear: Array  # (F, 2) m, middle of the rear face in the world's frame
    heading: Array  # (F,) rad
    length: float  # m
    width: float  # m
    object_class: str
    reported: bool  # whether the object detector knows it at all
    painted: SignContent | None  # a sign on the rear face

    def corners(self, samples: int = 24) -> Array:
        """Return points on the outline, (F, P, 2) in the world's frame."""
        u = np.linspace(0.0, 1.0, samples)
        ends = np.stack([np.zeros_like(u), u - 0.5], axis=-1), np.stack([np.ones_like(u), u - 0.5], axis=-1)
        sides = np.stack([u**2, np.full_like(u, -0.5)], axis=-1), np.stack([u**2, np.full_like(u, 0.5)], axis=-1)
        box = np.concatenate([*ends, *sides]) * np.array([self.length, self.width])
        return self.to_world(box)

    def to_world(self, box: Array) -> Array:
        """Place points (P, 2) of the vehicle's box (x from the rear face forward, y left) in the world, (F, P, 2)."""
        cos, sin = np.cos(self.heading)[:, None], np.sin(self.heading)[:, None]
        return self.rear[:, None, :] + np.stack(
            [cos * box[:, 0] - sin * box[:, 1], sin * box[:, 0] + cos * box[:, 1]], axis=-1
        )

    def hides(self, frame: NDArray[np.intp], eye: Array, target: Array) -> Flags:
        """Tell which lines of sight, (N,) frames with (N, 2) from `eye` to `target`, this vehicle's box cuts."""
        result = np.zeros(frame.size, bool)
        index = np.searchsorted(self.frames, frame)
        here = (index < self.frames.size) & (self.frames[np.minimum(index, self.frames.size - 1)] == frame)
        if not here.any():
            return result
        at = index[here]
        start, end = (self._in_box(points[here], at) for points in (eye, target))
        low, high = np.array([0.0, -self.width / 2]), np.array([self.length, self.width / 2])
        step = end - start
        step = np.where(np.abs(step) < 1e-9, 1e-9, step)
        first, second = (low - start) / step, (high - start) / step
        enter = np.minimum(first, second).max(axis=-1)
        leave = np.maximum(first, second).min(axis=-1)
        result[here] = (enter < leave) & (leave > 0.0) & (enter < 1.0)
        return result

    def _in_box(self, points: Array, at: NDArray[np.intp]) -> Array:
        delta = points - self.rear[at]
        cos, sin = np.cos(self.heading[at]), np.sin(self.heading[at])
        return np.stack([cos * delta[:, 0] + sin * delta[:, 1], -sin * delta[:, 0] + cos * delta[:, 1]], axis=-1)


def make_traffic(
    world: World, path: Trajectory, times: Array, p: TrafficParameters, rng: np.random.Generator
) -> list[Neighbour]:
    """Draw the encounters of a drive; one that would run into the ego vehicle or another truck does not take place.

    Parameters
    ----------
    times : (T,) instants of the camera frames, s.
    """
    neighbours: list[Neighbour] = []
    last: dict[int, float] = {}
    ego_s = np.interp(times, path.t, path.s)
    ego_offset = np.interp(times, path.t, path.offset)
    beside = rng.exponential(p.encounter_interval_s)
    while beside < path.t[-1]:
        overtakes = rng.random() < p.overtaker_share
        lane = len(world.lane_offsets) - 1 if overtakes else int(rng.random() < 0.15 and len(world.lane_offsets) > 2)
        length, width = _VAN if overtakes else (p.truck_length_m, p.truck_width_m)
        ego_speed = float(np.interp(beside, path.t, path.speed))
        speed = ego_speed + rng.uniform(2.0, 6.0) if overtakes else rng.uniform(p.min_speed, p.max_speed)
        ahead = np.interp(beside, path.t, path.s) + speed * (times - beside) - length / 2 - ego_s
        offset = world.lane_offsets[lane] + float(np.clip(rng.normal(0.0, 0.15), -0.4, 0.4))
        paint = PAINTED[0], PAINTED[1][rng.integers(len(PAINTED[1]))]
        painted = paint if rng.random() < p.painted_share else None
        reported = bool(rng.random() >= p.unreported_share)
        near = np.abs(times - beside) < _LEAD_IN_S
        side = np.abs(ego_offset - offset)
        overlap = near & (ahead < 6.0) & (ahead > -length - 3.0) & (side < (width + _EGO_WIDTH_M) / 2 + _CLEARANCE_M)
        frames = np.flatnonzero(near & (ahead > -length - _BEHIND_M) & (ahead < p.sight_m))
        if frames.size and not overlap.any() and beside - last.get(lane, -np.inf) > _HEADWAY_S:
            last[lane] = beside
            s = ego_s[frames] + ahead[frames]
            neighbours.append(
                Neighbour(
                    frames=frames,
                    rear=world.road.place(s, offset),
                    heading=world.road.heading_at(s + length / 2),
                    length=length,
                    width=width,
                    object_class="van" if overtakes else "truck",
                    reported=reported,
                    painted=painted,
                )
            )
        beside += rng.exponential(p.encounter_interval_s)
    return neighbours


def report_objects(
    neighbours: Sequence[Neighbour],
    eye: Array,
    axis: Array,
    *,
    half_fov: float,
    p: TrafficParameters,
    rng: np.random.Generator,
) -> list[list[Occluder]]:
    """Return for each of T frames what the object detector reports of the traffic in the field of view.

    Parameters
    ----------
    eye : (T, 2) places of the camera; axis : (T,) directions in which it looks, rad.
    """
    reports: list[list[Occluder]] = [[] for _ in range(axis.size)]
    for neighbour in neighbours:
        if not neighbour.reported:
            continue
        delta = neighbour.corners() - eye[neighbour.frames][:, None, :]
        angle = np.arctan2(delta[..., 1], delta[..., 0]) - axis[neighbour.frames][:, None]
        angle = (angle + np.pi) % (2.0 * np.pi) - np.pi
        seen = np.abs(angle) <= half_fov
        distance = np.where(seen, np.hypot(delta[..., 0], delta[..., 1]), np.inf).min(axis=1)
        low, high = np.where(seen, angle, np.inf).min(axis=1), np.where(seen, angle, -np.inf).max(axis=1)
        told = seen.any(axis=1) & (distance < p.sight_m) & (rng.random(distance.size) < p.report_probability)
        for i in np.flatnonzero(told):
            noise = rng.normal(size=3)
            true_width = 2.0 * distance[i] * np.tan((high[i] - low[i]) / 2)
            reports[neighbour.frames[i]].append(
                Occluder(
                    range=round(max(0.5, distance[i] + (p.range_std_m + p.range_std_rel * distance[i]) * noise[0]), 2),
                    bearing=round(float((low[i] + high[i]) / 2 + p.bearing_std_rad * noise[1]), 4),
                    width=round(max(0.1, float(true_width * (1.0 + p.width_std_rel * noise[2]))), 2),
                    object_class=neighbour.object_class,
                )
            )
    return reports
