"""What the sign camera sees: signs in bursts, wrong ranges, false alarms, ghosts and signs painted on lorries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection
from slamcu_core.geometry import wrap_angle
from slamcu_eval.highway.motion import gauss_markov
from slamcu_eval.highway.parameters import CameraParameters, TrafficParameters
from slamcu_eval.highway.signs import SignContent, draw_other_sign, draw_sign
from slamcu_eval.highway.traffic import Neighbour
from slamcu_eval.highway.world import World

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

FALSE_ALARM, GHOST, PAINTED_SIGN = -1, -2, -3  # sources of detections that are no sign of the world


@dataclass(frozen=True, slots=True)
class CameraErrors:
    """The constants that a vehicle's camera has wrong; truth, never written to a log."""

    range_scale: float  # measured range is (1 + range_scale) times the true one
    mount_yaw: float  # rad; the camera looks further left than its mount says


@dataclass(frozen=True, slots=True)
class Looks:
    """Every frame in which a standing sign was in the camera's field of view and reach."""

    sign: Indices  # (N,) indices into World.signs
    frame: Indices  # (N,)
    range: Array  # (N,) true, m
    hidden: NDArray[np.bool_]  # (N,) behind a truck
    detected: NDArray[np.bool_]  # (N,)


@dataclass(slots=True)
class _Film:
    """Detections by frame, each with its source: an index into World.signs, or one of the negative codes."""

    p: CameraParameters
    errors: CameraErrors
    rng: np.random.Generator
    frames: dict[int, list[tuple[Detection, int]]] = field(default_factory=dict)

    def add(self, frame: int, distance: float, bearing: float, content: SignContent, source: int) -> None:
        """Put one detection at a measured range and bearing on a frame, read well or badly."""
        p, rng = self.p, self.rng
        sign: str | None
        sign, value = content
        if rng.random() < p.misread:
            sign, value = draw_other_sign(content, rng)
        if rng.random() < p.unread_near + (p.unread_far - p.unread_near) * (distance / p.max_range_m) ** 2:
            sign = value = None
        detection = Detection(
            feature_class="traffic_sign",
            range=round(max(distance, 0.5), 3),
            bearing=round(bearing, 5),
            sign=sign,
            value=value,
            confidence=round(float(rng.uniform(*p.reported_confidence)), 3),
        )
        self.frames.setdefault(frame, []).append((detection, source))

    def measure(self, distance: float, bearing: float, scale: float = 0.0, turn: float = 0.0) -> tuple[float, float]:
        """Return a range and bearing as measured, with the vehicle's own and a pass's errors."""
        std = self.p.range_std_m + self.p.range_std_rel * distance
        return (
            distance * (1.0 + self.errors.range_scale + scale) + std * self.rng.normal(),
            bearing + turn + self.p.bearing_std_rad * self.rng.normal(),
        )


def draw_camera_errors(p: CameraParameters, rng: np.random.Generator) -> CameraErrors:
    """Draw what one vehicle's camera has wrong for good."""
    return CameraErrors(
        range_scale=float(p.common_range_bias + rng.normal(0.0, p.range_bias_std)),
        mount_yaw=float(rng.normal(0.0, p.mount_yaw_std_rad)),
    )


def film(
    world: World,
    eye: Array,
    axis: Array,
    neighbours: Sequence[Neighbour],
    *,
    errors: CameraErrors,
    p: CameraParameters,
    traffic: TrafficParameters,
    rng: np.random.Generator,
) -> tuple[dict[int, list[tuple[Detection, int]]], Looks]:
    """Film a drive.

    Parameters
    ----------
    eye : (T, 2) places of the camera, m; axis : (T,) directions in which it really looks, rad.

    Returns the detections by frame with their sources, in random order within a frame, and the looks at signs.
    """
    reel = _Film(p, errors, rng)
    looks = _film_signs(world, eye, axis, neighbours, reel)
    _film_false_alarms(axis.size, reel)
    _film_ghosts(eye, axis, reel)
    _film_painted(eye, axis, neighbours, traffic, reel)
    # The order within a frame must not tell signs from false alarms.
    frames = {frame: [items[i] for i in rng.permutation(len(items))] for frame, items in reel.frames.items()}
    return frames, looks


def in_view(places: Array, eye: Array, axis: Array, p: CameraParameters) -> tuple[Indices, Indices, Array, Array]:
    """Return which of N places (N, 2) are in the field of view and reach in which of T frames, hidden or not.

    Parallel arrays, ordered by place and frame: index of the place, of the frame, true range (m) and bearing (rad).
    """
    delta = places[:, None, :] - eye[None, :, :]
    distance = np.hypot(delta[..., 0], delta[..., 1])
    place, frame = np.nonzero((distance <= p.max_range_m) & (distance >= p.min_range_m))
    direction = np.arctan2(delta[place, frame, 1], delta[place, frame, 0])
    bearing: Array = wrap_angle(direction - axis[frame])
    seen = np.abs(bearing) <= np.deg2rad(p.fov_deg) / 2
    place, frame = place[seen], frame[seen]
    return place, frame, distance[place, frame], bearing[seen]


