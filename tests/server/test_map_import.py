"""Importing maps: features keep their identity, and a file is taken whole or not at all."""

from __future__ import annotations

import asyncio
import gzip
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.errors import FormatError
from slamcu_core.formats import write_hd_map
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_server.maps.importer import ImportedMap, MapImportError, import_map

pytestmark = pytest.mark.anyio

Command = Callable[..., subprocess.CompletedProcess[str]]
ONE, TWO, THREE = (MapFeature(number, 2.0 + number / 100, 48.9, sign="STOP_SIGN") for number in (1, 2, 3))

PLAIN = replace(ONE, sign=None)


class Importer:
    def __init__(self, engine: AsyncEngine, directory: Path) -> None:
        self.engine, self.directory = engine, directory

    async def put(self, version: str, *features: MapFeature, source: str = "town") -> ImportedMap:
        return await self.put_text("".join(write_hd_map(MapIdentity(source, version), features)))

    async def put_text(self, content: str | bytes) -> ImportedMap:
        path = self.directory / "map.geojson"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        async with self.engine.begin() as connection:
            return await import_map(connection, path)

    async def rows(self, query: str) -> list[tuple[Any, ...]]:
        async with self.engine.connect() as connection:
            return [tuple(row) for row in await connection.execute(text(query))]

    async def feature_ids(self) -> dict[int, int]:
        return {row[0]: row[1] for row in await self.rows("SELECT object_id, id FROM features")}

    async def spans(self) -> dict[int, list[tuple[int, int | None]]]:
        """For each object id, from which version to which it had the same attributes."""
        found: dict[int, list[tuple[int, int | None]]] = {}
        query = """SELECT object_id, from_sequence, to_sequence FROM feature_versions
            JOIN features ON id = feature_id ORDER BY object_id, from_sequence"""
        for number, begun, ended in await self.rows(query):
            found.setdefault(number, []).append((begun, ended))
        return found


@pytest.fixture
def importer(engine: AsyncEngine, tmp_path: Path) -> Importer:
    return Importer(engine, tmp_path)


async def test_versions_follow_each_other(importer: Importer) -> None:
    first = await importer.put("a", ONE, TWO)
    assert (first.sequence, first.features, first.added, first.changed, first.removed) == (1, 2, 2, 0, 0)
    identity = await importer.feature_ids()
    moved = replace(TWO, lon=2.5)
    second = await importer.put("b", moved, THREE)
    assert (second.sequence, second.added, second.changed, second.removed) == (2, 1, 1, 1)
    third = await importer.put("c", ONE, moved, THREE)
    assert (third.sequence, third.added, third.changed, third.removed) == (3, 1, 0, 0)
    assert await importer.spans() == {1: [(1, 2), (3, None)], 2: [(1, 2), (2, None)], 3: [(2, None)]}
    assert {number: found for number, found in (await importer.feature_ids()).items() if number != 3} == identity
    assert await importer.rows("SELECT source, current_sequence, next_object_id FROM maps") == [("town", 3, 4)]


async def test_every_attribute_counts_as_a_change(importer: Importer) -> None:
    changes: dict[str, Any] = {
        "feature_class": "pole", "sign": "YIELD", "value": "80", "altitude": 5.0, "heading_deg": 90.0,
        "existence_confidence": 0.5, "position_std_m": 0.3, "lon": 2.0001, "lat": 48.90000001,
    }  # fmt: skip
    await importer.put("0", PLAIN)
    for number, (name, value) in enumerate(changes.items(), 1):
        changed = (
            replace(ONE, sign=None, feature_class=value) if name == "feature_class" else replace(ONE, **{name: value})
        )
        assert (await importer.put(f"{number}", changed)).changed == 1, name
        assert (await importer.put(f"{number}-again", changed)).changed == 0, name
        assert (await importer.put(f"{number}-back", PLAIN)).changed == 1, name


async def test_the_same_version_again(importer: Importer) -> None:
    await importer.put("a", ONE, TWO)
    await importer.put("b", ONE)
    spans = await importer.spans()
    again = await importer.put("a", TWO, ONE)  # in another order, and not the current one
    assert (again.unchanged, again.sequence) == (True, 1)
    for other in ([ONE], [ONE, replace(TWO, value="x")], [ONE, TWO, THREE], []):
        with pytest.raises(MapImportError, match=r"version 'a' of map 'town' is here with another content"):
            await importer.put("a", *other)
    assert await importer.spans() == spans
    assert await importer.rows("SELECT version FROM map_versions ORDER BY sequence") == [("a",), ("b",)]


