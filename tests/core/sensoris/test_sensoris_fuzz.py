"""Whatever bytes come in, the only exception that comes out is WireError."""

import json
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamcu_core.errors import WireError
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import decode_batch, decode_message, encode_batch, serialize_message, to_json
from slamcu_core.sensoris.proto import data_pb2

fixture_is_read_only = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])

scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(["NaN", "Infinity", "-1", "1e3", "", "9" * 30])
)


def survive(body: bytes, *, is_json: bool = False) -> None:
    """Decode; every refusal must be a WireError with a reason and a text."""
    refusals: list[WireError | None] = []
    try:
        items = decode_batch(body, is_json=is_json)
    except WireError as error:
        items, refusals = [], [error]
    refusals += [item.error for item in items]
    assert all(error.reason and error.message for error in refusals if error)
    for item in items:
        assert (item.report is None) != (item.error is None)


@given(body=st.binary(max_size=200))
def test_any_bytes(body: bytes) -> None:
    survive(body)
    survive(body, is_json=True)


@fixture_is_read_only
@given(data=st.data())
def test_a_message_with_some_bytes_changed(a_report: ReportMessage, data: st.DataObject) -> None:
    body = bytearray(serialize_message(a_report))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(body) - 1))
        body[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=3))
    try:
        report = decode_message(bytes(body))
    except WireError:
        return
    assert report.session_id


@fixture_is_read_only
@given(data=st.data())
def test_integers_of_any_size_in_any_field(foreign: data_pb2.DataMessage, data: st.DataObject) -> None:
    message = data_pb2.DataMessage()
    message.CopyFrom(foreign)
    document = json.loads(to_json(data_pb2.DataMessages(data_message=[message]).SerializeToString()))
    spoil(document, data)

    survive(json.dumps(document).encode(), is_json=True)


@fixture_is_read_only
@given(data=st.data())
def test_our_own_json_with_anything_in_any_place(a_report: ReportMessage, data: st.DataObject) -> None:
    document = json.loads(to_json(encode_batch([a_report])))
    spoil(document, data)

    survive(json.dumps(document).encode(), is_json=True)


def spoil(document: object, data: st.DataObject) -> None:
    """Replace one to three values somewhere in a document by anything."""
    for _ in range(data.draw(st.integers(1, 3))):
        holder, key = data.draw(st.sampled_from(holders(document)))
        holder[key] = data.draw(scalars | st.lists(scalars, max_size=2) | st.dictionaries(st.text(max_size=5), scalars))


def holders(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key) of a document."""
    if isinstance(value, dict):
        pairs = list(value.items())
    elif isinstance(value, list):
        pairs = list(enumerate(value))
    else:
        return []
    return [(value, key) for key, _ in pairs] + [found for _, each in pairs for found in holders(each)]
