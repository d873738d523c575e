"""A pass, and a third party's message built from it field by field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import settings

from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import (
    DetectionStatus,
    Health,
    MapReference,
    MeasuredPosition,
    PassReport,
    ReportMessage,
)
from slamcu_core.sensoris import encode_message
from slamcu_core.sensoris.proto import base_pb2, data_pb2, traffic_regulation_pb2

# the same examples everywhere, and no test that fails because the machine is busy
settings.register_profile("slamcu", derandomize=True, deadline=None)
settings.load_profile("slamcu")

START = datetime(2026, 5, 1, 8, 0, 0, 123456, tzinfo=UTC)

PASS = PassReport(
    started_at=START,
    ended_at=START + timedelta(seconds=2.7),
    status=DetectionStatus.EXPECTED_AND_DETECTED,
    weight_for=2.302585092994046,
    weight_against=0.125,
    sign="SPEED_LIMIT",
    value="80",
    reference=MapReference(0, 4711),
    position=MeasuredPosition(2.1000000123, 48.9, (1.25, -0.3, 0.75)),
    frames_detected=31,
    frames_missed=2,
)
MESSAGE = ReportMessage(
    session_id="2026-05-01T08:00Z-007",
    message_id=3,
    passes=(PASS,),
    last_of_session=True,
    vehicle_id="veh-007",
    fleet_id="demo",
    map_identity=MapIdentity("highway", "2026.05.1"),
    sensor_model="front-camera-2",
    software_version="1.2.3",
    health=Health(trusted=False, effective_particles=0.61, innovation_ratio=1.3, unexplained_ratio=0.02),
)


@pytest.fixture
def a_pass() -> PassReport:
    """A map feature seen."""
    return PASS


@pytest.fixture
def a_report() -> ReportMessage:
    """A message with that pass."""
    return MESSAGE


@pytest.fixture
def report_of() -> Callable[..., ReportMessage]:
    """Make a message of one pass that differs from the sample in the fields given."""
    return lambda **changes: replace(MESSAGE, passes=(replace(PASS, **changes),))


@pytest.fixture
def a_message() -> data_pb2.DataMessage:
    """The sample on the wire, with our extension."""
    return encode_message(MESSAGE)


@pytest.fixture
def foreign() -> data_pb2.DataMessage:
    """A third party's message: one traffic sign that its map has, seen, and not a word of ours."""
    message = data_pb2.DataMessage()
    message.envelope.ids.session_id.value = "drive-1"
    message.envelope.ids.message_id.value = 1
    message.envelope.map_identification.provider_version.source.value = "highway"
    message.envelope.map_identification.provider_version.version.name.value = "2026.05.1"
    group = message.event_group.add()
    sign = group.traffic_regulation_category.traffic_sign.add()
    sign.envelope.id.value = 1
    sign.envelope.timestamp.posix_time.value = 1_777_622_400_000
    sign.envelope.timestamp.posix_time_fraction.value = 250
    sign.existence_confidence.value = 90
    sign.detection_status.type = base_pb2.EventDetectionStatus.EXPECTED_AND_DETECTED
    sign.type_and_confidence.type = traffic_regulation_pb2.TrafficSign.TypeAndConfidence.SPEED_LIMIT
    sign.value_and_confidence.value.value = "80"
    place = sign.rectangular_box_and_accuracy.center_orientation_size.center_position_and_accuracy
    place.geographic_wgs84.longitude.value = 210_000_000
    place.geographic_wgs84.latitude.value = 4_890_000_000
    place.combined_std_dev.value = 1500
    reference = group.map_category.map_reference.add()
    reference.envelope.id.value = 2
    reference.location_reference.map_object_id.tile_id.value = 12
    reference.location_reference.map_object_id.object_id.value = 4711
    relation = message.event_relation.add(type=data_pb2.DataMessage.EventRelation.MAP_REFERENCE)
    relation.from_id.add(value=1)
    relation.to_id.add(value=2)
    return message
