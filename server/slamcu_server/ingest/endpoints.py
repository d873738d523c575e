"""POST /v1/data-messages."""

from __future__ import annotations

import math
from typing import Any

from fastapi import APIRouter, Request, status

from slamcu_server.accounts.authentication import Reporter
from slamcu_server.database.transactions import EngineDependency
from slamcu_server.ingest import body, service
from slamcu_server.ingest.quota import PASS_BYTES, Quota
from slamcu_server.ingest.schemas import EXAMPLE_BATCH, IngestResult
from slamcu_server.metrics.instruments import Instruments
from slamcu_server.problems import Problem, responses
from slamcu_server.settings import Settings

router = APIRouter(prefix="/v1", tags=["vehicles"])

_REQUEST_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "A SENSORIS 1.5 `DataMessages`; it may be compressed (`Content-Encoding: gzip`).",
        "content": {
            body.PROTOBUF: {"schema": {"type": "string", "format": "binary"}},
            body.JSON: {"schema": {"type": "object"}, "example": EXAMPLE_BATCH},
        },
    }
}


@router.post(
    "/data-messages",
    status_code=status.HTTP_202_ACCEPTED,
    responses=responses(400, 401, 403, 413, 415, 429),
    openapi_extra=_REQUEST_BODY,
)
async def post_data_messages(request: Request, reporter: Reporter, engine: EngineDependency) -> IngestResult:
    """Report what a vehicle saw.

    Each message is taken or refused whole; the good ones of a batch are kept. A message is known by the key's account,
    its session id and its message id: the same again is a duplicate, the same ids with other bytes are refused. The
    answer comes when the accepted messages are durable. If no message of the batch could be taken, now or earlier, the
    answer is a 422 problem with the same members. An account that reports far more than a car can is answered with 429
    and `Retry-After`.
    """
    settings: Settings = request.app.state.settings
    quota: Quota = request.app.state.quota
    _require_room(quota, reporter.account_id)
    is_json = body.media_type(request.headers) == body.JSON
    limit = (
        min(settings.max_json_bytes, settings.max_decompressed_bytes) if is_json else settings.max_decompressed_bytes
    )
    content = await body.read(request.stream(), gzip=body.is_gzip(request.headers), limit=limit)
    _require_room(quota, reporter.account_id)  # others of the account may have come in between
    most = len(content) // PASS_BYTES + 1
    with quota.holding(reporter.account_id, most):
        passes = most
        try:
            batch = await service.read(settings, content, is_json=is_json)
            passes = batch.passes
        finally:
            quota.charge(reporter.account_id, passes)
    result = await service.ingest(engine, reporter, batch)
    _count(request.app.state.instruments, result)
    if result.rejected and not result.accepted and not result.duplicates:
        detail = f"none of the {len(result.rejected)} messages could be taken; the first: {result.rejected[0].detail}"
        raise Problem(422, "nothing-accepted", detail, **result.model_dump(exclude_none=True))
    return result


def _require_room(quota: Quota, account_id: int) -> None:
    if (wait := quota.wait_s(account_id)) > 0.0:
        detail = f"this account reports more passes than a car makes; send again in {wait:.0f} s"
        raise Problem(429, "too-many-passes", detail, headers={"Retry-After": str(math.ceil(wait))})


def _count(instruments: Instruments, result: IngestResult) -> None:
    instruments.messages.labels("accepted").inc(result.accepted)
    instruments.messages.labels("duplicate").inc(result.duplicates)
    instruments.messages.labels("rejected").inc(len(result.rejected))
    for rejection in result.rejected:
        instruments.rejections.labels(rejection.reason).inc()