async def test_maps_do_not_touch_each_other(importer: Importer) -> None:
    await importer.put("a", ONE, TWO)
    await importer.put("a", replace(ONE, value="x"), source="village")
    await importer.put("b", source="village")
    assert await importer.rows("SELECT count(*) FROM feature_versions WHERE to_sequence IS NULL") == [(2,)]


async def test_two_imports_at_once_become_two_versions(importer: Importer, tmp_path: Path) -> None:
    async def put(version: str, *features: MapFeature) -> ImportedMap:
        directory = tmp_path / version
        directory.mkdir()
        return await Importer(importer.engine, directory).put(version, *features)

    results = await asyncio.gather(put("a", ONE, TWO), put("b", TWO, THREE), put("c", THREE))
    assert sorted(result.sequence for result in results) == [1, 2, 3]
    last = max(results, key=lambda result: result.sequence)
    current = await importer.rows("SELECT count(*) FROM feature_versions WHERE to_sequence IS NULL")
    assert current == [(last.features,)]


def document(*features: dict[str, Any], **members: Any) -> str:
    return json.dumps(
        {"type": "FeatureCollection", "map": {"source": "town", "version": "x"}, "features": features} | members
    )


def point(number: Any = 1, lon: Any = 2.1, lat: Any = 48.9, **properties: Any) -> dict[str, Any]:
    geometry = {"type": "Point", "coordinates": [lon, lat]}
    return {"type": "Feature", "id": number, "geometry": geometry, "properties": {"class": "traffic_sign"} | properties}


