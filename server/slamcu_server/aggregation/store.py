"""Store passes: what messages say, row by row, for good."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.binary import Column, copy, text_field
from slamcu_server.aggregation.condensed import PLACED, STATUSES, VALID
from slamcu_server.aggregation.resolve import Resolved
from slamcu_server.database.statements import text

_TEXTS = ("status", "feature_class", "sign", "value", "sensor_model", "software_version", "fleet_id")

Ids = NDArray[np.int64]
Indices = NDArray[np.intp]


async def new_ids(connection: AsyncConnection, count: int) -> Ids:
    """Return ids for so many passes."""
    query = text("SELECT nextval(pg_get_serial_sequence('passes', 'id')) FROM generate_series(1, :count)")
    return np.array((await connection.execute(query, {"count": count})).scalars().all(), np.int64)


async def store_passes(
    connection: AsyncConnection, resolved: Resolved, chosen: Indices, ids: Ids | None = None
) -> None:
    """Store some of the passes, with these ids or with such as nobody asks for."""
    if not len(chosen):
        return
    reported = resolved.reported
    message, records = reported.message[chosen], reported.records[chosen]

    def of_message(values: list[int] | Ids) -> Ids:
        return np.asarray(values, np.int64)[message]

    nowhere = records["flags"] & PLACED == 0
    about = {"feature_id": resolved.feature_id, "watch_id": resolved.watch_id, "candidate_id": resolved.candidate_id}
    columns = {
        "message": Column("bigint", of_message([one.id for one in reported.claimed])),
        "index_in_message": Column("integer", reported.index[chosen]),
        "map_id": Column("bigint", of_message(resolved.map_id)),
        "contributor_id": Column("bigint", of_message([one.account_id for one in reported.claimed])),
        "started_at": Column("timestamptz", records["started_at"]),
        "ended_at": Column("timestamptz", records["ended_at"]),
        **{name: Column("float8", records[name]) for name in ("weight_for", "weight_against")},
        **{name: Column("integer", records[name]) for name in ("frames_detected", "frames_missed", "frames_blocked")},
        **{name: Column("bigint", each[chosen], each[chosen] == 0) for name, each in about.items()},
        "geom": Column("point", np.column_stack([records["lon"], records["lat"]]), nowhere),
        **{name: Column("float8", records[name], nowhere) for name in ("cov_xx", "cov_xy", "cov_yy")},
        "map_sequence": Column("integer", of_message(resolved.map_sequence)),
        "valid": Column("boolean", records["flags"] & VALID > 0),
        "trusted": Column("boolean", of_message([one.trusted for one in reported.envelopes])),
        "archived": Column("boolean", resolved.archived[chosen]),
    }
    if ids is not None:
        columns = {"id": Column("bigint", ids), **columns}
    await copy(connection, "passes", columns, _TEXTS, _texts(resolved, chosen))


def _texts(resolved: Resolved, chosen: Indices) -> list[bytes]:
    """Return the fields of _TEXTS of each pass, those that are the same as the same bytes."""
    reported = resolved.reported
    kinds = reported.records["status"], reported.feature_class, reported.sign, reported.value
    shape = len(STATUSES), *3 * (len(reported.texts),)
    codes, which = np.unique(np.ravel_multi_index([each[chosen] for each in kinds], shape), return_inverse=True)
    of_kind = [
        text_field(STATUSES[status]) + b"".join(text_field(reported.texts[number]) for number in names)
        for status, *names in zip(*(each.tolist() for each in np.unravel_index(codes, shape)), strict=True)
    ]
    of_message = [
        b"".join(map(text_field, (one.sensor_model, one.software_version, one.fleet_id))) for one in reported.envelopes
    ]
    pairs = zip(which.tolist(), reported.message[chosen].tolist(), strict=True)
    return [of_kind[kind] + of_message[message] for kind, message in pairs]
