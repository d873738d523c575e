"""The outermost layer of protobuf: fields of a message as bytes, so that a batch splits without being re-serialized.

A receiver compares the hash of a repeated message with the first; bytes that went through a parser and a serializer
depend on the version of both, the bytes as sent do not.
"""

from __future__ import annotations

from collections.abc import Iterator

from slamcu_core.errors import WireError

_VARINT, _FIXED64, _DELIMITED, _FIXED32 = 0, 1, 2, 5


def delimited(number: int, payload: bytes) -> bytes:
    """Return a length-delimited field."""
    return _varint(number << 3 | _DELIMITED) + _varint(len(payload)) + payload


def fields(body: bytes) -> Iterator[tuple[int, bytes | None]]:
    """Iterate over the top-level fields of a serialized message: number, and payload if length-delimited.

    Raises WireError with reason ``not-protobuf`` where the bytes are no protobuf.
    """
    at = 0
    while at < len(body):
        tag, at = _read_varint(body, at)
        number, kind = tag >> 3, tag & 7
        if not 1 <= number < 1 << 29:
            raise _not_protobuf(at, f"field number {number}")
        payload: bytes | None = None
        if kind == _VARINT:
            _, at = _read_varint(body, at)
        elif kind == _FIXED64:
            at += 8
        elif kind == _FIXED32:
            at += 4
        elif kind == _DELIMITED:
            length, at = _read_varint(body, at)
            payload = body[at : at + length]
            at += length
        else:  # groups end with protobuf 2; SENSORIS is protobuf 3
            raise _not_protobuf(at, f"wire type {kind}")
        if at > len(body):
            raise _not_protobuf(len(body), "the end of the body within a field")
        yield number, payload


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _read_varint(body: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(body):
            raise _not_protobuf(at, "the end of the body within an integer")
        byte = body[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise _not_protobuf(at, "an integer of more than ten bytes")


def _not_protobuf(at: int, found: str) -> WireError:
    return WireError("not-protobuf", f"the body is not a serialized SENSORIS DataMessages: {found} at byte {at}")
