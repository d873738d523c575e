"""Import a map: its file becomes the first, or the next, version of the map that it names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.errors import FormatError, SlamcuError
from slamcu_core.formats import Lanelet2Reader
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_server.aggregation.cells import map_key
from slamcu_server.database.tables.columns import ID_MAX
from slamcu_server.maps.map_file import MapFormat, opened

_OBJECT_ID_MAX = ID_MAX - 1  # leaves a next one
_TEXT_MAX = 200
_SOURCE = re.compile(r"[\w][\w .:@+~-]{0,199}")  # it stands in paths

_COLUMNS = (
    "object_id", "feature_class", "sign", "value", "altitude", "heading_deg", "existence_confidence", "position_std_m",
    "lon", "lat",
)  # fmt: skip
_STAGE = """
    CREATE TEMPORARY TABLE staged_features (
        object_id bigint NOT NULL, feature_class text NOT NULL, sign text, value text, altitude float8,
        heading_deg float8, existence_confidence float8 NOT NULL, position_std_m float8 NOT NULL,
        lon float8 NOT NULL, lat float8 NOT NULL
    ) ON COMMIT DROP"""
_SAME = """
    (s.feature_class, s.sign, s.value, s.altitude, s.heading_deg, s.existence_confidence, s.position_std_m,
     s.lon, s.lat)
    IS NOT DISTINCT FROM
    (v.feature_class, v.sign, v.value, v.altitude, v.heading_deg, v.existence_confidence, v.position_std_m,
     ST_X(v.geom), ST_Y(v.geom))"""


class MapImportError(SlamcuError):
    """A map cannot become a version of what is here."""


@dataclass(frozen=True, slots=True)
class ImportedMap:
    """What an import did: the version that is now current, and how it differs from the one before."""

    identity: MapIdentity
    sequence: int
    features: int
    added: int
    changed: int
    removed: int
    unchanged: bool = False  # this version was here already, with this content: nothing was done
    map_id: int = 0
    unknown_signs: Mapping[str, int] = field(default_factory=dict)  # national numbers without a sign type, how often


async def import_map(
    connection: AsyncConnection,
    path: Path,
    *,
    identity: MapIdentity | None = None,
    map_format: MapFormat | None = None,
) -> ImportedMap:
    """Import the file at `path`, plain or gzipped, within the transaction of `connection`.

    Object ids that the map had before stand for the same features; ids that are missing are no longer part of the
    map.

    Parameters
    ----------
    identity : source and version, where not empty in place of the file's.
    map_format : what the file is written in; by default what its name stands for.

    Raises FormatError naming the file, line and field that is wrong, and MapImportError if the version is here with
    another content; the transaction must then be rolled back.
    """
    await connection.execute(text(_STAGE))
    given = identity or MapIdentity()
    found, count, unknown = await _stage(connection, path, map_format or MapFormat.of(path))
    identity = _checked(MapIdentity(given.source or found.source, given.version or found.version), str(path))
    await connection.execute(text("CREATE UNIQUE INDEX ON staged_features (object_id)"))
    await connection.execute(text("ANALYZE staged_features"))
    map_id, current = await _lock_map(connection, identity.source)
    if (earlier := await _sequence_of(connection, map_id, identity.version)) is not None:
        if not await _equals(connection, map_id, earlier):
            raise MapImportError(
                f"{path}: version {identity.version!r} of map {identity.source!r} is here with another content; "
                "a changed map needs another version"
            )
        return ImportedMap(identity, earlier, count, 0, 0, 0, unchanged=True, map_id=map_id, unknown_signs=unknown)
    sequence = current + 1
    removed, changed, added = await _write(connection, map_id, sequence, identity.version)
    return ImportedMap(identity, sequence, count, added, changed, removed, map_id=map_id, unknown_signs=unknown)


async def _stage(
    connection: AsyncConnection, path: Path, map_format: MapFormat
) -> tuple[MapIdentity, int, Mapping[str, int]]:
    """Copy the file's features into the staging table; return its identity, how many, and which signs are unknown."""
    raw = await connection.get_raw_connection()
    assert raw.driver_connection is not None  # noqa: S101  (it is checked out)
    try:
        with opened(path) as pieces:
            reader = map_format.reader(pieces, str(path))
            status = await raw.driver_connection.copy_records_to_table(
                "staged_features", records=_records(reader, str(path)), columns=_COLUMNS
            )
            unknown = reader.unknown_signs if isinstance(reader, Lanelet2Reader) else {}
            return reader.identity, int(status.rpartition(" ")[2]), unknown
    except OSError as error:
        raise MapImportError(f"cannot read {path}: {error.strerror or error}") from error


