"""The formats of map files that can be imported."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path

from slamcu_core.formats import HDMapReader, Lanelet2Reader, read_hd_map, read_lanelet2


class MapFormat(StrEnum):
    """What a map file is written in."""

    GEOJSON = "geojson"
    LANELET2 = "lanelet2"

    @classmethod
    def of(cls, path: Path) -> MapFormat:
        """Return the format that a file's name stands for: Lanelet2 for ``.osm``, else GeoJSON."""
        return cls.LANELET2 if path.suffix.lower() == ".osm" else cls.GEOJSON

    def reader(self, chunks: Iterable[bytes], source: str) -> HDMapReader | Lanelet2Reader:
        """Return a reader of the features in a file's text, which tells the map's identity when they are read."""
        read = read_lanelet2 if self is MapFormat.LANELET2 else read_hd_map
        return read(chunks, source=source)
