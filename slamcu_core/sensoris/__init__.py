"""SENSORIS on the wire: reports to messages and back, with our own extension for exact evidence."""

from slamcu_core.sensoris.batch import BatchItem, decode_batch, parse_json_batch, split_batch, to_json
from slamcu_core.sensoris.checks import check_message
from slamcu_core.sensoris.decode import decode_message
from slamcu_core.sensoris.encode import encode_batch, encode_message, join_batch, sendable, serialize_message
from slamcu_core.sensoris.policy import MAX_PASS_WEIGHT, ThirdPartyDefaults, WireLimits

__all__ = [
    "MAX_PASS_WEIGHT",
    "BatchItem",
    "ThirdPartyDefaults",
    "WireLimits",
    "check_message",
    "decode_batch",
    "decode_message",
    "encode_batch",
    "encode_message",
    "join_batch",
    "parse_json_batch",
    "sendable",
    "serialize_message",
    "split_batch",
    "to_json",
]