BAD_MAPS: dict[str, tuple[str | bytes, str]] = {
    "two equal ids": (document(point(7), point(7)), "7"),
    "a longitude out of range": (document(point(lon=181)), "coordinates"),
    "a latitude out of range": (document(point(lat=-91)), "coordinates"),
    "another geometry": (document(point() | {"geometry": {"type": "Polygon", "coordinates": []}}), "geometry"),
    "no id": (document({k: v for k, v in point().items() if k != "id"}), "id"),
    "an id that is no integer": (document(point("x")), "id"),
    "an id beyond 64 bits": (document(point(2**63)), "id"),
    "a confidence above 1": (document(point(existence_confidence=1.5)), "existence_confidence"),
    "a nul in a value": (document(point(value="a\0b")), "value"),
    "a lone surrogate": (document(point(value="\ud800")), "value"),
    "a watch feature": (document(point(tile_id=-5)), "tile_id"),
    "no name": (document(point(), map={"version": "x"}), "map"),
    "a name for a path": (document(point(), map={"source": "a/b", "version": "x"}), "source"),
    "a version of two lines": (document(point(), map={"source": "a", "version": "x\ny"}), "version"),
    "half a file": (document(*(point(n) for n in range(1, 50)))[:-100], "map.geojson"),
    "no JSON": ("lon;lat;sign", "map.geojson"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00\xff", "map.geojson"),
    "an empty file": ("", "map.geojson"),
}


@pytest.mark.parametrize("name", BAD_MAPS)
async def test_a_bad_map_changes_nothing(importer: Importer, name: str) -> None:
    await importer.put("a", ONE)
    content, named = BAD_MAPS[name]
    with pytest.raises(FormatError, match=named):
        await importer.put_text(content)
    assert await importer.rows("SELECT source, current_sequence FROM maps") == [("town", 1)]
    assert await importer.spans() == {1: [(1, None)]}


def test_the_command(command: Command, tmp_path: Path) -> None:
    path = tmp_path / "town.geojson"
    path.write_text("".join(write_hd_map(MapIdentity("town", "1"), [ONE, TWO])))
    first = command("import-map", str(path))
    assert first.returncode == 0, first.stderr
    assert "2 features; it is the first version" in first.stderr
    assert "nothing to do" in command("import-map", str(path)).stderr
    assert "1 features" not in command("import-map", str(path), "--version", "2").stderr

    path.write_text(document(point(), point(2, lon=500)))
    bad = command("import-map", str(path))
    assert bad.returncode == 1
    assert bad.stderr.count("\n") == 1
    assert "features[1]" in bad.stderr
    missing = command("import-map", str(tmp_path / "nowhere.geojson"))
    assert (missing.returncode, missing.stderr.count("\n")) == (1, 1)
    assert "nowhere.geojson" in missing.stderr


SIGN_WAY = "<way id='{}'><nd ref='1'/><nd ref='2'/><tag k='type' v='traffic_sign'/><tag k='subtype' v='{}'/></way>"


def test_a_lanelet2_map_is_imported_by_name_or_by_option(command: Command, tmp_path: Path) -> None:
    nodes = "<node id='1' lat='49.0' lon='8.4'/><node id='2' lat='49.0' lon='8.40001'/>"
    path = tmp_path / "town.osm"
    path.write_text(f"<osm>{nodes}{SIGN_WAY.format(44, 'de205')}{SIGN_WAY.format(45, 'de999')}</osm>")
    unnamed = command("import-map", str(path))
    assert (unnamed.returncode, unnamed.stderr.count("\n")) == (1, 1)
    assert "a map needs a name and a version" in unnamed.stderr
    done = command("import-map", str(path), "--source", "town", "--version", "1")
    assert done.returncode == 0, done.stderr
    assert "2 features; it is the first version" in done.stderr
    assert "without a known type, to be matched by class alone: de999 (1)" in done.stderr

    other = path.rename(tmp_path / "town.xml")
    again = command("import-map", str(other), "--source", "town", "--version", "1", "--format", "lanelet2")
    assert "nothing to do" in again.stderr, again.stderr
    other.write_text(f"<osm>{nodes}{SIGN_WAY.format(44, 'de205')}")
    half = command("import-map", str(other), "--source", "town", "--version", "2", "--format", "lanelet2")
    assert (half.returncode, half.stderr.count("\n")) == (1, 1)
    assert "town.xml, line 1: expected OSM XML" in half.stderr


def test_a_gzipped_map_is_imported_whatever_its_name(command: Command, tmp_path: Path) -> None:
    plain = "".join(write_hd_map(MapIdentity("town", "1"), [ONE, TWO])).encode()
    half = len(plain) // 2
    members = gzip.compress(plain[:half]) + gzip.compress(plain[half:])  # as of files that were joined
    nodes = '<node id="1" lat="48.9" lon="2.1"/><node id="2" lat="48.9" lon="2.1001"/>'
    osm = gzip.compress(f"<osm>{nodes}{SIGN_WAY.format(44, 'de205')}</osm>".encode())
    for name, content, options in (
        ("town.geojson.gz", members, ()),
        ("misnamed.geojson", members, ("--source", "village")),
        ("hamlet.OSM.gz", osm, ("--source", "hamlet", "--version", "1")),
    ):
        (tmp_path / name).write_bytes(content)
        done = command("import-map", str(tmp_path / name), *options)
        assert done.returncode == 0, done.stderr
    again = tmp_path / "town.geojson"
    again.write_bytes(plain)
    assert "is here already, with the same 2 features" in command("import-map", str(again)).stderr


def test_the_import_says_how_a_version_differs_from_the_one_before(command: Command, tmp_path: Path) -> None:
    path = tmp_path / "town.geojson"
    told = []
    for version, features in (("1", [ONE, TWO]), ("2", [replace(ONE, value="3"), THREE])):
        path.write_text("".join(write_hd_map(MapIdentity("town", version), features)))
        told.append(command("import-map", str(path)).stderr.splitlines()[0])
    assert told == [
        "map town version 1: 2 features; it is the first version",
        "map town version 2: 2 features; 1 added, 1 changed, 1 removed since the version before",
    ]


def test_a_gzipped_map_is_read_from_a_pipe(server_environment: dict[str, str]) -> None:
    packed = gzip.compress("".join(write_hd_map(MapIdentity("town", "1"), [ONE, TWO])).encode())
    done = subprocess.run(
        [sys.executable, "-m", "slamcu_server", "import-map", "/dev/stdin"],
        input=packed,
        env=server_environment,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("broken", ["cut short", "a changed byte", "nothing but its first bytes", "something after it"])
async def test_a_broken_packing_is_named_and_nothing_is_imported(importer: Importer, broken: str) -> None:
    packed = gzip.compress("".join(write_hd_map(MapIdentity("town", "1"), [ONE, TWO])).encode())
    content = {
        "cut short": packed[:-12],
        "a changed byte": packed[:-6] + bytes([packed[-6] ^ 1]) + packed[-5:],
        "nothing but its first bytes": packed[:2],
        "something after it": packed + b"x",
    }[broken]
    with pytest.raises(FormatError, match=r"map\.geojson: the gzip packing is broken: "):
        await importer.put_text(content)
    assert await importer.rows("SELECT id FROM maps") == []
