"""How far the filter trusts itself: what it sees and misses, against what a right and what a wrong pose would show.

Each encounter with a thing, one continuous stay in view, is one look at the question whether the pose is right, however
many frames it has: one hidden sign is no more than that. Its evidence is the ratio of two probabilities, and their logs
are added up by Page's rule (1954): below 0 the sum starts anew, so that a long good time does not speak against a loss.
While the pose is right, the sum passes h once in exp(h) encounters at most (Lorden 1971), so that h is a choice of how
often a healthy filter may cry wolf, not of how things look on some road.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from slamcu_core.reports import Doubt, Health

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_MEMORY = 30.0  # looks over which the ratios that go with reports are averaged
_APART_S = 5.0  # s out of view that end an encounter, as they end a pass
_IN_VIEW = 0.05  # probability of being in sight from which a thing is in view
_SEEN = 0.5  # detections that it takes to have been seen ...
_FOUND = 1.5  # ... and of what the map lacks, of which a single one may be a false alarm
_STANDS = 0.9  # probability that a thing stands where the map says so, at most: maps age in many places at once
_BY_CHANCE = 0.25  # that one is detected there though the pose is wrong
_FOUND_ODDS = 0.6  # ln of how much likelier a find is with a wrong pose
_FALSE_ALARM = 0.05 / 100.0  # per encounter: in five of a hundred drives of a hundred signs, at most
_LOST = -math.log(_FALSE_ALARM)  # sum from which on reports are not to be believed ...
_RECOVERED = 0.5 * _LOST  # ... until it has fallen to this
_MOST = 2.0 * _LOST  # no filter is so lost that it could not find out that it no longer is
_WITNESSES = 2  # features of the map that speak for the pose against fixes ...
_WELL = 6.0  # ... and how well they have to fit: 95 % do, if it is right
_MISSED = 2.0  # detections due of a feature that shows by bringing none that something is wrong
_DOUBT = 3.0  # sum from which on a better pose is looked for: at worst once in twenty encounters, for it costs little


class _Kept:
    """What is kept by row of the feature table of its present encounter or the last one; the first begin at 0."""

    DUE: Final = 0  # detections that it should have brought ...
    HIT: Final = 1  # ... and those that it has
    SHOWN: Final = 2  # how surely it could be seen when it could best
    AGAINST: Final = 3  # what the encounter says against the pose
    STANDS: Final = 4  # how surely it stands there, as believed when it came into view
    SQUARE: Final = 5  # normalised innovation squared of its first detection
    LAST: Final = 6  # s, in view


_SUMS = slice(0, _Kept.STANDS)


def _none_yet(size: int) -> Array:
    """Return what is kept (7, F) of rows that never were in view."""
    kept = np.zeros((7, size))
    kept[_Kept.LAST] = -np.inf
    return kept


class _Testimony:
    """What features of the map have shown for a while, each of them once."""

    def __init__(self) -> None:
        self._due: dict[int, float] = {}  # detections that were due, by row
        self._fits: dict[int, bool] = {}  # whether those detected fit well where the map has them

    def note(self, rows: Index, due: Array, hit: Array, squares: Array) -> None:
        """Note a frame's features (F,): detections due and made, normalised innovations squared."""
        for row, was_due, made, square in zip(rows.tolist(), due.tolist(), hit.tolist(), squares.tolist(), strict=True):
            self._due[row] = self._due.get(row, 0.0) + was_due
            if made > 0.0:
                self._fits.setdefault(row, square < _WELL)

    @property
    def vouches(self) -> bool:
        """Whether enough of them were seen where they are to be, and by far most."""
        well = sum(self._fits.values())
        missed = sum(due > _MISSED and row not in self._fits for row, due in self._due.items())
        return well >= _WITNESSES and well > 2 * (len(self._fits) - well + missed)


