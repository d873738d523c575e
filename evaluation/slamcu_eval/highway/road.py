"""The motorway's centre line: straights and gentle curves joined by clothoids, addressed by arc length and offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_STEP = 1.0  # m between the samples of the centre line
_RUN_OUT = 300.0  # m of road before and behind the driven part, so that sight lines never leave it
_MAX_TURN = np.deg2rad(50.0)  # the road turns back before it heads further than this from its main direction


@dataclass(frozen=True, slots=True)
class Road:
    """A centre line sampled every metre; arc length 0 is where drives start."""

    s: Array  # (K,) m
    xy: Array  # (K, 2) m in the world's local frame
    heading: Array  # (K,) rad counter-clockwise from east, unwrapped
    curvature: Array  # (K,) 1/m

    def heading_at(self, s: ArrayLike) -> Array:
        """Return the heading (rad, unwrapped) of the centre line at arc lengths of shape (...)."""
        return np.asarray(np.interp(np.asarray(s, float), self.s, self.heading))

    def curvature_at(self, s: ArrayLike) -> Array:
        """Return the curvature (1/m, left positive) at arc lengths of shape (...)."""
        return np.asarray(np.interp(np.asarray(s, float), self.s, self.curvature))

    def place(self, s: ArrayLike, offset: ArrayLike) -> Array:
        """Return the points (..., 2) at arc lengths and offsets (m to the left) of shape (...)."""
        s = np.asarray(s, float)
        heading = self.heading_at(s)
        centre = np.stack([np.interp(s, self.s, self.xy[:, 0]), np.interp(s, self.s, self.xy[:, 1])], axis=-1)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return np.asarray(centre + np.asarray(offset)[..., None] * left)


def make_road(length_m: float, min_radius_m: float, rng: np.random.Generator) -> Road:
    """Draw a road of a length with its middle at (0, 0), curvature piecewise linear between knots (clothoids)."""
    main = rng.uniform(-np.pi, np.pi)
    knots, values, turned = [-_RUN_OUT], [0.0], 0.0
    while knots[-1] < length_m + _RUN_OUT:
        sweep, ramp = rng.uniform(300.0, 1_200.0), rng.uniform(150.0, 300.0)
        bend = rng.choice([0.0, 1.0, 1.0]) / (min_radius_m * rng.uniform(1.0, 3.5))
        side = -np.sign(turned) if abs(turned) > _MAX_TURN / 2 else rng.choice([-1.0, 1.0])
        bend *= side
        # A curve: ramp in, hold, ramp out; its turn is bend * (sweep + ramp).
        knots += [knots[-1] + ramp, knots[-1] + ramp + sweep, knots[-1] + 2 * ramp + sweep]
        values += [bend, bend, 0.0]
        turned += bend * (sweep + ramp)
    s = np.arange(-_RUN_OUT, length_m + _RUN_OUT + _STEP, _STEP)
    curvature = np.interp(s, knots, values)
    heading = main + np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * _STEP)])
    middle = (heading[1:] + heading[:-1]) / 2
    steps = _STEP * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    centre = np.stack([np.interp(length_m / 2, s, xy[:, 0]), np.interp(length_m / 2, s, xy[:, 1])])
    return Road(s, xy - centre, heading, curvature)
