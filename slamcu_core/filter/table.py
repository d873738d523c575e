"""What the car holds about each feature that is near, as arrays of rows: place, evidence, and the open pass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]  # rows of a table, by column


class Kind:
    """What a row stands for: plain numbers, for members of an enumeration are slow to reach within a step."""

    MAP: Final = 0  # a feature of the HD map: has a prior (eq. 3)
    WATCH: Final = 1  # a candidate that the cloud wants checked: vacuous (eq. 4), never localized on
    NEW: Final = 2  # found by this car: vacuous (eq. 4)


_COLUMNS: dict[str, tuple[type, tuple[int, ...]]] = {
    "kind": (np.int8, ()),
    "source": (np.intp, ()),  # index into the HD map; -1 for NEW
    "slot": (np.intp, ()),  # slot in the particles' arrays; -1 if none
    "alive": (np.bool_, ()),
    "disputed": (np.bool_, ()),  # a feature of the map that may have moved: never localized on
    "reported": (np.bool_, ()),  # a NEW feature that the cloud has been told of
    "feature_class": (np.intp, ()),
    "sign": (np.intp, ()),  # code of the sign type; 0: not known
    "value": (np.intp, ()),
    "xy": (np.float64, (2,)),  # m, in the filter's frame
    "covariance": (np.float64, (3,)),  # m²; xx, xy, yy
    "prior": (np.float64, ()),  # weight of eq. 3
    "hits": (np.int64, ()),
    "born": (np.float64, ()),
    "number": (np.int64, ()),  # of a find in the drive, from 1
    "passes": (np.int64, ()),
    "nominal": (np.float64, ()),  # P_D of the sensor that found it
    # the open pass
    "open": (np.bool_, ()),
    "pass_start": (np.float64, ()),
    "pass_last": (np.float64, ()),
    "best_view": (np.float64, ()),  # largest probability in the pass with which it could have been seen
    "evidence": (np.float64, (9,)),  # sums that a frame adds to; its parts are named in _PARTS
    "sighted": (np.float64, (13,)),  # sums over the sightings of the pass; its parts are named in _PARTS
    # regression of place along the road on time: does it stand still?
    "axis": (np.float64, (2,)),  # the road's direction and our place at birth, by dead reckoning
    "origin": (np.float64, (2,)),
    "track": (np.float64, (9,)),  # Σ of xx, xy, yy of R⁻¹, of xx and xy with t, of xx with t², of R⁻¹z, of its x with t
}


class Sum:
    """The columns of `evidence`."""

    WEIGHT_FOR: Final = 0  # of the whole drive, without the prior
    WEIGHT_AGAINST: Final = 1
    PASS_FOR: Final = 2
    PASS_AGAINST: Final = 3
    LOOKS_HIT: Final = 4  # independent looks of the pass that found it, and that did not
    LOOKS_MISSED: Final = 5
    DETECTED: Final = 6  # frames of the pass
    MISSED: Final = 7
    BLOCKED: Final = 8


_PARTS: dict[str, tuple[str, slice, tuple[int, ...]]] = {
    **{name.lower(): ("evidence", slice(at, at + 1), ()) for name, at in vars(Sum).items() if name.isupper()},
    "seen_information": ("sighted", slice(0, 4), (2, 2)),  # Σ R⁻¹ of sightings in the frame, 1/m²
    "seen_vector": ("sighted", slice(4, 6), (2,)),  # Σ R⁻¹ p
    "view_weight": ("sighted", slice(6, 7), ()),  # Σ 1/σ_r² of sightings
    "view_from": ("sighted", slice(7, 9), (2,)),  # Σ (place of the sensor) / σ_r²
    "by_scale": ("sighted", slice(9, 11), (2,)),  # what a range scale error of 1 adds to `seen_vector`
    "by_turn": ("sighted", slice(11, 13), (2,)),  # what a bearing bias of 1 rad adds to it
}
_OF_THE_PASS = slice(Sum.PASS_FOR, None)


class FeatureTable:
    """Rows of features as arrays; attributes are named as in `_COLUMNS` and are views of the rows in use."""

    kind: NDArray[np.int8]
    source: NDArray[np.intp]
    slot: NDArray[np.intp]
    alive: NDArray[np.bool_]
    disputed: NDArray[np.bool_]
    reported: NDArray[np.bool_]
    feature_class: NDArray[np.intp]
    sign: NDArray[np.intp]
    value: NDArray[np.intp]
    xy: Array
    covariance: Array
    prior: Array
    evidence: Array
    weight_for: Array
    weight_against: Array
    hits: NDArray[np.int64]
    born: Array
    number: NDArray[np.int64]
    passes: NDArray[np.int64]
    nominal: Array
    open: NDArray[np.bool_]
    pass_start: Array
    pass_last: Array
    best_view: Array
    pass_for: Array
    pass_against: Array
    detected: Array
    missed: Array
    blocked: Array
    looks_hit: Array
    looks_missed: Array
    sighted: Array
    seen_information: Array
    seen_vector: Array
    view_weight: Array
    view_from: Array
    by_scale: Array
    by_turn: Array
    axis: Array
    origin: Array
    track: Array

    def __init__(self) -> None:
        self._store: dict[str, NDArray[Any]] = {
            name: np.zeros((64, *shape), kind) for name, (kind, shape) in _COLUMNS.items()
        }
        self._size = 0
        self._unused: list[int] = []
        self._bind()

    def __len__(self) -> int:
        return self._size

    def __getstate__(self) -> dict[str, Any]:
        return {"_store": self._store, "_size": self._size, "_unused": self._unused}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()  # a copy's views must be of its own rows

    def _bind(self) -> None:
        for name, store in self._store.items():
            setattr(self, name, store[: self._size])
        for name, (of, part, shape) in _PARTS.items():
            whole = self._store[of][: self._size, part]
            setattr(self, name, whole.reshape(self._size, *shape) if len(shape) != 1 else whole)

    def add(self, kind: int, *, feature_class: int, sign: int, value: int, prior: float = 0.0) -> int:
        """Take a row into use and return its index."""
        row = int(self.take(1)[0])
        self.kind[row] = kind
        self.feature_class[row], self.sign[row], self.value[row] = feature_class, sign, value
        self.prior[row] = prior
        return row

    def take(self, count: int) -> NDArray[np.intp]:
        """Take rows into use, about which nothing is known yet, and return their indices."""
        rows = np.array([self._unused_row() for _ in range(count)], dtype=np.intp)
        for store in self._store.values():
            store[rows] = 0
        self.source[rows] = self.slot[rows] = -1
        self.alive[rows] = True
        return rows

    def take_over(self, other: FeatureTable, row: int) -> int:
        """Copy a row of another table and return its index here; it has no slot."""
        mine = self._unused_row()
        for name, store in self._store.items():
            store[mine] = other._store[name][row]
        self.slot[mine] = -1
        return mine

    def copied(self, rows: NDArray[np.intp]) -> Columns:
        """Return a copy of rows, by column."""
        return {name: store[rows] for name, store in self._store.items()}

    def paste(self, columns: Columns) -> NDArray[np.intp]:
        """Take rows into use for copies of rows, and return their indices; they have no slot and no open pass."""
        rows = self.take(len(columns["kind"]))
        for name, values in columns.items():
            self._store[name][rows] = values
        self.slot[rows] = -1
        self.open[rows] = False
        return rows

    def release(self, row: int) -> None:
        """Give a row up, to be used again."""
        self.alive[row] = self.open[row] = False
        self.slot[row] = -1
        self._unused.append(row)

    @property
    def used(self) -> int:
        """Number of rows in use."""
        return self._size - len(self._unused)

    def _unused_row(self) -> int:
        if self._unused:
            return self._unused.pop()
        if self._size == len(self._store["kind"]):
            self._store = {name: np.concatenate([s, np.zeros_like(s)]) for name, s in self._store.items()}
        self._size += 1
        self._bind()
        return self._size - 1

    def begin_passes(self, rows: NDArray[np.intp], t: float) -> None:
        """Open passes of rows at time t."""
        self.open[rows] = True
        self.pass_start[rows] = t
        self.evidence[rows, _OF_THE_PASS] = 0.0
        self.best_view[rows] = 0.0
        self.sighted[rows] = 0.0
        self.passes[rows] += 1


class Vocabulary:
    """Small integers for names; 0 stands for None."""

    def __init__(self) -> None:
        self._names: list[str | None] = [None]
        self._codes: dict[str | None, int] = {None: 0}

    def code(self, name: str | None) -> int:
        """Return the code of a name, new if need be."""
        code = self._codes.get(name)
        if code is None:
            code = self._codes[name] = len(self._names)
            self._names.append(name)
        return code

    def codes(self, names: Sequence[str | None]) -> NDArray[np.intp]:
        """Return the codes of names, (D,)."""
        known = self._codes
        return np.array([known[name] if name in known else self.code(name) for name in names], dtype=np.intp)

    def name(self, code: int) -> str | None:
        """Return the name of a code."""
        return self._names[code]
