"""What a detection may be, where that is in doubt: every particle weighs all explanations and draws one of them.

Association is one for all particles (section 4.3.1) where it is clear. Where two features explain a detection about as
well, or a feature and something that nobody knows of, to commit to one drags every particle after it; if it was wrong,
the right pose has no particle left when the next things come into view. So there each particle weighs them all,
conditions its pose on one that it draws by their weights (Monte Carlo data association, Montemerlo 2003), and the
shares of the explanations over the particles say how much of the detection is evidence for which feature.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.assignment import assign
from slamcu_core.filter.proposal import PendingNoise
from slamcu_core.filter.weighting import gaussian_log_likelihood

Array = NDArray[np.float64]

_CLEAR = 0.98  # share of an explanation that leaves no doubt
_NEGLIGIBLE = 0.005  # share of one that need not be considered
_LEAST = 1e-9  # share of something unknown
_ROUNDS = 10  # of messages between detections and features; two do in most frames


class Explanations(NamedTuple):
    """What D detections may be: of C features those that are possible, as M particles see them, or something unknown.

    `possible` (D, C) says what is to be considered; in the order of its rows that makes P pairs of a detection and a
    feature. `innovation` (2, P, M) is z - ẑ at the predicted poses, `covariance` (3, P, M) that of it without the
    pending noise, `by_noise` (2, K, P, M) its Jacobian with respect to that noise, None if it is not to be
    conditioned; `log_unknown` (D,) is ln of the density of anything else.
    """

    innovation: Array
    covariance: Array
    by_noise: Array | None
    possible: NDArray[np.bool_]
    log_unknown: Array


class Weighed(NamedTuple):
    """What explanations make of M particles.

    `log_likelihood` (M,), the `shares` (P, M) of the explanations in each particle, and what those that each particle
    drew tell of the pending `noise`; None if that was not asked for.
    """

    log_likelihood: Array
    shares: Array
    noise: PendingNoise | None


def shared_out(score: Array) -> Array:
    """Return the posterior (D, F) of features by ln of their density over that of the unknown, (D, F).

    What a row lacks to 1 is the share of something unknown.
    """
    top = np.maximum.reduce(score, axis=1, initial=0.0, keepdims=True)
    each = np.exp(score - top)
    each /= np.add.reduce(each, axis=1, keepdims=True) + np.exp(-top)
    return each


def in_doubt(score: Array) -> bool:
    """Return whether any detection has a feature for an explanation, but none beyond doubt; `score` as above."""
    best = np.maximum.reduce(shared_out(score), axis=1, initial=0.0)
    return bool(np.count_nonzero((best > _NEGLIGIBLE) & (best < _CLEAR)))


def exclusive(shares: Array) -> Array:
    """Return shares (D, C) of features in detections, given that nothing is detected twice in a frame.

    Two detections side by side tell together which of two things each of them is, where neither tells by itself. The
    sum over all joint associations is taken by belief propagation, as good as exact (Williams and Lau 2014).
    """
    if np.maximum.reduce(np.add.reduce(shares > _NEGLIGIBLE, axis=0, dtype=np.intp), initial=0) < 2:
        return shares
    odds = shares / np.maximum(1.0 - shares.sum(axis=1, keepdims=True), _LEAST)
    free = np.ones(shares.shape)  # odds that no other detection is of the feature, to any that is
    for _ in range(_ROUNDS):
        open_to = odds * free
        claims = odds / (1.0 + open_to.sum(axis=1, keepdims=True) - open_to)
        free = 1.0 / (1.0 + claims.sum(axis=0) - claims)
    odds = odds * free
    return np.asarray(odds / (1.0 + odds.sum(axis=1, keepdims=True)))


def settle_on(shares: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the feature that each of D detections is taken for, one to one, or -1, and how probable that is, (D,)."""
    unknown = np.maximum(1.0 - np.add.reduce(shares, axis=1), _LEAST)
    columns = assign(np.log(np.maximum(shares / unknown[:, None], 1e-300)))
    certain = np.where(columns >= 0, shares[np.arange(len(columns)), columns], unknown)
    return columns, np.where(certain < _CLEAR, certain, 1.0)


def weigh(explanations: Explanations, rng: np.random.Generator) -> Weighed:
    """Weigh every particle by all explanations of the detections.

    An explanation counts neither by how sure its feature is nor by how many particles have it in view: both are the
    same in the next frame, and would count again in each.
    """
    pairs = explanations.possible.nonzero()[0].tolist()  # the detection of each
    asked = sorted(set(pairs))
    starts = [bisect_left(pairs, detection) for detection in asked]
    log_unknown = explanations.log_unknown[asked, None]
    if explanations.by_noise is not None:
        detections = zip(starts, [*starts[1:], len(pairs)], log_unknown, strict=True)
        return _one_after_the_other(explanations, explanations.by_noise, detections, rng)
    log = gaussian_log_likelihood(explanations.innovation, explanations.covariance)
    top = np.maximum.reduceat(log, starts, axis=0)
    np.maximum(top, log_unknown, out=top)
    of = [asked.index(detection) for detection in pairs]
    log -= top.take(of, axis=0)
    each = np.exp(log, out=log)
    total = np.add.reduceat(each, starts, axis=0)
    total += np.exp(log_unknown - top)
    each /= total.take(of, axis=0)
    top += np.log(total)
    return Weighed(np.add.reduce(top, axis=0), each, None)


def _one_after_the_other(
    explanations: Explanations, h: Array, detections: Iterable[tuple[int, int, Array]], rng: np.random.Generator
) -> Weighed:
    """Weigh by detections, each the first of its pairs, their end, and ln of the density of anything else (1,).

    The pending noise is conditioned on each before the next is asked.
    """
    noises, pairs, count = h.shape[1:]
    noise = PendingNoise.untold(noises, count)
    log_likelihood, shares = np.zeros(count), np.empty((pairs, count))
    for start, end, log_unknown in detections:
        nu, foreseen, across = noise.foresee(
            h[:, :, start:end], explanations.innovation[:, start:end], explanations.covariance[:, start:end]
        )
        q = np.array(foreseen)
        log = np.empty((end - start + 1, count))
        log[:-1] = gaussian_log_likelihood(nu, q)
        log[-1] = log_unknown
        top = log.max(axis=0)
        each = np.exp(log - top)
        total = each.sum(axis=0)
        each /= total
        log_likelihood += top + np.log(total)
        shares[start:end] = each[:-1]
        drawn = (each.cumsum(axis=0) < rng.random(count)).sum(axis=0)
        known, every = drawn < end - start, np.arange(count)
        drawn = np.minimum(drawn, end - start - 1)
        noise.learn(nu[:, drawn, every], q[:, drawn, every], across[:, :, drawn, every], known)
    return Weighed(log_likelihood, shares, noise)
