"""The .proto files say what the interface says, in numbers, types and enum values, and the code is theirs."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from google.protobuf import descriptor_pool
from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor

from slamcu_core.catalogue import SIGN_TYPES, STATIC_OBJECT, STATIC_OBJECT_CLASSES, UNKNOWN_SIGN
from slamcu_core.reports import DetectionStatus
from slamcu_core.sensoris.proto import (
    base_pb2,
    data_pb2,
    intersection_attribution_pb2,
    job_pb2,
    localization_pb2,
    map_pb2,
    object_detection_pb2,
    source_pb2,
    spatial_pb2,
    traffic_regulation_pb2,
)

ROOT = Path(__file__).parents[3]
PROTO = ROOT / "slamcu_core" / "sensoris" / "proto"
PACKAGE = "slamcu.sensoris.v1."
MODULES = (
    base_pb2,
    data_pb2,
    intersection_attribution_pb2,
    job_pb2,
    localization_pb2,
    map_pb2,
    object_detection_pb2,
    source_pb2,
    spatial_pb2,
    traffic_regulation_pb2,
)


def facts(name: str) -> list[dict[str, str]]:
    with (ROOT / "tests" / "core" / "data" / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def with_nested(descriptor: Descriptor) -> list[Descriptor]:
    return [descriptor, *(each for nested in descriptor.nested_types for each in with_nested(nested))]


MESSAGES = [
    each for module in MODULES for top in module.DESCRIPTOR.message_types_by_name.values() for each in with_nested(top)
]
ENUMS: list[EnumDescriptor] = [enum for message in MESSAGES for enum in message.enum_types]


def as_fact(field: FieldDescriptor) -> tuple[str, ...]:
    assert field.containing_type is not None
    if field.message_type is not None:
        kind = field.message_type.full_name
    elif field.enum_type is not None:
        kind = field.enum_type.full_name
    else:
        kind = {FieldDescriptor.TYPE_INT64: "int64"}[field.type]
    return (
        field.containing_type.full_name.removeprefix(PACKAGE),
        str(field.number),
        field.name,
        "repeated" if field.is_repeated else "optional",
        kind.removeprefix(PACKAGE),
        field.containing_oneof.name if field.containing_oneof is not None else "",
    )


def test_every_field_of_the_subset_is_a_field_of_the_interface() -> None:
    interface = {tuple(row.values()) for row in facts("sensoris_fields.tsv")}
    ours = {as_fact(field) for message in MESSAGES for field in message.fields}

    assert len(ours) > 200
    assert ours == interface


def test_every_enum_is_complete() -> None:
    interface: dict[str, dict[str, int]] = {}
    for row in facts("sensoris_enums.tsv"):
        interface.setdefault(row["enum"], {})[row["name"]] = int(row["number"])
    ours = {enum.full_name.removeprefix(PACKAGE): {v.name: v.number for v in enum.values} for enum in ENUMS}

    assert ours == interface
    assert len(ours["TrafficSign.TypeAndConfidence.Type"]) == 309


def test_the_catalogue_names_what_the_interface_names() -> None:
    signs = set(traffic_regulation_pb2.TrafficSign.TypeAndConfidence.Type.keys())
    things = set(map(str.lower, object_detection_pb2.StaticObject.TypeAndConfidence.Type.keys()))

    assert signs == SIGN_TYPES | {UNKNOWN_SIGN}
    assert things - {UNKNOWN_SIGN.lower()} == STATIC_OBJECT_CLASSES - {STATIC_OBJECT}
    assert {status.value for status in DetectionStatus} == set(base_pb2.EventDetectionStatus.Type.keys()) - {
        "UNKNOWN_TYPE"
    }


def test_names_do_not_clash_with_the_official_classes() -> None:
    pool = descriptor_pool.Default()

    for message in MESSAGES:
        assert message.full_name.startswith(PACKAGE)
    with pytest.raises(KeyError):
        pool.FindMessageTypeByName("sensoris.protobuf.messages.data.DataMessages")


def test_regenerating_changes_nothing(tmp_path: Path) -> None:
    subprocess.run(
        [ROOT / "scripts" / "generate-protobuf", tmp_path],
        check=True,
        env={"PYTHON": sys.executable, "PATH": "/usr/bin:/bin"},
        capture_output=True,
    )
    made = {path.name: path.read_text() for path in (tmp_path / "slamcu_core" / "sensoris" / "proto").iterdir()}
    checked_in = {path.name: path.read_text() for path in PROTO.iterdir() if "_pb2.py" in path.name}

    assert len(made) == 2 * len(list(PROTO.glob("*.proto")))
    assert made == checked_in
