"""What is let in: one record after the other, in order of time, each of which makes sense."""

from __future__ import annotations

from slamcu_core.drive import DetectionFrame, DriveHeader, Record
from slamcu_core.errors import SlamcuError
from slamcu_core.records import check_record

_LONGEST_SILENCE_S = 3_600.0  # s; a clock that leaps farther is wrong, or the car has been parked: a new session


class Intake:
    """Refuses what must not reach the particles of one drive."""

    def __init__(self, header: DriveHeader) -> None:
        self._sensors = {sensor.id: sensor for sensor in header.sensors}
        self._wheelbase_m = header.wheelbase_m
        self._last_frames: dict[str, float] = {}  # s, by sensor

    def admit(self, record: Record, now: float) -> None:
        """Let a record in, the last one having been of the time `now`, s.

        Raises SlamcuError if time runs backwards or leaps ahead by more than an hour, a sensor is not in the header or
        has two frames at one instant, or a value makes no sense.
        """
        check_record(record, self._sensors, wheelbase_m=self._wheelbase_m)
        t = record.t
        if t < now:
            raise SlamcuError(f"time runs backwards: t = {t} s after {now} s")
        if t - now > _LONGEST_SILENCE_S:
            raise SlamcuError(
                f"time leaps ahead: t = {t} s after {now} s; after more than {_LONGEST_SILENCE_S:g} s "
                "without a record a new session is needed"
            )
        if isinstance(record, DetectionFrame):
            if self._last_frames.get(record.sensor) == t:
                raise SlamcuError(f"sensor {record.sensor!r} has two frames at t = {t} s")
            self._last_frames[record.sensor] = t
