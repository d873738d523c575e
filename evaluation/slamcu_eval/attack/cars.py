"""What cars report of one drive, at the level of passes: honest ones with their errors, and lost ones.

The filter is not run: its passes are drawn from the model below, whose figures are those of the simulated motorway and
of the filter on it (docs/simulator.md, docs/filter.md), so that ten thousand passes take minutes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from slamcu_core.hd_map import MapFeature
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport
from slamcu_eval.attack.world import FRAME, SIGN, VALUE, Site, World


@dataclass(frozen=True, slots=True)
class PassModel:
    """How an honest car errs in one pass."""

    miss: float = 0.05  # a sign that is there is denied, as for want of detections
    false_sight: float = 0.01  # a sign that is not there is seen where one is expected
    blocked: float = 0.02  # a truck hides the place for the whole pass (simulator: 1.8 to 2.1 %)
    vague: float = 0.2  # the pass tells little: weight 0.3 to 1.5 instead of 2 to 4
    clutter: float = 0.5  # finds of nothing per drive, anywhere (goal of the filter: at most 0.5 false new)
    vehicle_bias_m: float = 0.35  # 1 σ each axis, common to a vehicle's passes
    pass_noise_m: float = 0.45  # 1 σ each axis (together 0.7 m mean error, that of one pass of the filter)

    @property
    def claimed_std_m(self) -> float:
        """What a pass says of its own error."""
        return float(np.hypot(self.vehicle_bias_m, self.pass_noise_m))


@dataclass
class Car:
    """One vehicle with its bias and its randomness."""

    name: str
    rng: np.random.Generator
    model: PassModel = field(default_factory=PassModel)

    def __post_init__(self) -> None:
        self.bias = self.rng.normal(0.0, self.model.vehicle_bias_m, 2)

    def drive(self, world: World, watches: Iterable[MapFeature], begin: datetime) -> list[PassReport]:
        """Return the passes of a drive past every site, by the map and the watch features that it was given."""
        passes: list[PassReport] = []
        watched = [(feature, place_of(feature)) for feature in watches]
        told: set[int] = set()
        for number, site in enumerate(world.sites):
            when = begin + timedelta(seconds=5 * number)
            near = [item for item in watched if np.hypot(*(item[1] - site.xy)) <= 10.0]
            told |= {feature.object_id for feature, _ in near}
            passes += self._at_site(site, near, when)
        for feature, _ in watched:  # clutter of others: nothing is there
            if feature.object_id not in told:
                passes.append(self.look(feature, exists=False, place=None, when=begin))
        for _ in range(self.rng.poisson(self.model.clutter)):
            x = self.rng.uniform(0.0, world.sites[-1].xy[0])
            passes.append(self.find((float(x), float(self.rng.choice([-12.0, 14.0]))), begin))
        return passes

    def _at_site(self, site: Site, near: Sequence[tuple[MapFeature, np.ndarray]], when: datetime) -> list[PassReport]:
        passes = []
        if site.object_id is not None:
            mapped = MapFeature(site.object_id, 0.0, 0.0, sign=SIGN, value=VALUE)
            passes.append(self.look(mapped, exists=site.stands, place=site.xy, when=when))
        stands_unmapped = site.stands and site.object_id is None
        closest = min(near, key=lambda item: float(np.hypot(*(item[1] - site.xy))), default=None)
        for item in near:
            mine = stands_unmapped and item is closest and np.hypot(*(item[1] - site.xy)) <= 3.0
            passes.append(self.look(item[0], exists=bool(mine), place=site.xy, when=when))
            stands_unmapped = stands_unmapped and not mine
        if stands_unmapped and self.rng.random() > self.model.miss + self.model.blocked:
            passes.append(self.find(site.xy, when))
        return passes

    def look(
        self, feature: MapFeature, *, exists: bool, place: tuple[float, float] | None, when: datetime
    ) -> PassReport:
        """Report a mapped or watched feature, with this car's errors."""
        chance = self.rng.random()
        if chance < self.model.blocked:
            return blocked(feature, when)
        wrong = self.rng.random() < (self.model.miss if exists else self.model.false_sight)
        if exists is wrong:
            return missed(feature, when, self.weight())
        return seen(feature, when, self.weight(), self.measure(place if place is not None else place_of(feature)))

    def find(self, xy: tuple[float, float], when: datetime) -> PassReport:
        """Report a sign that no map has."""
        return found(when, self.weight(), self.measure(xy))

    def measure(self, xy: tuple[float, float] | np.ndarray) -> MeasuredPosition:
        """Return a place as this car measures it."""
        return position(
            np.asarray(xy) + self.bias + self.rng.normal(0.0, self.model.pass_noise_m, 2), self.model.claimed_std_m
        )

    def weight(self) -> float:
        """Return the weight of evidence of a pass."""
        vague = self.rng.random() < self.model.vague
        return float(self.rng.uniform(0.3, 1.5) if vague else self.rng.uniform(2.0, 4.0))


