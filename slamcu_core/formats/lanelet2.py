"""Signs and lights of a Lanelet2 map: OSM XML, whose ways of these types run along a sign's or a light's face."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from xml.parsers import expat

from slamcu_core.catalogue import TRAFFIC_LIGHT, TRAFFIC_SIGN
from slamcu_core.errors import FormatError
from slamcu_core.formats.national_signs import read_national_sign
from slamcu_core.hd_map import MapFeature, MapIdentity

_CLASSES = {"traffic_sign": TRAFFIC_SIGN, "traffic_light": TRAFFIC_LIGHT}

Place = tuple[float, float]  # longitude and latitude, degrees


class Lanelet2Reader:
    """Reads the traffic signs and traffic lights of a Lanelet2 map, each a way; iterate once.

    A feature stands in the middle of its way, and has the way's id. Which way a face looks the format does not say,
    nor above what `ele` is. The file names no map, so `identity` is empty.
    """

    identity = MapIdentity()

    def __init__(self, chunks: Iterable[str | bytes], *, source: str | None = None) -> None:
        self._chunks, self._source = chunks, source
        self.unknown_signs: Counter[str] = Counter()
        """How many signs have a number that has no SENSORIS type here: they come without type and value."""

    def __iter__(self) -> Iterator[MapFeature]:
        """Iterate over the features, in the order of the file. Raises FormatError with line and element."""
        document = _Document(self._source)
        seen: set[int] = set()
        for chunk in self._chunks:
            yield from self._features(document.feed(chunk), seen)
        yield from self._features(document.end(), seen)

    def _features(self, ways: Iterable[_Way], seen: set[int]) -> Iterator[MapFeature]:
        for way in ways:
            feature = self._feature(way)
            if feature.object_id in seen:
                raise way.error("two ways have this id")
            seen.add(feature.object_id)
            yield feature

    def _feature(self, way: _Way) -> MapFeature:
        if way.number <= 0:
            raise way.error("expected a positive id, as editors give it when they upload or renumber")
        feature_class, code = _CLASSES[way.tags["type"]], way.tags.get("subtype", "")
        sign = value = None
        if feature_class == TRAFFIC_SIGN:
            sign, value = read_national_sign(code)
            if sign is None:
                self.unknown_signs[code] += 1
        return MapFeature(way.number, *_middle(way.places), feature_class, sign, value)


def read_lanelet2(chunks: Iterable[str | bytes], *, source: str | None = None) -> Lanelet2Reader:
    """Return a reader that streams the signs and lights of a Lanelet2 map; parameters as of `read_hd_map`."""
    return Lanelet2Reader(chunks, source=source)


class _Way:
    """A way with its tags and, once it is known to be wanted, the places of its nodes."""

    def __init__(self, number: int, line: int, source: str | None) -> None:
        self.number, self.line, self.source = number, line, source
        self.tags: dict[str, str] = {}
        self.nodes: list[int] = []
        self.places: list[Place] = []

    def error(self, message: str) -> FormatError:
        """Return the error that names this way."""
        return FormatError(message, source=self.source, line=self.line, field=f"way {self.number}")


class _Document:
    """The OSM document so far: its nodes, and the ways that are wanted as they end."""

    def __init__(self, source: str | None) -> None:
        self._source = source
        self._nodes: dict[int, Place] = {}
        self._way: _Way | None = None  # the one that is open
        self._depth = 0
        self._ended: list[_Way] = []
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._doctype

    def feed(self, chunk: str | bytes) -> list[_Way]:
        """Return the ways that have ended with this piece of text."""
        return self._parsed(chunk, last=False)

    def end(self) -> list[_Way]:
        """Return the last ways; the document must be whole."""
        return self._parsed(b"", last=True)

    def _parsed(self, chunk: str | bytes, *, last: bool) -> list[_Way]:
        try:
            self._parser.Parse(chunk, last)
        except expat.ExpatError as error:
            message = f"expected OSM XML: {expat.ErrorString(error.code)}"
            raise FormatError(message, source=self._source, line=error.lineno) from error
        ended, self._ended = self._ended, []
        return ended

    def _error(self, message: str, field: str | None = None) -> FormatError:
        return FormatError(message, source=self._source, line=self._parser.CurrentLineNumber, field=field)

    def _doctype(self, *_declaration: object) -> None:
        raise self._error("a document type is not accepted: OSM XML has none, and its entities could grow without end")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        if self._depth == 1 and name != "osm":
            raise self._error(f"expected an OSM document (<osm>), found <{name}>")
        if self._depth == 2:
            if attributes.get("visible") == "false" or attributes.get("action") == "delete":
                return
            if name == "node":
                number = self._integer(attributes, "id", "node")
                self._nodes[number] = self._place(attributes, f"node {number}")
            elif name == "way":
                self._way = _Way(self._integer(attributes, "id", "way"), self._parser.CurrentLineNumber, self._source)
        elif self._way is not None and name == "nd":
            self._way.nodes.append(self._integer(attributes, "ref", f"way {self._way.number}"))
        elif self._way is not None and name == "tag":
            self._way.tags[attributes.get("k", "")] = attributes.get("v", "")

    def _end(self, _name: str) -> None:
        if self._depth == 2 and self._way is not None:
            if self._way.tags.get("type") in _CLASSES:
                self._ended.append(self._placed(self._way))
            self._way = None
        self._depth -= 1

    def _placed(self, way: _Way) -> _Way:
        if not way.nodes:
            raise way.error("expected nodes, found none")
        for number in way.nodes:
            if number not in self._nodes:
                raise way.error(f"its node {number} is not in the file, or only after it")
            way.places.append(self._nodes[number])
        return way

    def _place(self, attributes: dict[str, str], where: str) -> Place:
        if not attributes.get("lat") or not attributes.get("lon"):
            raise self._error("expected lat and lon; local_x and local_y alone do not say where on earth it is", where)
        return (
            self._degrees(attributes["lon"], f"{where}.lon", 180.0),
            self._degrees(attributes["lat"], f"{where}.lat", 90.0),
        )

    def _integer(self, attributes: dict[str, str], name: str, where: str) -> int:
        text = attributes.get(name, "")
        try:
            return int(text)
        except ValueError:
            raise self._error(f"expected an integer, found {text[:40]!r}", f"{where}.{name}") from None

    def _degrees(self, text: str, field: str, limit: float) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= limit:
            raise self._error(f"expected degrees from {-limit:g} to {limit:g}, found {text[:40]!r}", field)
        return value


def _middle(places: list[Place]) -> Place:
    """Return the mean of the places; a ring's first one, which is its last one too, counts once."""
    points = places[:-1] if len(places) > 1 and places[0] == places[-1] else places
    first = points[0][0]  # longitudes are told from it, so that a sign may stand on the antimeridian
    lon = first + sum((p[0] - first + 180.0) % 360.0 - 180.0 for p in points) / len(points)
    return (lon + 180.0) % 360.0 - 180.0, sum(p[1] for p in points) / len(points)
