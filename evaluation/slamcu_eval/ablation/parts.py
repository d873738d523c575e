"""The parts that take the place of the filter's own in an ablation: simpler, or as the paper printed them.

The filter has no switches for them, for nobody should drive with them. An ablation puts them where the filter looks its
own parts up, by name, and takes them away again; a name that the filter no longer has is an error, not a silent no-op.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import SlamcuError
from slamcu_core.filter import existence
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.frame_update import FrameUpdate, Matches
from slamcu_core.filter.table import Kind
from slamcu_core.filter.view import View

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Swap = tuple[str, str, Any]  # "module" or "module:Class", the name in it, and what takes its place

CORE = "slamcu_core.filter"


@contextmanager
def replaced(swaps: tuple[Swap, ...]) -> Iterator[None]:
    """Put parts in place of the filter's own until the end of the block.

    Raises SlamcuError if the filter has no part of that name.
    """
    before: list[Swap] = []
    try:
        for where, name, part in swaps:
            module, _, owner = where.partition(":")
            holder = getattr(import_module(module), owner) if owner else import_module(module)
            if not hasattr(holder, name):
                raise SlamcuError(f"the filter has no {where}.{name} to be replaced")
            before.append((where, name, getattr(holder, name)))
            setattr(holder, name, part)
        yield
    finally:
        for where, name, part in reversed(before):
            module, _, owner = where.partition(":")
            setattr(getattr(import_module(module), owner) if owner else import_module(module), name, part)


def certain_detection(held: Array, _nominal: Array, _concentration: float) -> Array:
    """Stand in for `existence.detectability`: what is in view is always detected."""
    return np.ones(len(held))


def as_a_whole(visible: Array) -> Array:
    """Return P(visible) as the paper has it: a feature is in the field of view or it is not."""
    return np.asarray(visible > 0.5, float)


def whole_visibility(sensor: Any, distance: Array, bearing: Array, weights: Array) -> Array:
    """Stand in for `visibility_probability`: what is in most particles' field of view is in view."""
    inside = (
        (distance >= sensor.min_range_m)
        & (distance <= sensor.max_range_m)
        & (np.abs(bearing) <= np.deg2rad(sensor.fov_deg) / 2.0)
    )
    return as_a_whole(inside @ weights)


def nothing_hides(_occluders: object, distance: Array, _bearing: Array, _std: Array) -> Array:
    """Stand in for `occlusion_probability`: every line of sight is free."""
    return np.zeros(len(distance))


def each_by_itself(score: Array) -> Index:
    """Stand in for `assign`: every detection takes its likeliest feature, taken or not (section 4.3.1 as printed)."""
    if not score.size:
        return np.full(len(score), -1, dtype=np.intp)
    best = score.argmax(axis=1)
    return np.where(score[np.arange(len(score)), best] > 0.0, best, -1).astype(np.intp)


def no_fix(*_arguments: object) -> bool:
    """Stand in for `GnssBias.update`: fixes are not taken, and none of them is an outlier."""
    return False


def no_contradiction(*_arguments: object, **_refused: bool) -> bool:
    """Stand in for `FixWatch.note`: no fix contradicts the pose."""
    return False


def nothing_learned(*_arguments: object) -> None:
    """Stand in for `Whiteness.learn`: frames are not compared."""


def never_pays(*_arguments: object) -> bool:
    """Stand in for `proposal.pays`: poses are always sampled from the motion prior."""
    return False


def all_stand(table: Any, rows: Index, _speed: float, parameters: Any) -> NDArray[np.bool_]:
    """Stand in for `standing.stands_still`: what was detected often enough is taken to stand still."""
    return np.asarray(table.hits[rows] >= parameters.minimum_hits)


def nothing_rides(_self: object, seen: Any, _odometer: float) -> NDArray[np.bool_]:
    """Stand in for `Riders.flag`: every detection is taken to belong to the road."""
    return np.zeros(len(seen.weight), dtype=bool)


def no_way_back(*_arguments: object) -> tuple[None, int, int]:
    """Stand in for `relocation.search`: no better pose is found."""
    return None, 0, 0


class WeighsDeleted(FrameUpdate):
    """A frame update in which every associated map feature weighs the particles, Deleted or not."""

    def weigh(
        self,
        view: View,
        seen: Seen,
        matched: tuple[Index, Index],
        usable: NDArray[np.bool_],
        *,
        share: float,
        rng: np.random.Generator,
    ) -> Matches:
        """Weigh by the usable matches and by all those with features of the map."""
        usable = usable | (self.table.kind[view.rows[matched[1]]] == Kind.MAP)
        return super().weigh(view, seen, matched, usable, share=share, rng=rng)


def weighs_as_normal(table: Any, rows: Index) -> NDArray[np.bool_]:
    """Tell which rows are Normal features of the map, by their masses (section 4.3.3)."""
    e, n, u = existence.masses(table, rows)
    return np.asarray((table.kind[rows] == Kind.MAP) & (e > n) & (e > u))
