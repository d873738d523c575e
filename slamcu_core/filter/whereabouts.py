"""Where the car is beyond what one frame tells: fixes, doubt, and the way back from a wrong or unknown pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import GnssFix
from slamcu_core.filter.calibration import GnssBias
from slamcu_core.filter.detections import Instant, Seen
from slamcu_core.filter.doubles import Doubles
from slamcu_core.filter.fixes import FixWatch
from slamcu_core.filter.health import HealthMonitor
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.outage import Outage
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.recovery import Recovery
from slamcu_core.filter.retrospect import Retrospect
from slamcu_core.filter.table import FeatureTable
from slamcu_core.models import SensorModel
from slamcu_core.reports import Doubt

Array = NDArray[np.float64]

_WITHOUT_FIXES_S = 60.0  # s


class Whereabouts:
    """Watches the pose of one drive, and starts over where it turns out to be another."""

    def __init__(
        self,
        table: FeatureTable,
        particles: Particles,
        *,
        gnss: GnssBias,
        outage: Outage,
        around: Neighbourhood,
        management: MapManagement,
        monitor: HealthMonitor,
        rng: np.random.Generator,
    ) -> None:
        self._particles, self._outage, self._rng = particles, outage, rng
        self._around, self._management, self._monitor = around, management, monitor
        self._recovery = Recovery(table, particles, rng)
        self._doubles = Doubles(table, particles, around, management)
        self._fixed_at = -np.inf  # s, by a fix that was not refused
        self._retrospect = Retrospect(table, particles, around, management)
        self.fixes = FixWatch(particles, gnss, monitor)

    @property
    def unknown(self) -> bool:
        """Whether nothing that is seen or missed is evidence, for the pose is too vague."""
        return self._outage.doubtful

    @property
    def doubt(self) -> Doubt | None:
        """Why the pose is in doubt, if not for what the map says."""
        if self._outage.doubtful:
            return Doubt.ODOMETRY
        return Doubt.FIXES if self.fixes.contradicted else None

    def take_fix(self, record: GnssFix) -> bool:
        """Take a fix of poses that are sampled; return whether the particles started over there."""
        fix = self._around.frame.to_local(record.lon, record.lat)
        refused = self._outage.take(record.t, fix, record.std_m)
        if not refused:
            self._fixed_at = record.t
        if not self.fixes.note(record.t, fix, record.std_m, refused=refused):
            return False
        self.fixes.start_over(fix, record.std_m, self._rng)
        self._retrospect.forget()  # nothing says since when the pose was wrong
        self._start_over(fix, None)
        return True

    def lose_track(self) -> None:
        """Part with what hangs on knowing how the car moves from now on."""
        self._around.part_finds(self._particles.cloud().mean[:2], self._particles)
        self._recovery.forget()
        self._retrospect.forget()

    def look_around(self, model: SensorModel, seen: Seen, now: Instant) -> None:
        """Remember what is seen, and go by it where the pose is in doubt or nobody knows it."""
        self._recovery.remember(model, seen, now)
        self._retrospect.note(now, in_order=self._monitor.in_order and not self.unknown)
        if not self.unknown and now.t - self._fixed_at > _WITHOUT_FIXES_S:
            self._undo_doubles(now)
        if self._monitor.doubtful or self.unknown:
            place = self._recovery.find_the_way_back(now, self._around.rows, anywhere=self.unknown)
            if place is not None:
                self._start_over(place, now)
        self._outage.look_again()

    def _undo_doubles(self, now: Instant) -> None:
        """Leave a pose from which the car has found the map's features anew; where fixes come, they would say so."""
        place = self._doubles.undo(now, self._rng)
        if place is not None:
            self._recovery.forget()
            self._retrospect.forget()
            self._monitor.reset()
            self._around.let_go()
            self._around.refresh(place, self._particles, force=True)

    def _start_over(self, place: Array, now: Instant | None) -> None:
        """Part with what was believed from a wrong pose; the particles are at a place (2,), m, by now.

        Where sightings told so, `now`, what was believed before the pose was wrong is believed again.
        """
        known = not self.unknown  # or else nothing was believed
        if known and (now is None or not self._retrospect.bring_back(now)):
            self._management.start_over()
        self._monitor.reset()
        self._around.refresh(place, self._particles, force=True)
        self._outage.place_found()
