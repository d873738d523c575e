"""Maps that are wrong on purpose: landmarks taken out, phantoms put in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import FormatError
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity
from slamcu_eval.mrclam.files import Landmark
from slamcu_eval.mrclam.runs import ARENA, LANDMARK_CLASS

PHANTOM_ID = 100  # the first object id of a phantom; landmarks keep their subject number
CHANGES = 3  # landmarks removed, and phantoms added, per edit
CLEARANCE_M = 0.7  # m between a phantom and any landmark, and between phantoms


@dataclass(frozen=True, slots=True)
class TrueFeature:
    """What is true of one feature of the world or of the edited map."""

    truth: str  # normal, deleted or new
    x: float  # m, in the arena
    y: float  # m
    object_id: int | None  # in the edited map; None: new


def edit_map(
    landmarks: Sequence[Landmark], seed: int | Sequence[int], *, source: str = "mrclam", changes: int = CHANGES
) -> tuple[HDMap, tuple[TrueFeature, ...]]:
    """Make a wrong map of the landmarks, and say what is wrong with it.

    `changes` landmarks are removed (truth: new) and as many phantoms are added (truth: deleted), uniformly over the
    landmarks' bounding box and at least 0.7 m from every landmark and from each other.

    Raises FormatError if there are too few landmarks to remove, or no room for a phantom.
    """
    if len(landmarks) < changes:
        raise FormatError(f"expected at least {changes} landmarks, found {len(landmarks)}")
    rng = np.random.default_rng(seed)
    places = np.array([(mark.x, mark.y) for mark in landmarks])
    removed = set(rng.choice(len(landmarks), changes, replace=False).tolist())
    phantoms = _phantoms(places, changes, rng)
    truth = [
        TrueFeature("new", mark.x, mark.y, None)
        if index in removed
        else TrueFeature("normal", mark.x, mark.y, mark.subject)
        for index, mark in enumerate(landmarks)
    ]
    truth += [TrueFeature("deleted", x, y, PHANTOM_ID + index) for index, (x, y) in enumerate(phantoms.tolist())]
    mapped = [feature for feature in truth if feature.object_id is not None]
    lon, lat = ARENA.to_geographic(np.array([(feature.x, feature.y) for feature in mapped]))
    features = [
        MapFeature(
            feature.object_id or 0, float(lon[i]), float(lat[i]), feature_class=LANDMARK_CLASS, position_std_m=0.02
        )
        for i, feature in enumerate(mapped)
    ]
    return HDMap(features, MapIdentity(source, "1")), tuple(truth)


def _phantoms(places: NDArray[np.float64], count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw phantoms (count, 2) in the bounding box of the places (K, 2), clear of them and of each other."""
    low, high = places.min(axis=0), places.max(axis=0)
    taken = places
    for _ in range(10_000):
        if len(taken) == len(places) + count:
            break
        draw = rng.uniform(low, high)
        if np.hypot(*(taken - draw).T).min() >= CLEARANCE_M:
            taken = np.vstack([taken, draw])
    else:
        raise FormatError(f"found no room for {count} phantoms {CLEARANCE_M} m clear of the landmarks")
    return taken[len(places) :]
