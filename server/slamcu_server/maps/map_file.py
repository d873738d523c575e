"""The files of maps that can be imported: their formats, and their packing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path

from slamcu_core.formats import HDMapReader, Lanelet2Reader, read_hd_map, read_lanelet2
from slamcu_core.formats.packing import pieces, unpacked


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
        yield pieces(unpacked(file), str(path))
