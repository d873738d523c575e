"""The document of a change: what a map provider reads about it."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np

from slamcu_core.evidence import conflict, masses_from_weights
from slamcu_server.changes.belief import Belief

Document = dict[str, Any]

_CHI2_95_2DOF = 5.991464547107979  # the 95 % quantile of the chi-squared distribution with 2 degrees of freedom


def ellipse95(covariance_m2: tuple[float, float, float]) -> dict[str, float]:
    """Return the 95 % ellipse of a covariance [xx, xy, yy] in m² east-north.

    Semi-axes are in metres, the orientation is the compass direction of the longer one in [0, 180) degrees.
    """
    xx, xy, yy = covariance_m2
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    east, north = vectors[:, 1]
    minor, major = np.sqrt(np.maximum(values, 0.0) * _CHI2_95_2DOF)
    orientation = float(np.rad2deg(np.arctan2(east, north))) % 180.0
    return {"semi_major_m": float(major), "semi_minor_m": float(minor), "orientation_deg": orientation}


def evidence(weight_for: float, weight_against: float) -> dict[str, float]:
    """Return the weights, the masses they stand for (eq. 1-7) and their conflict, by the documents' names."""
    exists, not_exists, unknown = masses_from_weights(weight_for, weight_against)
    return {
        "weight_for": weight_for,
        "weight_against": weight_against,
        "mass_exists": float(exists),
        "mass_not_exists": float(not_exists),
        "mass_unknown": float(unknown),
        "conflict": float(conflict(weight_for, weight_against)),
    }


def timestamp(value: datetime | None) -> str | None:
    """Return a time as RFC 3339 text, or None."""
    return None if value is None else value.isoformat()


def change_document(
    belief: Belief, *, map_source: str, map_object_id: int | None, watch_id: int | None, confirmed_at: datetime | None
) -> Document:
    """Build what is published about a change, all but its id, state and revision."""
    return {
        "map": map_source,
        "map_object_id": map_object_id,
        "watch_id": watch_id,
        "class": belief.feature_class,
        "sign": belief.sign,
        "value": belief.value,
        "geometry": {"type": "Point", "coordinates": [belief.lon, belief.lat]},
        "covariance_m2": list(belief.covariance_m2),
        "ellipse95": ellipse95(belief.covariance_m2),
        **evidence(belief.weight_for, belief.weight_against),
        "contributors_for": belief.contributors_for,
        "contributors_against": belief.contributors_against,
        "passes": belief.passes,
        "first_seen": timestamp(belief.first_seen),
        "last_seen": timestamp(belief.last_seen),
        "last_looked": timestamp(belief.last_looked),
        "confirmed_at": timestamp(confirmed_at),
        "policy_version": belief.policy_version,
        "merged_into": None,
        "review": None,
    }
