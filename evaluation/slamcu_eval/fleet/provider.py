"""The API as a map provider uses it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import quote

from slamcu_client import Response, Server
from slamcu_core.errors import SlamcuError

_PATIENCE_S = 30.0  # with a server that says when to ask again, as while a map is imported


class CloudError(SlamcuError):
    """The server does not do what the evaluation needs; the text ends with what the server said."""


class Provider:
    """Ask a server as a map provider.

    Parameters
    ----------
    server : where it is, with a provider's key; None: not known yet.
    """

    def __init__(self, server: Server | None = None) -> None:
        self._provider = server

    def request(
        self,
        method: str,
        path: str,
        *,
        query: Mapping[str, str] | str = "",
        headers: Mapping[str, str] | None = None,
        body: object = None,
    ) -> Response:
        """Send a request as a map provider, again for a while if the server is busy and says when.

        Raises CloudError if the answer is no success, TransportError if none came.
        """
        if self._provider is None:
            raise CloudError("the server has not been started")
        content = b"" if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json", **(headers or {})}
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            _, answer = self._provider.exchange(method, path, query=query, headers=headers, content=content)
            pause = answer.headers.get("retry-after", "")
            if answer.status != 503 or not pause.isdigit() or time.monotonic() + int(pause) > deadline:
                break
            time.sleep(int(pause))
        if not 200 <= answer.status < 300:
            raise CloudError(f"{method} {path}: {answer.status} {answer.content.decode(errors='replace')[:300]}")
        return answer

    def get(self, path: str, query: Mapping[str, str] | str = "") -> Any:
        """Ask the server as a map provider, and return the JSON of its answer; raises as `request` does."""
        return json.loads(self.request("GET", path, query=query).content)

    def pages(self, path: str, query: Mapping[str, str] | None = None) -> Iterator[Any]:
        """Yield the pages of a list, following its `next` links."""
        page = self.get(path, query or {})
        yield page
        while link := page.get("next"):
            page = self.get(path, link.partition("?")[2])
            yield page

    def features(self, map_name: str) -> list[dict[str, Any]]:
        """Return the features of a map's current version as GeoJSON, without watch features."""
        path = f"/v1/maps/{quote(map_name, safe='')}/features"
        return [feature for page in self.pages(path) for feature in page["features"]]

    def map_summary(self, map_name: str) -> dict[str, Any]:
        """Return what the list of maps says of one of them."""
        maps: list[dict[str, Any]] = self.get("/v1/maps")["maps"]
        return next(one for one in maps if one["source"] == map_name)

    def accept(self, change_id: int) -> None:
        """Look at a change, and accept it as it was looked at."""
        detail = self.request("GET", f"/v1/changes/{change_id}")
        self.request(
            "POST",
            f"/v1/changes/{change_id}/review",
            headers={"If-Match": detail.headers["etag"]},
            body={"decision": "accept"},
        )
