"""The routers of the API, in the order of its documentation. Each domain folder brings its own."""

from __future__ import annotations

from fastapi import APIRouter

from slamcu_server.health.endpoints import router as health
from slamcu_server.metrics.endpoints import router as metrics

ROUTERS: tuple[APIRouter, ...] = (
    health,
    metrics,
)
