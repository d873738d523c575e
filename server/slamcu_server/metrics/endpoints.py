"""GET /metrics, for Prometheus."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from slamcu_server.aggregation import aside
from slamcu_server.database.transactions import ReadTransaction
from slamcu_server.metrics import repository
from slamcu_server.metrics.instruments import Instruments

router = APIRouter(tags=["operation"])


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request, connection: ReadTransaction) -> Response:
    """Report what this process counts, and how far the aggregation and the feed have come."""
    instruments: Instruments = request.app.state.instruments
    backlog = await repository.backlog(connection)
    instruments.pending.set(backlog.pending)
    instruments.quarantined.set(backlog.quarantined)
    for work, number in (await aside.count(connection)).items():
        instruments.put_aside.labels(work.value).set(number)
    instruments.lag.set(backlog.lag_s)
    instruments.tell_changes(await repository.count_changes(connection))
    for quantile, seconds in (("0.5", backlog.latency_s), ("0.95", backlog.slow_latency_s)):
        if seconds is not None:
            instruments.fuse_latency.labels(quantile).set(seconds)
    instruments.feed_sequence.set(backlog.feed_sequence)
    pool = request.app.state.engine.pool
    instruments.pool.labels("busy").set(pool.checkedout())
    instruments.pool.labels("idle").set(pool.checkedin())
    instruments.pool_size.set(pool.size())
    worker = request.app.state.worker
    instruments.worker_healthy.set(worker is not None and worker.healthy)
    return Response(generate_latest(instruments.registry), media_type=CONTENT_TYPE_LATEST)
