"""Fold again what a transaction touched, and write what is believed now: the one way by which beliefs change.

The caller holds the cells; reviews and rebuilds come this way too. The arithmetic runs in a thread, because the process
may be serving requests at the same time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads, windows, writes
from slamcu_server.aggregation.cells import Cell, keys_within
from slamcu_server.aggregation.evidence import Place, Summary
from slamcu_server.aggregation.folding import (
    CandidateFold,
    Partition,
    fold_candidates,
    fold_features,
    members,
    partition,
)
from slamcu_server.aggregation.locks import require_cells
from slamcu_server.aggregation.membership import Membership
from slamcu_server.aggregation.pairs import (
    candidates_beside,
    doubted,
    features_beside,
    pair_beliefs,
    stored_partners,
    strong,
    write_pairs,
)
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.reads import MappedFeature
from slamcu_server.changes.belief import Belief, Beliefs, Kind, Subject

Places = frozenset[tuple[int, float, float]]


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """What has been folded so far."""

    features: Mapping[int, tuple[Subject, Belief]]
    candidates: Mapping[int, tuple[Subject, Belief]]
    merged: frozenset[int]
    unmapped: frozenset[int]


@dataclass(frozen=True, slots=True)
class Touched:
    """What has to be folded again; None stands for everything there is."""

    features: frozenset[int] | None = None
    places: Places | None = None  # (map id, lon, lat) near which finds have come or gone
    candidates: frozenset[int] = frozenset()  # of which only watch features were reported: their finds stay the same


NOTHING = Touched(frozenset(), frozenset())


async def refold(
    connection: AsyncConnection, touched: Touched, held: frozenset[Cell] | None, policy: Policy
) -> Beliefs:
    """Fold what was touched from its stored passes, and what may be one change with it, and write the result.

    Raises BeyondLockedCells if a connected group reaches beyond the cells that are held (None: everything is).
    """
    if touched == NOTHING:
        return Beliefs((), {}, frozenset())
    features: dict[int, tuple[Subject, Belief]] = {}
    candidates: dict[int, tuple[Subject, Belief]] = {}
    merged: dict[int, int] = {}
    unmapped: set[int] = set()
    gone: set[int] = set()  # candidates that are none any more, though a pair is stored
    todo: Touched | None = touched
    watched = touched.candidates
    while todo is not None:
        if todo.features is None or todo.features:
            mapped, without = await _refold_features(connection, todo.features, policy)
            features |= mapped
            unmapped |= without
        if todo.places is None or todo.places or watched:
            found, into = await _refold_candidates(connection, todo.places, watched, held, policy)
            candidates |= found
            merged |= into
            watched = frozenset()
        known = Neighbourhood(features, candidates, frozenset(merged), frozenset(unmapped))
        todo, stale = await _further(connection, known, held, policy)
        gone |= stale
    pairs = pair_beliefs(features, candidates, policy)
    await write_pairs(connection, pairs, [*candidates, *merged, *gone])
    about = (*(features[key] for key in sorted(features)), *(candidates[key] for key in sorted(candidates)))
    return Beliefs(about, merged, frozenset(unmapped), pairs=pairs)


async def _further(
    connection: AsyncConnection, known: Neighbourhood, held: frozenset[Cell] | None, policy: Policy
) -> tuple[Touched | None, frozenset[int]]:
    """Return what else may be one change with what is known by now, and candidates whose stored pair is void.

    Raises BeyondLockedCells if that lies beyond the cells that are held.
    """
    partners = await stored_partners(connection, {*known.features, *known.unmapped}, {*known.candidates, *known.merged})
    deleted = [*doubted(known.features, policy).values()]
    new = [*strong(known.candidates, policy).values()]
    if not (partners or deleted or new):
        return None, frozenset()
    if held is not None:
        require_cells(cells_of([*deleted, *new], policy), held)
    reach = policy.lock_reach_m
    beside = await candidates_beside(connection, deleted, (key for key, _ in partners), reach)
    features = await features_beside(connection, new, reach) | {feature for _, feature in partners}
    features -= {*known.features, *known.unmapped}
    places = frozenset(place for key, place in beside.items() if key not in known.candidates)
    require_cells(cells_of([*places, *await reads.anchors(connection, features)], policy), held)
    stale = frozenset(key for key, _ in partners if key not in beside)
    return (Touched(frozenset(features), places) if features or places else None), stale


async def _refold_features(
    connection: AsyncConnection, ids: frozenset[int] | None, policy: Policy
) -> tuple[dict[int, tuple[Subject, Belief]], frozenset[int]]:
    passes = await reads.passes_over_features(connection, ids)
    features = await reads.features(connection, ids if ids is not None else await reads.reported_features(connection))
    summaries = await asyncio.to_thread(fold_features, features.values(), passes, policy)
    rows = {
        key: {
            **writes.feature_row(summary, policy.version),
            "forgotten_looked": summary.forgotten_looked,
            "forgotten_blocked": summary.forgotten_blocked,
            "passes_window": windows.of_kept(passes.get(key, ()), summary.expired),
        }
        for key, summary in summaries.items()
    }
    await writes.upsert_feature_states(connection, rows)
    await writes.delete_passes(connection, (key for summary in summaries.values() for key in summary.expired))
    beliefs = {
        key: feature_belief(features[key], summary, policy.version)
        for key, summary in summaries.items()
        if features[key].in_map
    }
    return beliefs, frozenset(key for key in summaries if not features[key].in_map)


async def _refold_candidates(
    connection: AsyncConnection,
    places: Places | None,
    watched: frozenset[int],
    held: frozenset[Cell] | None,
    policy: Policy,
) -> tuple[dict[int, tuple[Subject, Belief]], dict[int, int]]:
    """Cluster the finds near places anew, and fold what they make together with the candidates that were watched.

    Return the beliefs, and of the candidates that are part of another one now that one's id.
    """
    parts, named = await _clustered(connection, places, held, policy)
    standing, named_too = await _watched(connection, watched - parts.watch_ids, held, policy)
    parts, named = replace(parts, memberships=(*parts.memberships, *standing)), named | named_too
    folds = await asyncio.to_thread(fold_candidates, parts, named, policy)
    ids = await _write_candidates(connection, folds, policy)
    await writes.merge_candidates(connection, parts.merged)

    belongs = {item.id: key for key, one in zip(ids, folds, strict=True) for item in one.passes}
    before = {item.id: item.candidate_id for item in _all(folds, parts.alone)}
    after = {key: belongs.get(key) for key in before}
    await writes.assign_passes(connection, {key: now for key, now in after.items() if now != before[key]})
    await writes.delete_passes(connection, (key for one in folds for key in one.summary.expired))
    beliefs = {key: candidate_belief(key, one, policy.version) for key, one in zip(ids, folds, strict=True)}
    return beliefs, parts.merged


async def _clustered(
    connection: AsyncConnection, places: Places | None, held: frozenset[Cell] | None, policy: Policy
) -> tuple[Partition, dict[int, list[StoredPass]]]:
    """Return the candidates that the finds near places make, and the passes over their watch features."""
    if places is None:
        passes = await reads.all_clustering_passes(connection)
    elif places:
        passes = await reads.passes_near(connection, places, policy.reach_m)
        require_cells(cells_of(((item.map_id, *item.place[:2]) for item in passes if item.place), policy), held)
    else:
        return Partition((), ()), {}
    known = await reads.candidates_founded_by(connection, (item.id for item in passes))
    parts = await asyncio.to_thread(partition, passes, {key: item.id for key, item in known.items()}, policy)
    return parts, await reads.passes_over_watches(connection, parts.watch_ids)


async def _watched(
    connection: AsyncConnection, ids: frozenset[int], held: frozenset[Cell] | None, policy: Policy
) -> tuple[list[Membership], dict[int, list[StoredPass]]]:
    """Return candidates as they are stored, and the passes that named them: no group is clustered anew for these."""
    if not ids:
        return [], {}
    passes = await reads.passes_over_candidates(connection, ids)
    standing = [one for key in sorted(passes) if (one := members(key, passes[key])) is not None]
    places = ((item.map_id, *item.place[:2]) for one in standing for item in one.members if item.place)
    require_cells(cells_of(places, policy), held)
    return standing, {key: [item for item in mine if not item.clusters] for key, mine in passes.items()}


async def _write_candidates(connection: AsyncConnection, folds: list[CandidateFold], policy: Policy) -> list[int]:
    """Write candidates and return their ids, in the order given."""
    rows = [writes.candidate_row(one, policy.version) for one in folds]
    there = {
        one.membership.candidate_id: row
        for one, row in zip(folds, rows, strict=True)
        if one.membership.candidate_id is not None
    }
    await writes.update_candidates(connection, there)
    new = [row for one, row in zip(folds, rows, strict=True) if one.membership.candidate_id is None]
    made = await writes.insert_candidates(connection, new)
    return [one.membership.candidate_id or made[one.membership.founder.id] for one in folds]


def _all(folds: Iterable[CandidateFold], alone: Iterable[StoredPass]) -> Iterable[StoredPass]:
    for one in folds:
        yield from one.passes
    yield from alone


def cells_of(places: Iterable[tuple[int, float, float]], policy: Policy) -> frozenset[Cell]:
    """Return the cells that whoever changes anything at these places must hold."""
    maps, lon, lat = tuple(zip(*places, strict=True)) or ((), (), ())
    return frozenset(map(Cell.of_key, np.unique(keys_within(maps, lon, lat, policy.lock_reach_m)[1]).tolist()))


def feature_belief(feature: MappedFeature, summary: Summary, policy_version: str) -> tuple[Subject, Belief]:
    """Return a map feature's evidence as that of its deletion."""
    variance = feature.position_std_m**2
    place = Place(feature.lon, feature.lat, (variance, 0.0, variance))
    kind = (feature.feature_class, feature.sign, feature.value)
    subject = Subject(Kind.DELETED, feature.map_id, feature_id=feature.id, map_object_id=feature.object_id)
    belief = _belief(Kind.DELETED, summary, place, kind, policy_version)
    return subject, replace(belief, order=(feature.object_id,), begun=summary.turned, heading_deg=feature.heading_deg)


