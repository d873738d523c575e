"""Errors as RFC 9457 problem documents: every response that is not a success carries one."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

import asyncpg
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import DataError, DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from starlette.exceptions import HTTPException

from slamcu_server.logs import told

logger = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
_BUSY = {"40001", "40P01", "53300", "55P03", "57014", "57P01", "57P02", "57P03"}  # SQLSTATEs that a repeat may cure
_BARE = {404: "there is nothing at this path; those of the API begin with /v1/", 405: "not with this method"}
_BAD_VALUE = ("22", "54")  # classes of SQLSTATEs: data exceptions, limits exceeded


class FieldError(BaseModel):
    """One thing that is wrong with a request."""

    field: str = Field(description="Where it is, such as `query.bbox`.")
    detail: str


class ProblemDocument(BaseModel):
    """An RFC 9457 problem document; some problems carry further members."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(description="A URN, `urn:slamcu:problem:<code>`, that names the kind of problem for machines.")
    title: str
    status: int
    detail: str | None = None
    errors: list[FieldError] | None = Field(None, description="For a request that is not valid: each field.")


class Problem(HTTPException):
    """Answer a request with a problem document.

    Parameters
    ----------
    status : HTTP status.
    code : the kind of problem for machines, such as ``unknown-map``; its type is ``urn:slamcu:problem:<code>``.
    detail : what is wrong and what was expected, for people.
    headers : further response headers.
    members : further members of the document.
    """

    def __init__(
        self, status: int, code: str, detail: str, *, headers: Mapping[str, str] | None = None, **members: Any
    ) -> None:
        super().__init__(status, detail, dict(headers) if headers else None)
        self.code, self.members = code, members


def problem_response(
    status: int,
    detail: str | None = None,
    *,
    code: str | None = None,
    headers: Mapping[str, str] | None = None,
    members: Mapping[str, Any] | None = None,
) -> JSONResponse:
    """Make the response that carries a problem document; without a `code` the status gives it, as ``not-found``."""
    phrase = HTTPStatus(status).phrase
    # never about:blank: by its type a vehicle tells this server's word from a hotspot's
    kind = code or re.sub(r"[^a-z]+", "-", phrase.lower())
    if not detail or detail == phrase:
        detail = _BARE.get(status)
    document = {
        "type": f"urn:slamcu:problem:{kind}",
        "title": kind.replace("-", " ").capitalize(),
        "status": status,
        **({"detail": detail} if detail else {}),
        **(members or {}),
    }
    return JSONResponse(document, status, headers=dict(headers) if headers else None, media_type=MEDIA_TYPE)


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe the problem documents of an endpoint for OpenAPI."""
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    return {
        status: {"description": HTTPStatus(status).phrase, "content": {MEDIA_TYPE: {"schema": schema}}}
        for status in statuses
    }


async def _on_http_exception(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)  # noqa: S101  (registered for this type)
    if error.status_code == 400 and not isinstance(error, Problem):  # FastAPI's word for a body it cannot read
        return _invalid([{"field": "body", "detail": "cannot be read; expected JSON in UTF-8"}])
    code = error.code if isinstance(error, Problem) else None
    members = error.members if isinstance(error, Problem) else None
    return problem_response(error.status_code, error.detail, code=code, headers=error.headers, members=members)


async def _on_invalid_request(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)  # noqa: S101
    return _invalid([_named(item) for item in error.errors()])


def _named(item: Mapping[str, Any]) -> dict[str, str]:
    """Return which field pydantic complains about, and of what."""
    if item["type"] == "json_invalid":
        return {"field": "body", "detail": f"expected JSON: {item['ctx']['error']} at character {item['loc'][1]}"}
    return {"field": ".".join(map(str, item["loc"])), "detail": str(item["msg"]).removeprefix("Value error, ")}


def _invalid(errors: Sequence[Mapping[str, str]]) -> JSONResponse:
    detail = "; ".join(f"{item['field']}: {item['detail']}" for item in errors)
    return problem_response(422, detail, code="invalid-request", members={"errors": list(errors)})


async def _on_data_error(request: Request, error: Exception) -> JSONResponse:
    # Checks should have refused the value earlier; that they did not is ours, but the value is the client's.
    route = getattr(request.scope.get("route"), "path", "an unknown route")
    logger.warning("the database refused a value of a request to %s: %s", route, told(error))
    return problem_response(422, "the request holds a value that cannot be stored", code="invalid-value")


async def _on_database_error(request: Request, error: Exception) -> JSONResponse:
    if isinstance(error, DBAPIError):
        state = getattr(error.orig, "sqlstate", None) or ""
        if state.startswith(_BAD_VALUE):
            return await _on_data_error(request, error)
        lost = isinstance(error, InterfaceError | OperationalError) or error.connection_invalidated or state in _BUSY
    elif isinstance(error, asyncpg.PostgresError):
        lost = error.sqlstate in _BUSY
    else:  # a refused connection names no file, unlike a file that is missing
        lost = not isinstance(error, OSError) or error.filename is None
    if lost:
        logger.warning("the database did not answer: %s", told(error))
        detail = "the database is busy or not reachable; the request had no effect and may be repeated"
        return problem_response(503, detail, code="database-unavailable", headers={"Retry-After": "1"})
    return on_unexpected_error(error)


def on_unexpected_error(error: Exception) -> JSONResponse:
    """Log what nobody foresaw, and answer without its internals."""
    logger.error("unexpected error", exc_info=error)
    return problem_response(500, "an unexpected error; it has been logged")


def install(app: FastAPI) -> None:
    """Make `app` answer every error with a problem document."""
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(DataError, _on_data_error)
    for kind in (DBAPIError, PoolTimeoutError, asyncpg.PostgresError, OSError):
        app.add_exception_handler(kind, _on_database_error)
    describe = app.openapi

    def openapi() -> dict[str, Any]:
        schema = describe()
        document = ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas = schema.setdefault("components", {}).setdefault("schemas", {})
        schemas.update({**document.pop("$defs", {}), "ProblemDocument": document})
        return schema

    app.openapi = openapi  # type: ignore[method-assign]  # FastAPI's documented way to extend the schema
