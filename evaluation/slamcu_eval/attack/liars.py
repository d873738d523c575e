"""What liars send: an honest drive, with lies about the targets on which they have agreed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from slamcu_core.hd_map import MapFeature
from slamcu_core.reports import PassReport
from slamcu_eval.attack.cars import Car, LostCar, found, missed, place_of, position, seen
from slamcu_eval.attack.world import SIGN, VALUE, Site, Truth, World

LIE = 6.0
"""Weight of a lie: of a pass that leaves no doubt, and more than an honest one has."""

TARGETS = 8
"""Signs invented, denied or shifted."""

REPETITIONS = 48
"""Times that a flood says the same, an hour of event time apart; that a replay is sent again; sessions minted."""


@dataclass(frozen=True, slots=True)
class Sending:
    """One message that a car sends: a session, a number in it, and passes."""

    session: str
    number: int
    passes: tuple[PassReport, ...]
    trusted: bool = True  # what it says of its own filter


Script = Callable[[Car, World, Sequence[MapFeature], datetime, str], list[Sending]]
"""What a car sends of a drive: (car, world, watch features, beginning, name of the drive)."""


def honest(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Send an honest drive as one message."""
    return [Sending(name, 1, tuple(car.drive(world, watches, begin)))]


def inventing(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """See signs where there are none; once the service watches them, see them again."""
    passes = _without(car, world, watches, begin, world.of(Truth.EMPTY)[:TARGETS])
    return [Sending(name, 1, (*passes, *_inventions(world, watches, begin)))]


def denying(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Miss mapped signs that are there."""
    passes = _without(car, world, watches, begin, _targets(world))
    return [Sending(name, 1, (*passes, *_denials(world, begin)))]


def hiding(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Keep still about new signs that are there, and miss them as soon as the service watches them."""
    targets = world.of(Truth.NEW)[:TARGETS]
    passes = _without(car, world, watches, begin, targets)
    found = [feature for feature in watches if any(np.hypot(*(place_of(feature) - s.xy)) <= 10.0 for s in targets)]
    return [Sending(name, 1, (*passes, *(missed(feature, begin, LIE) for feature in found)))]


def shifting(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Miss mapped signs, and see each three metres beside."""
    targets = _targets(world)
    passes = _without(car, world, watches, begin, targets)
    beside = [replace(site, xy=(site.xy[0], site.xy[1] + 3.0)) for site in targets]
    return [Sending(name, 1, (*passes, *_denials(world, begin), *_sightings(beside, watches, begin)))]


def flooding(_: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Invent and deny the same for every hour of two days, as if one had been there all the time."""
    sent = []
    for number in range(REPETITIONS):
        when = begin - timedelta(hours=number)
        passes = (*_inventions(world, watches, when), *_denials(world, when))
        sent.append(Sending(f"{name}-{number}", 1, passes))
    return sent


def replaying(_: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Send one drive of lies again and again: as it was, with other bytes, and under new ids."""
    lies = (*_inventions(world, watches, begin), *_denials(world, begin))
    again = [Sending(name, 1, lies) for _ in range(REPETITIONS)]
    changed = [Sending(name, 1, lies[: -1 - number % 3]) for number in range(REPETITIONS)]
    renamed = [Sending(name, number + 2, lies) for number in range(REPETITIONS)]
    return [*again, *changed, *renamed]


def minting(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Send the same lies in many sessions, each with another face and another minute."""
    return [
        Sending(
            f"{name}-{car.rng.integers(2**60):x}",
            1,
            (*_inventions(world, watches, when), *_denials(world, when)),
        )
        for number in range(REPETITIONS)
        for when in (begin + timedelta(seconds=40 * number),)
    ]


def doubting(_: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Invent and deny, and flag it all, as if roadworks had led one astray: flags are not judged."""
    passes = (*_inventions(world, watches, begin), *_denials(world, begin))
    return [Sending(name, 1, passes, trusted=False)]


def lost(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Drive with a filter that has diverged and does not know."""
    angle = car.rng.uniform(0.0, 2.0 * np.pi)
    diverged = LostCar(car.name, car.rng, car.model, shift=(11.0 * np.cos(angle), 11.0 * np.sin(angle)))
    return [Sending(name, 1, tuple(diverged.drive(world, watches, begin)))]


def astray(car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, name: str) -> list[Sending]:
    """Drive with a filter that has diverged, and knows."""
    return [replace(sending, trusted=False) for sending in lost(car, world, watches, begin, name)]


ATTACKS: dict[str, Script] = {
    "inventing": inventing,
    "denying": denying,
    "hiding": hiding,
    "shifting": shifting,
    "flooding": flooding,
    "replaying": replaying,
    "minting": minting,
    "doubting": doubting,
    "lost": lost,
    "astray": astray,
}


def _targets(world: World) -> list[Site]:
    return world.of(Truth.UNCHANGED)[:TARGETS]


def _without(
    car: Car, world: World, watches: Sequence[MapFeature], begin: datetime, targets: Sequence[Site]
) -> list[PassReport]:
    """Return an honest drive, all but what it says near the targets."""
    kept = World(world.name, tuple(site for site in world.sites if site not in targets))
    elsewhere = [
        feature for feature in watches if all(np.hypot(*(place_of(feature) - site.xy)) > 10.0 for site in targets)
    ]
    return car.drive(kept, elsewhere, begin)


def _inventions(world: World, watches: Sequence[MapFeature], when: datetime) -> list[PassReport]:
    return _sightings(world.of(Truth.EMPTY)[:TARGETS], watches, when)


def _denials(world: World, when: datetime) -> list[PassReport]:
    return [
        missed(MapFeature(site.object_id, 0.0, 0.0, sign=SIGN, value=VALUE), when, LIE)
        for site in _targets(world)
        if site.object_id is not None
    ]


def _sightings(targets: Sequence[Site], watches: Sequence[MapFeature], when: datetime) -> list[PassReport]:
    """See signs at these places: as the watch features that are there already, else as finds."""
    passes = []
    for site in targets:
        where = position(np.asarray(site.xy), 0.4)
        near = [feature for feature in watches if np.hypot(*(place_of(feature) - site.xy)) <= 3.0]
        passes += [seen(feature, when, LIE, where) for feature in near] or [found(when, LIE, where)]
    return passes
