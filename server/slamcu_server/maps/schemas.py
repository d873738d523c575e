"""What the map API answers."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class MapSummary(BaseModel):
    """An HD map: its name, and its current version."""

    source: str = Field(description="The map's name.")
    version: str = Field(description="Its current version.")
    sequence: int = Field(description="Number of that version, from 1.")
    features: int = Field(description="Features in that version.")
    bbox: tuple[float, float, float, float] | None = Field(
        description="West, south, east, north, as the parameter `bbox` takes them; null if empty."
    )


class MapList(BaseModel):
    """The maps that this server has, by name."""

    maps: list[MapSummary]


class MapVersion(BaseModel):
    """One version of a map, and where it came from."""

    version: str
    sequence: int = Field(description="From 1; later versions have greater ones.")
    origin: Literal["import", "review"]
    change_id: int | None = Field(description="The accepted change that made this version, if it was one.")
    created_at: datetime


class MapVersionPage(BaseModel):
    """Versions of a map, oldest first."""

    versions: list[MapVersion]
    next: str | None = Field(description="Where the following versions are; null: these were the last.")


class MapIdentityDocument(BaseModel):
    """Which version of which map it is."""

    source: str
    version: str


class Point(BaseModel):
    """A GeoJSON point: longitude, latitude, and altitude where it is known."""

    type: Literal["Point"] = "Point"
    coordinates: list[float]


class FeatureDocument(BaseModel):
    """A map feature, or a watch feature (`watch` true): a candidate that vehicles look for but never localize on."""

    type: Literal["Feature"] = "Feature"
    id: int = Field(description="The map's object id; of a watch feature, its own id.")
    geometry: Point
    properties: dict[str, Any] = Field(
        description="`class`, `sign`, `value`, `heading_deg`, `existence_confidence`, `position_std_m` and "
        "`feature_id`; of a watch feature `watch`, `covariance_m2` ([xx, xy, yy], east-north), `kind` (new, moved, "
        "modified) and what it `replaces` (the object id of what has moved or been modified). `tile_id` goes into "
        "a MAP_REFERENCE: 0 or more for map features, negative for watch features. What is not known is left out."
    )


class FeaturePage(BaseModel):
    """Features of a map version as GeoJSON, by id: first map features, then watch features."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "type": "FeatureCollection",
                "map": {"source": "demo", "version": "2026.05.1"},
                "features": [
                    {
                        "type": "Feature",
                        "id": 17,
                        "geometry": {"type": "Point", "coordinates": [2.1003, 48.9001]},
                        "properties": {
                            "class": "traffic_sign",
                            "sign": "SPEED_LIMIT",
                            "value": "80",
                            "existence_confidence": 0.95,
                            "position_std_m": 0.15,
                            "tile_id": 135886181,
                            "feature_id": 17,
                        },
                    }
                ],
                "next": "/v1/maps/demo/features?version=2026.05.1&limit=1&after=17",
            }
        }
    )

    type: Literal["FeatureCollection"] = "FeatureCollection"
    map: MapIdentityDocument
    features: list[FeatureDocument]
    next: str | None = Field(description="Where the following features of this version are; null: these were the last.")
