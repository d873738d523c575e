"""Tie passes that name nothing to the map features that they must be about."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.boxes import degrees
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.resolve import match_feature


async def match(
    connection: AsyncConnection, passes: Sequence[StoredPass], sequences: Sequence[int], policy: Policy
) -> list[StoredPass]:
    """Return passes with the features of the current maps that those without any name are about.

    The caller holds the cells of their places.

    Parameters
    ----------
    sequences : for each pass, the map version that its vehicle compared with.
    """
    made = list(passes)
    unreferenced = [
        (number, (item.map_id, *item.place[:2]))
        for number, item in enumerate(passes)
        if item.place and item.feature_id is None and item.watch_id is None
    ]
    nearby = await reads.features_near(connection, [place for _, place in unreferenced], degrees(policy.reach_m))
    for (number, _), near in zip(unreferenced, nearby, strict=True):
        feature = match_feature(passes[number], sequences[number], near, policy)
        if feature is not None:
            made[number] = passes[number]._replace(feature_id=feature.id)
    return made
