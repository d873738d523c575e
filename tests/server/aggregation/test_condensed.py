"""What the ingest condenses is what the bytes say, and what is copied in is what was given."""

from __future__ import annotations

import struct
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import text

from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import DetectionStatus, Health, MapReference, MeasuredPosition, PassReport, ReportMessage
from slamcu_server.aggregation.binary import Column, copy, text_field
from slamcu_server.aggregation.condensed import condense, read
from slamcu_server.aggregation.log import FORM, ClaimedMessage
from slamcu_server.aggregation.lookups import KnownFeatures, Lookups, WatchReference
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.resolve import passes_of, resolve

START = datetime(2026, 4, 1, tzinfo=UTC)
names = st.sampled_from(["SPEED_LIMIT", "STOP_SIGN", "mögliche Ölspur", None])
weights = st.floats(0.0, 30.0)
positions = st.none() | st.builds(
    MeasuredPosition,
    st.floats(-180.0, 180.0),
    st.floats(-90.0, 90.0),
    st.tuples(st.floats(0.1, 4.0), st.floats(-0.1, 0.1), st.floats(0.2, 4.0)),
)
passes = st.builds(
    PassReport,
    started_at=st.integers(0, 10**12).map(lambda us: START + timedelta(microseconds=us)),
    ended_at=st.integers(10**12, 10**13).map(lambda us: START + timedelta(microseconds=us)),
    status=st.sampled_from(DetectionStatus),
    weight_for=weights,
    weight_against=weights,
    feature_class=st.sampled_from(["traffic_sign", "traffic_light", "pole"]),
    sign=names,
    value=names,
    reference=st.none() | st.builds(MapReference, st.sampled_from([-1, 0]), st.integers(1, 3)),
    position=positions,
    frames_detected=st.integers(0, 10**7),
    valid=st.booleans(),
)
messages = st.lists(
    st.builds(
        ReportMessage,
        session_id=st.just("s"),
        message_id=st.just(1),
        passes=st.lists(passes, max_size=5).map(tuple),
        map_identity=st.just(MapIdentity("town", "1")),
        sensor_model=st.sampled_from(["", "camera"]),
        health=st.builds(Health, trusted=st.booleans()),
    ),
    max_size=4,
)
# features 1 and 2 of the map, of which the second has been something else since; and the watch features 1 to 3
FEATURES = KnownFeatures(
    *(
        np.array(column)
        for column in (
            [7, 7, 7],
            [1, 2, 3],
            [101, 102, 103],
            [2.0, 2.1, 2.2],
            [48.0] * 3,
            [1, 5, 1],
            ["traffic_sign"] * 3,
            [0.95] * 3,
        )
    )
)
KNOWN = Lookups(
    {("town", "1"): (7, 3)},
    FEATURES,
    {key: WatchReference(key, 7, 10 + key, 103 if key == 3 else None, 2.5, 48.0) for key in (1, 2, 3)},
    {7: 5},
)


def claimed(reports: list[ReportMessage]) -> list[ClaimedMessage]:
    return [
        ClaimedMessage(number + 1, 20 + number, one.session_id, one.message_id, b"", condensed=condense(one))
        for number, one in enumerate(reports)
    ]


@given(messages)
def test_passes_are_what_was_reported_and_are_about_what_they_name(reports: list[ReportMessage]) -> None:
    reported, reasons = read(claimed(reports))
    resolved, unresolvable = resolve(reported, KNOWN)
    assert (reasons, unresolvable) == ({}, {})
    count = len(reported.records)
    found = passes_of(resolved, np.arange(count), np.arange(count))
    wanted = [(number, index, item) for number, one in enumerate(reports) for index, item in enumerate(one.passes)]
    assert len(found) == len(wanted)
    for stored, (number, index, item) in zip(found, wanted, strict=True):
        about: tuple[Any, ...] = (None, None, None, False)
        if item.reference is not None and item.reference.watched:
            watch = KNOWN.watches[item.reference.object_id]
            about = (watch.feature_id, watch.id, None if watch.feature_id else watch.candidate_id, False)
        elif item.reference is not None:
            about = (100 + item.reference.object_id, None, None, item.reference.object_id == 2)
        assert (stored.feature_id, stored.watch_id, stored.candidate_id, stored.archived) == about
        assert stored == as_stored(item, stored.id)._replace(key=(20 + number, "s", 1, index), map_id=7,
            trusted=reports[number].health.trusted, feature_id=about[0], watch_id=about[1], candidate_id=about[2],
            archived=about[3])  # fmt: skip


