"""Existence and classification, sections 4.2.2, 4.3.2 and 4.3.3, on rows of the feature table."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from slamcu_core.evidence import LAMBDA_MAX, LN_2, masses_from_weights
from slamcu_core.filter.table import FeatureTable, Kind, Sum

Array = NDArray[np.float64]

_CERTAIN = 1.0 - 1e-6  # no view is more certain than this
_LASTING = 0.99  # independent looks after the first, before something is there
_PERSISTENCE = 0.2  # of the sensor's P_D; one real pass in a thousand falls below (Beta, four looks)


class State(StrEnum):
    """The classes of section 4.3.3."""

    NORMAL = "normal"
    DELETED = "deleted"
    NEW = "new"
    UNCLASSIFIED = "unclassified"


def temper(dt: float, correlation_time: float) -> float:
    """Return the share of a frame's evidence that is its own, dt seconds after the last (errata to section 6.2)."""
    return 1.0 if correlation_time <= 0.0 else min(1.0, dt / correlation_time)


def add(table: FeatureTable, rows: NDArray[np.intp], held: Array, sums: Array, cap: float) -> None:
    """Add sums (9, F), as in `Sum`, to what rows have held (F, 9) of evidence (eq. 5).

    Evidence is capped by scaling both its weights.
    """
    held += sums.T
    weights = held[:, : Sum.PASS_FOR]
    if np.maximum.reduce(weights, axis=None, initial=0.0) > cap:
        weights *= (cap / np.maximum(weights.max(axis=1), cap))[:, None]
    table.evidence[rows] = held


def miss_weight(probability: Array, miss_confidence: float) -> Array:
    """Return the weights of misses (eq. 2): their mass is λ · P(visible) · P_D, vacuous when occluded."""
    return np.asarray(-np.log1p(-np.minimum(miss_confidence * probability, LAMBDA_MAX)))


def detectability(held: Array, nominal: Array, concentration: float) -> Array:
    """Return P_D (F,) of rows in their open pass, given how the pass has gone so far by the evidence held (F, 9).

    Misses come in bursts: a feature that faces away or stands behind a bush is missed in every frame of a pass. So P_D
    of a pass is itself uncertain, Beta distributed with the sensor's nominal P_D as mean and `concentration` looks as
    its weight; each look updates it, and a long row of misses counts ever less.
    """
    hit, missed = held[:, Sum.LOOKS_HIT], held[:, Sum.LOOKS_MISSED]
    return np.asarray((concentration * nominal + hit) / (concentration + hit + missed))


def bounded_by_view(
    table: FeatureTable, rows: NDArray[np.intp], held: Array, looked: Array, weight_against: Array
) -> Array:
    """Return the weights of misses (F,), bounded by how surely their rows could be seen at all; they `held` (F, 9).

    What stood outside the view because the pose is wrong, or behind something, did so in every frame of the pass: all
    its misses together say no more than that it could be seen when it was so most surely. `looked` (F,) is with which
    probability it could in this frame.
    """
    best = np.maximum(table.best_view[rows], looked)
    table.best_view[rows] = best
    most = -np.log1p(-np.minimum(best, _CERTAIN))
    return np.asarray(np.minimum(weight_against, np.maximum(most - held[:, Sum.PASS_AGAINST], 0.0)))


def masses(table: FeatureTable, rows: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Return the masses (e, n, u) of rows, with the map's prior (eq. 3) where they have one."""
    return masses_from_weights(table.prior[rows] + table.weight_for[rows], table.weight_against[rows])


def exists(table: FeatureTable, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether existence is the largest mass of rows (section 4.3.3): e > n where f > a, e > u where f > ln 2."""
    weight_for = table.prior[rows] + table.weight_for[rows]
    return np.asarray((weight_for > table.weight_against[rows]) & (weight_for > LN_2))


def probability(table: FeatureTable, rows: NDArray[np.intp]) -> Array:
    """Return e + u/2 of rows, (exp(f) - 1/2) / (exp(f) + exp(a) - 1), for evidence that is capped."""
    weight_for = table.prior[rows] + table.weight_for[rows]
    inverse = np.exp(-weight_for)
    likely = 1.0 - 0.5 * inverse
    np.subtract(1.0, inverse, out=inverse)
    inverse += np.exp(table.weight_against[rows] - weight_for)
    likely /= inverse
    return np.asarray(likely)


def classify(table: FeatureTable, rows: NDArray[np.intp], stands: NDArray[np.bool_]) -> NDArray[np.str_]:
    """Return the class of rows by their largest mass (section 4.3.3).

    `stands` says of each row whether it has proven to stand still; an unmapped feature that has not is not New.
    """
    e, n, u = masses(table, rows)
    exists, not_exists = (e > n) & (e > u), (n > e) & (n > u)
    mapped = table.kind[rows] == Kind.MAP
    state = np.full(len(rows), State.UNCLASSIFIED.value, dtype="U12")
    state[mapped & exists] = State.NORMAL.value
    state[mapped & not_exists] = State.DELETED.value
    state[~mapped & exists & stands] = State.NEW.value
    return state


def shows_itself(table: FeatureTable, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether rows were detected about as often in their pass as a real feature would have been.

    Two painted signs one behind the other, or two reflections, can pass for one sign that stands still; but the place
    between them stays empty. And what was seen for no longer than errors are correlated, as a reflection is, was seen
    once.
    """
    hit, missed = table.looks_hit[rows], table.looks_missed[rows]
    return np.asarray(hit >= np.maximum(_PERSISTENCE * table.nominal[rows] * (hit + missed), _LASTING))
