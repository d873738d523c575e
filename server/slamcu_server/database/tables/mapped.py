"""What is mapped: feature identity is stable, its attributes are versioned by the map's sequence."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Identity,
    Index,
    Integer,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
    text,
)

from slamcu_server.database.tables.columns import created, metadata, point

maps = Table(
    "maps",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("source", Text, nullable=False, unique=True),
    Column("current_sequence", Integer, nullable=False),
    Column("next_object_id", BigInteger, nullable=False),
    Column("evidence_time", DateTime(timezone=True)),  # of the newest report that the housekeeping knows of
    created(),
)

map_versions = Table(
    "map_versions",
    metadata,
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("sequence", Integer, nullable=False),
    Column("version", Text, nullable=False),
    Column("origin", Text, nullable=False),
    Column("change_id", BigInteger),  # the accepted change that made this version
    created(),
    PrimaryKeyConstraint("map_id", "sequence"),
    UniqueConstraint("map_id", "version"),
    CheckConstraint("origin IN ('import', 'review')", name="origin"),
)

features = Table(
    "features",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("object_id", BigInteger, nullable=False),
    UniqueConstraint("map_id", "object_id"),
)

feature_versions = Table(
    "feature_versions",
    metadata,
    Column("feature_id", BigInteger, ForeignKey("features.id", ondelete="CASCADE"), nullable=False),
    Column("from_sequence", Integer, nullable=False),
    Column("to_sequence", Integer),  # the first version without it; NULL: still in the map
    Column("evidence_sequence", Integer),  # since when it is this thing here; NULL: since its first version
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("feature_class", Text, nullable=False),
    Column("sign", Text),
    Column("value", Text),
    Column("altitude", Double),
    Column("heading_deg", Double),
    Column("existence_confidence", Double, nullable=False),
    Column("position_std_m", Double, nullable=False),
    point(),
    PrimaryKeyConstraint("feature_id", "from_sequence"),
    CheckConstraint("to_sequence IS NULL OR to_sequence > from_sequence", name="sequence_order"),
)
Index("ix_feature_versions_geom", feature_versions.c.geom, postgresql_using="gist")
Index(
    "ix_feature_versions_current",
    feature_versions.c.map_id,
    feature_versions.c.feature_id,
    unique=True,
    postgresql_where=text("to_sequence IS NULL"),
)
