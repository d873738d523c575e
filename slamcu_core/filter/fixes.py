"""Satellite fixes and pose that cannot both be right: which of them is believed.

A fix far beyond what pose, bias and noise allow is an outlier, as reflections are, and changes nothing. But fixes that
lie beyond it one after the other, and agree, say that the pose is wrong: an odometer told nonsense, or records are
missing. So does a bias that no receiver has. Then the position starts over at the fix, unless the map's features show
meanwhile that the pose is right: that many fixes in one wrong place are the receiver's.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.calibration import ASIDE_M2, GnssBias
from slamcu_core.filter.health import HealthMonitor
from slamcu_core.filter.particles import Particles

Array = NDArray[np.float64]

_WARNING = 3  # fixes that agree before the pose is not to be trusted ...
_RUN = 5  # ... before it is held to be wrong, and fixes that fit before it is trusted again
_RUN_S = 4.0  # s from the first to the last of them, for a receiver of 10 Hz makes five of one reflection
_ALIKE = 3.0  # standard deviations by which neighbouring fixes that agree may differ
_NO_BIAS = 36.0  # square of a bias in its standard deviations: half a second of a year of driving


class FixWatch:
    """What the fixes of one drive say against the pose."""

    def __init__(self, particles: Particles, gnss: GnssBias, monitor: HealthMonitor) -> None:
        self._particles, self._gnss, self._monitor = particles, gnss, monitor
        self.refused = 0  # fixes that changed nothing
        self.restarts = 0  # of the position, at a fix
        self.suspect = False  # whether fixes agree in what the map's features contradict
        self.contradicted = False  # whether the pose is not to be trusted: fixes contradict it, or did until just now
        self._run = self._fitting = 0  # fixes in a row
        self._since = 0.0  # s, the first of the run
        self._offset = np.zeros(2)  # m, of the last fix from the pose ...
        self._std = 0.0  # ... and its standard deviation

    def note(self, t: float, fix: Array, std_m: float, *, refused: bool) -> bool:
        """Note a fix (2,), m, after the particles were updated by it; return whether to start over there."""
        weights = self._particles.weights
        bias = self._particles.gnss_bias @ weights
        self.refused += refused
        if not refused and float(bias @ bias) <= _NO_BIAS * (self._gnss.stationary + ASIDE_M2):
            self._fit()
            return False
        self._fitting = 0
        offset = fix - self._particles.state[:2] @ weights
        if not self._run or math.dist(offset, self._offset) > _ALIKE * math.hypot(std_m, self._std):
            self._run, self._since = 0, t
            self._monitor.ask_the_map()
        self._run += 1
        self._offset, self._std = offset, std_m
        if self._run < _WARNING:
            return False
        self.suspect = self._monitor.map_vouches
        self.contradicted = not self.suspect
        return self.contradicted and self._run >= _RUN and t - self._since >= _RUN_S

    def _fit(self) -> None:
        """Note a fix that the pose explains."""
        if self._run:
            self._run = 0
            self._monitor.ask_no_more()
        self._fitting += 1
        if self._fitting >= _RUN:
            self.suspect = self.contradicted = False

    def start_over(self, fix: Array, std_m: float, rng: np.random.Generator) -> None:
        """Spread the particles about a fix (2,), m, in place; heading and what they know of the vehicle stay."""
        self._gnss.start_over(self._particles, fix, std_m, rng)
        self._run = 0
        self._monitor.ask_no_more()
        self.restarts += 1
