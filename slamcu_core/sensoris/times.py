"""Instants: aware datetimes inside, POSIX milliseconds and a fraction in microseconds on the wire."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from slamcu_core.errors import WireError
from slamcu_core.sensoris.proto import base_pb2

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)


def to_microseconds(instant: datetime) -> int:
    """Return the POSIX microseconds of an aware instant, exactly."""
    return (instant - EPOCH) // _MICROSECOND


def from_microseconds(microseconds: int) -> datetime:
    """Return the instant of POSIX microseconds; raises WireError where no calendar goes."""
    try:
        return EPOCH + timedelta(microseconds=microseconds)
    except OverflowError as error:
        raise WireError("bad-time", f"{microseconds} microseconds since 1970 is no instant of any calendar") from error


def write_timestamp(target: base_pb2.Timestamp, instant: datetime) -> None:
    """Set a SENSORIS timestamp to an aware instant."""
    milliseconds, fraction = divmod(to_microseconds(instant), 1000)
    target.posix_time.value = milliseconds
    if fraction:
        target.posix_time_fraction.value = fraction


def read_timestamp(timestamp: base_pb2.Timestamp) -> datetime | None:
    """Return the instant of a SENSORIS timestamp, None if it is not set.

    Raises WireError if its fraction is not 0 to 999 microseconds.
    """
    if not timestamp.HasField("posix_time"):
        return None
    fraction = timestamp.posix_time_fraction.value
    if not 0 <= fraction < 1000:
        raise WireError("bad-time", f"posix_time_fraction is {fraction}, expected 0 to 999 microseconds")
    return from_microseconds(timestamp.posix_time.value * 1000 + fraction)
