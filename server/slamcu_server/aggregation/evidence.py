"""Fold what was reported about one map feature or candidate: pure functions of the set of its passes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation import (
    EPOCH_S,
    ClassPolicy,
    FoldedColumns,
    FoldedState,
    Side,
    fades_each,
    fold_columns,
    fuse_positions_each,
    moments,
)
from slamcu_core.evidence import masses_from_weights
from slamcu_core.geometry import LocalFrame, to_local_each
from slamcu_server.aggregation.cells import Cell, cell_at
from slamcu_server.aggregation.pass_table import Flags, Indices, PassTable
from slamcu_server.aggregation.passes import StoredPass

_CALENDAR_END_S = datetime(9999, 12, 31, tzinfo=UTC).timestamp()


@dataclass(frozen=True, slots=True)
class Summary:
    """What the passes over one thing amount to."""

    state: FoldedState
    passes: int
    looked: int  # passes that could see the place
    blocked: int  # passes that could not
    first_seen: datetime | None
    last_seen: datetime | None
    last_looked: datetime | None
    fades_at: datetime | None  # when it stands, or is spoken of, no longer if no news comes
    expired: tuple[int, ...]  # ids of passes that no fold will need again
    forgotten_looked: int  # of these, passes that could see the place
    forgotten_blocked: int  # and passes that could not

    @property
    def last_informative(self) -> datetime | None:
        """The time of the last informative contribution."""
        return moment(self.state.last_informative)

    @property
    def stood_since(self) -> datetime | None:
        """Since when the change stands, in event time."""
        return moment(self.state.stood_since)

    @property
    def turned(self) -> tuple[datetime | None, datetime | None]:
        """The last who denied that it is gone, and the first who said so after that."""
        return moment(self.state.turned_after), moment(self.state.turned_at)


@dataclass(frozen=True, slots=True)
class Place:
    """A fused place."""

    lon: float  # degrees
    lat: float
    covariance_m2: tuple[float, float, float]  # xx, xy, yy in east-north


def moment(posix_s: float | None) -> datetime | None:
    """Return a POSIX time as an aware datetime; None for one after the calendar's end, which nobody lives to see."""
    return None if posix_s is None or posix_s > _CALENDAR_END_S else datetime.fromtimestamp(posix_s, UTC)


def summarize(
    things: Sequence[Iterable[StoredPass]],
    policy: ClassPolicy,
    side: Side,
    *,
    prior_weights: Sequence[float] | None = None,
    may_expire: Callable[[StoredPass], bool] = lambda _: True,
) -> list[Summary]:
    """Fold the passes over each of many things of one class, and count them; without `prior_weights` none has a prior.

    Passes of epochs before the window of contributions that fold are expired: nothing that comes later, however late,
    can bring them back. Only the last that saw it stays. Expired passes are left out of the counts, which are therefore
    a pure function of all that was ever reported, whether the expired passes are still stored or not.
    """
    table = PassTable.of(things)
    priors = [0.0] * len(things) if prior_weights is None else prior_weights
    folded = fold_columns(table.columns(), priors, policy, deleted=side is Side.DELETED)
    looked, seen, blocked = table.counts & ~table.blocked, table.counts & table.found, table.counts & table.blocked
    if side is Side.NEW:  # as `witnesses`
        unseen = (table.count(seen) == 0) & (folded.weight_for > 0.0)
        seen |= unseen[table.thing] & table.valid & table.found
    last_seen = table.last(seen)
    expired = _expired(table, folded, last_seen, policy, may_expire)
    columns = zip(
        folded.states(),
        table.count(~expired).tolist(),
        table.count(looked & ~expired).tolist(),
        table.count(blocked & ~expired).tolist(),
        table.ends(table.first(seen & ~expired)),
        table.ends(last_seen),
        table.ends(table.last(looked)),
        map(moment, moments(_fades_at(folded, policy, side))),
        table.count(looked & expired).tolist(),
        table.count(blocked & expired).tolist(),
        strict=True,
    )
    gone = table.ids_of(expired)
    return [
        Summary(state, passes, looks, blocks, first, last, look, fades, gone.get(number, ()), *forgotten)
        for number, (state, passes, looks, blocks, first, last, look, fades, *forgotten) in enumerate(columns)
    ]


