"""Checked access to the fields of JSON objects: each error says where, and what was expected."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn, TypeVar

from slamcu_core.errors import FieldError, FormatError

T = TypeVar("T")

MAX_TEXT = 200
INT64_MAX = 2**63 - 1

_TYPE_NAMES = {dict: "an object", list: "a list", str: "text", bool: "a boolean", type(None): "null"}


@dataclass(frozen=True, slots=True)
class Place:
    """Where a value stands: in which source, on which line, within which subject (such as ``feature 17``)."""

    source: str | None = None
    line: int | None = None
    subject: str = ""

    def error(self, message: str, field: str | None = None) -> FormatError:
        """Return the error that names this place."""
        text = f"{self.subject}: {message}" if self.subject else message
        return FormatError(text, source=self.source, line=self.line, field=field or None)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON, expected a finite number")


DECODER = json.JSONDecoder(parse_constant=_refuse_constant)
"""JSON as its standard has it: without NaN and Infinity."""


def parse_json(text: str, place: Place) -> object:
    """Return the value of a JSON text. Raises FormatError."""
    try:
        return DECODER.decode(text)
    except json.JSONDecodeError as error:
        raise place.error(f"not valid JSON: {error.msg} at column {error.colno}") from error
    except (ValueError, RecursionError) as error:  # a constant, an integer of thousands of digits, brackets without end
        raise place.error(f"not valid JSON: {error}") from error


def describe(value: object) -> str:
    """Say what a JSON value is, short enough for an error."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return _TYPE_NAMES.get(type(value), type(value).__name__)
    text = repr(value) if isinstance(value, str) else f"{value:.12g}" if isinstance(value, float) else _integer(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _integer(value: int) -> str:
    return str(value) if abs(value) <= INT64_MAX else "an integer beyond 64 bits"


class Fields:
    """A JSON object whose fields are read with checks.

    Parameters
    ----------
    data : the value that must be an object.
    place : where it stands.
    path : its path there, such as ``items[2]``; empty at the top.
    """

    __slots__ = ("data", "path", "place")

    def __init__(self, data: object, place: Place, path: str = "") -> None:
        if not isinstance(data, Mapping):
            raise place.error(f"expected an object, not {describe(data)}", path)
        self.data: Mapping[str, object] = data
        self.place = place
        self.path = path

    def at(self, name: str) -> str:
        """Return the path of a field."""
        return f"{self.path}.{name}" if self.path else name

    def error(self, name: str, expected: str) -> FormatError:
        """Return the error that a field is missing or not what was expected."""
        found = f", not {describe(self.data[name])}" if name in self.data else ", but it is missing"
        return self.place.error(f"expected {expected}{found}", self.at(name))

    def __contains__(self, name: str) -> bool:
        """Say whether a field is there and not null."""
        return self.data.get(name) is not None

    def number(
        self,
        name: str,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
    ) -> float:
        """Return a finite number in [low, high] that is greater than `above`."""
        value = self.data.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(name, _range("a number", low, high, above))
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not (math.isfinite(number) and low <= number <= high and number > above):
            raise self.error(name, _range("a finite number", low, high, above))
        return number

    def optional_number(
        self, name: str, *, low: float = -math.inf, high: float = math.inf, above: float = -math.inf
    ) -> float | None:
        """Return a number as `number` does, None where the field is missing or null."""
        return self.number(name, low=low, high=high, above=above) if name in self else None

    def number_or(
        self,
        name: str,
        default: float,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
    ) -> float:
        """Return a number as `number` does, the default where the field is missing or null."""
        return self.number(name, low=low, high=high, above=above) if name in self else default

    def integer(self, name: str, *, low: int = -INT64_MAX, high: int = INT64_MAX) -> int:
        """Return an integer in [low, high]; 3.0 is none."""
        value = self.data.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            bounds = "" if (low, high) == (-INT64_MAX, INT64_MAX) else f" from {low}" + _upto(high)
            raise self.error(name, f"an integer{bounds}")
        return value

    def text(self, name: str, *, choices: Collection[str] = (), kind: str = "") -> str:
        """Return printable text of 1 to MAX_TEXT characters, one of the choices if there are any.

        Parameters
        ----------
        kind : what the choices are, for errors; without it they are listed.
        """
        value = self.data.get(name)
        if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT or not value.isprintable():
            raise self.error(name, kind or f"printable text of 1 to {MAX_TEXT} characters")
        if choices and value not in choices:
            raise self.error(name, kind or "one of " + ", ".join(sorted(choices)))
        return value

    def optional_text(self, name: str, *, choices: Collection[str] = (), kind: str = "") -> str | None:
        """Return text as `text` does, None where the field is missing or null."""
        return self.text(name, choices=choices, kind=kind) if name in self else None

    def checked(self, make: Callable[[], T]) -> T:
        """Return what is made of the fields; what it says of one of them is said of this place."""
        try:
            return make()
        except FieldError as error:
            raise self.place.error(
                f"expected {error.expected}, not {describe(error.value)}", self.at(error.field)
            ) from error

    def child(self, name: str) -> Fields:
        """Return a field that is an object."""
        if not isinstance(self.data.get(name), Mapping):
            raise self.error(name, "an object")
        return Fields(self.data[name], self.place, self.at(name))

    def children(self, name: str) -> list[Fields]:
        """Return a field that is a list of objects."""
        value = self.data.get(name)
        if not isinstance(value, list):
            raise self.error(name, "a list of objects")
        path = self.at(name)
        return [Fields(each, self.place, f"{path}[{index}]") for index, each in enumerate(value)]

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a field that is a list of text."""
        value = self.data.get(name)
        if not isinstance(value, list):
            raise self.error(name, "a list of text")
        items = Fields({str(index): each for index, each in enumerate(value)}, self.place, self.at(name))
        return tuple(items.text(index) for index in items.data)

    def numbers(self, name: str, lengths: Sequence[int]) -> list[float]:
        """Return a field that is a list of as many finite numbers as one of `lengths`."""
        value = self.data.get(name)
        if not isinstance(value, list) or len(value) not in lengths:
            raise self.error(name, f"a list of {' or '.join(map(str, lengths))} numbers")
        items = Fields({str(index): each for index, each in enumerate(value)}, self.place, self.at(name))
        return [items.number(index) for index in items.data]


def _range(what: str, low: float, high: float, above: float) -> str:
    parts = [what]
    if above > -math.inf:
        parts.append(f"above {above:g}")
    if low > -math.inf:
        parts.append(f"from {low:g}")
    if high < math.inf:
        parts.append(f"up to {high:g}" if low == -math.inf else f"to {high:g}")
    return " ".join(parts)


def _upto(high: int) -> str:
    return "" if high == INT64_MAX else f" to {high}"