def _records(features: Iterable[MapFeature], source: str) -> Iterator[tuple[Any, ...]]:
    for feature in features:
        where = f"id {feature.object_id}"
        if feature.watched:
            raise FormatError(f"{where} is a watch feature, which is no part of a map", source=source, field="tile_id")
        if feature.object_id > _OBJECT_ID_MAX:
            raise FormatError(f"{where} is greater than {_OBJECT_ID_MAX}", source=source, field="id")
        for name, value in (("class", feature.feature_class), ("sign", feature.sign), ("value", feature.value)):
            if value is not None and not (value.isprintable() and len(value) <= _TEXT_MAX):
                message = f"of {where} must be printable and have at most {_TEXT_MAX} characters"
                raise FormatError(message, source=source, field=name)
        yield (
            feature.object_id,
            feature.feature_class,
            feature.sign,
            feature.value,
            feature.altitude,
            feature.heading_deg,
            feature.existence_confidence,
            feature.position_std_m,
            feature.lon,
            feature.lat,
        )


def _checked(identity: MapIdentity, source: str) -> MapIdentity:
    if not identity.source or not identity.version:
        message = 'a map needs a name and a version: {"map": {"source": "…", "version": "…"}} or --source and --version'
        raise FormatError(message, source=source, field="map")
    if not _SOURCE.fullmatch(identity.source):
        message = "expected letters, digits and . : @ + ~ - _ and spaces, beginning with a letter or digit, at most 200"
        raise FormatError(message, source=source, field="map.source")
    if not identity.version.isprintable() or len(identity.version) > _TEXT_MAX:
        message = f"expected at most {_TEXT_MAX} printable characters"
        raise FormatError(message, source=source, field="map.version")
    return identity


async def _lock_map(connection: AsyncConnection, source: str) -> tuple[int, int]:
    """Return id and current sequence (0: a new map) of the map `source`, locked against other writers."""
    insert = "INSERT INTO maps (source, current_sequence, next_object_id) VALUES (:source, 0, 1) ON CONFLICT DO NOTHING"
    await connection.execute(text(insert), {"source": source})
    map_id = (
        await connection.execute(text("SELECT id FROM maps WHERE source = :source"), {"source": source})
    ).scalar_one()
    # Workers and reviews hold it shared, and before the row: a batch is folded against one version of the map.
    await connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": map_key(map_id)})
    query = text("SELECT current_sequence FROM maps WHERE id = :id FOR UPDATE")
    return map_id, (await connection.execute(query, {"id": map_id})).scalar_one()


async def _sequence_of(connection: AsyncConnection, map_id: int, version: str) -> int | None:
    query = text("SELECT sequence FROM map_versions WHERE map_id = :map AND version = :version")
    return (await connection.execute(query, {"map": map_id, "version": version})).scalar_one_or_none()


async def _equals(connection: AsyncConnection, map_id: int, sequence: int) -> bool:
    """Tell whether what is staged is what the map's version holds."""
    query = text(f"""
        SELECT NOT EXISTS (
            SELECT FROM (
                SELECT f.object_id, v.* FROM feature_versions v JOIN features f ON f.id = v.feature_id
                WHERE v.map_id = :map AND v.from_sequence <= :sequence
                    AND (v.to_sequence IS NULL OR v.to_sequence > :sequence)
            ) v FULL JOIN staged_features s USING (object_id)
            WHERE s.object_id IS NULL OR v.feature_id IS NULL OR NOT ({_SAME})
        )""")  # noqa: S608  (constants)
    return bool((await connection.execute(query, {"map": map_id, "sequence": sequence})).scalar_one())


