"""Read map features with the windows of the passes that they were folded from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.boxes import PROBE
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.database.statements import text


@dataclass(frozen=True, slots=True)
class WindowedFeatures:
    """N map features and the windows of the passes that they were folded from before this transaction."""

    id: NDArray[np.int64]  # in ascending order
    said: NDArray[np.bool_]  # whether a change about it was ever told, or evidence against it has mattered before
    known: NDArray[np.bool_]  # whether the window is of all its passes
    window_bytes: NDArray[np.int64]  # how long each is
    windows: bytes  # one after the other

    def in_order(self) -> WindowedFeatures:
        """Return the same in order of their ids: PostgreSQL would sort megabytes, which are nearly always in order."""
        order = np.argsort(self.id)
        if (order == np.arange(len(order))).all():
            return self
        ends = np.cumsum(self.window_bytes)
        pieces = [self.windows[ends[at] - self.window_bytes[at] : ends[at]] for at in order.tolist()]
        return WindowedFeatures(
            self.id[order], self.said[order], self.known[order], self.window_bytes[order], b"".join(pieces)
        )


async def windowed_features(connection: AsyncConnection, added: Mapping[int, int]) -> WindowedFeatures:
    """Return map features with their windows; `added` says how many passes each has got in this transaction.

    A window counts if nothing has written the row since it was packed: a server before 0.3 leaves it as it was. Where
    there is no row, nothing was known if nothing but what was just added is stored.
    """
    types = {"id": "bigint", "added": "integer"}
    rows = [{"id": key, "added": added[key]} for key in sorted(added)]
    found = await connection.execute(
        text(f"""
        SELECT array_agg(id), array_agg(said), array_agg("window" IS NOT NULL),
               array_agg(COALESCE(octet_length("window"), 0)), string_agg("window", '')
        FROM (
            SELECT r.id,
                   EXISTS (SELECT FROM changes c WHERE c.feature_id = r.id)
                   OR COALESCE(s.weight_against > s.weight_for OR s.fades_at IS NOT NULL, false) AS said,
                   CASE WHEN s.feature_id IS NOT NULL THEN
                            CASE WHEN s.window_at = s.updated_at THEN s.passes_window END
                        WHEN (SELECT count(*) FROM (
                            SELECT FROM passes p WHERE p.feature_id = r.id LIMIT r.added + 1) few) <= r.added
                        THEN ''::bytea END AS "window"
            FROM {unnest(types)}
            LEFT JOIN LATERAL (
                SELECT feature_id, weight_for, weight_against, fades_at, passes_window, window_at, updated_at
                FROM feature_states WHERE feature_id = r.id {PROBE}) s ON true) each"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )
    ids, said, known, window_bytes, windows = (column or () for column in found.one())
    return WindowedFeatures(
        np.array(ids, np.int64),
        np.array(said, bool),
        np.array(known, bool),
        np.array(window_bytes, np.int64),
        windows or b"",
    ).in_order()