def _expired(
    table: PassTable,
    folded: FoldedColumns,
    last_seen: Indices,
    policy: ClassPolicy,
    may_expire: Callable[[StoredPass], bool],
) -> Flags:
    """Return (P,), which passes no fold will need again."""
    begin = np.where(folded.folded == policy.window, np.floor(folded.oldest / EPOCH_S), -np.inf)
    expired = np.floor(table.ended_at / EPOCH_S) < begin[table.thing]
    for number in np.flatnonzero(expired).tolist():
        expired[number] = may_expire(table.passes[number])
    expired[last_seen[last_seen >= 0]] = False
    return np.asarray(expired)


def _fades_at(folded: FoldedColumns, policy: ClassPolicy, side: Side) -> NDArray[np.float64]:
    """Return when each state stands, or is spoken of, no longer if no news comes; NaN for one that is not."""
    exists, not_exists, _ = masses_from_weights(folded.weight_for, folded.weight_against)
    speaks = folded.standing | ((exists if side is Side.NEW else not_exists) >= policy.closing_mass)
    levels = np.where(folded.standing, policy.leave, policy.closing_mass)
    told = np.full(len(speaks), np.nan)
    told[speaks] = fades_each(
        folded.weight_for[speaks],
        folded.weight_against[speaks],
        folded.last_informative[speaks],
        levels[speaks],
        policy=policy,
        side=side,
    )
    return told


def witnesses(passes: Iterable[StoredPass]) -> list[StoredPass]:
    """Return the passes that saw something: whoever did in doubt is asked only where nobody else has seen it."""
    seen = [item for item in passes if item.valid and item.found]
    return [item for item in seen if item.trusted] or seen


def fuse_place(passes: Iterable[StoredPass], policy: ClassPolicy) -> Place:
    """Fuse the places where passes saw a candidate, in a frame that depends on nothing but these passes.

    Raises ValueError if no pass saw it at a place.
    """
    return fuse_places([passes], policy)[0]


def fuse_places(things: Sequence[Iterable[StoredPass]], policy: ClassPolicy) -> list[Place]:
    """Fuse the places where passes saw each of some candidates of one class: `fuse_place` of each."""
    if not things:
        return []
    seen = [witnesses(item for item in passes if item.place is not None) for passes in things]
    if not all(seen):
        raise ValueError("no pass saw it at a place")
    firsts = [min(mine, key=lambda item: item.order).place for mine in seen]
    frames = [frame_at(place[0], place[1]) for place in firsts if place is not None]
    places = [item.place for mine in seen for item in mine if item.place is not None]
    of_thing = np.repeat(np.arange(len(seen)), [len(mine) for mine in seen])
    fused = fuse_positions_each(
        to_local_each(frames, of_thing, [place[0] for place in places], [place[1] for place in places]),
        covariances([place[2] for place in places]),
        np.array([item.contributor for mine in seen for item in mine]),
        of_thing,
        policy,
    )
    made: list[Place] = []
    for frame, at, covariance in zip(frames, fused.xy, fused.covariance.tolist(), strict=True):
        lon, lat = frame.to_geographic(at)
        (xx, xy), (_, yy) = covariance
        made.append(Place(float(lon), float(lat), (xx, xy, yy)))
    return made


def frame_at(lon: float, lat: float) -> LocalFrame:
    """Return the metric frame of the cell in which a place lies."""
    return _frame_of(cell_at(0, lon, lat))


@lru_cache(maxsize=4096)
def _frame_of(cell: Cell) -> LocalFrame:
    west, south, east, north = cell.bounds
    return LocalFrame((west + east) / 2, (south + north) / 2)


def covariances(entries: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Return covariances [xx, xy, yy] as matrices (N, 2, 2)."""
    flat = np.array(entries, float).reshape(-1, 3)
    return flat[:, [0, 1, 1, 2]].reshape(-1, 2, 2)


def prevailing(passes: Iterable[StoredPass]) -> tuple[str | None, str | None]:
    """Return the sign and value with the most weight for them; equal weights go by name, and a name beats none."""
    seen = witnesses(passes)
    sign = _heaviest([(item.sign, item.weight_for) for item in seen])
    value = _heaviest([(item.value, item.weight_for) for item in seen if item.sign == sign or item.sign is None])
    return sign, value


def _heaviest(votes: Sequence[tuple[str | None, float]]) -> str | None:
    names = sorted({name for name, _ in votes if name is not None})
    if len(names) < 2:
        return names[0] if names else None
    weights = {name: math.fsum(weight for voted, weight in votes if voted == name) for name in names}
    return max(names, key=lambda name: weights[name])