def as_stored(item: PassReport, key: int) -> StoredPass:
    place = item.position
    return StoredPass(
        id=key,
        key=(0, "", 0, 0),
        map_id=0,
        started_at=item.started_at,
        ended_at=item.ended_at,
        status=item.status,
        feature_class=item.feature_class,
        sign=item.sign,
        value=item.value,
        weight_for=item.weight_for,
        weight_against=item.weight_against,
        valid=item.valid,
        trusted=True,
        place=(place.lon, place.lat, place.covariance_m2) if place else None,
    )


@given(messages)
def test_a_message_that_cannot_be_resolved_takes_no_other_with_it(reports: list[ReportMessage]) -> None:
    stray = replace(
        PassReport(START, START, DetectionStatus.EXPECTED_AND_DETECTED, 1.0, 0.0), reference=MapReference(0, 9)
    )
    unknown = ReportMessage("s", 1, (stray,), map_identity=MapIdentity("town", "1"))
    elsewhere = ReportMessage("s", 1, map_identity=MapIdentity("moon", "1"))
    alone, _ = resolve(read(claimed(reports))[0], KNOWN)
    among, reasons = resolve(read(claimed([*reports, unknown, elsewhere]))[0], KNOWN)
    assert {key: why.split()[-1] for key, why in reasons.items()} == {len(reports) + 1: "9", len(reports) + 2: "here"}
    assert among.messages == alone.messages == len(reports)
    assert among.feature_id.tolist() == alone.feature_id.tolist()
    assert among.reported.records.tobytes() == alone.reported.records.tobytes()


def test_bytes_are_read_where_nothing_is_condensed() -> None:
    reported, reasons = read([ClaimedMessage(3, 1, "s", 1, b"no message")])
    assert not reported.claimed
    assert reasons.keys() == {3}
    assert condense(ReportMessage("s", 1))[0] == FORM


@pytest.mark.anyio
async def test_rows_arrive_as_they_were_given(town: Any) -> None:
    rng = np.random.default_rng(3)
    missing = rng.random((4, 50)) < 0.3
    numbers = {kind: rng.integers(-(2**bits), 2**bits, 50) for kind, bits in (("bigint", 60), ("integer", 30))}
    moments, floats, flags = rng.integers(0, 2**50, 50), rng.normal(size=50) * 1e9, rng.random(50) < 0.5
    places, names = rng.uniform(-80, 80, (50, 2)), [None if n % 7 == 0 else "ä" * (n % 5) for n in range(50)]
    columns = {
        "key": Column("integer", np.arange(50)),
        "big": Column("bigint", numbers["bigint"], missing[0]),
        "small": Column("integer", numbers["integer"], missing[1]),
        "at": Column("timestamptz", moments, missing[2]),
        "size": Column("float8", floats),
        "flag": Column("boolean", flags),
        "place": Column("point", places, missing[3]),
    }
    async with town.engine.begin() as connection:
        await connection.execute(
            text("""
            CREATE TEMPORARY TABLE rows (key integer, big bigint, small integer, at timestamptz,
                size float8, flag boolean, place geometry(Point, 4326), name text, bytes bytea) ON COMMIT DROP""")
        )
        tails = [text_field(name) + text_field(struct.pack(">h", n)) for n, name in enumerate(names)]
        await copy(connection, "rows", columns, ["name", "bytes"], tails)
        found = (
            await connection.execute(text("SELECT *, ST_X(place) AS x, ST_Y(place) AS y FROM rows ORDER BY key"))
        ).all()
    assert len(found) == 50
    for n, row in enumerate(found):
        assert row.big == (None if missing[0, n] else numbers["bigint"][n])
        assert row.small == (None if missing[1, n] else numbers["integer"][n])
        assert row.at == (
            None if missing[2, n] else datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(moments[n]))
        )
        assert (row.size, row.flag, row.name, row.bytes) == (floats[n], flags[n], names[n], struct.pack(">h", n))
        assert (row.x, row.y) == ((None, None) if missing[3, n] else tuple(places[n]))
