"""Request bodies of ingest: their type and encoding, read with bounded memory."""

from __future__ import annotations

import asyncio
import zlib
from collections.abc import AsyncIterable

from starlette.datastructures import Headers

from slamcu_server.problems import Problem

PROTOBUF, JSON = "application/x-protobuf", "application/json"
_ALIASES = {"application/protobuf": PROTOBUF, PROTOBUF: PROTOBUF, JSON: JSON}
_GZIP = 31  # zlib's window bits for gzip's format
_PIECE = 64 * 1024
_MEMBERS = 64  # of a gzip stream: senders make one, perhaps one a message; each costs as much as a small body


def media_type(headers: Headers) -> str:
    """Return the body's type, PROTOBUF or JSON; answer 415 to others."""
    stated = headers.get("content-type", "").partition(";")[0].strip().lower()
    if found := _ALIASES.get(stated):
        return found
    detail = f"a body is {PROTOBUF} or {JSON}, not {stated[:100] or 'of an unstated Content-Type'}"
    raise Problem(415, "unsupported-media-type", detail, headers={"Accept": f"{PROTOBUF}, {JSON}"})


def is_gzip(headers: Headers) -> bool:
    """Tell whether the body is compressed; answer 415 to encodings other than gzip."""
    stated = headers.get("content-encoding", "identity").strip().lower()
    if stated in {"identity", ""}:
        return False
    if stated in {"gzip", "x-gzip"}:
        return True
    detail = f"a body may be compressed with gzip, not with {stated[:100]}"
    raise Problem(415, "unsupported-encoding", detail, headers={"Accept-Encoding": "gzip"})


async def read(chunks: AsyncIterable[bytes], *, gzip: bool, limit: int) -> bytes:
    """Read a body of at most `limit` bytes after decompression, never holding more; answer 413 to a longer one.

    Answers 400 if what should be gzip is not, ends early, or has more members than any sender makes. Others have their
    turn after each piece.
    """
    body = bytearray()
    inflater = zlib.decompressobj(_GZIP) if gzip else None
    begun, members = False, 1
    async for chunk in chunks:
        if inflater is None:
            _extend(body, chunk, limit)
            continue
        left = chunk
        try:
            while left:
                if inflater.eof:  # gzip allows several members, one after the other
                    members += 1
                    if members > _MEMBERS:
                        raise Problem(400, "bad-encoding", f"the gzip stream has more than {_MEMBERS} members")
                    inflater = zlib.decompressobj(_GZIP)
                begun = True
                piece = inflater.decompress(left, _PIECE)
                _extend(body, piece, limit)
                if len(piece) == _PIECE:
                    await asyncio.sleep(0)
                left = inflater.unused_data if inflater.eof else inflater.unconsumed_tail
        except zlib.error as error:
            raise Problem(400, "bad-encoding", f"the body is not gzip: {error}") from error
    if inflater is not None:
        # What is ready but did not fit the last piece is still to come out.
        while begun and not inflater.eof and (rest := inflater.decompress(b"", _PIECE)):
            _extend(body, rest, limit)
            await asyncio.sleep(0)
        if not inflater.eof:
            raise Problem(400, "bad-encoding", "the gzip stream ends early")
    return bytes(body)


def _extend(body: bytearray, piece: bytes, limit: int) -> None:
    if len(body) + len(piece) > limit:
        raise Problem(413, "body-too-large", f"a decompressed body has at most {limit} bytes; send smaller batches")
    body += piece
