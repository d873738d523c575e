"""Which signs stand along a motorway, how often, and what they are mistaken for."""

from __future__ import annotations

import numpy as np

# SENSORIS TrafficSign types with the values they carry and their rough frequency beside a European motorway.
_CATALOGUE: tuple[tuple[str, tuple[str | None, ...], float], ...] = (
    ("SPEED_LIMIT", ("130", "110", "110", "90", "70"), 0.30),
    ("NO_OVERTAKING_TRUCK", (None,), 0.10),
    ("NO_OVERTAKING_TRUCK_END", (None,), 0.05),
    ("ROAD_DISTANCE", ("1000", "500", "2000"), 0.10),
    ("EMERGENCY_PHONE", (None,), 0.08),
    ("BOARD_DIRECTION", (None,), 0.12),
    ("SPEED_LIMIT_ENFORCEMENT", (None,), 0.03),
    ("ALL_RESTRICTIONS_END", (None,), 0.03),
    ("CONSTRUCTION", (None,), 0.04),
    ("LANE_MERGE_ON_RIGHT", (None,), 0.04),
    ("GENERAL_WARNING", (None,), 0.03),
    ("LATERAL_WIND", (None,), 0.02),
    ("SLIPPERY_ROAD", (None,), 0.02),
    ("ANIMAL_DEER", (None,), 0.02),
    ("CONGESTION_HAZARD", (None,), 0.02),
)
_WEIGHTS = np.array([weight for _, _, weight in _CATALOGUE])
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()

PAINTED = ("SPEED_LIMIT", ("80", "90"))  # the stickers on the rear of lorries

SignContent = tuple[str, str | None]


def draw_sign(rng: np.random.Generator) -> SignContent:
    """Draw the type and value of a sign."""
    name, values, _ = _CATALOGUE[rng.choice(len(_CATALOGUE), p=_WEIGHTS)]
    return name, values[rng.integers(len(values))]


def draw_other_sign(content: SignContent, rng: np.random.Generator) -> SignContent:
    """Draw a sign that a sign could be mistaken for or replaced by: a speed limit mostly becomes another speed."""
    if content[0] == "SPEED_LIMIT" and rng.random() < 0.8:
        others = [value for value in ("130", "110", "90", "80", "70") if value != content[1]]
        return "SPEED_LIMIT", others[rng.integers(len(others))]
    while True:
        other = draw_sign(rng)
        if other != content:
            return other
