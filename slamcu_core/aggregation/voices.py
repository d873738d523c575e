"""The voices over many things at once: what each contributor's passes say together of where a thing is.

Plumbing of `position`: everything is laid out by thing, then contributor, so that sums over a contributor or over a
thing are sums over what stands side by side. The numbers of one thing do not depend on what it is laid out with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.geometry import inverse, mahalanobis_square

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Said:
    """What the voices say: (V, 2) m, (V, 2, 2) m² with what is wrong with all of a voice, and whether each says it."""

    means: Array
    spreads: Array
    present: Flags


@dataclass(frozen=True, slots=True)
class Layout:
    """N passes of V voices over T things, in order of thing and contributor; every thing has a pass."""

    places: Array  # (N, 2), m
    own: Array  # (N, 2, 2), m²: what is independent from pass to pass
    common: Array  # (2, 2), m²: what all passes of a voice have wrong together
    voice: Indices  # (N,), from 0
    thing: Indices  # (V,), from 0

    @property
    def thing_of_pass(self) -> Indices:
        """(N,), which thing each pass is of."""
        return np.asarray(self.thing[self.voice])

    def some(self, things: Flags) -> tuple[Layout, Flags]:
        """Return the layout of some things, (T,), and which passes they have, (N,)."""
        voices = things[self.thing]
        passes = voices[self.voice]
        voice, thing = np.cumsum(voices) - 1, np.cumsum(things) - 1
        chosen = voice[self.voice[passes]], thing[self.thing[voices]]
        return Layout(self.places[passes], self.own[passes], self.common, *chosen), passes

    def said(self, inlier: Flags) -> Said:
        """Return what the voices say with those of their passes that agree."""
        weights = inverses(self.own) * inlier[:, None, None]
        begins = first_of(self.voice)
        information = np.add.reduceat(weights, begins)
        vector = np.add.reduceat(np.einsum("nij,nj->ni", weights, self.places), begins)
        present = np.logical_or.reduceat(inlier, begins)
        information[~present] = np.eye(2)  # any that can be inverted
        spread = inverses(information)
        return Said(np.einsum("vij,vj->vi", spread, vector), spread + self.common, present)

    def pairs(self) -> tuple[Indices, Indices]:
        """Return each pair of voices over the same thing, both ways and with itself, in order of the first."""
        count = np.bincount(self.thing)
        first = first_of(self.thing)
        of_voice = count[self.thing]
        one = np.repeat(np.arange(len(self.thing)), of_voice)
        along = np.arange(len(one)) - np.repeat(np.cumsum(of_voice) - of_voice, of_voice)
        return one, first[self.thing[one]] + along


def first_of(groups: Indices) -> Indices:
    """Return where each group begins in ascending numbers of groups."""
    return np.flatnonzero(np.diff(groups, prepend=-1))


def mahalanobis(difference: Array, covariance: Array) -> Array:
    """Return d² of differences (..., 2) under covariances (..., 2, 2)."""
    return mahalanobis_square(np.moveaxis(difference, -1, 0), _components(covariance))[0]


def inverses(matrix: Array) -> Array:
    """Return the inverses of symmetric matrices (..., 2, 2)."""
    xx, xy, yy = inverse(_components(matrix))
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(matrix.shape)


def _components(matrix: Array) -> tuple[Array, Array, Array]:
    return matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
