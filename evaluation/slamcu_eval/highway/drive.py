"""One vehicle's drive along the simulated road: the log that it writes, and the truth that its log never contains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    DriveHeader,
    GnssFix,
    Mount,
    ObjectFrame,
    Occluder,
    Odometry,
    Record,
    Sensor,
)
from slamcu_eval.highway.camera import CameraErrors, Looks, draw_camera_errors, film, in_view
from slamcu_eval.highway.motion import MotionErrors, Trajectory, drive_along, measure_gnss, measure_odometry
from slamcu_eval.highway.parameters import CameraParameters, HighwayParameters
from slamcu_eval.highway.traffic import Neighbour, make_traffic, report_objects
from slamcu_eval.highway.world import World

Array = NDArray[np.float64]

CAMERA = "front_camera"
FLEET = "highway-fleet"
_FIRST_START = datetime(2026, 5, 1, 8, 0, tzinfo=UTC)
_START_GAP = timedelta(seconds=20)
_ORDER = {Odometry: 0, GnssFix: 1, ObjectFrame: 2, DetectionFrame: 3}  # records of one instant


@dataclass(frozen=True, slots=True)
class Reference:
    """The true poses of a drive (middle of the rear axle)."""

    t: Array  # (K,) s
    lon: Array  # (K,) degrees
    lat: Array  # (K,) degrees
    heading_deg: Array  # (K,) compass


@dataclass(frozen=True, slots=True)
class Sightings:
    """Where every detection of a drive came from; for the oracle and for tests, never for the filter."""

    t: Array  # (N,) s
    source: NDArray[np.intp]  # (N,) index into World.signs, or a negative code of slamcu_eval.highway.camera
    range: Array  # (N,) m, as reported
    bearing: Array  # (N,) rad, as reported
    camera: Array  # (N, 3) m, m, rad: true place of the camera and the direction that its mount claims


@dataclass(frozen=True, slots=True)
class Exposure:
    """How each of World.signs, standing or gone, lay before the camera: where it is, or where the map has it."""

    frames: NDArray[np.intp]  # (S,) frames with its place in the field of view and reach, hidden or not
    hidden: NDArray[np.intp]  # (S,) those of them in which traffic hid the place
    closest_m: Array  # (S,) least true range among them; inf if there is none


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive log in memory, and beside it what really happened."""

    header: DriveHeader
    records: tuple[Record, ...]
    reference: Reference
    sightings: Sightings
    looks: Looks
    exposure: Exposure
    motion_errors: MotionErrors
    camera_errors: CameraErrors

    @property
    def in_view(self) -> NDArray[np.bool_]:
        """Return for each of World.signs whether its place ever was in view, hidden or not, (S,)."""
        return self.exposure.frames > 0


def make_drive(
    world: World,
    seed: int,
    vehicle: int,
    parameters: HighwayParameters | None = None,
    *,
    departure: datetime | None = None,
) -> Drive:
    """Drive vehicle number `vehicle` along a world; equal arguments give equal drives, whatever the fleet's size.

    Without a `departure` the vehicles set out 20 s after each other.
    """
    p = parameters or HighwayParameters()
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence([seed, 1, vehicle]).spawn(5)]
    path = drive_along(world, p.vehicle, streams[0])
    odometry, motion_errors = measure_odometry(path, p.vehicle, streams[1])
    fixes, start = measure_gnss(path, world, p.vehicle, streams[2])
    times = np.round(np.arange(1, int(path.t[-1] * p.camera.rate_hz)) / p.camera.rate_hz, 4)
    pose = path.pose(times)
    eye = pose[:, :2] + p.camera.mount_x_m * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
    camera_errors = draw_camera_errors(p.camera, streams[3])
    axis = pose[:, 2] + camera_errors.mount_yaw
    neighbours = make_traffic(world, path, times, p.traffic, streams[4])
    objects = report_objects(
        neighbours, eye, axis, half_fov=np.deg2rad(p.camera.fov_deg) / 2, p=p.traffic, rng=streams[4]
    )
    frames, looks = film(
        world, eye, axis, neighbours, errors=camera_errors, p=p.camera, traffic=p.traffic, rng=streams[3]
    )
    started = departure or _FIRST_START + vehicle * _START_GAP
    header = DriveHeader(
        vehicle_id=f"veh-{vehicle:03d}",
        session_id=f"{world.name}-{vehicle:03d}-{started:%Y%m%dT%H%M%SZ}",
        start_time=started,
        initial_pose=start,
        sensors=(nominal_camera(p.camera),),
        fleet_id=FLEET,
    )
    camera = np.column_stack([eye, pose[:, 2]])
    return Drive(
        header=header,
        records=_in_order(odometry, fixes, times, frames, objects),
        reference=_reference(path, world),
        sightings=_sightings(times, camera, frames),
        looks=looks,
        exposure=_exposure(world, eye, axis, neighbours, p.camera),
        motion_errors=motion_errors,
        camera_errors=camera_errors,
    )


