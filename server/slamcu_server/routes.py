"""The routers of the API, in the order of its documentation. Each domain folder brings its own."""

from __future__ import annotations

from fastapi import APIRouter

from slamcu_server.changes.endpoints import router as changes
from slamcu_server.coverage.endpoints import router as coverage
from slamcu_server.features.endpoints import router as features
from slamcu_server.health.endpoints import router as health
from slamcu_server.ingest.endpoints import router as ingest
from slamcu_server.maps.endpoints import router as maps
from slamcu_server.metrics.endpoints import router as metrics
from slamcu_server.policies.endpoints import router as policies
from slamcu_server.retraction.endpoints import router as retraction

ROUTERS: tuple[APIRouter, ...] = (
    ingest,
    maps,
    features,
    changes,
    policies,
    coverage,
    retraction,
    health,
    metrics,
)
