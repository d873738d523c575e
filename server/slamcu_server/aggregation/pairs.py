"""Pair deleted map features with new ones, over whole neighbourhoods, whatever order the evidence came in.

A pair depends on what is near: whoever folds one half anew looks at everything that could be the other half of it, and
at what that could be the other half of, until nothing is left (`further`). So the stored pairs are a pure function of
the stored beliefs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import ClassPolicy, Half, Policy, pair
from slamcu_server.aggregation.boxes import PROBE, both_sides, box, degrees
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.aggregation.evidence import covariances, frame_at
from slamcu_server.changes.belief import Belief, Kind, Pair, Subject, masses
from slamcu_server.database.statements import text

Held = Mapping[int, tuple[Subject, Belief]]
Place = tuple[int, float, float]  # map id, lon, lat

_PLACE_TYPES = {"map_id": "bigint", "lon": "float8", "lat": "float8"}


def strong(held: Held, policy: Policy) -> dict[int, Place]:
    """Return the places of the beliefs that may be halves of a change: from where one would be spoken of."""
    return _believed(held, lambda rules: rules.opening_mass, policy)


def doubted(features: Held, policy: Policy) -> dict[int, Place]:
    """Return the places of the map features beside which a new half may have to wait: weakly denied ones too."""
    return _believed(features, lambda rules: rules.closing_mass, policy)


def _believed(held: Held, least: Callable[[ClassPolicy], float], policy: Policy) -> dict[int, Place]:
    beliefs = [belief for _, belief in held.values()]
    return {
        key: (subject.map_id, belief.lon, belief.lat)
        for (key, (subject, belief)), mass in zip(held.items(), masses(beliefs), strict=True)
        if belief.standing or mass >= least(policy.for_class(belief.feature_class))
    }


def pair_beliefs(features: Held, candidates: Held, policy: Policy) -> tuple[Pair, ...]:
    """Return which features and candidates are one change."""
    reach = degrees(policy.lock_reach_m)
    deleted, new = _near(doubted(features, policy), strong(candidates, policy), reach)
    spoken_of = strong({key: features[key] for key in deleted}, policy)

    def difference(feature: Half, candidate: Half) -> NDArray[np.float64] | None:
        one, other = deleted[feature.key[1]], new[candidate.key[1]]  # type: ignore[index]  # the keys made below
        if one[0] != other[0] or abs(one[2] - other[2]) > reach:
            return None
        frame = frame_at(one[1], one[2])
        return np.asarray(frame.to_local(other[1], other[2]) - frame.to_local(one[1], one[2]))

    found = pair(
        [_half((True, key), features[key][1], weak=key not in spoken_of) for key in sorted(deleted)],
        [_half((False, key), candidates[key][1]) for key in sorted(new)],
        difference,
        policy,
    )
    return tuple(
        Pair(Kind.MODIFIED if one.modified else Kind.MOVED, one.feature[1], one.candidate[1])  # type: ignore[index]
        for one in found
    )


def _near(
    some: Mapping[int, Place], others: Mapping[int, Place], reach_deg: float
) -> tuple[dict[int, Place], dict[int, Place]]:
    """Return of each those that have one of the other near, in latitude and longitude."""
    if not (some and others):
        return {}, {}
    one, other = np.array([*some.values()], float)[:, None], np.array([*others.values()], float)
    width = reach_deg / np.maximum(np.cos(np.radians(one[..., 2])), 0.0017)
    east = np.abs(one[..., 1] - other[:, 1])
    near = (one[..., 0] == other[:, 0]) & (np.abs(one[..., 2] - other[:, 2]) <= reach_deg)
    near &= np.minimum(east, 360.0 - east) <= 1.01 * width
    return (
        {key: place for (key, place), kept in zip(some.items(), near.any(axis=1).tolist(), strict=True) if kept},
        {key: place for (key, place), kept in zip(others.items(), near.any(axis=0).tolist(), strict=True) if kept},
    )


def _half(key: tuple[bool, int], belief: Belief, *, weak: bool = False) -> Half:
    return Half(
        key=key,
        order=belief.order,
        feature_class=belief.feature_class,
        sign=belief.sign,
        value=belief.value,
        covariance=covariances([belief.covariance_m2])[0],
        begun=tuple(None if time is None else time.timestamp() for time in belief.begun),  # type: ignore[arg-type]
        heading_deg=belief.heading_deg,
        standing=belief.standing,
        contributors=belief.contributors_for if belief.kind is Kind.NEW else belief.contributors_against,
        weak=weak,
    )


async def stored_partners(
    connection: AsyncConnection, features: Collection[int], candidates: Collection[int]
) -> list[tuple[int, int]]:
    """Return (candidate, feature) of the stored pairs of these, and of those whose candidate is none any more."""
    result = await connection.execute(
        text("""
        SELECT id, pair_feature_id FROM candidates WHERE pair_feature_id IS NOT NULL AND (
            pair_feature_id = ANY(CAST(:features AS bigint[])) OR id = ANY(CAST(:candidates AS bigint[]))
            OR merged_into IS NOT NULL OR feature_id IS NOT NULL)"""),
        {"features": sorted(features), "candidates": sorted(candidates)},
    )
    return [(row.id, row.pair_feature_id) for row in result]


async def candidates_beside(
    connection: AsyncConnection, places: Iterable[Place], ids: Iterable[int], reach_m: float
) -> dict[int, Place]:
    """Return the open candidates near places, and those with these ids, each with its founding place."""
    rows = [dict(zip(_PLACE_TYPES, place, strict=True)) for place in both_sides(sorted(set(places)))]
    asked = sorted(set(ids))
    if not (rows or asked):
        return {}
    result = await connection.execute(
        text(f"""
        SELECT c.id, c.map_id, ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat
        FROM (
            SELECT unnest(CAST(:ids AS bigint[])) AS id UNION
            SELECT near.id FROM {unnest(_PLACE_TYPES)} CROSS JOIN LATERAL (
                SELECT id FROM candidates WHERE geom && {box("r")} AND map_id = r.map_id
                AND merged_into IS NULL AND feature_id IS NULL {PROBE}) near
        ) asked
        JOIN candidates c ON c.id = asked.id JOIN passes p ON p.id = c.founding_pass
        WHERE c.merged_into IS NULL AND c.feature_id IS NULL"""),  # noqa: S608  (constants)
        {**arrays(_PLACE_TYPES, rows), "reach": degrees(reach_m), "ids": asked},
    )
    return {row.id: (row.map_id, row.lon, row.lat) for row in result}


async def features_beside(connection: AsyncConnection, places: Iterable[Place], reach_m: float) -> set[int]:
    """Return the features of the current maps near places against which enough is believed to be half of a change.

    What could fade could be half of a change; so could, in rows that an older server wrote, what evidence prevails
    against.
    """
    rows = [dict(zip(_PLACE_TYPES, place, strict=True)) for place in both_sides(sorted(set(places)))]
    if not rows:
        return set()
    result = await connection.execute(
        text(f"""
        SELECT DISTINCT v.feature_id FROM {unnest(_PLACE_TYPES)}
        CROSS JOIN LATERAL (
            SELECT feature_id FROM feature_versions WHERE geom && {box("r")} AND map_id = r.map_id
            AND to_sequence IS NULL {PROBE}) v
        JOIN feature_states s ON s.feature_id = v.feature_id
            AND (s.fades_at IS NOT NULL OR s.weight_against > s.weight_for)"""),  # noqa: S608  (constants)
        {**arrays(_PLACE_TYPES, rows), "reach": degrees(reach_m)},
    )
    return {row.feature_id for row in result}


async def write_pairs(connection: AsyncConnection, pairs: Sequence[Pair], candidates: Iterable[int]) -> None:
    """Say of candidates with which map features they are one change, or with none."""
    if not (concerned := sorted(set(candidates))):
        return
    types = {"id": "bigint", "feature": "bigint", "kind": "text"}
    partners = {one.candidate_id: one for one in pairs}
    rows = [
        {"id": key, "feature": partners[key].feature_id, "kind": partners[key].kind.value}
        if key in partners
        else {"id": key, "feature": None, "kind": None}
        for key in concerned
    ]
    await connection.execute(
        text(f"""
        UPDATE candidates c SET pair_feature_id = r.feature, pair_kind = r.kind FROM {unnest(types)}
        WHERE c.id = r.id AND (c.pair_feature_id, c.pair_kind) IS DISTINCT FROM (r.feature, r.kind)"""),  # noqa: S608
        arrays(types, rows),
    )
