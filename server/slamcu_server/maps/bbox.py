"""Bounding boxes of queries: west, south, east, north in degrees."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from fastapi import Query
from sqlalchemy import ColumnElement, Float, and_, func, literal, or_

from slamcu_server.problems import Problem

_NUMBER = r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?"
_PATTERN = re.compile(f"{_NUMBER}(,{_NUMBER}){{3}}")
_HELP = "expected west,south,east,north in degrees, such as 2.0,48.8,2.3,49.0"


def box_query(more: str = "") -> Any:
    """Describe a query parameter that `BoundingBox.parse` reads, as `Annotated[str, box_query()]`."""
    description = f"west,south,east,north in degrees; west greater than east crosses the antimeridian. {more}"
    pattern = {"pattern": f"^{_PATTERN.pattern}$"}  # told to clients; what is wrong with a box, `parse` says better
    return Query(
        description=description.strip(), examples=["2.0,48.8,2.3,49.0"], max_length=200, json_schema_extra=pattern
    )


@dataclass(frozen=True, slots=True)
class BoundingBox:
    """A box; one whose west is greater than its east crosses the antimeridian (RFC 7946, section 5.2)."""

    west: float
    south: float
    east: float
    north: float

    @classmethod
    def parse(cls, text: str) -> BoundingBox:
        """Read a box from a query parameter; answer 422 naming what is wrong with it."""
        if not _PATTERN.fullmatch(text):
            raise _invalid(f"cannot be read; {_HELP}")
        west, south, east, north = map(float, text.split(","))
        if not all(map(math.isfinite, (west, south, east, north))):
            raise _invalid(f"has a number that is not finite; {_HELP}")
        if not (-180 <= west <= 180 and -180 <= east <= 180):
            raise _invalid(f"has a longitude outside [-180, 180]; {_HELP}")
        if not (-90 <= south <= 90 and -90 <= north <= 90):
            raise _invalid(f"has a latitude outside [-90, 90]; {_HELP}")
        if south > north:
            raise _invalid(f"has its south above its north; {_HELP}")
        return cls(west, south, east, north)

    def holds(self, lon: float, lat: float) -> bool:
        """Whether a point lies in the box, its edges included."""
        if not self.south <= lat <= self.north:
            return False
        if self.west <= self.east:
            return self.west <= lon <= self.east
        return lon >= self.west or lon <= self.east

    def contains(self, geom: ColumnElement[object]) -> ColumnElement[bool]:
        """Return the SQL condition that points lie in the box, its edges included."""
        if self.west <= self.east:
            return _within(geom, self.west, self.south, self.east, self.north)
        return or_(
            _within(geom, self.west, self.south, 180.0, self.north),
            _within(geom, -180.0, self.south, self.east, self.north),
        )


def _within(geom: ColumnElement[object], *edges: float) -> ColumnElement[bool]:
    west, south, east, north = (literal(edge, Float(53)) for edge in edges)
    envelope = func.ST_MakeEnvelope(west, south, east, north, 4326)
    if edges[0] < edges[2] and edges[1] < edges[3]:
        return func.ST_Intersects(geom, envelope)
    # A line or a point is no valid polygon. && goes through the index, but compares in single precision.
    return and_(geom.op("&&")(envelope), func.ST_X(geom).between(west, east), func.ST_Y(geom).between(south, north))


def _invalid(detail: str) -> Problem:
    errors = [{"field": "query.bbox", "detail": detail}]
    return Problem(422, "invalid-request", f"query.bbox: {detail}", errors=errors)
