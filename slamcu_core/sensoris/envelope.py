"""The envelope of a message: its ids, the map that the vehicle compared with, and how its filter was doing."""

from __future__ import annotations

from slamcu_core.errors import WireError
from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import Health, ReportMessage
from slamcu_core.sensoris.extension import find
from slamcu_core.sensoris.proto import base_pb2, data_pb2, extension_pb2


def read_envelope(message: data_pb2.DataMessage) -> ReportMessage:
    """Return a report without passes that says what the envelope says.

    Raises WireError where the envelope changes the resolution of fields, or holds a malformed extension.
    """
    envelope = message.envelope
    if envelope.field_resolution_override:
        raise WireError(
            "unsupported-resolution",
            "field_resolution_override is not supported: expected the resolutions of SENSORIS 1.5",
        )
    ids = envelope.ids
    provider = envelope.map_identification.provider_version
    exact = find(envelope.extension, extension_pb2.MessageHealth)
    if exact is None:
        health, (sensor_model, software_version) = Health(), _source(message)
    else:
        health = Health(exact.trusted, exact.effective_particles, exact.innovation_ratio, exact.unexplained_ratio)
        sensor_model, software_version = exact.sensor_model, exact.software_version
    return ReportMessage(
        session_id=ids.session_id.value,
        message_id=ids.message_id.value,
        last_of_session=ids.last_message_of_session.value,
        vehicle_id=ids.vehicle_id.value,
        fleet_id=ids.vehicle_fleet_id.value,
        map_identity=MapIdentity(provider.source.value, _version(provider.version)),
        sensor_model=sensor_model,
        software_version=software_version,
        health=health,
    )


def _version(version: base_pb2.Version) -> str:
    """Return a version's name, or its numbers with dots between."""
    if version.name.value or not version.HasField("major"):
        return version.name.value
    parts = [version.major.value]
    if version.HasField("minor"):
        parts.append(version.minor.value)
        if version.HasField("patch"):
            parts.append(version.patch.value)
    return ".".join(map(str, parts))


def _source(message: data_pb2.DataMessage) -> tuple[str, str]:
    """Return the model and software of the sensor that a third party names, nothing where it names none or several."""
    found = {
        (entity.type.value or entity.primary_id.value, _version(entity.software_version))
        for entity in (source.source.entity for source in message.event_source)
    }
    return found.pop() if len(found) == 1 else ("", "")
