"""What the policy API answers."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from slamcu_core.aggregation import Policy

_EXAMPLE = Policy()


class PolicySummary(BaseModel):
    """A policy, by the digest of its document."""

    version: str
    since: datetime = Field(description="When this server first aggregated under it.")


class PolicyList(BaseModel):
    """The policies under which this server has aggregated."""

    in_force: str = Field(description="The one that this process has been told to use.")
    policies: list[PolicySummary]


class PolicyVersion(PolicySummary):
    """A policy with its parameters."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "version": _EXAMPLE.version,
                "since": "2026-05-01T08:00:00+00:00",
                "document": _EXAMPLE.to_document(),
            }
        }
    )

    document: dict[str, Any] = Field(description="`default`, and `classes` that differ from it, every parameter named.")
