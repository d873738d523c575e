"""Adding to a feature from its window gives what folding all its passes gives, whatever comes in whatever order."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_server.aggregation import batch, quiet, rebuild, windows
from slamcu_server.aggregation.worker import drain

pytestmark = pytest.mark.anyio

SIGNS = tuple((300.0 * number, 0.0) for number in range(10))
NUMBERS = "weight_for, weight_against, standing, contributors_for, contributors_against, passes, looked, blocked"


@pytest.fixture
async def street(engine: Any, town: Any) -> Any:
    """Ten signs, and a window so short that passes expire."""
    made = type(town)(engine, source="street", policy=Policy(ClassPolicy(window=8, contributors_in_doubt=2)))
    await made.import_map(SIGNS)
    return made


@pytest.fixture
def quiet_features(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many features each batch has added to without reading their passes."""
    counts: list[int] = []
    append = batch.quiet.append

    async def counting(connection: Any, about: Any, *others: Any) -> frozenset[int]:
        loud = await append(connection, about, *others)
        counts.append(len(set(about.tolist()) - loud))
        return loud

    monkeypatch.setattr(batch.quiet, "append", counting)
    return counts


def drives(reports: Any, seed: int) -> list[tuple[str, bool, list[Any]]]:
    """Cars that see nearly all signs nearly always, for three days; some look twice within the hour."""
    rng = random.Random(seed)
    made = []
    for number in range(45):
        hours, passes = rng.uniform(0.0, 72.0), []
        for sign in rng.sample(range(1, len(SIGNS) + 1), 5):
            draw, weight = rng.random(), rng.uniform(0.0, 4.0)
            if draw < 0.8:
                passes.append(reports.seen(sign, hours=hours, weight=weight))
            else:
                passes.append((reports.blocked if draw < 0.87 else reports.missed)(sign, hours=hours))
            if rng.random() < 0.3:
                passes.append(reports.seen(sign, hours=hours + 0.2, weight=weight))
        made.append((f"car-{number % 7}", rng.random() > 0.2, passes))
    return made


async def send(street: Any, messages: list[tuple[str, bool, list[Any]]], order: list[int]) -> None:
    for number in order:
        car, trusted, passes = messages[number]
        await street.report(car, *passes, session=f"drive-{number}", message_id=1, trusted=trusted)


async def believed(street: Any) -> list[list[Any]]:
    rows = await street.rows(
        f"SELECT {NUMBERS}, last_seen, last_looked, last_informative FROM feature_states ORDER BY feature_id"
    )
    return [list(row) for row in rows]


def agree(found: list[list[Any]], wanted: list[list[Any]]) -> None:
    assert len(found) == len(wanted) == len(SIGNS)
    for mine, other in zip(found, wanted, strict=True):
        assert mine[:2] == pytest.approx(other[:2], abs=1e-9, rel=1e-9)
        assert mine[2:] == other[2:]


@pytest.mark.parametrize("seed", [1, 2])
async def test_windows_fold_as_all_passes_do_in_any_order(
    street: Any, reports: Any, quiet_features: list[int], seed: int
) -> None:
    messages, rng, wanted = drives(reports, seed), random.Random(seed), None
    for workers, batch_size in ((1, 64), (1, 3), (2, 2)):
        await street.do("TRUNCATE messages, passes, candidates, feature_states, changes, change_entries CASCADE")
        await send(street, messages, rng.sample(range(len(messages)), len(messages)))
        done = await asyncio.gather(*(drain(street.engine, street.policy, batch_size) for _ in range(workers)))
        assert sum(one.fused for one in done) == len(messages)
        result = await believed(street)
        wanted = wanted or result
        agree(result, wanted)
        assert await rebuild.differences(street.engine, street.policy) == []
    assert sum(quiet_features) > 100, "the windows were put to use"
    kept = await street.scalar("SELECT count(*) FROM passes")
    assert kept < sum(len(passes) for _, _, passes in messages), "some passes have expired"
    assert kept == await street.scalar("SELECT sum(passes) FROM feature_states")