def nominal_camera(p: CameraParameters) -> Sensor:
    """Return the camera as its data sheet has it: the same for every vehicle, with none of a vehicle's own errors."""
    return Sensor(
        id=CAMERA,
        fov_deg=p.fov_deg,
        min_range_m=p.min_range_m,
        max_range_m=p.max_range_m,
        rate_hz=p.rate_hz,
        mount=Mount(x=p.mount_x_m),
        range_std_m=p.range_std_m,
        range_std_rel=p.range_std_rel,
        bearing_std_rad=p.bearing_std_rad,
        detection_probability=0.85,
        false_alarms_per_frame=p.false_alarms_per_frame,
    )


def _in_order(
    odometry: list[Odometry],
    fixes: list[GnssFix],
    times: Array,
    frames: dict[int, list[tuple[Detection, int]]],
    objects: list[list[Occluder]],
) -> tuple[Record, ...]:
    """Merge the records by time; at one instant motion comes first, then what can hide signs, then signs."""
    records: list[Record] = [*odometry, *fixes]
    for index, t in enumerate(times.tolist()):
        records.append(ObjectFrame(t=t, sensor=CAMERA, items=tuple(objects[index])))
        seen = tuple(detection for detection, _ in frames.get(index, ()))
        records.append(DetectionFrame(t=t, sensor=CAMERA, items=seen))
    records.sort(key=lambda record: (record.t, _ORDER[type(record)]))
    return tuple(records)


def _reference(path: Trajectory, world: World) -> Reference:
    lon, lat = world.frame.to_geographic(path.xy)
    return Reference(path.t, lon, lat, world.compass(path.heading, lon))


def _exposure(world: World, eye: Array, axis: Array, neighbours: Sequence[Neighbour], p: CameraParameters) -> Exposure:
    places = np.array([sign.place or sign.map_place for sign in world.signs], float)
    sign, frame, distance, _ = in_view(places, eye, axis, p)
    hidden = np.zeros(frame.size, bool)
    for neighbour in neighbours:
        hidden |= neighbour.hides(frame, eye[frame], places[sign])
    closest = np.full(len(places), np.inf)
    np.minimum.at(closest, sign, distance)
    return Exposure(
        frames=np.bincount(sign, minlength=len(places)),
        hidden=np.bincount(sign[hidden], minlength=len(places)),
        closest_m=closest,
    )


def _sightings(times: Array, camera: Array, frames: dict[int, list[tuple[Detection, int]]]) -> Sightings:
    rows = [(frame, d.range, d.bearing, source) for frame in sorted(frames) for d, source in frames[frame]]
    frame = np.array([row[0] for row in rows], dtype=np.intp)
    return Sightings(
        t=times[frame],
        source=np.array([row[3] for row in rows], dtype=np.intp),
        range=np.array([row[1] for row in rows], float),
        bearing=np.array([row[2] for row in rows], float),
        camera=camera[frame],
    )