_ADD_FEATURES = """
    INSERT INTO features (map_id, object_id)
    SELECT :map, object_id FROM staged_features ORDER BY object_id ON CONFLICT DO NOTHING"""
_END_VERSIONS = f"""
    WITH ended AS (
        UPDATE feature_versions v SET to_sequence = :sequence
        FROM features f LEFT JOIN staged_features s ON s.object_id = f.object_id
        WHERE f.id = v.feature_id AND f.map_id = :map AND v.to_sequence IS NULL
            AND (s.object_id IS NULL OR NOT ({_SAME}))
        RETURNING s.object_id IS NULL AS removed
    )
    SELECT count(*) FILTER (WHERE removed) AS removed, count(*) FILTER (WHERE NOT removed) AS changed FROM ended"""  # noqa: S608
# What is the same thing at the same place keeps the evidence about it: a survey that corrects a place by less than a
# vehicle can tell changes nothing of what was seen or missed there, nor does a sign's value that was not known before.
SAME_PLACE_M = 0.5
_BEGIN_VERSIONS = """
    INSERT INTO feature_versions (feature_id, from_sequence, evidence_sequence, map_id, feature_class, sign, value,
        altitude, heading_deg, existence_confidence, position_std_m, geom)
    SELECT f.id, :sequence, COALESCE(kept.since, :sequence), :map, s.feature_class, s.sign, s.value, s.altitude,
        s.heading_deg, s.existence_confidence, s.position_std_m, ST_SetSRID(ST_MakePoint(s.lon, s.lat), 4326)
    FROM staged_features s JOIN features f ON f.map_id = :map AND f.object_id = s.object_id
    LEFT JOIN LATERAL (
        SELECT COALESCE(v.evidence_sequence, (
            SELECT min(from_sequence) FROM feature_versions first WHERE first.feature_id = f.id)) AS since
        FROM feature_versions v
        WHERE v.feature_id = f.id AND v.to_sequence = :sequence AND v.feature_class = s.feature_class
            AND COALESCE(v.sign = s.sign, true) AND COALESCE(v.value = s.value, true)
            AND ST_Distance(
                CAST(v.geom AS geography), CAST(ST_SetSRID(ST_MakePoint(s.lon, s.lat), 4326) AS geography)
            ) <= :same_place
    ) kept ON true
    WHERE NOT EXISTS (SELECT FROM feature_versions v WHERE v.feature_id = f.id AND v.to_sequence IS NULL)
    ORDER BY f.id"""
_ADD_VERSION = """
    INSERT INTO map_versions (map_id, sequence, version, origin) VALUES (:map, :sequence, :version, 'import')"""
_MAKE_CURRENT = """
    UPDATE maps SET current_sequence = :sequence,
        next_object_id = greatest(next_object_id, (SELECT coalesce(max(object_id), 0) + 1 FROM staged_features))
    WHERE id = :map"""


async def _write(connection: AsyncConnection, map_id: int, sequence: int, version: str) -> tuple[int, int, int]:
    """Make the staged features the map's next version; return how many were removed, changed and added."""
    here = {"map": map_id, "sequence": sequence}
    await connection.execute(text(_ADD_FEATURES), {"map": map_id})
    removed, changed = (await connection.execute(text(_END_VERSIONS), here)).one()
    begun = (await connection.execute(text(_BEGIN_VERSIONS), here | {"same_place": SAME_PLACE_M})).rowcount
    await connection.execute(text(_ADD_VERSION), here | {"version": version})
    await connection.execute(text(_MAKE_CURRENT), here)
    return removed, changed, begun - changed
