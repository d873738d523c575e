"""The map API's pages: fetched one after the other, each only if it has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

from slamcu_client.errors import AnswerError
from slamcu_client.received import parse_json
from slamcu_client.server import Server, refuse_unauthorized, unexpected
from slamcu_client.transport import Request, Response

BoundingBox = tuple[float, float, float, float]
"""West, south, east, north in degrees; a west greater than the east crosses the antimeridian (RFC 7946, 5.2)."""

_ATTEMPTS = 3
_MAX_PAGES = 2_000


@dataclass(frozen=True, slots=True)
class MapPage:
    """One page of a map's features, and what it takes to ask for it again."""

    query: str
    etag: str | None
    next_query: str | None
    identity: dict[str, Any]  # the map's source and version
    features: tuple[dict[str, Any], ...]


class _MapChangedError(AnswerError):
    """A new version of the map came out between two pages."""


def fetch_pages(
    server: Server, name: str, bbox: BoundingBox | None, known: Sequence[MapPage] = ()
) -> tuple[MapPage, ...]:
    """Fetch all pages of one version of a map; pages that are `known` and unchanged are not transferred again.

    Raises TransportError, AuthenticationError or AnswerError as the exchange goes.
    """
    query = {"watch": "true"} if bbox is None else {"watch": "true", "bbox": ",".join(f"{edge:.7f}" for edge in bbox)}
    for _ in range(_ATTEMPTS - 1):
        try:
            return tuple(_pages(server, name, urlencode(query), known))
        except _MapChangedError:
            # page one may rightly be unchanged while the version is not: ask for all of them anew
            known = ()
    return tuple(_pages(server, name, urlencode(query), known))


def _pages(server: Server, name: str, first_query: str, known: Sequence[MapPage]) -> list[MapPage]:
    by_query = {page.query: page for page in known}
    pages: list[MapPage] = []
    asked: set[str] = set()
    query: str | None = first_query
    while query is not None:
        old = by_query.get(query)
        request, response = _ask(server, name, query, old.etag if old else None)
        page = old if response.status == 304 and old else _read_page(query, request, response)
        if pages and page.identity != pages[0].identity:
            raise _MapChangedError("the map changes faster than it can be fetched", request, response)
        pages.append(page)
        asked.add(query)
        query = page.next_query
        if query in asked or len(pages) > _MAX_PAGES:
            raise AnswerError("the pages of the map come to no end", request, response)
    return pages


def _ask(server: Server, name: str, query: str, etag: str | None) -> tuple[Request, Response]:
    headers = {"Accept": "application/geo+json, application/json"}
    if etag is not None:
        headers["If-None-Match"] = etag
    request, response = server.exchange(
        "GET", f"/v1/maps/{quote(name, safe='')}/features", query=query, headers=headers
    )
    refuse_unauthorized(request, response)
    return request, response


def _read_page(query: str, request: Request, response: Response) -> MapPage:
    if response.status != 200:
        raise unexpected(request, response)
    try:
        document = parse_json(response.content)
        features, identity, link = document["features"], document["map"], document.get("next")
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise AnswerError("the server's answer is no page of a map", request, response) from error
    if not isinstance(features, list) or not isinstance(identity, dict) or not isinstance(link, str | None):
        raise AnswerError("the server's answer is no page of a map", request, response)
    # only the query of the link is followed: behind a proxy the server may not know its own address, and the key must
    # not go to another
    return MapPage(
        query, response.headers.get("etag"), urlsplit(link).query if link else None, identity, tuple(features)
    )
