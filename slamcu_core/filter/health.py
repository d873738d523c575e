"""How far the filter trusts itself: innovations, unexplained detections and missing ones against their expectation."""

from __future__ import annotations

from slamcu_core.reports import Health

_MEMORY = 60.0  # detections or expected detections over which the statistics are averaged
_ENOUGH = 15.0


class HealthMonitor:
    """Running statistics of one drive."""

    def __init__(self) -> None:
        self._innovation = 0.0
        self._matched = 0.0
        self._unexplained = 0.0
        self._detections = 0.0
        self._expected = 0.0
        self._found = 0.0

    def observe(self, squares: list[float], detections: int, unexplained: int, expected: float, found: int) -> None:
        """Add one frame.

        Parameters
        ----------
        squares : normalised innovations squared of detections matched with features of the map.
        detections, unexplained : how many detections there were, and how many fitted nothing.
        expected : sum of the probabilities with which the features of the map should have shown themselves.
        found : how many of them did.
        """
        keep = max(0.0, 1.0 - (detections + expected) / _MEMORY)
        self._innovation = keep * self._innovation + sum(squares)
        self._matched = keep * self._matched + len(squares)
        self._unexplained = keep * self._unexplained + unexplained
        self._detections = keep * self._detections + detections
        self._expected = keep * self._expected + expected
        self._found = keep * self._found + found

    def state(self, effective_share: float) -> Health:
        """Return the health of the moment; `effective_share` is M_eff / M.

        Not trusted: most of what the map promises is not there and most of what is there is not in the map.
        """
        unexplained = self._unexplained / self._detections if self._detections > 0.0 else 0.0
        lost = self._expected > _ENOUGH and self._found < 0.3 * self._expected and unexplained > 0.5
        return Health(
            trusted=not lost,
            effective_particles=min(1.0, effective_share),
            innovation_ratio=self._innovation / (2.0 * self._matched) if self._matched > 0.0 else 1.0,
            unexplained_ratio=min(1.0, unexplained),
        )
