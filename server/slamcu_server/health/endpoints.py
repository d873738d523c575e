"""GET /livez and GET /readyz."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from slamcu_server.health import service
from slamcu_server.problems import problem_response, responses

router = APIRouter(tags=["operation"])


class Alive(BaseModel):
    """The process answers."""

    status: Literal["alive"] = "alive"


class Ready(BaseModel):
    """The server can do its work."""

    status: Literal["ready"] = "ready"


@router.get("/livez")
async def livez() -> Alive:
    """Tell that the process answers; it says nothing about the database."""
    return Alive()


@router.get("/readyz", response_model=Ready, responses=responses(503))
async def readyz(request: Request) -> Ready | JSONResponse:
    """Tell whether the database is reachable and of the right schema, and the worker of this process alive."""
    failing = await service.failing(request.app.state.readiness, request.app.state.worker)
    if failing:
        return problem_response(503, "; ".join(failing), code="not-ready", headers={"Retry-After": "1"})
    return Ready()