def _film_signs(world: World, eye: Array, axis: Array, neighbours: Sequence[Neighbour], reel: _Film) -> Looks:
    p, rng = reel.p, reel.rng
    standing, frame, r, bearing = in_view(world.places, eye, axis, p)
    hidden = np.zeros(frame.size, bool)
    for neighbour in neighbours:
        hidden |= neighbour.hides(frame, eye[frame], world.places[standing])
    detected = np.zeros(frame.size, bool)
    for place in np.unique(standing):
        rows = np.flatnonzero(standing == place)
        index = int(world.standing[place])
        hit = _detected(r[rows], p, rng) & ~hidden[rows]
        keep = float(np.exp(-1.0 / (p.rate_hz * p.pass_range_time_s)))
        scale = gauss_markov(rows.size, keep, p.pass_range_std, rng)
        turn = float(rng.normal(0.0, p.pass_bearing_std_rad))
        content = world.signs[index].sign or "", world.signs[index].value
        for row, error in zip(rows[hit].tolist(), scale[hit].tolist(), strict=True):
            measured = reel.measure(float(r[row]), float(bearing[row]), error, turn)
            reel.add(int(frame[row]), *measured, content, index)
        detected[rows[hit]] = True
    return Looks(world.standing[standing], frame, r, hidden, detected)


def _detected(distance: Array, p: CameraParameters, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw in which frames of a pass the camera finds a sign: a two-state Markov chain, and fading with range."""
    leave = 1.0 / p.bad_frames
    enter = leave * p.bad_share / (1.0 - p.bad_share)
    bad = np.empty(distance.size, bool)
    draws = rng.random(distance.size)
    state = bool(rng.random() < p.bad_share)
    for i, draw in enumerate(draws.tolist()):
        bad[i] = state
        state = (draw >= leave) if state else (draw < enter)
    fade = (distance - p.far_fade_from_m) / (p.max_range_m - p.far_fade_from_m)
    probability = np.where(bad, p.bad_detection, p.good_detection) * (1.0 - (1.0 - p.far_fade_to) * np.clip(fade, 0, 1))
    return np.asarray(rng.random(distance.size) < probability)


def _film_false_alarms(frames: int, reel: _Film) -> None:
    p, rng = reel.p, reel.rng
    half = np.deg2rad(p.fov_deg) / 2
    for frame in np.repeat(np.arange(frames), rng.poisson(p.false_alarms_per_frame, frames)).tolist():
        distance, bearing = float(rng.uniform(p.min_range_m, p.max_range_m)), float(rng.uniform(-half, half))
        reel.add(frame, distance, bearing, draw_sign(rng), FALSE_ALARM)


def _film_ghosts(eye: Array, axis: Array, reel: _Film) -> None:
    """Add false alarms that last a few frames, fixed in the world or to the vehicle."""
    p, rng = reel.p, reel.rng
    half = np.deg2rad(p.fov_deg) / 2
    for begin in np.flatnonzero(rng.random(axis.size) < p.ghosts_per_s / p.rate_hz).tolist():
        distance, bearing = float(rng.uniform(15.0, p.max_range_m)), float(rng.uniform(-half, half))
        fixed, content = rng.random() < p.ghost_fixed_share, draw_sign(rng)
        direction = axis[begin] + bearing
        place = eye[begin] + distance * np.array([np.cos(direction), np.sin(direction)])
        for frame in range(begin, min(begin + int(rng.integers(2, p.ghost_frames_max + 1)), axis.size)):
            if fixed:
                dx, dy = (place - eye[frame]).tolist()
                distance, bearing = float(np.hypot(dx, dy)), float(wrap_angle(np.arctan2(dy, dx) - axis[frame]))
            if abs(bearing) <= half and distance >= p.min_range_m:
                reel.add(frame, *reel.measure(distance, bearing), content, GHOST)


def _film_painted(
    eye: Array, axis: Array, neighbours: Sequence[Neighbour], traffic: TrafficParameters, reel: _Film
) -> None:
    """Add signs painted on the rear of lorries: they look real, and travel along."""
    half = np.deg2rad(reel.p.fov_deg) / 2
    for carrier in neighbours:
        if carrier.painted is None:
            continue
        frame = carrier.frames
        delta = carrier.rear - eye[frame]
        distance = np.hypot(delta[:, 0], delta[:, 1])
        bearing = wrap_angle(np.arctan2(delta[:, 1], delta[:, 0]) - axis[frame])
        seen = (np.abs(bearing) <= half) & (distance <= traffic.painted_reach_m) & (distance >= reel.p.min_range_m)
        for other in neighbours:
            if other is not carrier:
                seen &= ~other.hides(frame, eye[frame], carrier.rear)
        seen &= reel.rng.random(frame.size) < traffic.painted_detection
        for i in np.flatnonzero(seen).tolist():
            measured = reel.measure(float(distance[i]), float(bearing[i]))
            reel.add(int(frame[i]), *measured, carrier.painted, PAINTED_SIGN)
