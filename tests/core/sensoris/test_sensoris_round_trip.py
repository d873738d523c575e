"""What a car encodes, the cloud decodes: exactly with our extension, to the wire's resolution without."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamcu_core.catalogue import FEATURE_CLASSES, SIGN_TYPES
from slamcu_core.evidence import masses_from_weights
from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import (
    DetectionStatus,
    Health,
    MapReference,
    MeasuredPosition,
    PassReport,
    ReportMessage,
)
from slamcu_core.sensoris import (
    MAX_PASS_WEIGHT,
    decode_batch,
    decode_message,
    encode_batch,
    encode_message,
    sendable,
    serialize_message,
    to_json,
)
from slamcu_core.sensoris.proto import data_pb2

DETECTED = (DetectionStatus.EXPECTED_AND_DETECTED, DetectionStatus.NOT_EXPECTED_AND_DETECTED)
BLOCKED = DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED

weights = st.floats(0.0, MAX_PASS_WEIGHT)
names = st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=30)
instants = st.datetimes(datetime(2001, 1, 1), datetime(2098, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001
frames = st.integers(0, 100_000)


@st.composite
def positions(draw: st.DrawFn) -> MeasuredPosition:
    major, minor, angle = draw(st.floats(0.01, 50.0)), draw(st.floats(0.01, 50.0)), draw(st.floats(0.0, math.pi))
    c, s = math.cos(angle), math.sin(angle)
    return MeasuredPosition(
        draw(st.floats(-180.0, 180.0)),
        draw(st.floats(-90.0, 90.0)),
        (
            (major * c) ** 2 + (minor * s) ** 2,
            (major**2 - minor**2) * c * s,
            (major * s) ** 2 + (minor * c) ** 2,
        ),
    )


@st.composite
def passes(draw: st.DrawFn) -> PassReport:
    status = draw(st.sampled_from(DetectionStatus))
    valid = draw(st.booleans())
    weight_for, weight_against = draw(weights), draw(weights)
    if status is BLOCKED:
        weight_for = weight_against = 0.0
    elif status in DETECTED and weight_for == 0.0:
        weight_against = 0.0
    elif status not in DETECTED and (weight_against == 0.0 or not valid):
        weight_for = 0.0
    feature_class = draw(st.sampled_from(sorted(FEATURE_CLASSES)))
    sign = st.sampled_from(sorted(SIGN_TYPES)) if feature_class == "traffic_sign" else names
    expected = status is not DetectionStatus.NOT_EXPECTED_AND_DETECTED
    reference = st.builds(MapReference, st.integers(-(2**62), 2**62), st.integers(1, 2**63 - 1))
    has_reference = expected and draw(st.booleans())
    start = draw(instants)
    return PassReport(
        started_at=start,
        ended_at=start + draw(st.timedeltas(timedelta(0), timedelta(hours=2))),
        status=status,
        weight_for=weight_for,
        weight_against=weight_against if valid else 0.0,
        feature_class=feature_class,
        sign=draw(st.none() | sign),
        value=draw(st.none() | names),
        reference=draw(reference) if has_reference else None,
        position=draw(st.none() | positions()) if has_reference else draw(positions()),
        frames_detected=draw(frames),
        frames_missed=draw(frames),
        frames_blocked=draw(frames),
        valid=valid,
    )


reports = st.builds(
    ReportMessage,
    session_id=names,
    message_id=st.integers(1, 2**63 - 1),
    passes=st.lists(passes(), max_size=4).map(tuple),
    last_of_session=st.booleans(),
    vehicle_id=names | st.just(""),
    fleet_id=names | st.just(""),
    map_identity=st.builds(MapIdentity, names | st.just(""), names | st.just("")),
    sensor_model=names | st.just(""),
    software_version=names | st.just(""),
    health=st.builds(
        Health,
        trusted=st.booleans(),
        effective_particles=st.floats(1e-6, 1.0),
        innovation_ratio=st.floats(0.0, 1e6),
        unexplained_ratio=st.floats(0.0, 1.0),
    ),
)


@given(report=reports)
def test_a_report_comes_back_as_it_was(report: ReportMessage) -> None:
    assert decode_message(encode_message(report)) == report
    assert decode_message(serialize_message(report)) == report


@settings(max_examples=40)
@given(report=reports)
def test_the_json_mapping_says_the_same(report: ReportMessage) -> None:
    (item,) = decode_batch(to_json(encode_batch([report])).encode(), is_json=True)

    assert item.error is None
    assert item.report == report


@settings(max_examples=40)
@given(report=reports)
def test_the_same_report_gives_the_same_bytes(report: ReportMessage) -> None:
    again = decode_message(serialize_message(report))

    assert serialize_message(again) == serialize_message(report)


@given(one=passes())
def test_without_our_extension_the_rest_of_the_message_says_it_to_its_resolution(one: PassReport) -> None:
    message = encode_message(ReportMessage("s", 1, (one,)))
    strip_extensions(message)

    (read,) = decode_message(message).passes

    assert (read.status, read.feature_class, read.reference) == (one.status, one.feature_class, one.reference)
    assert read.started_at == read.ended_at == one.ended_at
    if one.feature_class == "traffic_sign":
        assert (read.sign, read.value, read.valid) == (one.sign, one.value, one.valid)
    if one.position is None:
        assert read.position is None
    else:
        assert read.position is not None
        assert read.position.lon == pytest.approx(one.position.lon, abs=5.1e-9)
        assert read.position.lat == pytest.approx(one.position.lat, abs=5.1e-9)
        assert read.position.covariance_m2 == pytest.approx(one.position.covariance_m2, abs=1.1e-6)
    net = one.weight_for - one.weight_against
    if one.status in DETECTED:
        assert read.weight_against == 0.0
        assert 1 - math.exp(-read.weight_for) == pytest.approx(
            min(0.99, max(0.01, 1 - math.exp(-max(net, 0.0)))), abs=5.1e-3
        )
    elif one.status is BLOCKED:
        assert (read.weight_for, read.weight_against) == (0.0, 0.0)
    else:
        assert read.weight_for == 0.0
        if one.status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE and (read.valid and one.valid):
            assert 1 - math.exp(-read.weight_against) == pytest.approx(
                min(0.99, max(0.01, 1 - math.exp(-max(-net, 0.0)))), abs=5.1e-3
            )


def test_a_pass_of_an_hour_is_bounded_without_changing_what_it_says(a_pass: PassReport) -> None:
    long = replace(a_pass, weight_for=40_000.0, weight_against=39_998.5)

    (read,) = decode_message(encode_message(ReportMessage("s", 1, (long,)))).passes

    assert read == decode_message(encode_message(ReportMessage("s", 1, (sendable(long),)))).passes[0]
    assert max(read.weight_for, read.weight_against) == MAX_PASS_WEIGHT
    assert masses_from_weights(read.weight_for, read.weight_against) == pytest.approx(
        masses_from_weights(long.weight_for, long.weight_against), abs=1e-12
    )


def test_a_crossed_out_sign_is_no_evidence_against_it(a_pass: PassReport) -> None:
    crossed = replace(a_pass, valid=False)

    (read,) = decode_message(encode_message(ReportMessage("s", 1, (crossed,)))).passes

    assert not read.valid
    assert (read.weight_for, read.weight_against) == (crossed.weight_for, 0.0)


def test_passes_keep_their_order_whatever_their_class(a_pass: PassReport) -> None:
    kinds = ("pole", "traffic_sign", "traffic_light", "tree", "traffic_sign", "static_object")
    report = ReportMessage("s", 1, tuple(replace(a_pass, feature_class=kind, sign=None) for kind in kinds))

    assert [one.feature_class for one in decode_message(encode_message(report)).passes] == list(kinds)


def test_the_covariance_on_the_wire_stays_positive_definite(a_pass: PassReport) -> None:
    sharp = replace(a_pass, position=MeasuredPosition(2.0, 48.0, (4.0000001, 3.9999999, 4.0)))
    message = encode_message(ReportMessage("s", 1, (sharp,)))
    strip_extensions(message)

    assert decode_message(message).passes[0].position is not None


def strip_extensions(message: data_pb2.DataMessage) -> None:
    del message.envelope.extension[:]
    for group in message.event_group:
        for events in (
            group.traffic_regulation_category.traffic_sign,
            group.intersection_attribution_category.traffic_signal,
            group.object_detection_category.static_object,
        ):
            for event in events:
                del event.envelope.extension[:]