class HealthMonitor:
    """Running statistics of one drive.

    Parameters
    ----------
    concentration : looks by which the detection probability of a pass is known; misses come in bursts.
    gate : largest normalised innovation squared of an association.
    unmapped_share : things that the map lacks, per feature that it has.
    """

    def __init__(self, concentration: float, gate: float, unmapped_share: float) -> None:
        self._concentration, self._gate = concentration, gate
        # what every feature that was looked for says by all that was not found beside it
        self._nothing_found = -unmapped_share * math.expm1(_FOUND_ODDS)
        self._asked: _Testimony | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the past, after the filter has found its way back."""
        self._innovation = self._matched = 0.0
        self._unexplained = self._detections = 0.0
        self._encounters = _none_yet(0)
        self._against = 0.0  # Page's sum: ln of how much likelier a wrong pose is than the right one
        self.lost = False  # whether reports are not to be believed
        if self._asked is not None:
            self.ask_the_map()

    def observe(
        self, squares: list[float], detections: int, unexplained: int, *, expected: float, share: float
    ) -> None:
        """Add one frame to the ratios that go with reports.

        Parameters
        ----------
        squares : normalised innovations squared of detections matched with features of the map.
        detections, unexplained : how many detections there were, and how many fitted nothing.
        expected : sum of the probabilities with which the features of the map, whatever has become of them, should
            have shown themselves.
        share : of the frame's evidence that is its own.
        """
        keep = max(0.0, 1.0 - share * (detections + expected) / _MEMORY)
        self._innovation = keep * self._innovation + share * sum(squares)
        self._matched = keep * self._matched + share * len(squares)
        self._unexplained = keep * self._unexplained + share * unexplained
        self._detections = keep * self._detections + share * detections

    def note(
        self,
        t: float,
        rows: Index,
        mapped: NDArray[np.bool_],
        *,
        shown: Array,
        due: Array,
        hit: Array,
        exists: Callable[[Index], Array],
        squares: Array,
    ) -> None:
        """Add what a frame at t s says of the things in view.

        Parameters
        ----------
        rows : (F,) of the feature table.
        mapped : (F,) which are the map's.
        shown : (F,) the probability that they could be seen.
        due, hit : (F,) independent detections that were due of each, and that were made.
        exists : says of rows how probable it is that they exist.
        squares : (F,) normalised innovations squared of those that were detected.
        """
        made = hit > 0.0
        in_view = ((shown > _IN_VIEW) | made).nonzero()[0]
        if not len(in_view):
            return
        if len(in_view) < len(rows):
            rows, mapped, shown, due = rows[in_view], mapped[in_view], shown[in_view], due[in_view]
            hit, squares, made = hit[in_view], squares[in_view], made[in_view]
        if self._asked is not None:
            self._asked.note(rows[mapped], due[mapped], hit[mapped], squares[mapped])
        kept = self._encounters_with(rows)
        begins = (t - kept[_Kept.LAST] > _APART_S).nonzero()[0]
        if len(begins):
            believed = exists(rows[begins])
            # from a pose that is in doubt, what has been learned of the map is in doubt too
            of_map = _STANDS if self.lost else np.minimum(np.maximum(believed, _BY_CHANCE), _STANDS)
            kept[_Kept.STANDS, begins] = np.where(mapped[begins], of_map, believed)
            kept[_SUMS, begins] = 0.0
        first = (made & (kept[_Kept.HIT] == 0.0)).nonzero()[0]
        kept[_Kept.SQUARE, first] = squares[first]
        kept[_Kept.DUE] += due
        kept[_Kept.HIT] += hit
        np.maximum(kept[_Kept.SHOWN], shown, out=kept[_Kept.SHOWN])
        kept[_Kept.LAST] = t
        against = self._weigh(kept, mapped)
        change = float(np.add.reduce(against - kept[_Kept.AGAINST]))
        kept[_Kept.AGAINST] = against
        self._encounters[:, rows] = kept
        self._against = min(max(self._against + change, 0.0), _MOST)
        self.lost = self._against > (_RECOVERED if self.lost else _LOST)

    def _encounters_with(self, rows: Index) -> Array:
        """Return what is kept (7, F) of rows."""
        try:
            return self._encounters.take(rows, axis=1)
        except IndexError:  # the table has grown
            more = _none_yet(2 * int(rows.max()) + 2 - self._encounters.shape[1])
            self._encounters = np.concatenate([self._encounters, more], axis=1)
            return self._encounters.take(rows, axis=1)

    def _weigh(self, kept: Array, mapped: NDArray[np.bool_]) -> Array:
        """Return ln of how much likelier encounters (F,), of which is `kept` (7, F), are so far with a wrong pose."""
        hit, stands, square = kept[_Kept.HIT], kept[_Kept.STANDS], kept[_Kept.SQUARE]
        shows = kept[_Kept.SHOWN] * (1.0 - (1.0 + kept[_Kept.DUE] / self._concentration) ** -self._concentration)
        missing = np.log((1.0 - _BY_CHANCE * shows) / (1.0 - stands * shows)) + shows * self._nothing_found
        # from a right pose the square is chi-square with two degrees of freedom, from a wrong one any within the gate
        there = 0.5 * np.minimum(square, self._gate) - np.log(np.maximum(stands / _BY_CHANCE, 1.0))
        there += self._nothing_found - math.log(0.5 * self._gate)
        weight = np.where(hit > _SEEN, there, missing)
        found = (~mapped).nonzero()[0]
        if len(found):
            weight[found] = np.where((hit[found] > _FOUND) & (stands[found] < _STANDS), _FOUND_ODDS, 0.0)
        return np.asarray(weight)

    def ask_the_map(self) -> None:
        """Begin to ask whether what the map's features show from now on is what the pose makes expect."""
        self._asked = _Testimony()

    def ask_no_more(self) -> None:
        """End that question."""
        self._asked = None

    @property
    def map_vouches(self) -> bool:
        """Whether the map's features, since they have been asked, speak for the pose, and nothing else against it."""
        return self._asked is not None and self._asked.vouches and not self.doubtful

    @property
    def in_order(self) -> bool:
        """Whether nothing speaks against the pose."""
        return self._against <= 0.0

    @property
    def doubtful(self) -> bool:
        """Whether there is reason to look for a better pose."""
        return self._against > _DOUBT

    def state(self, effective_share: float, doubt: Doubt | None = None) -> Health:
        """Return the health; `effective_share` is M_eff / M, `doubt` why others doubt the pose."""
        if doubt is None and self.lost:
            doubt = Doubt.MAP
        return Health(
            trusted=doubt is None,
            effective_particles=min(1.0, effective_share),
            innovation_ratio=self._innovation / (2.0 * self._matched) if self._matched > 0.0 else 1.0,
            unexplained_ratio=min(1.0, self._unexplained / self._detections) if self._detections > 0.0 else 0.0,
            doubt=doubt,
        )
