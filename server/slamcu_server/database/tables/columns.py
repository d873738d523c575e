"""What the tables share: their metadata, and the columns that recur."""

from __future__ import annotations

from geoalchemy2 import Geometry
from sqlalchemy import Column, DateTime, MetaData, func

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

ID_MAX = 2**63 - 1
"""The largest id: they are of type bigint."""


def point(*, nullable: bool = False) -> Column[object]:
    """Return a column of places on WGS84; its index is named where it is made."""
    return Column("geom", Geometry("POINT", srid=4326, spatial_index=False), nullable=nullable)


def created() -> Column[object]:
    """Return a column that says when a row was written."""
    return Column("created_at", DateTime(timezone=True), nullable=False, server_default=func.now())
