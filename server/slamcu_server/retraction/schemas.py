"""What the retraction API takes and answers."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from slamcu_server.instants import Instant
from slamcu_server.retraction.repository import State

_Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00]*$")]
_Reason = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=2000, pattern=r"^[^\x00]*$")]

EXACTNESS = (
    "Exact within the retained window: beliefs become the fold of the passes that are kept and not taken out. "
    "Passes that the window of a feature had already let go cannot come back in their place."
)


class Selection(BaseModel):
    """Which evidence: all that is given must hold of a pass."""

    model_config = ConfigDict(extra="forbid")

    contributor: _Name | None = Field(None, description="Label of the account that reported it.")
    session_id: _Name | None = Field(None, description="The session that it was reported in.")
    fleet_id: _Name | None = Field(None, description="The fleet that the vehicle named.")
    software_version: _Name | None = Field(None, description="The software that the vehicle named.")
    event_from: Instant | None = Field(None, description="The pass ended at this time or later.")
    event_until: Instant | None = Field(
        None, description="The pass ended before this time. Not given: what is reported from now on is taken out too."
    )

    @model_validator(mode="after")
    def _names_something(self) -> Self:
        if all(getattr(self, name) is None for name in Selection.model_fields):
            raise ValueError("name a contributor, a session, a fleet, a software version or a time window")
        if self.event_from is not None and self.event_until is not None and self.event_from >= self.event_until:
            raise ValueError("event_from must lie before event_until")
        return self


class RetractionRequest(Selection):
    """Evidence to take out, and why."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"fleet_id": "north", "software_version": "4.2.0", "reason": "4.2.0 reads distances in feet"},
                {
                    "contributor": "van-07",
                    "event_from": "2026-05-01T00:00:00Z",
                    "event_until": "2026-05-03T00:00:00Z",
                    "reason": "camera was loose",
                    "dry_run": True,
                },
            ]
        },
    )

    reason: _Reason
    dry_run: bool = Field(False, description="Only count what would be taken out.")


class UndoRequest(BaseModel):
    """Why evidence is let in again."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"reason": "the camera was not loose"}})

    reason: _Reason


class Retraction(BaseModel):
    """A retraction, who asked for it and why, and how far it is."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "id": 3,
                "state": "applied",
                "selection": {"fleet_id": "north", "software_version": "4.2.0"},
                "reason": "4.2.0 reads distances in feet",
                "requested_by": "operations",
                "requested_at": "2026-05-04T09:00:00+00:00",
                "applied_at": "2026-05-04T09:00:07+00:00",
                "passes": 18240,
                "features": 911,
                "candidates": 37,
                "put_aside": 0,
                "undo_reason": None,
                "undone_by": None,
                "undone_at": None,
                "exactness": EXACTNESS,
            }
        }
    )

    id: int | None = Field(description="None for a dry run.")
    state: State | None = Field(description="The evidence counts nowhere from `applied` on. None for a dry run.")
    selection: Selection
    reason: str
    requested_by: str | None = Field(description="Label of the account; None: the server gated a session by itself.")
    requested_at: datetime | None = None
    applied_at: datetime | None = None
    passes: int | None = Field(description="Stored passes that it took out, or would; None: not counted yet.")
    features: int | None = Field(description="Map features that they were about.")
    candidates: int | None = Field(description="Candidates that they were about.")
    put_aside: int = Field(
        0, description="Passes that could not be taken out, or let in again, so far: they are tried again."
    )
    undo_reason: str | None = None
    undone_by: str | None = None
    undone_at: datetime | None = None
    exactness: str = EXACTNESS


class RetractionPage(BaseModel):
    """A page of retractions, oldest first."""

    retractions: list[Retraction]
    next: str | None = Field(description="The next page, if there is one.")
