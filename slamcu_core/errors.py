"""The exceptions that slamcu raises for what its callers hand it."""

from __future__ import annotations

from numbers import Integral, Real


class SlamcuError(Exception):
    """Base of every error that slamcu raises on purpose; its text is fit to show to a user."""


class EvidenceError(SlamcuError, ValueError):
    """A mass, confidence or weight is outside its range."""


class FieldError(SlamcuError, ValueError):
    """A value that was handed in is outside its range.

    Parameters
    ----------
    field : its name or path, such as ``items[2].range``.
    expected : what it should be.
    value : what it is.
    """

    def __init__(self, field: str, expected: str, value: object) -> None:
        self.field, self.expected, self.value = field, expected, value
        super().__init__(f"{field} must be {expected}, not {value}")


def check_within(holder: object, field: str, low: float, high: float, unit: str) -> None:
    """Raise FieldError if a field of an object is not a number from `low` to `high`."""
    value = getattr(holder, field)
    number = type(value) is float or (isinstance(value, Real) and not isinstance(value, bool))
    if not (number and low <= value <= high):
        raise FieldError(field, f"a number in [{low:g}, {high:g}] {unit}".rstrip(), value)


def check_whole(holder: object, field: str, low: int, high: int) -> None:
    """Raise FieldError if a field of an object is not a whole number from `low` to `high`."""
    value = getattr(holder, field)
    if not (isinstance(value, Integral) and not isinstance(value, bool) and low <= int(value) <= high):
        raise FieldError(field, f"a whole number in [{low}, {high}]", value)


class ClockError(SlamcuError):
    """The time of a record does not follow the records before it.

    Parameters
    ----------
    message : what is wrong, for people.
    t : s, of the record.
    now : s, of the records before.
    """

    def __init__(self, message: str, t: float, now: float) -> None:
        self.t, self.now = t, now
        super().__init__(message)


class FilterLostError(SlamcuError):
    """The filter's numbers have broken down: what it believes is worth nothing, and a new session is needed."""


class FormatError(SlamcuError, ValueError):
    """A file does not follow its format.

    Parameters
    ----------
    message : what is wrong and what was expected.
    source : name of the file or stream, if known.
    line : number of the line, counted from 1, if the format has lines.
    field : path of the field, such as ``items[2].range``, if one is to blame.
    """

    def __init__(
        self, message: str, *, source: str | None = None, line: int | None = None, field: str | None = None
    ) -> None:
        self.message, self.source, self.line, self.field = message, source, line, field
        place = ", ".join(
            part
            for part in (source, f"line {line}" if line is not None else None, f"field {field}" if field else None)
            if part
        )
        super().__init__(f"{place}: {message}" if place else message)


class WireError(SlamcuError, ValueError):
    """A SENSORIS message cannot be used.

    Parameters
    ----------
    reason : a short stable code, such as ``missing-ids``, for machines.
    message : what is wrong and what was expected, for people.
    """

    def __init__(self, reason: str, message: str) -> None:
        self.reason, self.message = reason, message
        super().__init__(f"{reason}: {message}")
