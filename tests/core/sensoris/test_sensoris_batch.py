"""Batches come apart message by message: bytes as sent, bad ones named, good ones kept."""

import gzip
import json
from collections.abc import Callable
from dataclasses import replace

import pytest

from slamcu_core.errors import WireError
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import (
    WireLimits,
    decode_batch,
    encode_batch,
    join_batch,
    parse_json_batch,
    serialize_message,
    split_batch,
    to_json,
)
from slamcu_core.sensoris.extension import TYPE_URLS
from slamcu_core.sensoris.proto import data_pb2
from slamcu_core.sensoris.wire import delimited, fields


def test_a_batch_keeps_the_bytes_that_were_sent(a_report: ReportMessage) -> None:
    plain = serialize_message(a_report)
    backwards = b"".join(delimited(number, payload or b"") for number, payload in reversed(list(fields(plain))))
    bodies = [plain, backwards, b"", b"\x9a\x06\x03abc"]

    assert split_batch(join_batch(bodies)) == bodies
    assert [item.report for item in decode_batch(join_batch([plain, backwards]))] == [a_report, a_report]


def test_a_batch_is_what_any_sensoris_receiver_parses(a_report: ReportMessage) -> None:
    batch = data_pb2.DataMessages.FromString(encode_batch([a_report, replace(a_report, message_id=4)]))

    version = batch.envelope.version
    assert (version.major.value, version.minor.value, version.patch.value) == (1, 5, 1)
    assert [each.type_url.type_url.value for each in batch.envelope.extension_type_url_and_version] == list(TYPE_URLS)
    assert [message.envelope.ids.message_id.value for message in batch.data_message] == [3, 4]


def test_a_batch_declares_the_extensions_that_it_carries(a_report: ReportMessage) -> None:
    batch = data_pb2.DataMessages.FromString(encode_batch([a_report]))

    (message,) = batch.data_message
    (sign,) = message.event_group[0].traffic_regulation_category.traffic_sign
    carried = {each.type_url for each in (*message.envelope.extension, *sign.envelope.extension)}
    assert carried == {each.type_url.type_url.value for each in batch.envelope.extension_type_url_and_version}


def test_fields_of_any_number_that_protobuf_has_are_passed_over(a_report: ReportMessage) -> None:
    body = encode_batch([a_report])

    assert split_batch(body + delimited(2**29 - 1, b"later")) == split_batch(body)
    with pytest.raises(WireError, match=r"field number 536870912 at byte \d+"):
        split_batch(body + delimited(2**29, b"never"))


def test_the_good_messages_of_a_batch_are_kept(
    a_report: ReportMessage, report_of: Callable[..., ReportMessage]
) -> None:
    good = serialize_message(a_report)
    nameless = data_pb2.DataMessage.FromString(good)
    nameless.envelope.ids.Clear()
    body = join_batch([good, b"\xff\xff", nameless.SerializeToString(), good])

    items = decode_batch(body)

    assert [item.report == a_report for item in items] == [True, False, False, True]
    assert [item.error.reason for item in items if item.error] == ["not-protobuf", "missing-ids"]
    assert [item.body for item in items] == split_batch(body)


def test_the_good_messages_of_a_json_batch_are_kept(a_report: ReportMessage) -> None:
    document = json.loads(to_json(encode_batch([a_report])))
    (good,) = document["dataMessage"]
    nameless = {key: value for key, value in good.items() if key != "envelope"}
    body = json.dumps({"dataMessage": [good, 7, {"eventGroup": "?"}, nameless, good]}).encode()

    items = decode_batch(body, is_json=True)

    assert [item.report == a_report for item in items] == [True, False, False, False, True]
    assert [item.error.reason for item in items if item.error] == ["not-json", "not-json", "missing-ids"]
    assert items[0].body == items[4].body == serialize_message(a_report)


def test_json_of_the_full_schema_is_understood(a_report: ReportMessage) -> None:
    document = json.loads(to_json(encode_batch([a_report])))
    message = document["dataMessage"][0]
    message["eventGroup"][0]["weatherCategory"] = {"precipitation": [{"typeAndConfidence": {"type": "RAIN"}}]}
    message["envelope"]["extension"].append({"@type": "types.example/example.Unknown", "anything": [1]})

    (item,) = decode_batch(json.dumps(document).encode(), is_json=True)

    assert item.report == a_report


@pytest.mark.parametrize(
    "body",
    [
        b"\xff",
        b"\x0b",
        b"\x12\x7f",
        b"<html></html>",
        b'{"dataMessage": []}',
        gzip.compress(b"anything", mtime=0),
        b"\x08\x01",
        b"\x10\x01",
        b"\x12" + b"\xff" * 10,
    ],
)
def test_a_body_that_is_no_batch_is_refused(body: bytes) -> None:
    with pytest.raises(WireError) as refusal:
        split_batch(body)

    assert refusal.value.reason == "not-protobuf"


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b'{"dataMessage": 3}', b"\xff", b"[" * 100_000, b"1" * 10_000])
def test_a_body_that_is_no_json_batch_is_refused(body: bytes) -> None:
    with pytest.raises(WireError) as refusal:
        parse_json_batch(body)

    assert refusal.value.reason == "not-json"


def test_a_message_whose_json_is_nested_without_end_is_refused() -> None:
    deep = b'{"dataMessage": [' + b'{"a": [' * 200 + b"]}" * 200 + b"]}"

    (refused,) = parse_json_batch(deep)

    assert isinstance(refused, WireError)
    assert "deeper than 100" in refused.message


def test_an_empty_batch_has_no_messages() -> None:
    assert split_batch(b"") == []
    assert split_batch(join_batch([])) == []
    assert parse_json_batch(b"{}") == []


def test_too_many_messages_are_refused_before_they_are_read() -> None:
    limits = WireLimits(max_messages=2)

    with pytest.raises(WireError) as binary:
        split_batch(b"\x12\x00" * 1_000_000, limits=limits)
    with pytest.raises(WireError) as text:
        parse_json_batch(b'{"dataMessage": [{}, {}, {}]}', limits=limits)

    assert binary.value.reason == text.value.reason == "too-many-messages"
