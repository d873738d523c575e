"""What was left behind is still known, comes back as it was, and frees the rows it had."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Odometry, Record, Sensor
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.archive import FoundArchive, MapLedger
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature

FRAME = LocalFrame(2.1, 48.9)
SPEED = 20.0
CAMERA = Sensor("camera", fov_deg=40, min_range_m=2, max_range_m=80, range_std_m=0.3, bearing_std_rad=0.005)
HEADER = DriveHeader("v", "s", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(2.1, 48.9, 90.0, 0.2, 0.2), (CAMERA,))
MAPPED, UNMAPPED, GONE = (100.0, 6.0), (140.0, 7.0), (180.0, -6.0)


def _feature(object_id: int, place: tuple[float, float]) -> MapFeature:
    lon, lat = FRAME.to_geographic(place)
    return MapFeature(object_id, float(lon), float(lat))


def _records(seconds: float) -> Iterator[Record]:
    rng = np.random.default_rng(0)
    for step in range(1, round(10 * seconds)):
        yield Odometry((step - 1) / 10, SPEED, yaw_rate=0.0)
        t, items = step / 10, []
        for x, y in (MAPPED, UNMAPPED):
            distance, bearing = np.hypot(x - SPEED * t, y), np.arctan2(y, x - SPEED * t)
            if 2 < distance < 80 and abs(bearing) < np.deg2rad(20) and rng.random() < 0.9:
                noise = rng.normal(size=2) * (0.3, 0.005)
                items.append(Detection("traffic_sign", range=distance + noise[0], bearing=bearing + noise[1]))
        yield DetectionFrame(t, "camera", tuple(items))


def _outcome(seconds: float) -> tuple[SlamcuFilter, dict[int | None, tuple[object, ...]]]:
    car = SlamcuFilter(
        HDMap([_feature(1, MAPPED), _feature(2, GONE)]), HEADER, FilterParameters(), rng=np.random.default_rng(1)
    )
    for record in _records(seconds):
        car.feed(record)
    return car, {
        f.feature.object_id if f.feature else None: (f.state, f.passes, f.masses, f.lon, f.lat) for f in car.features()
    }


def test_features_left_behind_free_their_rows_and_keep_their_class_and_masses() -> None:
    near, before = _outcome(14.0)  # past all signs, which are still in the table
    far, after = _outcome(60.0)
    assert near.live_rows == 3
    assert far.live_rows == far.live_finds == 0
    assert {key: value[:3] for key, value in before.items()} == {key: value[:3] for key, value in after.items()}
    assert {key: value[0] for key, value in after.items()} == {1: "normal", 2: "deleted", None: "new"}
    place = FRAME.to_local(*after[None][3:])  # type: ignore[arg-type]  # longitude and latitude
    assert np.hypot(*(place - UNMAPPED)) < 1.5


def _find(table: FeatureTable, x: float, y: float) -> int:
    row = table.add(Kind.NEW, feature_class=1, sign=2, value=3)
    table.xy[row], table.covariance[row] = (x, y), (0.3, 0.1, 0.2)
    table.view_weight[row] = 4.0
    table.view_from[row] = 4.0 * np.array([x - 40.0, 0.0])
    table.weight_for[row], table.passes[row], table.reported[row] = 5.0, 2, True
    return row


def test_a_find_comes_back_as_it_was_in_whatever_frame_the_car_has_then() -> None:
    table, archive, later = FeatureTable(), FoundArchive(10), LocalFrame(2.2, 48.95)
    row = _find(table, 120.0, 7.0)
    archive.put(table, row, FRAME)
    assert (table.used, len(archive)) == (0, 1)
    (kept,) = archive.near(*(float(v) for v in FRAME.to_geographic([100.0, 0.0])), 150.0)
    back = archive.give_back(kept, table, later)
    assert (table.used, len(archive)) == (1, 0)
    np.testing.assert_allclose(table.xy[back], later.to_local(*FRAME.to_geographic([120.0, 7.0])), atol=1e-6)
    np.testing.assert_allclose(
        table.view_from[back] / table.view_weight[back], later.to_local(*FRAME.to_geographic([80.0, 0.0])), atol=1e-6
    )
    assert (table.weight_for[back], table.passes[back], table.slot[back]) == (5.0, 2, -1)
    assert table.reported[back]
    assert table.alive[back]


def test_a_copy_of_a_car_drives_on_as_the_car_does() -> None:
    car, _ = _outcome(6.0)
    twin = copy.deepcopy(car)
    for record in _records(20.0):
        if record.t > 6.0:
            assert car.feed(record) == twin.feed(record)
    assert car.features() == twin.features()


def test_beyond_its_bound_the_archive_drops_the_oldest_find() -> None:
    table, archive = FeatureTable(), FoundArchive(3)
    for index in range(5):
        archive.put(table, _find(table, 100.0 * index, 0.0), FRAME)
    east = [archive.place(row, FRAME)[0] for row in archive.rows()]
    np.testing.assert_allclose(east, [200.0, 300.0, 400.0], atol=1e-6)
    assert len(archive.table) <= 4
    archive.clear()
    assert len(archive) == 0


def test_the_ledger_gives_a_map_feature_its_evidence_back() -> None:
    table, ledger = FeatureTable(), MapLedger(5)
    row = table.add(Kind.MAP, feature_class=1, sign=0, value=0, prior=3.0)
    table.source[row], table.weight_for[row], table.weight_against[row], table.passes[row] = 4, 2.5, 0.5, 3
    ledger.put(table, np.array([row]))
    table.release(row)
    again = table.add(Kind.MAP, feature_class=1, sign=0, value=0, prior=3.0)
    table.source[again] = 4
    assert (again, table.weight_for[again]) == (row, 0.0), "a row used again starts empty"
    ledger.restore(table, np.array([again]))
    assert (table.weight_for[again], table.weight_against[again], table.passes[again]) == (2.5, 0.5, 3)
    ledger.clear()
    assert not ledger.passes.any()
    assert ledger.weight_for.sum() == pytest.approx(0.0)
