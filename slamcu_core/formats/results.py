"""Truth and results as GeoJSON: what is so, and what a drive or the cloud says is so."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from slamcu_core.formats.fields import Fields
from slamcu_core.formats.geojson import FeatureCollection, PointFeature, point_to_json, write_collection
from slamcu_core.formats.labels import read_class, read_sign


class ChangeState(StrEnum):
    """What has become of a feature."""

    NORMAL = "normal"
    DELETED = "deleted"
    NEW = "new"
    MOVED = "moved"
    MODIFIED = "modified"
    UNCLASSIFIED = "unclassified"  # results only


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthFeature:
    """A feature of the world, the map, or both.

    A deleted one stands where the map has it, a new one where the world has it, a moved one at its new place; `sign`
    and `value` are the world's (the map's, if deleted).
    """

    truth: ChangeState
    lon: float  # degrees
    lat: float  # degrees
    feature_class: str = "traffic_sign"
    sign: str | None = None
    value: str | None = None
    map_object_id: int | None = None  # of all but new ones
    from_lonlat: tuple[float, float] | None = None  # moved: where the map has it, degrees
    map_sign: str | None = None  # modified: what the map says
    map_value: str | None = None
    id: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFeature:
    """What a drive or the cloud says of one feature: every map feature, also those never in view, and every new one."""

    state: ChangeState
    lon: float  # degrees
    lat: float  # degrees
    mass_exists: float
    mass_not_exists: float
    mass_unknown: float
    conflict: float = 0.0
    covariance_m2: tuple[float, float, float] | None = None  # xx, xy, yy in east-north; None: not measured
    passes: int = 0
    vehicles: int = 0
    map_object_id: int | None = None  # where it is about a map feature
    feature_class: str = "traffic_sign"
    sign: str | None = None
    value: str | None = None
    from_lonlat: tuple[float, float] | None = None  # moved: where the map has it, degrees
    map_sign: str | None = None  # modified: what the map says
    map_value: str | None = None
    id: int | None = None


def read_truth(chunks: Iterable[str | bytes], *, source: str | None = None) -> Iterator[TruthFeature]:
    """Iterate over the features of a truth file; raises FormatError with feature, line and field.

    Parameters
    ----------
    chunks : the file in pieces of any size, as text or UTF-8; a file opened in either mode is one.
    source : its name, for errors.
    """
    for point in FeatureCollection(chunks, source=source, needs_id=False):
        fields = point.properties
        truth = _read_state(fields, "truth", unclassified=False)
        feature_class = read_class(fields)
        needs_id = truth is not ChangeState.NEW
        yield TruthFeature(
            truth=truth,
            lon=point.lon,
            lat=point.lat,
            feature_class=feature_class,
            sign=read_sign(fields, feature_class),
            value=fields.optional_text("value"),
            map_object_id=fields.integer("map_object_id", low=1) if needs_id else None,
            from_lonlat=_read_from(fields, required=truth is ChangeState.MOVED),
            map_sign=read_sign(fields, feature_class, "map_sign"),
            map_value=fields.optional_text("map_value"),
            id=point.id,
        )


def write_truth(features: Iterable[TruthFeature]) -> Iterator[str]:
    """Iterate over the text of a truth file in pieces."""
    return write_collection((_to_json(one, {"truth": one.truth.value}) for one in features), {})


def read_results(chunks: Iterable[str | bytes], *, source: str | None = None) -> Iterator[ResultFeature]:
    """Iterate over the features of a results file; raises FormatError as `read_truth` does."""
    for point in FeatureCollection(chunks, source=source, needs_id=False):
        yield _read_result(point)


def write_results(features: Iterable[ResultFeature]) -> Iterator[str]:
    """Iterate over the text of a results file in pieces."""
    return write_collection((_to_json(one, _result_properties(one)) for one in features), {})


def _read_result(point: PointFeature) -> ResultFeature:
    fields = point.properties
    feature_class = read_class(fields)
    masses = [fields.number(name, low=0.0, high=1.0) for name in ("mass_exists", "mass_not_exists", "mass_unknown")]
    if abs(sum(masses) - 1.0) > 1e-6:
        raise fields.place.error(f"the three masses sum to {sum(masses):g}, expected 1", fields.at("mass_exists"))
    return ResultFeature(
        state=_read_state(fields, "state", unclassified=True),
        lon=point.lon,
        lat=point.lat,
        mass_exists=masses[0],
        mass_not_exists=masses[1],
        mass_unknown=masses[2],
        conflict=fields.number_or("conflict", 0.0, low=0.0, high=1.0),
        covariance_m2=_read_covariance(fields),
        passes=fields.integer("passes", low=0) if "passes" in fields else 0,
        vehicles=fields.integer("vehicles", low=0) if "vehicles" in fields else 0,
        map_object_id=fields.integer("map_object_id", low=1) if "map_object_id" in fields else None,
        feature_class=feature_class,
        sign=read_sign(fields, feature_class),
        value=fields.optional_text("value"),
        from_lonlat=_read_from(fields, required=False),
        map_sign=read_sign(fields, feature_class, "map_sign"),
        map_value=fields.optional_text("map_value"),
        id=point.id,
    )


def _read_state(fields: Fields, name: str, *, unclassified: bool) -> ChangeState:
    allowed = [state for state in ChangeState if unclassified or state is not ChangeState.UNCLASSIFIED]
    return ChangeState(fields.text(name, choices=allowed))


def _read_from(fields: Fields, *, required: bool) -> tuple[float, float] | None:
    if not required and "from" not in fields:
        return None
    lon, lat = fields.numbers("from", (2,))
    if not (-180.0 <= lon <= 180.0 and -90.0 <= lat <= 90.0):
        raise fields.error("from", "[longitude, latitude] in degrees")
    return lon, lat


def _read_covariance(fields: Fields) -> tuple[float, float, float] | None:
    if "covariance_m2" not in fields:
        return None
    xx, xy, yy = fields.numbers("covariance_m2", (3,))
    if not (xx > 0.0 and xx * yy - xy * xy > 0.0):
        raise fields.error("covariance_m2", "[xx, xy, yy] of a positive definite matrix")
    return xx, xy, yy


def _result_properties(one: ResultFeature) -> dict[str, object]:
    return {
        "state": one.state.value,
        "mass_exists": one.mass_exists,
        "mass_not_exists": one.mass_not_exists,
        "mass_unknown": one.mass_unknown,
        "conflict": one.conflict,
        "covariance_m2": list(one.covariance_m2) if one.covariance_m2 is not None else None,
        "passes": one.passes,
        "vehicles": one.vehicles,
    }


def _to_json(one: TruthFeature | ResultFeature, properties: dict[str, object]) -> dict[str, object]:
    common: dict[str, object] = {
        "class": one.feature_class,
        "sign": one.sign,
        "value": one.value,
        "map_object_id": one.map_object_id,
        "from": list(one.from_lonlat) if one.from_lonlat is not None else None,
        "map_sign": one.map_sign,
        "map_value": one.map_value,
    }
    return point_to_json(one.id, one.lon, one.lat, None, properties | common)
