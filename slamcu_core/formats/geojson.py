"""The frame of a GeoJSON file (RFC 7946): a FeatureCollection of points, read feature by feature."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from slamcu_core.errors import FormatError
from slamcu_core.formats.fields import Fields, Place, describe
from slamcu_core.formats.json_stream import END_OF_LIST, JsonObjectStream


@dataclass(frozen=True, slots=True)
class PointFeature:
    """A point of a FeatureCollection: where it is, its id if it has one, and its properties to be read."""

    id: int | None
    lon: float
    lat: float
    altitude: float | None
    properties: Fields


class FeatureCollection:
    """Reads the points of a FeatureCollection, one at a time.

    Parameters
    ----------
    chunks : the text in pieces of any size (text or UTF-8), such as the lines of an open file.
    source : its name, for errors.
    needs_id : whether every feature must have a positive integer as its id.

    Other members of the collection are collected in `members` as they come by: they may stand after the features, so
    all are there only when iteration has ended. It can be iterated once.
    """

    def __init__(self, chunks: Iterable[str | bytes], *, source: str | None = None, needs_id: bool = True) -> None:
        self._stream = JsonObjectStream(chunks, source)
        self._source, self._needs_id = source, needs_id
        self.members: dict[str, tuple[object, Place]] = {}
        self.ended = False

    def __iter__(self) -> Iterator[PointFeature]:
        """Iterate over the features; raises FormatError."""
        index, ended_list = 0, False
        for name, value in self._stream.members("features"):
            place = Place(self._source, self._stream.value_line)
            if name != "features":
                self._keep(name, value, place)
            elif ended_list:
                raise place.error("expected one list, there are two", "features")
            elif value is END_OF_LIST:
                ended_list = True
            else:
                yield self._point(value, place, index)
                index += 1
        if not ended_list:
            raise self._stream.place().error("expected a list of features, but it is missing", "features")
        if "type" not in self.members:
            raise self._stream.place().error('expected "FeatureCollection", but it is missing', "type")
        self.ended = True

    def _keep(self, name: str, value: object, place: Place) -> None:
        if name in self.members:
            raise place.error("the member stands twice", name[:60])
        if name == "type" and value != "FeatureCollection":
            raise place.error(f'expected "FeatureCollection", not {describe(value)}', name)
        if name == "crs" and not any(wgs84 in json.dumps(value) for wgs84 in ("CRS84", "EPSG::4326", "EPSG:4326")):
            raise place.error("expected WGS84: RFC 7946 has no other coordinate reference system", name)
        if name in ("type", "map"):  # others may be large, and nobody asks for them
            self.members[name] = (value, place)

    def _point(self, value: object, place: Place, index: int) -> PointFeature:
        path = f"features[{index}]"
        fields = Fields(value, place, path)
        if fields.data.get("type") != "Feature":
            raise fields.error("type", '"Feature"')
        number = fields.integer("id", low=1) if self._needs_id or "id" in fields else None
        if number is not None:
            fields = Fields(value, Place(place.source, place.line, f"feature {number}"), path)
        geometry = fields.child("geometry")
        if geometry.data.get("type") != "Point":
            raise geometry.error("type", '"Point"')
        lon, lat, *altitude = geometry.numbers("coordinates", (2, 3))
        if not (-180.0 <= lon <= 180.0 and -90.0 <= lat <= 90.0):
            raise fields.place.error(
                f"longitude {lon:g}, latitude {lat:g}; expected [-180, 180] and [-90, 90] degrees",
                geometry.at("coordinates"),
            )
        return PointFeature(number, lon, lat, altitude[0] if altitude else None, fields.child("properties"))


def point_to_json(
    feature_id: int | None, lon: float, lat: float, altitude: float | None, properties: dict[str, object]
) -> dict[str, object]:
    """Return the JSON object of a point feature; properties that are None are left out."""
    coordinates = [lon, lat] if altitude is None else [lon, lat, altitude]
    document: dict[str, object] = {"type": "Feature"}
    if feature_id is not None:
        document["id"] = feature_id
    return document | {
        "geometry": {"type": "Point", "coordinates": coordinates},
        "properties": {name: value for name, value in properties.items() if value is not None},
    }


def write_collection(features: Iterable[dict[str, object]], members: dict[str, object]) -> Iterator[str]:
    """Iterate over the text of a FeatureCollection, one feature a line, its other members first."""
    head = "".join(f"{_dump(name)}: {_dump(value)},\n" for name, value in members.items())
    yield f'{{"type": "FeatureCollection",\n{head}"features": ['
    separator = "\n"
    for feature in features:
        yield separator + _dump(feature)
        separator = ",\n"
    yield "\n]}\n"


def read_unique(features: Iterable[PointFeature], key: Callable[[PointFeature], object]) -> Iterator[PointFeature]:
    """Pass features on; raises FormatError at the second one with the same key."""
    seen: set[object] = set()
    for feature in features:
        this = key(feature)
        if this in seen:
            raise _twice(feature)
        seen.add(this)
        yield feature


def _twice(feature: PointFeature) -> FormatError:
    path = feature.properties.path.removesuffix("properties") + "id"
    return feature.properties.place.error("an earlier feature has the same id", path)


def _dump(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