@dataclass
class LostCar(Car):
    """A car whose filter has diverged and does not know: all that it sees is elsewhere, and what it expects is not."""

    shift: tuple[float, float] = (9.0, -6.0)  # m

    def _at_site(self, site: Site, near: Sequence[tuple[MapFeature, np.ndarray]], when: datetime) -> list[PassReport]:
        passes = [missed(feature, when, self.weight()) for feature, _ in near]
        if site.object_id is not None:
            passes.append(missed(MapFeature(site.object_id, 0.0, 0.0, sign=SIGN, value=VALUE), when, self.weight()))
        if site.stands and self.rng.random() > self.model.miss:
            passes.append(self.find((site.xy[0] + self.shift[0], site.xy[1] + self.shift[1]), when))
        return passes


def place_of(feature: MapFeature) -> np.ndarray:
    """Return the place (2,) of a feature in metres."""
    return FRAME.to_local(feature.lon, feature.lat)


def position(xy: np.ndarray, std_m: float) -> MeasuredPosition:
    """Return a place in metres as a report gives it."""
    lon, lat = FRAME.to_geographic(xy)
    return MeasuredPosition(float(lon), float(lat), (std_m**2, 0.0, std_m**2))


def seen(feature: MapFeature, when: datetime, weight: float, where: MeasuredPosition) -> PassReport:
    """Report a mapped or watched feature as seen."""
    return PassReport(
        started_at=when - timedelta(seconds=3),
        ended_at=when,
        status=DetectionStatus.EXPECTED_AND_DETECTED,
        weight_for=weight,
        weight_against=0.05,
        sign=SIGN,
        value=VALUE,
        reference=MapReference(feature.tile_id, feature.object_id),
        position=where,
        frames_detected=30,
        frames_missed=5,
    )


def missed(feature: MapFeature, when: datetime, weight: float) -> PassReport:
    """Report a mapped or watched feature as looked for and not seen."""
    return PassReport(
        started_at=when - timedelta(seconds=3),
        ended_at=when,
        status=DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
        weight_for=0.0,
        weight_against=weight,
        sign=SIGN,
        value=VALUE,
        reference=MapReference(feature.tile_id, feature.object_id),
        frames_missed=35,
    )


def blocked(feature: MapFeature, when: datetime) -> PassReport:
    """Report a mapped or watched feature as hidden by a truck."""
    return PassReport(
        started_at=when - timedelta(seconds=3),
        ended_at=when,
        status=DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED,
        weight_for=0.0,
        weight_against=0.0,
        sign=SIGN,
        value=VALUE,
        reference=MapReference(feature.tile_id, feature.object_id),
        frames_blocked=35,
    )


def found(when: datetime, weight: float, where: MeasuredPosition) -> PassReport:
    """Report a sign that no map has."""
    return PassReport(
        started_at=when - timedelta(seconds=3),
        ended_at=when,
        status=DetectionStatus.NOT_EXPECTED_AND_DETECTED,
        weight_for=weight,
        weight_against=0.05,
        sign=SIGN,
        value=VALUE,
        position=where,
        frames_detected=30,
        frames_missed=5,
    )
