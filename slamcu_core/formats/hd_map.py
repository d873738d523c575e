"""HD maps as GeoJSON: points with class, sign, value and the map's own confidence, and the map's identity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

from slamcu_core.formats.fields import Fields
from slamcu_core.formats.geojson import FeatureCollection, PointFeature, point_to_json, read_unique, write_collection
from slamcu_core.formats.labels import read_class, read_sign
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity

_MOVED = "moved"  # the kind of a watch feature that is what the map has elsewhere
_DEFAULT = MapFeature(object_id=1, lon=0.0, lat=0.0)


class HDMapReader:
    """Reads an HD map: iterate for its features, then ask for its identity.

    The member ``map``, which names source and version, may stand after the features, so the identity is known for sure
    only when all have been read. It can be iterated once.

    Usage::

        with open(path, "rb") as file:
            reader = read_hd_map(file, source=path)
            for feature in reader:
                ...
            identity = reader.identity
    """

    def __init__(self, chunks: Iterable[str | bytes], *, source: str | None = None) -> None:
        self._collection = FeatureCollection(chunks, source=source)

    def __iter__(self) -> Iterator[MapFeature]:
        """Iterate over the features; raises FormatError with feature, line and field."""
        points = read_unique(self._collection, lambda point: (_tile_id(point) < 0, point.id))
        for point in points:
            yield _read_feature(point)
        _read_identity(self._collection)

    @property
    def identity(self) -> MapIdentity:
        """Source and version of the map; empty where the file does not say. Raises FormatError.

        Raises RuntimeError while features are left to be read.
        """
        if not self._collection.ended:
            raise RuntimeError("iterate over the features first: the map's identity may stand after them")
        return _read_identity(self._collection)


def read_hd_map(chunks: Iterable[str | bytes], *, source: str | None = None) -> HDMapReader:
    """Return a reader that streams the features of a map.

    Parameters
    ----------
    chunks : the file in pieces of any size, as text or UTF-8; a file opened in either mode is one.
    source : its name, for errors.
    """
    return HDMapReader(chunks, source=source)


def load_hd_map(chunks: Iterable[str | bytes], *, source: str | None = None) -> HDMap:
    """Read a whole map into memory. Raises FormatError."""
    reader = read_hd_map(chunks, source=source)
    features = list(reader)
    return HDMap(features, reader.identity)


def write_hd_map(identity: MapIdentity, features: Iterable[MapFeature]) -> Iterator[str]:
    """Iterate over the text of a map file in pieces."""
    documents = (
        point_to_json(feature.object_id, feature.lon, feature.lat, feature.altitude, map_properties(feature))
        for feature in features
    )
    return write_collection(documents, {"map": {"source": identity.source, "version": identity.version}})


def map_properties(feature: MapFeature) -> dict[str, object]:
    """Return the properties of a map feature as GeoJSON has them."""
    return {
        "class": feature.feature_class,
        "sign": feature.sign,
        "value": feature.value,
        "heading_deg": feature.heading_deg,
        "existence_confidence": feature.existence_confidence,
        "position_std_m": feature.position_std_m,
        "tile_id": feature.tile_id or None,
        **({} if feature.moved_from is None else {"kind": _MOVED, "replaces": feature.moved_from}),
    }


def _read_feature(point: PointFeature) -> MapFeature:
    properties = point.properties
    feature_class = read_class(properties)
    make = partial(
        MapFeature,
        object_id=point.id or 0,
        lon=point.lon,
        lat=point.lat,
        feature_class=feature_class,
        sign=read_sign(properties, feature_class),
        value=properties.optional_text("value"),
        altitude=point.altitude,
        heading_deg=properties.optional_number("heading_deg", low=-360.0, high=360.0),
        existence_confidence=properties.number_or(
            "existence_confidence", _DEFAULT.existence_confidence, above=0.0, high=1.0
        ),
        position_std_m=properties.number_or("position_std_m", _DEFAULT.position_std_m, low=0.0),
        tile_id=_tile_id(point),
        moved_from=_moved_from(point),
    )
    return properties.checked(make)


def _tile_id(point: PointFeature) -> int:
    return point.properties.integer("tile_id") if "tile_id" in point.properties else 0


def _moved_from(point: PointFeature) -> int | None:
    properties = point.properties
    moved = _tile_id(point) < 0 and "replaces" in properties and properties.optional_text("kind") == _MOVED
    return properties.integer("replaces", low=1) if moved else None


def _read_identity(collection: FeatureCollection) -> MapIdentity:
    if "map" not in collection.members:
        return MapIdentity()
    value, place = collection.members["map"]
    fields = Fields(value, place, "map")
    return MapIdentity(fields.optional_text("source") or "", fields.optional_text("version") or "")
