"""How far the filter trusts itself: innovations, unexplained detections and missing ones against their expectation."""

from __future__ import annotations

from slamcu_core.reports import Health

_MEMORY = 30.0  # looks over which the statistics are averaged
_ENOUGH = 8.0  # looks before they say anything
_DOUBT = 0.4  # share of detections that the map must explain, and of its promises that must be kept, to be in no doubt
_LOST = 0.3  # below this in both, reports are not to be believed


class HealthMonitor:
    """Running statistics of one drive, in independent looks (tempered frames)."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past, after the filter has found its way back."""
        self._innovation = self._matched = 0.0
        self._unexplained = self._detections = 0.0
        self._expected = self._found = 0.0

    def observe(
        self, squares: list[float], detections: int, unexplained: int, *, expected: float, found: int, share: float
    ) -> None:
        """Add one frame.

        Parameters
        ----------
        squares : normalised innovations squared of detections matched with features of the map.
        detections, unexplained : how many detections there were, and how many fitted nothing.
        expected : sum of the probabilities with which the features of the map, whatever has become of them, should
            have shown themselves.
        found : how many of them did.
        share : of the frame's evidence that is its own.
        """
        keep = max(0.0, 1.0 - share * (detections + expected) / _MEMORY)
        self._innovation = keep * self._innovation + share * sum(squares)
        self._matched = keep * self._matched + share * len(squares)
        self._unexplained = keep * self._unexplained + share * unexplained
        self._detections = keep * self._detections + share * detections
        self._expected = keep * self._expected + share * expected
        self._found = keep * self._found + share * found

    def _astray(self, share: float) -> bool:
        """Return whether the map explains less than a share of what is seen and keeps less of what it promises."""
        enough = min(self._detections, self._expected) > _ENOUGH
        return enough and self._found < share * min(self._detections, self._expected)

    @property
    def doubtful(self) -> bool:
        """Whether there is reason to look for a better pose."""
        return self._astray(_DOUBT)

    @property
    def lost(self) -> bool:
        """Whether reports are not to be believed."""
        return self._astray(_LOST)

    def state(self, effective_share: float) -> Health:
        """Return the health of the moment; `effective_share` is M_eff / M."""
        return Health(
            trusted=not self.lost,
            effective_particles=min(1.0, effective_share),
            innovation_ratio=self._innovation / (2.0 * self._matched) if self._matched > 0.0 else 1.0,
            unexplained_ratio=min(1.0, self._unexplained / self._detections) if self._detections > 0.0 else 0.0,
        )
