"""Content that may be gzipped, whatever its name."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from gzip import BadGzipFile, GzipFile

from slamcu_core.errors import FormatError

_GZIP = b"\x1f\x8b"  # RFC 1952, 2.3.1
_PIECE = 64 * 1024


def unpacked(file: io.BufferedReader) -> io.BufferedReader | GzipFile:
    """Return the stream of a file's content: what is in it if it is gzipped, else the file itself.

    Nothing is sought, so it may be a pipe. Read it by `pieces`, or within `unpacking`, and close the file itself.
    """
    return GzipFile(fileobj=file) if file.peek(len(_GZIP)).startswith(_GZIP) else file


@contextmanager
def unpacking(source: str) -> Iterator[None]:
    """Raise FormatError, naming `source`, where a packing that is read turns out to be broken."""
    try:
        yield
    except (BadGzipFile, zlib.error, EOFError) as error:
        raise FormatError(f"the gzip packing is broken: {error}", source=source) from error


def pieces(stream: io.BufferedReader | GzipFile, source: str) -> Iterator[bytes]:
    """Yield what is `unpacked` in pieces; raises FormatError, naming `source`, if the packing is broken."""
    with unpacking(source):
        while piece := stream.read(_PIECE):
            yield piece
