"""Fold everything again from the stored passes.

To check that what is believed is what was reported, or to make it so after the policy has changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads, windows, writes
from slamcu_server.aggregation.folding import fold_candidates, fold_features, partition
from slamcu_server.aggregation.locks import lock_maps
from slamcu_server.aggregation.pairs import Held, pair_beliefs
from slamcu_server.aggregation.policy import remember_policy
from slamcu_server.aggregation.refold import Touched, candidate_belief, feature_belief, refold
from slamcu_server.changes import feed
from slamcu_server.database.statements import text
from slamcu_server.trust.table import trusting

TOLERANCE = 1e-9


async def rebuild(engine: AsyncEngine, policy: Policy) -> int:
    """Fold everything under `policy` while workers and reviews wait, and return how many entries the feed got."""
    async with engine.begin() as connection:
        await lock_maps(connection)
        await remember_policy(connection, policy)
        policy = await trusting(connection, policy)
        beliefs = await refold(connection, Touched(), None, policy)
        entries = await feed.publish(connection, beliefs, policy)
        await feed.append(connection, entries)
    return len(entries)


async def differences(engine: AsyncEngine, policy: Policy) -> list[str]:
    """Return where the stored beliefs are not, to 1e-9, the fold of the stored passes; changes nothing."""
    async with engine.connect() as connection:
        await connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
        async with connection.begin():
            policy = await trusting(connection, policy)
            found, features = await _feature_differences(connection, policy)
            return [*found, *await _candidate_differences(connection, policy, features)]


async def _feature_differences(connection: AsyncConnection, policy: Policy) -> tuple[list[str], Held]:
    passes = await reads.passes_over_features(connection, None)
    features = await reads.features(connection, await reads.reported_features(connection))
    summaries = fold_features(features.values(), passes, policy)
    wanted = {key: writes.feature_row(summary, policy.version) for key, summary in summaries.items()}
    stored = await _stored(connection, "SELECT *, feature_id AS key FROM feature_states")
    found = list(_compare("feature", wanted, stored))
    for key in sorted(wanted.keys() & stored.keys()):
        packed, row = windows.of_kept(passes.get(key, ()), summaries[key].expired), stored[key]
        if row["window_at"] == row["updated_at"] and _sorted(row["passes_window"]) != _sorted(packed):
            found.append(f"feature {key}: its window is not of its passes")
    beliefs = {
        key: feature_belief(features[key], summary, policy.version)
        for key, summary in summaries.items()
        if features[key].in_map
    }
    return found, beliefs


def _sorted(window: bytes) -> list[tuple[float, ...]]:
    return sorted(windows.unpack(window).tolist())


async def _candidate_differences(connection: AsyncConnection, policy: Policy, features: Held) -> list[str]:
    passes = await reads.all_clustering_passes(connection)
    known = await reads.candidates_founded_by(connection, (item.id for item in passes))
    parts = partition(passes, {key: item.id for key, item in known.items()}, policy)
    watched = await reads.passes_over_watches(connection, parts.watch_ids)
    folds = fold_candidates(parts, watched, policy)
    beliefs = {
        one.membership.candidate_id: candidate_belief(one.membership.candidate_id, one, policy.version)
        for one in folds
        if one.membership.candidate_id is not None
    }
    pairs = {one.candidate_id: one for one in pair_beliefs(features, beliefs, policy)}
    found = list[str]()
    wanted: dict[int, writes.Row] = {}
    for one in folds:
        key = one.membership.candidate_id
        if key is None:
            found.append(f"pass {one.membership.founder.id} founds a candidate that is not stored")
            continue
        wanted[key] = writes.candidate_row(one, policy.version) | {
            "pair_feature_id": pairs[key].feature_id if key in pairs else None,
            "pair_kind": pairs[key].kind.value if key in pairs else None,
        }
        # An id stays with the pass that founded it, though an earlier one may have come late.
        del wanted[key]["founding_pass"]
        found += [
            f"pass {item.id} counts for candidate {item.candidate_id}, not for {key}"
            for item in one.passes
            if item.candidate_id != key
        ]
    found += [
        f"candidate {item.id} is part of {item.merged_into}, not of {parts.merged.get(item.id)}"
        for item in known.values()
        if item.merged_into != parts.merged.get(item.id)
    ]
    found += [f"pass {item.id} counts for a candidate" for item in parts.alone if item.candidate_id is not None]
    stored = await _stored(
        connection,
        """SELECT *, id AS key, ST_X(geom) AS lon, ST_Y(geom) AS lat FROM candidates
        WHERE merged_into IS NULL AND feature_id IS NULL""",
    )
    return [*found, *_compare("candidate", wanted, stored)]


async def _stored(connection: AsyncConnection, query: str) -> dict[int, dict[str, Any]]:
    return {row["key"]: {**row} for row in (await connection.execute(text(query))).mappings()}


def _compare(
    what: str, wanted: Mapping[int, Mapping[str, object]], stored: Mapping[int, Mapping[str, Any]]
) -> Iterator[str]:
    for key in sorted(wanted.keys() ^ stored.keys()):
        yield f"{what} {key} is {'not stored' if key in wanted else 'stored without any pass'}"
    for key in sorted(wanted.keys() & stored.keys()):
        for name in _unequal(wanted[key], stored[key]):
            yield f"{what} {key}: {name} is {stored[key][name]!r}, the fold gives {wanted[key][name]!r}"


def _unequal(wanted: Mapping[str, object], stored: Mapping[str, Any]) -> Iterable[str]:
    for name, value in wanted.items():
        if isinstance(value, float):
            if abs(value - stored[name]) > TOLERANCE * max(1.0, abs(value)):
                yield name
        elif value != stored[name]:
            yield name
