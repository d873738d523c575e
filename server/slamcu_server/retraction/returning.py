"""What comes back after its retraction is undone is about what the map has taken in meanwhile.

While passes were out, the map may have got the sign that they found, and a candidate may have become a map feature.
What comes back is read as if it were reported now: a find that its vehicle's map did not have counts for the feature
that is there now, and so does what named a watch feature. An id whose founding find is about a map feature is that
feature's.
"""

from __future__ import annotations

from collections.abc import Collection

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.aggregation.matching import match
from slamcu_server.database.statements import text

_ABOUT = {"id": "bigint", "feature": "bigint"}
_TIE = text(f"""
    UPDATE passes p SET feature_id = r.feature, candidate_id = NULL FROM {unnest(_ABOUT)} WHERE p.id = r.id""")  # noqa: S608  (constants)
_BIND = text(f"""
    UPDATE candidates c SET feature_id = r.feature, merged_into = NULL, pair_feature_id = NULL, pair_kind = NULL
    FROM {unnest(_ABOUT)} WHERE c.founding_pass = r.id AND c.feature_id IS NULL RETURNING c.id""")  # noqa: S608  (constants)
# also what was reported about an id while nothing stood behind it
_FOLLOW = text("""
    UPDATE passes p SET feature_id = root.feature_id, candidate_id = NULL
    FROM candidates c JOIN candidates root ON root.id = COALESCE(c.merged_into, c.id)
    WHERE p.watch_id = c.id AND (p.id = ANY(CAST(:passes AS bigint[])) OR c.id = ANY(CAST(:bound AS bigint[])))
      AND root.feature_id IS NOT NULL AND p.feature_id IS NULL AND NOT p.archived AND p.retraction_id IS NULL
    RETURNING p.feature_id""")


async def tie(connection: AsyncConnection, pass_ids: Collection[int], policy: Policy) -> frozenset[int]:
    """Tie those of the passes that have come back to the map features they are about now, and return these.

    The caller holds the cells of the passes' places; those of the features it has to hold before it folds them.
    """
    found = await reads.nameless_passes(connection, pass_ids)
    matched = await match(connection, [item for item, _ in found], [sequence for _, sequence in found], policy)
    tied = {item.id: item.feature_id for item in matched if item.feature_id is not None}
    bound: list[int] = []
    if tied:
        about = [{"id": key, "feature": feature} for key, feature in tied.items()]
        await connection.execute(_TIE, arrays(_ABOUT, about))
        bound = [row.id for row in await connection.execute(_BIND, arrays(_ABOUT, about))]
    followed = await connection.execute(_FOLLOW, {"passes": sorted(pass_ids), "bound": bound})
    return frozenset(tied.values()) | {row.feature_id for row in followed}
