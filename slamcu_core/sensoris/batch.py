"""Batches: DataMessages split message by message, so that a bad one is refused and the rest are kept."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from google.protobuf import json_format

from slamcu_core.errors import WireError
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris.decode import decode_message
from slamcu_core.sensoris.extension import EXTENSION_TYPES
from slamcu_core.sensoris.policy import DEFAULT_LIMITS, DEFAULT_THIRD_PARTY, ThirdPartyDefaults, WireLimits
from slamcu_core.sensoris.proto import data_pb2
from slamcu_core.sensoris.wire import fields

_MAX_DEPTH = 100  # of nested JSON, as protobuf parsers have it for their own

_OWN_TYPES = frozenset(extension.DESCRIPTOR.full_name for extension in EXTENSION_TYPES)


@dataclass(frozen=True, slots=True)
class BatchItem:
    """One message of a batch: its serialized bytes, and either the report or why it is refused."""

    body: bytes
    report: ReportMessage | None = None
    error: WireError | None = None


def split_batch(body: bytes, *, limits: WireLimits = DEFAULT_LIMITS) -> list[bytes]:
    """Split a serialized DataMessages into its DataMessages, each as the bytes that were sent.

    Raises WireError with reason ``not-protobuf`` where the body is not a DataMessages, ``too-many-messages``.
    """
    found: list[bytes] = []
    own = not body
    for number, payload in fields(body):
        own = own or (payload is not None and number <= data_pb2.DataMessages.DATA_MESSAGE_FIELD_NUMBER)
        if number != data_pb2.DataMessages.DATA_MESSAGE_FIELD_NUMBER:
            continue
        if payload is None:
            raise WireError("not-protobuf", "the field data_message of the body holds no message")
        if len(found) == limits.max_messages:
            raise _too_many(limits)
        found.append(payload)
    if not own:
        raise WireError("not-protobuf", "the body holds no field of a SENSORIS DataMessages")
    return found


def parse_json_batch(body: bytes | str, *, limits: WireLimits = DEFAULT_LIMITS) -> list[bytes | WireError]:
    """Turn a DataMessages in protobuf's JSON mapping into serialized DataMessages; a bad one becomes its error.

    The bytes are a deterministic serialization: the same JSON gives the same bytes. Fields and extensions that are not
    in our subset are passed over.

    Raises WireError with reason ``not-json`` where the body as a whole cannot be read, ``too-many-messages``.
    """
    try:
        document = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise WireError("not-json", f"the body is not JSON: {str(error)[:200]}") from error
    messages = document.get("dataMessage", document.get("data_message", [])) if isinstance(document, dict) else None
    if not isinstance(messages, list):
        raise WireError(
            "not-json", 'expected an object {"dataMessage": [...]}, the JSON mapping of a SENSORIS DataMessages'
        )
    if len(messages) > limits.max_messages:
        raise _too_many(limits)
    return [_from_json(message) for message in messages]


def to_json(body: bytes) -> str:
    """Return a serialized DataMessages in protobuf's JSON mapping."""
    return str(json_format.MessageToJson(data_pb2.DataMessages.FromString(body), indent=None))


def decode_batch(
    body: bytes,
    *,
    is_json: bool = False,
    limits: WireLimits = DEFAULT_LIMITS,
    defaults: ThirdPartyDefaults = DEFAULT_THIRD_PARTY,
) -> list[BatchItem]:
    """Read a whole batch: one item per message in order, bad ones with their error.

    Raises WireError where the body as a whole cannot be read.
    """
    items: list[BatchItem] = []
    for message in parse_json_batch(body, limits=limits) if is_json else split_batch(body, limits=limits):
        if isinstance(message, WireError):
            items.append(BatchItem(b"", error=message))
            continue
        try:
            items.append(BatchItem(message, decode_message(message, limits=limits, defaults=defaults)))
        except WireError as error:
            items.append(BatchItem(message, error=error))
    return items


def _from_json(message: object) -> bytes | WireError:
    if not isinstance(message, dict):
        return WireError("not-json", "a data message must be an object")
    try:
        parsed = json_format.ParseDict(_known(message), data_pb2.DataMessage(), ignore_unknown_fields=True)
        return bytes(parsed.SerializeToString(deterministic=True))
    except (json_format.ParseError, ValueError, TypeError, AttributeError, RecursionError) as error:
        return WireError("not-json", f"not the JSON mapping of a SENSORIS DataMessage: {str(error)[:200]}")


def _known(value: Any, depth: int = 0) -> Any:
    """Return a document without the extensions of others, whose types the JSON mapping cannot parse."""
    if depth > _MAX_DEPTH:
        raise ValueError(f"nested deeper than {_MAX_DEPTH}")
    if isinstance(value, list):
        return [_known(each, depth + 1) for each in value]
    if not isinstance(value, dict):
        return value
    return {
        name: _known([each for each in part if _is_own(each)] if _holds_extensions(name, part) else part, depth + 1)
        for name, part in value.items()
    }


def _holds_extensions(name: str, part: object) -> bool:
    return name == "extension" and isinstance(part, list)


def _is_own(extension: object) -> bool:
    url = extension.get("@type") if isinstance(extension, dict) else None
    return isinstance(url, str) and url.rpartition("/")[2] in _OWN_TYPES


def _too_many(limits: WireLimits) -> WireError:
    return WireError("too-many-messages", f"more than {limits.max_messages} messages in one batch")
