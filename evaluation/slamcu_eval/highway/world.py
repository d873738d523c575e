"""The simulated world: a road, the signs that stand beside it, and the HD map that is out of date."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import SlamcuError
from slamcu_core.formats.results import ChangeState
from slamcu_core.geometry import LocalFrame, math_to_compass
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity
from slamcu_eval.highway.parameters import WorldParameters
from slamcu_eval.highway.road import Road, make_road
from slamcu_eval.highway.signs import draw_other_sign, draw_sign

Array = NDArray[np.float64]
Place = tuple[float, float]

_CLEAR_M = 150.0  # no sign closer than this to either end: every sign can be passed whole
_GAP_M = 25.0  # along the road between signs that do not belong together
_FIRST_OBJECT_ID = 1001
_KINDS = tuple(kind for kind in ChangeState if kind is not ChangeState.UNCLASSIFIED)


@dataclass(frozen=True, slots=True)
class WorldSign:
    """One sign, as the world has it and as the map has it; None where it has none."""

    truth: ChangeState
    heading: float  # rad; the way its face looks
    place: Place | None  # m in the world's frame
    sign: str | None
    value: str | None
    map_place: Place | None
    map_sign: str | None
    map_value: str | None
    map_object_id: int | None


@dataclass(frozen=True, slots=True)
class World:
    """A road, its signs, and the map that a fleet compares it with."""

    name: str
    frame: LocalFrame
    road: Road
    length_m: float
    lane_offsets: tuple[float, ...]  # m left of the centre line, right lane first
    signs: tuple[WorldSign, ...]
    standing: NDArray[np.intp]  # (N,) indices into signs of those that stand in the world
    places: Array  # (N, 2) m, of the standing signs
    hd_map: HDMap

    def compass(self, heading: Array, lon: Array) -> Array:
        """Turn headings in the world's frame (rad) at longitudes into compass degrees there.

        Meridians converge: east of the anchor, north leans to the west of the frame's y axis.
        """
        convergence = (lon - self.frame.lon) * np.sin(np.deg2rad(self.frame.lat))
        return np.asarray((90.0 - np.rad2deg(heading) + convergence) % 360.0)


def make_world(seed: int, parameters: WorldParameters | None = None) -> World:
    """Draw a world; equal seeds and parameters give equal worlds.

    Raises SlamcuError if the road is too short for its signs.
    """
    p = parameters or WorldParameters()
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0]))
    frame = LocalFrame(p.anchor_lon, p.anchor_lat)
    road = make_road(p.length_m, p.min_radius_m, rng)
    truths = [truth for truth in _KINDS for _ in range(getattr(p, truth.value))]
    truths = [truths[i] for i in rng.permutation(len(truths))]
    sites = _draw_sites(len(truths), p, rng)
    signs: list[WorldSign] = []
    mapped = 0
    for truth, (s, offset, content) in zip(truths, sites, strict=True):
        signs.append(
            _draw_history(
                truth,
                s=s,
                offset=offset,
                content=content,
                road=road,
                p=p,
                rng=rng,
                object_id=_FIRST_OBJECT_ID + mapped,
            )
        )
        mapped += truth is not ChangeState.NEW  # ids without gaps: the map must not tell where it lacks signs
    standing = np.array([i for i, sign in enumerate(signs) if sign.place is not None], dtype=np.intp)
    places = np.array([signs[i].place for i in standing], float).reshape(-1, 2)
    lanes = tuple((lane - (p.lanes - 1) / 2) * p.lane_width_m for lane in range(p.lanes))
    name = f"{p.road_name}-{seed}"
    hd_map = HDMap(_map_features(signs, frame), MapIdentity(name, "1"))
    return World(name, frame, road, p.length_m, lanes, tuple(signs), standing, places, hd_map)


def _draw_sites(
    count: int, p: WorldParameters, rng: np.random.Generator
) -> list[tuple[float, float, tuple[str, str | None]]]:
    """Draw arc length, offset and content of signs, some of them in close pairs."""
    pairs = round(count * p.grouped_share / 2)
    groups = count - pairs
    room = p.length_m - 2 * _CLEAR_M - groups * _GAP_M
    if room <= 0:
        raise SlamcuError(f"a road of {p.length_m:.0f} m is too short for {count} signs")
    starts = _CLEAR_M + np.sort(rng.uniform(0.0, room, groups)) + _GAP_M * np.arange(groups)
    paired = np.zeros(groups, bool)
    paired[rng.choice(groups, pairs, replace=False)] = True
    edge = p.lanes * p.lane_width_m / 2
    sites = []
    for s, pair in zip(starts.tolist(), paired, strict=True):
        content = draw_sign(rng)
        right, left = -edge - rng.uniform(3.0, 5.0), edge + rng.uniform(1.2, 2.5)
        if not pair:
            sites.append((s, right if rng.random() < 0.75 else left, content))
            continue
        layout = rng.random()
        if layout < 0.4:  # the same sign on both sides of the carriageway
            sites += [(s, right, content), (s + rng.normal(0.0, 0.3), left, content)]
        elif layout < 0.7:  # two signs on a gantry, over neighbouring lanes
            lane = rng.uniform(-edge + 1.0, edge - 5.0)
            sites += [(s, lane, content), (s, lane + rng.uniform(2.0, 4.0), draw_sign(rng))]
        else:  # two posts one behind the other
            sites += [(s, right, content), (s + rng.uniform(2.0, 4.0), right + rng.normal(0.0, 0.3), draw_sign(rng))]
    return sites


def _draw_history(
    truth: ChangeState,
    *,
    s: float,
    offset: float,
    content: tuple[str, str | None],
    road: Road,
    p: WorldParameters,
    rng: np.random.Generator,
    object_id: int,
) -> WorldSign:
    """Draw what the map has of a sign and what the world has now."""
    now = then = _point(road, s, offset)
    old = content
    if truth is ChangeState.MOVED:
        along = rng.choice([-1.0, 1.0]) * rng.uniform(p.moved_min_m, p.moved_max_m)
        then = _point(road, s + along, offset + rng.normal(0.0, 0.5))
    if truth is ChangeState.MODIFIED:
        old = draw_other_sign(content, rng)
    error = rng.normal(0.0, p.map_error_std_m, 2)
    mapped = truth is not ChangeState.NEW
    stands = truth is not ChangeState.DELETED
    return WorldSign(
        truth=truth,
        heading=float(road.heading_at(s) + np.pi),
        place=now if stands else None,
        sign=content[0] if stands else None,
        value=content[1] if stands else None,
        map_place=(then[0] + float(error[0]), then[1] + float(error[1])) if mapped else None,
        map_sign=old[0] if mapped else None,
        map_value=old[1] if mapped else None,
        map_object_id=object_id if mapped else None,
    )


def _point(road: Road, s: float, offset: float) -> Place:
    x, y = road.place(s, offset)
    return float(x), float(y)


def _map_features(signs: list[WorldSign], frame: LocalFrame) -> list[MapFeature]:
    """Return what the map has, to 8 decimals of a degree (1 mm), as a map file keeps it."""
    features = []
    for sign in signs:
        if sign.map_place is None or sign.map_object_id is None:
            continue
        lon, lat = frame.to_geographic(np.array(sign.map_place))
        features.append(
            MapFeature(
                object_id=sign.map_object_id,
                lon=round(float(lon), 8),
                lat=round(float(lat), 8),
                sign=sign.map_sign,
                value=sign.map_value,
                heading_deg=round(math_to_compass(sign.heading), 1),
            )
        )
    return features
