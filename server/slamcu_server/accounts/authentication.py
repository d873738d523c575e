"""What endpoints depend on to know, and restrict, who is asking."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from slamcu_server.accounts.schemas import Principal, Role
from slamcu_server.accounts.service import Authenticator
from slamcu_server.problems import Problem

_bearer = HTTPBearer(
    scheme_name="key", description="An API key, from `slamcu-server create-key`.", bearerFormat="key", auto_error=False
)


async def authenticate(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]
) -> Principal:
    """Return who is asking, or answer 401."""
    if credentials is None:
        detail = "send an API key as Authorization: Bearer slamcu_…"
        raise Problem(401, "key-missing", detail, headers={"WWW-Authenticate": "Bearer"})
    authenticator: Authenticator = request.app.state.authenticator
    principal = await authenticator.authenticate(credentials.credentials)
    if principal is None:
        headers = {"WWW-Authenticate": 'Bearer error="invalid_token"'}
        raise Problem(401, "key-invalid", "the API key is unknown, expired or revoked", headers=headers)
    request.state.principal = principal
    return principal


def require(*roles: Role) -> Callable[[Principal], Awaitable[Principal]]:
    """Make a dependency that admits accounts of `roles`, and admins, and answers 403 to others."""
    admitted = {*roles, Role.ADMIN}

    async def admit(principal: Annotated[Principal, Depends(authenticate)]) -> Principal:
        if principal.role not in admitted:
            needed = " or ".join(sorted(admitted))
            headers = {"WWW-Authenticate": 'Bearer error="insufficient_scope"'}
            detail = f"this needs a key of role {needed}; yours is of role {principal.role}"
            raise Problem(403, "role-insufficient", detail, headers=headers)
        return principal

    return admit


Reporter = Annotated[Principal, Depends(require(Role.VEHICLE))]
Provider = Annotated[Principal, Depends(require(Role.PROVIDER))]
MapReader = Annotated[Principal, Depends(require(Role.VEHICLE, Role.PROVIDER))]
Admin = Annotated[Principal, Depends(require())]
