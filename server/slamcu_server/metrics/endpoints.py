"""GET /metrics, for Prometheus."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from slamcu_server.database.engine import ReadTransaction
from slamcu_server.metrics import repository
from slamcu_server.metrics.instruments import Instruments

router = APIRouter(tags=["operation"])


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request, connection: ReadTransaction) -> Response:
    """Report what this process counts, and how far the aggregation is behind."""
    instruments: Instruments = request.app.state.instruments
    backlog = await repository.backlog(connection)
    instruments.pending.set(backlog.pending)
    instruments.quarantined.set(backlog.quarantined)
    instruments.lag.set(backlog.lag_s)
    instruments.tell_changes(await repository.count_changes(connection))
    return Response(generate_latest(instruments.registry), media_type=CONTENT_TYPE_LATEST)
