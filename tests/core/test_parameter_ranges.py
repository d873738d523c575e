"""Every number that can be set has a range, and what lies outside is refused by its name."""

from __future__ import annotations

import math
from dataclasses import fields
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.aggregation import ClassPolicy
from slamcu_core.errors import EvidenceError, FieldError
from slamcu_core.filter import FilterParameters
from slamcu_core.models import MotionNoise
from slamcu_core.sensoris.policy import ThirdPartyDefaults, WireLimits

_OTHERS = {"motion", "altitude_m", "earliest", "latest", "trusts"}
NUMBERS = [
    (kind, item.name)
    for kind in (FilterParameters, MotionNoise, WireLimits, ThirdPartyDefaults, ClassPolicy)
    for item in fields(kind)
    if item.name not in _OTHERS
]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300, -1.0, "5", None, True], ids=repr)
@pytest.mark.parametrize(("kind", "name"), NUMBERS, ids=lambda item: getattr(item, "__name__", item))
def test_a_number_outside_its_range_is_refused_by_name(kind: type, name: str, value: object) -> None:
    with pytest.raises((FieldError, EvidenceError), match=f"^{name} must be"):
        kind(**{name: value})


@pytest.mark.parametrize("name", ["particles", "max_new", "kept_finds", "minimum_hits"])
def test_counts_are_whole(name: str) -> None:
    with pytest.raises(FieldError, match=f"^{name} must be a whole number"):
        FilterParameters(**{name: 50.5})  # type: ignore[arg-type]  # wrong on purpose
    assert getattr(FilterParameters(**{name: np.int64(50)}), name) == 50  # type: ignore[arg-type]


def test_what_would_divide_by_zero_is_refused() -> None:
    for change in ({"detection_concentration": 0.0}, {"calibration_time_s": 0.0}, {"gnss_white_share": 0.0}):
        with pytest.raises(FieldError, match=next(iter(change))):
            FilterParameters(**change)  # type: ignore[arg-type]
    for change in ({"constant_time_s": 0.0}, {"slip_share": 1.0}, {"slip_time_s": 0.0}):
        with pytest.raises(FieldError, match=next(iter(change))):
            MotionNoise(**change)


def test_ranges_are_of_numbers_of_any_kind() -> None:
    assert FilterParameters(gate=np.float32(12.0), jitter=1).gate == 12.0  # type: ignore[arg-type]
    with pytest.raises(FieldError, match="motion must be a MotionNoise"):
        FilterParameters(motion=None)  # type: ignore[arg-type]


def test_bounds_of_a_receiver_that_are_none_are_refused() -> None:
    with pytest.raises(FieldError, match="altitude_m"):
        WireLimits(altitude_m=(100.0, -100.0))
    with pytest.raises(FieldError, match="latest"):
        WireLimits(latest=datetime(1999, 1, 1, tzinfo=UTC))
    with pytest.raises(FieldError, match="earliest"):
        WireLimits(earliest=datetime(2000, 1, 1))  # noqa: DTZ001 - wrong on purpose