def candidate_belief(candidate_id: int, one: CandidateFold, policy_version: str) -> tuple[Subject, Belief]:
    """Return a candidate's evidence as that of a new feature."""
    founder = one.membership.founder
    kind = (founder.feature_class, one.sign, one.value)
    subject = Subject(Kind.NEW, founder.map_id, candidate_id=candidate_id)
    belief = _belief(Kind.NEW, one.summary, one.place, kind, policy_version)
    return subject, replace(belief, order=founder.order, begun=(one.summary.first_seen, one.summary.first_seen))


def _belief(
    kind: Kind, summary: Summary, place: Place, what: tuple[str, str | None, str | None], policy_version: str
) -> Belief:
    feature_class, sign, value = what
    return Belief(
        kind=kind,
        weight_for=summary.state.weight_for,
        weight_against=summary.state.weight_against,
        standing=summary.state.standing,
        stood_since=summary.stood_since,
        contributors_for=summary.state.contributors_for,
        contributors_against=summary.state.contributors_against,
        passes=summary.passes,
        first_seen=summary.first_seen,
        last_seen=summary.last_seen,
        last_looked=summary.last_looked,
        last_informative=summary.last_informative,
        feature_class=feature_class,
        sign=sign,
        value=value,
        lon=place.lon,
        lat=place.lat,
        covariance_m2=place.covariance_m2,
        policy_version=policy_version,
        fades_at=summary.fades_at,
    )
