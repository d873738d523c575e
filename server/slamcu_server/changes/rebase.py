"""After an import: what the provider's new version makes of the open changes, and of the evidence behind them.

Evidence follows a feature as long as it is the same thing at the same place; what was reported about anything else is
archived (`maps.importer` says which). An open change is *absorbed* if the version says what it says, *contradicted* if
the version states the opposite, and still open if the version does not say: a map that repeats what it said before has
not looked again, unless the provider tells when and where it was surveyed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_core.errors import SlamcuError
from slamcu_core.hd_map import MapIdentity
from slamcu_server.aggregation.policy import remember_policy
from slamcu_server.aggregation.refold import Places, Touched, refold
from slamcu_server.changes import feed, map_edit
from slamcu_server.changes.absorption import absorbing_features
from slamcu_server.changes.belief import OPEN, Kind, State
from slamcu_server.changes.document import timestamp
from slamcu_server.maps.bbox import BoundingBox
from slamcu_server.maps.importer import ImportedMap, import_map
from slamcu_server.maps.map_file import MapFormat
from slamcu_server.problems import Problem
from slamcu_server.retraction import marks
from slamcu_server.trust.table import trusting


@dataclass(frozen=True, slots=True)
class Survey:
    """When the provider has looked himself, and where (None: at all that the map covers)."""

    at: datetime
    bbox: BoundingBox | None = None

    @classmethod
    def parse(cls, at: datetime | None, bbox: str | None) -> Survey | None:
        """Read a survey from what a command was given (a time without a zone is UTC); None if it was given nothing.

        Raises SlamcuError naming what cannot be read.
        """
        if at is None:
            if bbox is not None:
                raise SlamcuError("--surveyed-bbox goes with --surveyed-at")
            return None
        try:
            box = None if bbox is None else BoundingBox.parse(bbox)
        except Problem as problem:
            raise SlamcuError(problem.detail.replace("query.bbox", "--surveyed-bbox")) from None
        return cls(at if at.tzinfo is not None else at.replace(tzinfo=UTC), box)

    def covers(self, document: Mapping[str, Any]) -> bool:
        """Whether a change lies where was surveyed, and nobody has reported on it since."""
        lon, lat = document["geometry"]["coordinates"][:2]
        looked = document["last_looked"]
        before = looked is None or datetime.fromisoformat(looked) <= self.at
        return before and (self.bbox is None or self.bbox.holds(lon, lat))


@dataclass(frozen=True, slots=True)
class Rebased:
    """What an import made of the changes that were open."""

    absorbed: int = 0
    contradicted: int = 0
    still_open: int = 0


@dataclass(frozen=True, slots=True)
class _OpenChange:
    id: int
    kind: Kind
    revision: int
    document: dict[str, Any]
    feature_id: int | None
    candidate_id: int | None
    in_map: bool  # the new version has the feature
    restated: bool  # and says that it is something else, or elsewhere


async def import_and_rebase(
    connection: AsyncConnection,
    policy: Policy,
    path: Path,
    *,
    identity: MapIdentity | None = None,
    map_format: MapFormat | None = None,
    survey: Survey | None = None,
) -> tuple[ImportedMap, Rebased]:
    """Import a map and settle what was open about it, in the transaction of `connection`; raises as `import_map`.

    The import holds the whole map, so that no report is fused and no review decided meanwhile.
    """
    await marks.hold(connection)
    imported = await import_map(connection, path, identity=identity, map_format=map_format)
    if imported.unchanged:
        return imported, Rebased()
    await remember_policy(connection, policy)
    policy = await trusting(connection, policy)
    becomes = await absorbing_features(connection, imported.map_id, imported.sequence, policy)
    settled: list[feed.Entry] = []
    still_open = 0
    for change in await _open_changes(connection, imported.map_id, imported.sequence):
        state = _settle(change, becomes, survey)
        if state is None:
            still_open += 1
        else:
            settled.append(_entry(change, imported, state, becomes))
    await feed.revise(connection, settled)
    await feed.settle(connection, settled)

    places: Places = frozenset()
    for candidate_id, feature in sorted(becomes.items()):
        places |= await map_edit.become(connection, candidate_id, feature.id)
    features = await _archive(connection, imported.map_id, imported.sequence)
    beliefs = await refold(connection, Touched(features, places), None, policy)
    entries = await feed.publish(connection, beliefs, policy)
    await feed.append(connection, [*settled, *entries])
    absorbed = sum(entry.state is State.ABSORBED for entry in settled)
    return imported, Rebased(absorbed, len(settled) - absorbed, still_open)


def _settle(change: _OpenChange, becomes: Mapping[int, Any], survey: Survey | None) -> State | None:
    """Return what the new version makes of an open change; None if it does not say, or only half of it."""
    there = change.candidate_id is not None and change.candidate_id in becomes  # the version has what was found
    gone = not change.in_map
    if change.kind is Kind.NEW:
        absorbed, half = there, False
    elif change.kind is Kind.DELETED:
        absorbed, half = gone, False
    else:
        absorbed = there and (gone or change.restated)
        half = there or gone  # one end is in the map now, and the other goes on
    if absorbed:
        return State.ABSORBED
    if change.restated:
        return State.CONTRADICTED
    surveyed = survey is not None and survey.covers(change.document)
    return State.CONTRADICTED if surveyed and not half else None


def _entry(change: _OpenChange, imported: ImportedMap, state: State, becomes: Mapping[int, Any]) -> feed.Entry:
    absorbed = state is State.ABSORBED
    document = change.document | {
        "mapped_at": timestamp(datetime.now(UTC)) if absorbed else None,
        "mapped_in": imported.identity.version,
    }
    if absorbed and change.candidate_id is not None:
        document["map_object_id"] = becomes[change.candidate_id].object_id
    return feed.Entry(change.id, imported.map_id, change.kind, state, change.revision + 1, document)


async def _open_changes(connection: AsyncConnection, map_id: int, sequence: int) -> list[_OpenChange]:
    result = await connection.execute(
        text("""
        SELECT c.id, c.kind, c.revision, c.document, c.feature_id, c.candidate_id, v.feature_id IS NOT NULL AS in_map,
               COALESCE(v.evidence_sequence = :sequence, false) AS restated
        FROM changes c LEFT JOIN feature_versions v ON v.feature_id = c.feature_id AND v.to_sequence IS NULL
        WHERE c.map_id = :map AND c.state = ANY(CAST(:open AS text[])) ORDER BY c.id""").columns(document=JSONB),
        {"map": map_id, "sequence": sequence, "open": sorted(OPEN)},
    )
    return [
        _OpenChange(
            row.id,
            Kind(row.kind),
            row.revision,
            row.document,
            row.feature_id,
            row.candidate_id,
            row.in_map,
            row.restated,
        )
        for row in result
    ]


async def _archive(connection: AsyncConnection, map_id: int, sequence: int) -> frozenset[int]:
    """Archive the evidence about what features were until this version; return the features to be folded again.

    Those are all that the version changes or has no longer and about which anything is believed, or an open change is.
    """
    here = {"map": map_id, "sequence": sequence}
    await connection.execute(
        text("""
        UPDATE passes p SET archived = true FROM feature_versions v
        WHERE v.map_id = :map AND v.from_sequence = :sequence AND v.evidence_sequence = :sequence
          AND p.feature_id = v.feature_id AND NOT p.archived AND p.map_sequence < :sequence"""),
        here,
    )
    result = await connection.execute(
        text("""
        SELECT s.feature_id FROM feature_states s JOIN feature_versions v ON v.feature_id = s.feature_id
        WHERE v.map_id = :map AND (v.from_sequence = :sequence OR v.to_sequence = :sequence)
        UNION SELECT feature_id FROM changes
        WHERE map_id = :map AND state IN ('candidate', 'confirmed') AND feature_id IS NOT NULL"""),
        here,
    )
    return frozenset(row.feature_id for row in result)
