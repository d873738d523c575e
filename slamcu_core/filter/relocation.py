"""Finding the way back: match what was seen lately, as one rigid constellation, with the features of the map.

A filter that has settled on a wrong pose explains what it sees with features of its own making, and its particles hold
no better pose to fall back on. The last sightings placed by dead reckoning form a small map that is right up to a
rotation and a shift; pairs of it matched with pairs of the HD map propose that motion, and the proposal that lays most
sightings on the map wins, if it wins clearly (a consensus search after Fischler and Bolles 1981).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_MOST = 1000  # sightings remembered
_PAIRS = 200  # of things seen, looked for in the map, and ...
_COMPARISONS = 2_000_000  # ... of them with features, so that a search takes no longer where things stand in crowds
_TURN = 0.25  # rad, and
_SHIFT_M = 0.5  # m: motions nearer than this are the same answer


class Sightings(NamedTuple):
    """The detections of one frame, and where the vehicle was by dead reckoning."""

    t: float  # s
    reckoned: Array  # (3,)
    ahead_left: Array  # (2, D) m, from the vehicle
    std: Array  # (D,) m, larger axis
    feature_class: Index
    sign: Index


@dataclass(frozen=True, slots=True)
class Constellation:
    """Distinct things seen lately: places (L, 2) in the dead-reckoning frame, their std (L,), class and sign codes."""

    place: Array
    std: Array
    feature_class: Index
    sign: Index

    def fits(self, feature_class: Index, sign: Index) -> NDArray[np.bool_]:
        """Return which things could be which features (F,) by class and sign, where it is known, (L, F)."""
        alike = (self.sign[:, None] == sign) | (self.sign[:, None] == 0) | (sign == 0)
        return np.asarray((self.feature_class[:, None] == feature_class) & alike)


@dataclass(frozen=True, slots=True)
class Motion:
    """A rigid motion p -> R(angle) p + shift from the dead-reckoning frame into the map's."""

    angle: float  # rad
    shift: Array  # (2,) m

    @classmethod
    def between(cls, reckoned: Array, pose: Array) -> Motion:
        """Return the motion that takes a pose by dead reckoning (3,) to one in the map's frame."""
        turn = cls(float(pose[2] - reckoned[2]), np.zeros(2))
        return cls(turn.angle, pose[:2] - turn.apply(reckoned[:2]))

    @classmethod
    def fitted(cls, places: Array, targets: Array) -> Motion:
        """Return the motion that brings places (N, 2) closest to their targets (N, 2), by least squares."""
        middle, target = places.mean(axis=0), targets.mean(axis=0)
        (x, y), (u, v) = (places - middle).T, (targets - target).T
        turn = cls(float(np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum())), np.zeros(2))
        return cls(turn.angle, target - turn.apply(middle))

    def apply(self, place: Array) -> Array:
        """Move places (..., 2)."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return np.asarray(place @ np.array([[cos, sin], [-sin, cos]]) + self.shift)


class Memory:
    """The sightings of the last `window` seconds."""

    def __init__(self, window: float) -> None:
        self._window = window
        self._frames: deque[Sightings] = deque()
        self._count = 0

    def add(self, frame: Sightings) -> None:
        """Remember the sightings of a frame and forget those that are too old or too many."""
        frames, too_old = self._frames, frame.t - self._window
        frames.append(frame)
        self._count += len(frame.std)
        while frames[0].t < too_old or self._count - len(frames[0].std) >= _MOST:
            self._count -= len(frames.popleft().std)

    def clear(self) -> None:
        """Forget everything."""
        self._frames.clear()
        self._count = 0

    def constellation(self) -> Constellation:
        """Merge sightings within three standard deviations of each other, and drop what was seen only once.

        Each sighting joins what an earlier frame saw last beside it; no two of a frame are of one thing unless one was
        there before.
        """
        if not self._frames:
            none = np.zeros(0, dtype=np.intp)
            return Constellation(np.zeros((0, 2)), np.zeros(0), none, none)
        sizes = [len(frame.std) for frame in self._frames]
        reckoned = np.array([frame.reckoned for frame in self._frames]).T.repeat(sizes, axis=1)
        ahead, left = np.concatenate([frame.ahead_left for frame in self._frames], axis=1)
        cos, sin = np.cos(reckoned[2]), np.sin(reckoned[2])
        x, y = reckoned[0] + cos * ahead - sin * left, reckoned[1] + sin * ahead + cos * left
        std = np.concatenate([frame.std for frame in self._frames])
        feature_class = np.concatenate([frame.feature_class for frame in self._frames])
        sign = np.concatenate([frame.sign for frame in self._frames])
        kind = feature_class * (int(sign.max(initial=0)) + 1) + sign
        variance = std * std
        group = np.empty(len(std), dtype=np.intp)
        latest = np.empty(len(std), dtype=np.intp)  # sighting of each group
        begin = groups = 0
        for size in sizes:  # a frame at a time: one by one, thousands of them would take as long as many steps
            end = begin + size
            last = latest[:groups]
            off_x, off_y = x[last] - x[begin:end, None], y[last] - y[begin:end, None]
            near = off_x * off_x + off_y * off_y < 9.0 * (variance[last] + variance[begin:end, None])
            near &= kind[last] == kind[begin:end, None]
            joins = near.any(axis=1)
            fresh = int(np.count_nonzero(~joins))
            if groups:
                group[begin:end] = near.argmax(axis=1)
            group[begin:end][~joins] = groups + np.arange(fresh)
            groups += fresh
            latest[group[begin:end]] = np.arange(begin, end)
            begin = end
        count = np.bincount(group)
        kept = count > 1
        mean = np.stack([np.bincount(group, values) for values in (x, y, std)]) / count
        one = latest[:groups][kept]
        return Constellation(
            mean[:2, kept].T.copy(),
            mean[2, kept] / np.sqrt(np.minimum(count[kept], 4)),
            feature_class[one],
            sign[one],
        )


def distances(places: Array, others: Array) -> Array:
    """Return how far places (L, 2) are from others (F, 2), (L, F)."""
    return np.asarray(np.hypot(*np.moveaxis(places[:, None] - others, -1, 0)))


def agreement(seen: Constellation, motion: Motion, places: Array, fits: NDArray[np.bool_]) -> int:
    """Count the things seen that a motion lays on features of the map (F, 2), one to one; `fits` (L, F) by kind."""
    close = fits & (distances(motion.apply(seen.place), places) < 3.0 * seen.std[:, None])
    return int(min(close.any(axis=1).sum(), close.any(axis=0).sum()))


def search(seen: Constellation, places: Array, fits: NDArray[np.bool_]) -> tuple[Motion | None, int, int]:
    """Find the motion that lays most things seen on features of the map (F, 2).

    Returns
    -------
    The motion, how many things agree with it, and how many agree with the best motion that is another one: an arena
    full of like things repeats itself.
    """
    found: list[tuple[int, Motion]] = []
    gaps = places[None, :] - places[:, None]  # (F, F, 2) from a to b
    lengths = np.hypot(gaps[..., 0], gaps[..., 1])
    first, second = np.triu_indices(len(seen.place), 1)
    spans = seen.place[second] - seen.place[first]
    spanned = np.hypot(spans[:, 0], spans[:, 1])
    slack = 3.0 * np.hypot(seen.std[first], seen.std[second])
    told = _thinned(
        (spanned >= 2.0 * slack).nonzero()[0], min(_PAIRS, max(_COMPARISONS // lengths.size, 1))
    )  # shorter ones tell no direction
    proposed = [
        (pair, a, b)
        for pair in told.tolist()
        for a, b in np.argwhere(
            (np.abs(lengths - spanned[pair]) < slack[pair]) & fits[first[pair]][:, None] & fits[second[pair]][None, :]
        ).tolist()
    ]
    for index in _thinned(np.arange(len(proposed)), max(_COMPARISONS // max(fits.size, 1), 1)).tolist():
        pair, a, b = proposed[index]
        angle = float(np.arctan2(gaps[a, b, 1], gaps[a, b, 0]) - np.arctan2(spans[pair, 1], spans[pair, 0]))
        turn = Motion(angle, np.zeros(2))
        middle = 0.5 * (seen.place[first[pair]] + seen.place[second[pair]])
        motion = Motion(angle, 0.5 * (places[a] + places[b]) - turn.apply(middle))
        found.append((agreement(seen, motion, places, fits), motion))
    if not found:
        return None, 0, 0
    agreed, best = max(found, key=lambda item: item[0])
    centre = seen.place.mean(axis=0)
    rivals = [count for count, motion in found if not same(motion, best, centre)]
    return best, agreed, max(rivals, default=0)


def _thinned(items: Index, most: int) -> Index:
    """Return at most so many of the items, evenly taken: a right motion is proposed by many pairs."""
    return items[:: max(1, -(-len(items) // most))]


def same(first: Motion, second: Motion, place: Array) -> bool:
    """Return whether two motions are nearly one, as seen at a place (2,)."""
    turn = (first.angle - second.angle + np.pi) % (2.0 * np.pi) - np.pi
    return bool(abs(turn) < _TURN and np.hypot(*(first.apply(place) - second.apply(place))) < _SHIFT_M)