async def test_a_window_that_others_have_overtaken_is_not_believed(street: Any, reports: Any) -> None:
    messages = drives(reports, 3)
    await send(street, messages, list(range(20)))
    await street.fuse()
    # what a server does that knows no windows: it stores passes, folds all of them and writes the row
    await street.do("DELETE FROM passes WHERE id % 3 = 0")
    await street.do("UPDATE feature_states SET updated_at = now()")
    await send(street, messages, list(range(20, 45)))
    await street.fuse(batch_size=4)
    assert await rebuild.differences(street.engine, street.policy) == []


async def test_a_window_of_a_server_that_did_not_know_doubt_is_not_believed(street: Any, reports: Any) -> None:
    messages = drives(reports, 5)
    await send(street, messages, list(range(30)))
    await street.fuse()
    before = 0
    for row in await street.rows("SELECT feature_id, passes_window FROM feature_states"):
        entries = windows.unpack(row.passes_window).copy()
        silent = entries["flags"] & windows.COUNTS == 0
        for name in ("weight_for", "weight_against"):
            entries[name][silent] = 0.0
        entries["flags"] &= windows.COUNTS | windows.BLOCKED | windows.FOUND
        before += int(silent.sum())
        await street.do(
            "UPDATE feature_states SET passes_window = :w WHERE feature_id = :f",
            w=windows.stored(entries),
            f=row.feature_id,
        )
    assert before > 5
    await send(street, messages, list(range(30, 45)))
    await street.fuse(batch_size=4)
    assert await rebuild.differences(street.engine, street.policy) == []


async def test_features_of_which_passes_are_stored_but_nothing_is_believed_are_folded_from_them(
    street: Any, reports: Any
) -> None:
    messages = drives(reports, 4)
    await send(street, messages, list(range(20)))
    await street.fuse()
    await street.do("DELETE FROM feature_states")
    await send(street, messages, list(range(20, 45)))
    await street.fuse()
    assert await rebuild.differences(street.engine, street.policy) == []


async def test_a_sign_that_goes_speaks_up_after_a_long_silence(street: Any, reports: Any) -> None:
    for number in range(12):
        await street.report(f"car-{number % 4}", *(reports.seen(sign, hours=2 * number) for sign in range(1, 11)))
    await street.fuse(batch_size=2)
    assert await street.changes() == []
    for number in range(6):
        await street.report(f"car-{number}", reports.missed(5, hours=40 + 2 * number))
        await street.fuse()
    [change] = await street.changes()
    assert (change.kind, change.state, change.document["map_object_id"]) == ("deleted", "confirmed", 5)
    await street.report("late", replace(reports.seen(5, hours=39.5), frames_detected=3))
    await street.fuse()
    assert await rebuild.differences(street.engine, street.policy) == []


async def test_a_full_window_is_stored_as_it_is_and_forgets_what_leaves_it(town: Any, reports: Any) -> None:
    window = town.policy.default.window
    for number in range(window + 20):
        await town.report(f"car-{number % 7}", reports.seen(1, hours=number))
    await town.fuse(batch_size=16)
    [stored] = await town.rows("""
        SELECT octet_length(passes_window) AS length, pg_column_compression(passes_window) AS compressed, passes,
               (SELECT count(*) FROM passes) AS kept, forgotten_looked FROM feature_states""")
    assert stored.length == 33 * window
    assert stored.compressed is None, "packing it takes longer than all else that the database does"
    assert (stored.passes, stored.kept, stored.forgotten_looked) == (window, window, 20)
    assert await rebuild.differences(town.engine, town.policy) == []


@pytest.mark.parametrize("oldest", [1_777_000_000_000_000, -62_000_000_000_000_000], ids=["today", "antiquity"])
def test_passes_are_put_in_order_whatever_date_one_of_them_bears(oldest: int) -> None:
    rng = np.random.default_rng(0)
    feature, contributor = rng.integers(0, 512, 2000), rng.integers(0, 9, 2000)
    ended_at = 1_777_000_000_000_000 + rng.permutation(2000)
    ended_at[0] = oldest
    ordered = quiet._order(feature, ended_at, contributor)
    assert ordered.tolist() == np.lexsort((contributor, ended_at, feature)).tolist()
