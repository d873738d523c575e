"""The files of maps that can be imported: their formats, and their packing."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import IO, cast

from slamcu_core.errors import FormatError
from slamcu_core.formats import HDMapReader, Lanelet2Reader, read_hd_map, read_lanelet2

_GZIP = b"\x1f\x8b"
_PIECE = 64 * 1024


class MapFormat(StrEnum):
    """What a map file is written in."""

    GEOJSON = "geojson"
    LANELET2 = "lanelet2"

    @classmethod
    def of(cls, path: Path) -> MapFormat:
        """Return the format that a file's name stands for: Lanelet2 for ``.osm`` and ``.osm.gz``, else GeoJSON."""
        name = path.name.lower().removesuffix(".gz")
        return cls.LANELET2 if name.endswith(".osm") else cls.GEOJSON

    def reader(self, chunks: Iterable[bytes], source: str) -> HDMapReader | Lanelet2Reader:
        """Return a reader of the features in a file's text, which tells the map's identity when they are read."""
        read = read_lanelet2 if self is MapFormat.LANELET2 else read_hd_map
        return read(chunks, source=source)


@contextmanager
def opened(path: Path) -> Iterator[Iterator[bytes]]:
    """Give the content of a map file in pieces, unpacked if it is gzipped, whatever its name.

    Raises OSError if the file cannot be read, FormatError if the packing is broken.
    """
    with path.open("rb") as file:
        packed = file.peek(len(_GZIP)).startswith(_GZIP)  # no seeking: it may be a pipe
        yield _pieces(cast("IO[bytes]", gzip.GzipFile(fileobj=file)) if packed else file, str(path))


def _pieces(file: IO[bytes], source: str) -> Iterator[bytes]:
    try:
        while piece := file.read(_PIECE):
            yield piece
    except (gzip.BadGzipFile, zlib.error, EOFError) as error:
        raise FormatError(f"the gzip packing is broken: {error}", source=source) from error
