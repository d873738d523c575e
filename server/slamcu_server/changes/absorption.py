"""Which candidates a new map version has as features of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_core.aggregation.agglomeration import compatible
from slamcu_server.aggregation.boxes import box, degrees
from slamcu_server.aggregation.evidence import frame_at


@dataclass(frozen=True, slots=True)
class AbsorbingFeature:
    """The map feature that a candidate is."""

    id: int
    object_id: int


async def absorbing_features(
    connection: AsyncConnection, map_id: int, sequence: int, policy: Policy
) -> dict[int, AbsorbingFeature]:
    """Return for each open candidate the nearest feature that it is and that the version is the first to have there."""
    result = await connection.execute(
        text(f"""
        SELECT r.id, r.feature_class, r.sign, r.value, r.cov_xx, r.cov_xy, r.cov_yy, r.lon, r.lat,
               f.id AS feature_id, f.object_id, v.sign AS map_sign, v.value AS map_value, v.position_std_m,
               ST_X(v.geom) AS map_lon, ST_Y(v.geom) AS map_lat
        FROM (
            SELECT *, ST_X(geom) AS lon, ST_Y(geom) AS lat FROM candidates
            WHERE map_id = :map AND merged_into IS NULL AND feature_id IS NULL) r
        JOIN feature_versions v ON v.map_id = :map AND v.from_sequence = :sequence
            AND v.evidence_sequence = :sequence AND v.feature_class = r.feature_class AND v.geom && {box("r")}
        JOIN features f ON f.id = v.feature_id"""),  # noqa: S608  (constants)
        {"map": map_id, "sequence": sequence, "reach": degrees(policy.reach_m)},
    )
    nearest: dict[int, tuple[float, int, AbsorbingFeature]] = {}
    for row in result:
        if not (compatible(row.sign, row.map_sign) and compatible(row.value, row.map_value)):
            continue
        rules = policy.for_class(row.feature_class)
        frame = frame_at(row.lon, row.lat)
        shift = frame.to_local(row.map_lon, row.map_lat) - frame.to_local(row.lon, row.lat)
        own = row.position_std_m**2 + rules.position_floor_m**2
        spread = np.array([[row.cov_xx + own, row.cov_xy], [row.cov_xy, row.cov_yy + own]])
        squared = float(shift @ np.linalg.solve(spread, shift))
        if squared > rules.gate or float(np.hypot(*shift)) > rules.match_radius_m:
            continue
        feature = AbsorbingFeature(row.feature_id, row.object_id)
        found = nearest.get(row.id)
        if found is None or (squared, feature.object_id) < found[:2]:
            nearest[row.id] = (squared, feature.object_id, feature)
    return {key: feature for key, (_, _, feature) in nearest.items()}
