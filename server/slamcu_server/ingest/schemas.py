"""What the ingest answers, and an example of what it takes."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

_EXAMPLE_PLACE = {
    "geographicWgs84": {"longitude": {"value": "210030000"}, "latitude": {"value": "4890010000"}},
    "covariance": {"a11": "250000", "a12": "0", "a21": "0", "a22": "250000", "a33": "10000000000"},
}
_EXAMPLE_SIGN = {
    "envelope": {"id": "1", "timestamp": {"posixTime": "1777622402000"}},
    "existenceConfidence": {"value": "67"},
    "detectionStatus": {"type": "NOT_EXPECTED_AND_DETECTED"},
    "rectangularBoxAndAccuracy": {"centerOrientationSize": {"centerPositionAndAccuracy": _EXAMPLE_PLACE}},
    "typeAndConfidence": {"type": "SPEED_LIMIT"},
    "valueAndConfidence": {"value": "80"},
}


class Rejection(BaseModel):
    """A message that was refused, and why."""

    index: int = Field(description="Which message of the batch, from 0.")
    session_id: str | None = Field(None, description="Its session, where it could be read.")
    message_id: int | None = Field(None, description="Its id, where it could be read.")
    reason: str = Field(description="A short code for machines; it does not change.")
    detail: str = Field(description="What is wrong and what was expected.")


class IngestResult(BaseModel):
    """What became of a batch. Accepted messages are durable; sending them again changes nothing."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "accepted": 1,
                "duplicates": 0,
                "rejected": [
                    {
                        "index": 1,
                        "session_id": "2026-05-01T08:00Z-007",
                        "message_id": 4,
                        "reason": "unknown-map",
                        "detail": "there is no map 'toyland' here",
                    }
                ],
            }
        }
    )

    accepted: int = Field(description="Messages that are now in the log.")
    duplicates: int = Field(description="Messages that were in the log already, with the same bytes.")
    rejected: list[Rejection] = Field(description="Messages that were refused; repeating them is of no use.")


EXAMPLE_BATCH: dict[str, Any] = {
    "dataMessage": [
        {
            "envelope": {
                "ids": {"sessionId": "2026-05-01T08:00Z-007", "messageId": "1"},
                "mapIdentification": {"providerVersion": {"source": "demo", "version": {"name": "2026.05.1"}}},
            },
            "eventGroup": [{"trafficRegulationCategory": {"trafficSign": [_EXAMPLE_SIGN]}}],
        }
    ]
}
"""A batch of one message: a speed limit sign of 80 that the map did not have."""
