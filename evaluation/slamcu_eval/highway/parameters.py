"""Every number of the simulated motorway, in the unit and with the reason that stands beside it.

The sensor is never better than the floors of `docs/simulator.md`; `tests/evaluation` measures that from the output.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

from slamcu_core.errors import SlamcuError


@dataclass(frozen=True, slots=True)
class WorldParameters:
    """The road, its signs and how far the map is out of date (paper §6.1 unless said otherwise)."""

    length_m: float = 20_000.0  # paper: 20 km of motorway
    anchor_lon: float = 2.1  # degrees; the paper's drive was in France
    anchor_lat: float = 48.9  # degrees
    lanes: int = 3
    lane_width_m: float = 3.5
    min_radius_m: float = 1_500.0  # sharpest curve; smallest usual radius of a 130 km/h motorway
    normal: int = 55  # paper, table 1
    deleted: int = 9  # paper, table 1
    new: int = 39  # paper, table 1
    moved: int = 0  # beyond the paper
    moved_min_m: float = 5.0  # along the road
    moved_max_m: float = 25.0
    modified: int = 0  # beyond the paper
    grouped_share: float = 0.35  # share of signs that stand in pairs: both sides of the road, gantries, doubled posts
    map_error_std_m: float = 0.12  # each axis; paper §2: 10 to 20 cm accuracy
    road_name: str = "highway"


@dataclass(frozen=True, slots=True)
class VehicleParameters:
    """How a vehicle drives, and its odometry and satellite receiver (own choice, series-production grade)."""

    min_speed: float = 25.0  # m/s; evaluation contract: 25 to 36 m/s
    max_speed: float = 36.0  # m/s
    lane_change_interval_s: float = 45.0  # mean time between lane changes
    lane_wander_std_m: float = 0.2
    odometry_rate_hz: float = 50.0
    speed_scale_std: float = 0.0075  # 1 sigma per vehicle, constant: tyre radius
    speed_noise_std: float = 0.05  # m/s, white at 50 Hz
    gyro_bias_std: float = 5e-4  # rad/s, 1 sigma per vehicle at the start
    gyro_bias_walk: float = 2e-5  # rad/s per root second
    gyro_scale_std: float = 0.005  # 1 sigma per vehicle
    gyro_noise_std: float = 2e-3  # rad/s, white at 50 Hz
    gnss_rate_hz: float = 1.0
    gnss_bias_std_m: float = 1.5  # each axis, Gauss-Markov
    gnss_bias_time_s: float = 180.0  # correlation time of that bias
    gnss_noise_std_m: float = 0.5  # each axis, white
    start_heading_std_deg: float = 2.0


@dataclass(frozen=True, slots=True)
class CameraParameters:
    """How the sign camera sees and errs (paper §6.1 for rate, field of view, reach; else the evaluation's floors)."""

    rate_hz: float = 15.0
    fov_deg: float = 40.0
    min_range_m: float = 4.0
    max_range_m: float = 80.0
    mount_x_m: float = 1.8  # ahead of the rear axle
    range_std_m: float = 0.3  # white per frame; floor 0.3 m + 5 % of range
    range_std_rel: float = 0.05
    range_bias_std: float = 0.018  # 1 sigma per vehicle, constant scale error of range; floor 1.5 %
    common_range_bias: float = 0.0  # scale error shared by every car of a fleet
    pass_range_std: float = 0.015  # scale error of range common to one pass (size and height of the sign's face)
    pass_range_time_s: float = 2.0  # correlation time of that error: nearly constant within a pass
    bearing_std_rad: float = 0.006  # white per frame
    pass_bearing_std_rad: float = 0.001  # common to one pass
    mount_yaw_std_rad: float = 0.003  # 1 sigma per vehicle, constant: calibration of the mount
    good_detection: float = 0.95  # probability of a detection per frame outside a burst of misses
    bad_detection: float = 0.10  # and inside one
    bad_share: float = 0.10  # stationary share of frames inside a burst: 0.95 * 0.9 + 0.1 * 0.1 = 0.865 <= 0.9
    bad_frames: float = 6.0  # mean length of a burst in frames
    far_fade_from_m: float = 60.0  # beyond, the detection probability falls linearly ...
    far_fade_to: float = 0.7  # ... to this share of it at max_range_m
    false_alarms_per_frame: float = 0.022  # uniform in the field of view, independent; floor 0.02
    ghosts_per_s: float = 0.05  # short-lived correlated false alarms: a reflection or a poster held for a sign
    ghost_frames_max: int = 5  # a ghost lasts 2 to this many frames
    ghost_fixed_share: float = 0.3  # share of ghosts that stand still in the world; the rest moves with the vehicle
    unread_near: float = 0.02  # share of detections without a sign type, at range 0 ...
    unread_far: float = 0.17  # ... and at max_range_m (grows with the square)
    misread: float = 0.02  # share of detections with another type or value
    reported_confidence: tuple[float, float] = (0.85, 0.95)  # uniform, independent of truth; paper: 0.9


@dataclass(frozen=True, slots=True)
class TrafficParameters:
    """The trucks that hide signs and carry painted ones (own choice; floor: 1 % of passes wholly hidden)."""

    encounter_interval_s: float = 50.0  # mean time between vehicles met; hides 1.5 to 2 % of passes (paper: 1 of 55)
    min_speed: float = 21.5  # m/s; trucks go 77 to 85 km/h
    max_speed: float = 23.5
    overtaker_share: float = 0.15  # share of encounters with a coach on the left that overtakes
    truck_length_m: float = 16.5  # articulated lorry, EU maximum
    truck_width_m: float = 2.55
    sight_m: float = 100.0  # reach of the object detector
    unreported_share: float = 0.10  # share of trucks that the object detector never reports
    report_probability: float = 0.95  # per frame, for the others
    range_std_m: float = 0.3  # of the reported near face, plus 2 % of range
    range_std_rel: float = 0.02
    bearing_std_rad: float = 0.005
    width_std_rel: float = 0.08
    painted_share: float = 0.25  # share of trucks with a painted sign on the rear
    painted_detection: float = 0.6  # per frame, within painted_reach_m
    painted_reach_m: float = 60.0


@dataclass(frozen=True, slots=True)
class HighwayParameters:
    """All parameters of a simulated motorway."""

    world: WorldParameters = field(default_factory=WorldParameters)
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    camera: CameraParameters = field(default_factory=CameraParameters)
    traffic: TrafficParameters = field(default_factory=TrafficParameters)

    def having(self, **changes: Any) -> HighwayParameters:
        """Return these parameters with some fields changed, each named `group_field` or, if unambiguous, `field`.

        Raises SlamcuError for a name that no group or more than one group has.
        """
        result = self
        for name, value in changes.items():
            group, leaf = self._find(name)
            result = replace(result, **{group: replace(getattr(result, group), **{leaf: value})})
        return result

    def _find(self, name: str) -> tuple[str, str]:
        groups = {item.name: {leaf.name for leaf in fields(getattr(self, item.name))} for item in fields(self)}
        hits = [(group, name) for group, leaves in groups.items() if name in leaves]
        hits += [
            (g, name.removeprefix(g + "_")) for g, leaves in groups.items() if name.removeprefix(g + "_") in leaves
        ]
        hits = list(dict.fromkeys(hits))
        if len(hits) != 1:
            raise SlamcuError(f"{name}: {'ambiguous' if hits else 'unknown'} simulation parameter")
        return hits[0]
