"""What the coverage API answers."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field


class CoveredTile(BaseModel):
    """What the fleet has looked at in one web-mercator tile; features are those of the map's current version."""

    z: int
    x: int
    y: int
    bbox: tuple[float, float, float, float] = Field(description="West, south, east, north in degrees.")
    features: int
    verified: int = Field(description="Seen since `since`, and not believed to be gone.")
    looked_at: int = Field(description="Looked at since `since`, whatever was seen.")
    contradicted: int = Field(description="Features of which the evidence stands that they are gone.")
    never_looked: int = Field(description="Features that nobody has ever been able to see the place of.")
    always_hidden: int = Field(description="Of these, features that somebody tried to see, in vain.")
    oldest_look: datetime | None = Field(description="Of the features' last looks, the oldest.")
    newest_look: datetime | None
    looks: int = Field(description="Passes that could see a place, over all features and time.")
    could_not_see: int = Field(description="Passes that could not.")


class Coverage(BaseModel):
    """What the fleet has looked at, by tile."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "map": "demo",
                "zoom": 14,
                "since": "2026-05-01T00:00:00+00:00",
                "tiles": [
                    {
                        "z": 14,
                        "x": 8287,
                        "y": 5633,
                        "bbox": [2.087, 48.893, 2.109, 48.908],
                        "features": 41,
                        "verified": 38,
                        "looked_at": 40,
                        "contradicted": 1,
                        "never_looked": 1,
                        "always_hidden": 1,
                        "oldest_look": "2026-03-02T07:12:40+00:00",
                        "newest_look": "2026-05-02T07:55:03+00:00",
                        "looks": 1204,
                        "could_not_see": 96,
                    }
                ],
            }
        }
    )

    map: str
    zoom: int
    since: datetime
    tiles: list[CoveredTile] = Field(description="Tiles with features, by x and y.")
