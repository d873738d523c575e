"""What the feature API answers."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field

from slamcu_server.changes.belief import Kind, State
from slamcu_server.changes.schemas import Evidence
from slamcu_server.maps.schemas import Point


class FeatureVersion(BaseModel):
    """What the map says about a feature, from one version to another."""

    since: str = Field(description="The first map version that says so.")
    until: str | None = Field(description="The first that does not any more; null: the current one still does.")
    feature_class: str = Field(alias="class")
    sign: str | None
    value: str | None
    geometry: Point
    heading_deg: float | None
    existence_confidence: float
    position_std_m: float


class Standing(Evidence):
    """What vehicles say about a feature, decayed to now."""

    as_of: datetime
    stands_against: bool = Field(description="Whether the evidence stands that it is not there any more.")
    contributors_for: int = Field(description="Different vehicles whose evidence for it still weighs.")
    contributors_against: int
    passes: int = Field(description="Within the window of contributions that count.")
    looked: int = Field(description="Of these, passes that could see the place.")
    blocked: int = Field(description="Of these, passes that could not.")
    looked_ever: int = Field(description="Passes that could see the place, those that are not kept any more included.")
    could_not_see_ever: int = Field(description="Passes that could not, likewise.")
    last_looked: datetime | None
    last_seen: datetime | None
    policy_version: str | None = Field(description="null: nobody has reported on it, the map's word is all there is.")


class FeatureChange(BaseModel):
    """A change about this feature."""

    id: int
    kind: Kind
    state: State


class Feature(BaseModel):
    """A map feature, what vehicles say about it, and its history."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": 17,
                "map": "demo",
                "object_id": 17,
                "in_map": True,
                "standing": {
                    "as_of": "2026-05-03T09:00:00+00:00",
                    "weight_for": 3.1,
                    "weight_against": 0.0,
                    "mass_exists": 0.955,
                    "mass_not_exists": 0.0,
                    "mass_unknown": 0.045,
                    "conflict": 0.0,
                    "stands_against": False,
                    "contributors_for": 4,
                    "contributors_against": 0,
                    "passes": 5,
                    "looked": 5,
                    "blocked": 0,
                    "looked_ever": 112,
                    "could_not_see_ever": 9,
                    "last_looked": "2026-05-02T07:55:03+00:00",
                    "last_seen": "2026-05-02T07:55:03+00:00",
                    "policy_version": "3f1c92ab04de",
                },
                "versions": [
                    {
                        "since": "2026.05.1",
                        "until": None,
                        "class": "traffic_sign",
                        "sign": "SPEED_LIMIT",
                        "value": "80",
                        "geometry": {"type": "Point", "coordinates": [2.1003, 48.9001]},
                        "heading_deg": 267.0,
                        "existence_confidence": 0.95,
                        "position_std_m": 0.15,
                    }
                ],
                "changes": [],
            }
        }
    )

    id: int
    map: str
    object_id: int = Field(description="The map's own id, the same in all its versions.")
    in_map: bool = Field(description="Whether the map's current version has it.")
    standing: Standing
    versions: list[FeatureVersion] = Field(description="Oldest first.")
    changes: list[FeatureChange]


class Look(BaseModel):
    """When a feature was looked at, and how often."""

    id: int
    object_id: int
    feature_class: str = Field(alias="class")
    sign: str | None
    value: str | None
    geometry: Point
    last_looked: datetime | None = Field(description="When somebody last could see its place; null: never.")
    last_seen: datetime | None = Field(description="When it was last seen there.")
    looked: int = Field(description="Passes that could see the place.")
    could_not_see: int = Field(description="Passes that could not.")
    stands_against: bool = Field(description="Whether the evidence stands that it is not there any more.")


class LookPage(BaseModel):
    """Features of a map's current version, by id, with when they were looked at."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "features": [
                    {
                        "id": 17,
                        "object_id": 17,
                        "class": "traffic_sign",
                        "sign": "SPEED_LIMIT",
                        "value": "80",
                        "geometry": {"type": "Point", "coordinates": [2.1003, 48.9001]},
                        "last_looked": "2026-05-02T07:55:03+00:00",
                        "last_seen": "2026-05-02T07:55:03+00:00",
                        "looked": 112,
                        "could_not_see": 9,
                        "stands_against": False,
                    }
                ],
                "next": "/v1/features?map=demo&limit=1&after=17",
            }
        }
    )

    features: list[Look]
    next: str | None = Field(description="Where the following features are; null: these were the last.")
