"""The map cache: the HD map around the car, kept on disk and renewed when the server has a newer one."""

from __future__ import annotations

import json
import logging
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from slamcu_client.atomic_file import replacing
from slamcu_client.errors import AnswerError, MapUnavailableError, TransportError
from slamcu_client.files import load_map_file
from slamcu_client.map_pages import BoundingBox, MapPage, fetch_pages
from slamcu_client.received import one_line, parse_json
from slamcu_client.retry import SAYS_AGAIN
from slamcu_client.server import Server, is_own_problem
from slamcu_client.transport import Response
from slamcu_client.watches import without_unusable_watches
from slamcu_core.errors import FormatError
from slamcu_core.formats import load_hd_map
from slamcu_core.hd_map import HDMap

_FORMAT = 1
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MapSnapshot:
    """A map as the cache has it."""

    hd_map: HDMap
    fetched_at: datetime  # when this content came from the server
    fresh: bool  # whether the server has just confirmed it
    stale_because: str = ""  # why it has not: what kept the server from being asked, or its map from being used


@dataclass(frozen=True, slots=True)
class _Stored:
    """The cache file, taken apart into the pages it came in."""

    pages: tuple[MapPage, ...]
    hd_map: HDMap
    fetched_at: datetime


class MapCache:
    """Keep a server's map, or a part of it, in a file, watch features included.

    The file is a plain HD map in GeoJSON that any tool reads, with the pages' ETags in a foreign member; it is only
    ever replaced as a whole.

    ::

        with Server("https://slamcu.example", api_key) as server:
            cache = MapCache("map.geojson", server, "highway", bbox=(2.0, 48.8, 2.3, 49.0))
            snapshot = cache.refresh()         # the cached copy if the server cannot be reached
        session = VehicleSession(snapshot.hd_map, header, outbox)

    Parameters
    ----------
    path : the file.
    server : where the map comes from.
    name : the map's name on the server.
    bbox : west, south, east, north in degrees, a west greater than the east crosses the antimeridian; None: the whole
        map.
    """

    def __init__(
        self, path: str | os.PathLike[str], server: Server, name: str, *, bbox: BoundingBox | None = None
    ) -> None:
        self.path = Path(path)
        self._server, self._name, self._bbox = server, name, bbox
        self._source = {"server": server.url, "map": name, "bbox": None if bbox is None else list(bbox)}

    def refresh(self) -> MapSnapshot:
        """Fetch what has changed since the last time, store it, and return the map.

        If the server cannot be reached, is too busy or broken, or something else answers in its place, and if its map
        cannot be used, the cached copy is returned with `fresh` False. A copy that cannot be used is none. A watch
        feature that cannot be used is passed over.

        Raises MapUnavailableError if there is no cached copy then, AuthenticationError if the server itself does not
        accept the key, AnswerError if it does not have that map, and OSError if the file cannot be written.
        """
        stored = self._read()
        try:
            pages = fetch_pages(self._server, self._name, self._bbox, stored.pages if stored else ())
        except (TransportError, AnswerError) as error:
            if isinstance(error, AnswerError) and _is_refusal(error.response):
                raise
            if stored is None:
                raise MapUnavailableError(
                    f"there is no copy of the map {self._name} in {self.path}, and {error}"
                ) from error
            return MapSnapshot(stored.hd_map, stored.fetched_at, fresh=False, stale_because=str(error))
        if stored is not None and pages == stored.pages:
            return MapSnapshot(stored.hd_map, stored.fetched_at, fresh=True)
        try:
            return self._store(pages)
        except MapUnavailableError as error:
            if stored is None:
                raise
            _log.warning("%s: the copy in %s serves on", error, self.path)
            return MapSnapshot(stored.hd_map, stored.fetched_at, fresh=False, stale_because=str(error))

    def load(self) -> MapSnapshot:
        """Return the cached copy without asking the server; raise MapUnavailableError if there is none."""
        stored = self._read()
        if stored is None:
            raise MapUnavailableError(f"there is no copy of the map {self._name} in {self.path}")
        return MapSnapshot(stored.hd_map, stored.fetched_at, fresh=False, stale_because="the server was not asked")

    def _store(self, pages: tuple[MapPage, ...]) -> MapSnapshot:
        pages = without_unusable_watches(pages)
        fetched_at = datetime.now(UTC)
        about = {
            "format": _FORMAT,
            **self._source,
            "fetched_at": fetched_at.isoformat(),
            "pages": [
                {"query": page.query, "etag": page.etag, "next": page.next_query, "features": len(page.features)}
                for page in pages
            ],
        }
        try:
            with replacing(self.path) as temporary:
                with temporary.open("w", encoding="utf-8") as file:
                    file.write('{"type": "FeatureCollection",\n')
                    file.write(f'"map": {_dump(pages[0].identity)},\n"slamcu_cache": {_dump(about)},\n"features": [\n')
                    file.write(",\n".join(_dump(feature) for page in pages for feature in page.features))
                    file.write("\n]}\n")
                # read before it takes the place of a copy that was good
                hd_map = load_map_file(temporary)
        except (ValueError, RecursionError) as error:  # no map, half a surrogate pair, or brackets without end
            why = error.message if isinstance(error, FormatError) else str(error)
            raise MapUnavailableError(f"the server's map cannot be used: {one_line(why)}") from error
        return MapSnapshot(hd_map, fetched_at, fresh=True)

    def _read(self) -> _Stored | None:
        """Read the cache file; None if there is none that can be used, or if it is of another map or format."""
        try:
            content = self.path.read_bytes()
            document: Any = parse_json(content)
            about = document["slamcu_cache"]
            if about["format"] != _FORMAT or any(about[key] != value for key, value in self._source.items()):
                return None
            pages: list[MapPage] = []
            start = 0
            for page in about["pages"]:
                features = tuple(document["features"][start : start + page["features"]])
                start += page["features"]
                pages.append(MapPage(page["query"], page["etag"], page["next"], document["map"], features))
            # read as a map too: with its ETags a copy that is none would be confirmed by the server again and again
            hd_map = load_hd_map([content], source=str(self.path))
            return _Stored(tuple(pages), hd_map, datetime.fromisoformat(about["fetched_at"]))
        except FileNotFoundError:
            return None
        except FormatError as error:
            _log.warning("the copy of the map cannot be used: %s", error)
            return None
        except (ValueError, TypeError, KeyError):
            return None


def _is_refusal(response: Response) -> bool:
    return is_own_problem(response) and 400 <= response.status < 500 and response.status not in SAYS_AGAIN


def _dump(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))
