"""Packed and plain files read the same, from what cannot be sought in too, and broken packing is named."""

from __future__ import annotations

import gzip
import io
import os
from pathlib import Path

import pytest

from slamcu_core.errors import FormatError
from slamcu_core.formats.packing import pieces, unpacked, unpacking

TEXT = b"".join(b"line %d of a drive\n" % number for number in range(20_000))
PACKED = gzip.compress(TEXT[:1000]) + gzip.compress(TEXT[1000:])  # members, as of files that were joined


def opened(content: bytes) -> io.BufferedReader:
    return io.BufferedReader(io.BytesIO(content))


@pytest.mark.parametrize("content", [TEXT, PACKED], ids=["plain", "packed"])
def test_packed_and_plain_read_the_same(content: bytes) -> None:
    assert b"".join(pieces(unpacked(opened(content)), "log")) == TEXT
    with unpacking("log"):
        assert unpacked(opened(content)).readlines() == TEXT.splitlines(keepends=True)


@pytest.mark.parametrize("content", [b"", b"\x1f", b"{}"])
def test_what_is_too_short_to_be_packed_is_plain(content: bytes) -> None:
    assert b"".join(pieces(unpacked(opened(content)), "log")) == content


@pytest.mark.parametrize("content", [b"plain text\n", gzip.compress(b"plain text\n")], ids=["plain", "packed"])
def test_a_pipe_is_read_too(content: bytes) -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "wb") as pipe:
        pipe.write(content)
    with os.fdopen(reading, "rb") as file:
        assert b"".join(pieces(unpacked(file), "pipe")) == b"plain text\n"


@pytest.mark.parametrize(
    "broken",
    [PACKED[:-9], PACKED[:-8] + bytes(8), PACKED + b"rubbish", PACKED[:100] + bytes(50) + PACKED[150:], b"\x1f\x8b"],
    ids=["cut", "another sum", "more behind it", "overwritten", "begun"],
)
def test_a_broken_packing_is_told_with_its_file(broken: bytes, tmp_path: Path) -> None:
    path = tmp_path / "drive.jsonl"
    path.write_bytes(broken)
    with path.open("rb") as file, pytest.raises(FormatError, match=r"drive\.jsonl: the gzip packing is broken: ."):
        list(pieces(unpacked(file), str(path)))


def test_what_else_goes_wrong_with_a_file_is_not_called_a_broken_packing() -> None:
    with pytest.raises(FileNotFoundError), unpacking("log"):
        raise FileNotFoundError
