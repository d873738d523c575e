"""A road with signs that stand where the map says, that are gone, and that are new: what is there, and nothing more."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import MapFeature, MapIdentity

FRAME = LocalFrame(2.1, 48.9)
SIGN, VALUE = "SPEED_LIMIT", "80"
SPACING_M = 120.0
"""Between sites: farther than anything that could be paired or confused."""


class Truth(StrEnum):
    """What has become of a site."""

    UNCHANGED = "unchanged"
    DELETED = "deleted"
    NEW = "new"
    EMPTY = "empty"  # nothing has ever stood there: where liars invent signs


@dataclass(frozen=True, slots=True)
class Site:
    """A place beside the road."""

    truth: Truth
    xy: tuple[float, float]  # m
    object_id: int | None = None  # in the map

    @property
    def stands(self) -> bool:
        """Whether there is a sign."""
        return self.truth in (Truth.UNCHANGED, Truth.NEW)


@dataclass(frozen=True, slots=True)
class World:
    """A road, and the map of it."""

    name: str
    sites: tuple[Site, ...]

    @property
    def identity(self) -> MapIdentity:
        """The map's name and version."""
        return MapIdentity(self.name, "1")

    def features(self) -> list[MapFeature]:
        """Return the map, as it was before anything changed."""
        made = []
        for site in self.sites:
            if site.object_id is not None:
                lon, lat = FRAME.to_geographic(site.xy)
                made.append(MapFeature(site.object_id, float(lon), float(lat), sign=SIGN, value=VALUE))
        return made

    def of(self, truth: Truth) -> list[Site]:
        """Return the sites of one kind."""
        return [site for site in self.sites if site.truth is truth]


def make_world(name: str, counts: dict[Truth, int], rng: np.random.Generator) -> World:
    """Make a road on which sites of all kinds follow each other in random order."""
    kinds = [truth for truth, count in counts.items() for _ in range(count)]
    sites = []
    mapped = 0
    for number, kind in enumerate(rng.permutation(len(kinds)).tolist()):
        truth = kinds[kind]
        in_map = truth in (Truth.UNCHANGED, Truth.DELETED)
        mapped += in_map
        sites.append(Site(truth, (SPACING_M * number, 4.0), mapped if in_map else None))
    return World(name, tuple(sites))
