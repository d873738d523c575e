"""What is let in: one record after the other, in order of time, each of which makes sense.

A single time that is wrong by minutes would have all records refused until the car's clock has caught up. So a record
that comes after a pause waits for the next one: only if that comes later still has time gone on.
"""

from __future__ import annotations

import math

from slamcu_core.drive import DetectionFrame, DriveHeader, Record
from slamcu_core.errors import ClockError, SlamcuError
from slamcu_core.records import check_record

_PAUSE_S = 3.0  # s; longer than from any record to the next while a car is at work
_LONGEST_SILENCE_S = 3_600.0  # s; a clock that leaps farther is wrong, or the car has been parked: a new session


class Intake:
    """Refuses what must not reach the particles of one drive."""

    def __init__(self, header: DriveHeader) -> None:
        self._sensors = {sensor.id: sensor for sensor in header.sensors}
        self._wheelbase_m = header.wheelbase_m
        self._last_frames: dict[str, float] = {}  # s, by sensor
        self._waits: Record | None = None  # what came after a pause
        self.dropped = 0  # records that waited, and whose time no other confirmed

    def admit(self, record: Record, now: float) -> tuple[Record, ...]:
        """Return the records that are to be taken now, the last one taken having been of the time `now`, s.

        Those are the record, or none if it came after a pause and has to wait; before it the one that waited, if this
        one confirms its time.

        Raises ClockError if time runs backwards or leaps ahead by more than an hour, SlamcuError if a sensor is not in
        the header or has two frames at one instant, or a value makes no sense; nothing has changed then.
        """
        t, waits = record.t, self._waits
        if -math.inf < t < 0.0:
            raise ClockError(f"t must be seconds since the start of the drive, not {t}", t, now)
        check_record(record, self._sensors, wheelbase_m=self._wheelbase_m)
        if t < now:
            raise ClockError(f"time runs backwards: t = {t} s after {now} s", t, now)
        admitted = () if waits is None or t < waits.t else (waits,)
        since = waits.t if waits is not None and admitted else now
        if t - since > _LONGEST_SILENCE_S:
            raise ClockError(
                f"time leaps ahead: t = {t} s after {since} s; after more than {_LONGEST_SILENCE_S:g} s "
                "without a record a new session is needed",
                t,
                since,
            )
        frames = dict(self._last_frames)
        for one in (*admitted, record):
            if isinstance(one, DetectionFrame):
                if frames.get(one.sensor) == one.t:
                    raise SlamcuError(f"sensor {one.sensor!r} has two frames at t = {one.t} s")
                frames[one.sensor] = one.t
        self.dropped += waits is not None and not admitted
        self._waits = record if t - since > _PAUSE_S else None
        if self._waits is None:
            admitted = (*admitted, record)
        for one in admitted:
            if isinstance(one, DetectionFrame):
                self._last_frames[one.sensor] = one.t
        return admitted
