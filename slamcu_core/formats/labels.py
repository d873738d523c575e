"""What a feature is: its class, and the type of a sign."""

from __future__ import annotations

from slamcu_core.catalogue import FEATURE_CLASSES, SIGN_TYPES, TRAFFIC_SIGN, UNKNOWN_SIGN
from slamcu_core.formats.fields import Fields

_SIGN_NAMES = SIGN_TYPES | {UNKNOWN_SIGN}


def read_class(fields: Fields) -> str:
    """Read the class of a map feature."""
    return fields.text("class", choices=FEATURE_CLASSES)


def read_sign(fields: Fields, feature_class: str, name: str = "sign") -> str | None:
    """Read the type of a sign: a SENSORIS TrafficSign type name for traffic signs, any text for other classes."""
    if feature_class != TRAFFIC_SIGN:
        return fields.optional_text(name)
    sign = fields.optional_text(name, choices=_SIGN_NAMES, kind="a SENSORIS TrafficSign type name")
    return None if sign == UNKNOWN_SIGN else sign
