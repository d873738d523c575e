"""A frame whose detections are in doubt, or come as a surprise, through the particles.

Three things lose a particle filter that the plain frame update (`frame_update`) cannot mend. A detection may be more
than one thing: then each particle weighs all of them (`explanations`). After a long way without sightings the particles
lie too far apart for any of them to fit what comes into view: then new ones are drawn about them by what is seen. And
odometry may have failed, so that what is seen fits nothing: then some of those are drawn far off, and the map alone
says whether they are right.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import explanations, proposal
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.explanations import Explanations, Weighed
from slamcu_core.filter.frame_update import CloseLook, FrameUpdate
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.resampling import systematic
from slamcu_core.filter.table import Kind
from slamcu_core.filter.view import View
from slamcu_core.geometry import mahalanobis_square

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_UNLIKELY = -7.0  # ln of the density over that of the unknown below which a feature is no explanation
_WIDE = 5.0  # times the area of the measurement's noise: so far apart, few particles fit any one explanation
_MANY = 20  # particles drawn for each
_PART = 250  # of these particles weighed at a time
_KERNEL = 0.5  # width of the kernels that they are drawn from, in standard deviations of the cloud
_ASTRAY = 0.02  # chance that odometry failed, when what is seen is a surprise ...
_ASTRAY_SHARE = 0.5  # ... share of the particles drawn for that case ...
_ASTRAY_WIDTH = 5.0  # ... and how far off, in standard deviations of the cloud
_REACH = 200.0  # on squares of innovations, of what none of them can see: far beyond any that could weigh


class _Question(NamedTuple):
    """Which of the columns (C,) of a view the detections may be, as `possible` (D, C) says, or something unknown."""

    view: View
    seen: Seen
    columns: Index
    possible: NDArray[np.bool_]
    log_unknown: Array

    def of_what_may_be(self) -> _Question:
        """Return the question without the columns that no detection may be."""
        asked = np.logical_or.reduce(self.possible, axis=0)
        return self._replace(columns=self.columns[asked], possible=self.possible[:, asked])


class Occasion(NamedTuple):
    """Why a frame is taken with care."""

    stale: bool  # nothing that weighs the particles has been seen for long
    surprised: bool  # several detections fit nothing on the map


def weigh_with_care(
    update: FrameUpdate,
    view: View,
    seen: Seen,
    score: Array,
    usable: NDArray[np.bool_],
    *,
    occasion: Occasion,
    log_unknown: Array,
    share: float,
    rng: np.random.Generator,
) -> tuple[Array, tuple[Index, CloseLook] | None]:
    """Weigh the particles by all that the detections may be; return the share (D, C) of each explanation.

    Also the columns that any detection may be, with how the particles see them, if their poses are still as when that
    was asked.

    Parameters
    ----------
    score : (D, C) ln of the density of each feature over that of something unknown, -inf beyond the gate.
    usable : (C,) which rows are Normal or New, so that the car may localize on them.
    log_unknown : (D,) ln of the density of that.
    share : of the frame's evidence that is its own.

    Leaves the poses sampled.
    """
    particles = update.particles
    possible = score > _UNLIKELY
    if occasion.surprised:  # by the map alone: what was found from a wrong pose would speak for it
        usable = usable & (update.table.kind[view.rows[: view.close]] == Kind.MAP)
        possible |= usable & update.fits(view, seen) & _within_reach(update, view, seen)
    # what must not weigh the particles is as likely in all of them
    explainable = possible & usable
    unusable = np.count_nonzero(explainable) < np.count_nonzero(possible)
    if unusable:
        others = np.exp(np.where(possible & ~usable, score, -np.inf))
        of_others = np.add.reduce(others, axis=1, keepdims=True)
        log_unknown = log_unknown + np.log1p(of_others[:, 0])
    columns = np.logical_or.reduce(possible, axis=0).nonzero()[0]
    question = _Question(view, seen, columns, explainable.take(columns, axis=1), log_unknown)
    looked = None
    shares = np.zeros(score.shape)
    pairs = question.possible.nonzero()
    explained = pairs[0], columns[pairs[1]]
    if not len(explained[0]):
        particles.settle(rng)
    elif occasion.surprised or (occasion.stale and _wide(view, seen, score)):
        slots = update.table.slot[view.rows[columns]]
        many = particles.many(_MANY, _KERNEL, rng, slots[slots >= 0])
        question = question.of_what_may_be()
        if occasion.surprised:
            many.stray(particles, _ASTRAY, _ASTRAY_SHARE, _ASTRAY_WIDTH, rng)
        log_likelihood, each = _weigh_in_parts(replace(update, particles=many), question, share, rng)
        many.log_weight = many.log_weight + log_likelihood
        shares[explained] = each @ many.weights
        particles.become(many, systematic(many.weights, rng, len(particles)))
    else:
        weighed, temper, close = _weigh(update, question, share, rng)
        if weighed.noise is not None:
            particles.settle_conditioned(weighed.noise.mean, weighed.noise.spread, rng)
        else:
            looked = columns, close
        particles.log_weight = particles.log_weight + temper * weighed.log_likelihood
        shares[explained] = weighed.shares @ particles.weights
    if unusable:
        left = 1.0 - np.add.reduce(shares, axis=1, keepdims=True)
        shares += left * others / (1.0 + of_others)
    return shares, looked


def _wide(view: View, seen: Seen, score: Array) -> bool:
    """Return whether the particles lie too far apart for enough of them to fit each explanation."""
    xx, xy, yy = view.marginal.covariance
    area = np.sqrt((xx * yy - xy * xy) / seen.noise.prod(axis=0)[:, None])
    return bool((area[score > _UNLIKELY] > _WIDE).any())


def _within_reach(update: FrameUpdate, view: View, seen: Seen) -> NDArray[np.bool_]:
    """Return which features (C,) particles that are astray can see where detections (D,) are."""
    nu = update.model.innovation(seen.measurement[:, :, None], view.marginal.mean[:, None])
    xx, xy, yy = (1.0 + _ASTRAY_WIDTH**2) * view.marginal.covariance
    along, across = seen.noise[:, :, None]
    return np.asarray(mahalanobis_square(nu, (xx + along, xy, yy + across))[0] < _REACH)


def _weigh_in_parts(
    update: FrameUpdate, question: _Question, share: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Weigh the many particles of an update, whose poses are sampled; return ln of their likelihoods, and shares.

    A part of them at a time, for particles know nothing of each other here, and arrays that outgrow the processor's
    cache take three times as long.
    """
    count, weighed = len(update.particles), []
    for start in range(0, count, _PART):
        some = replace(update, particles=update.particles.part(start, start + _PART))
        part, temper, _ = _weigh(some, question, share, rng)
        weighed.append((temper * part.log_likelihood, part.shares))
    return np.concatenate([log for log, _ in weighed]), np.concatenate([shares for _, shares in weighed], axis=1)


def _weigh(
    update: FrameUpdate, question: _Question, share: float, rng: np.random.Generator
) -> tuple[Weighed, float, CloseLook]:
    """Weigh the particles of an update, and return how much of the likelihood is to count, and how they see things."""
    particles: Particles = update.particles
    view, seen, columns = question.view, question.seen, question.columns
    noise = view.noise.take(columns, axis=1)
    detections, features = question.possible.nonzero()
    if particles.pending is not None:
        asked = columns[question.possible.any(axis=0)]
        of_mean = view.by_place.take(asked, axis=1) + view.noise.take(asked, axis=1)
        if not proposal.pays(view.by_motion.take(asked, axis=1), of_mean):
            particles.settle(rng)
    close = update.examine(view, columns)
    q, by_noise = update.innovation_covariance(close, noise).take(features, axis=1), None
    if particles.pending is not None:
        by_pose = update.model.by_pose(close.sight, close.by_feature)
        by_noise = proposal.noise_jacobian(by_pose, particles.pending).take(features, axis=2)
        q, share = q / share, 1.0
    innovation = update.model.innovation(
        seen.measurement.take(detections, axis=1)[:, :, None], update.calibrated(close.sight).take(features, axis=1)
    )
    weighed = explanations.weigh(Explanations(innovation, q, by_noise, question.possible, question.log_unknown), rng)
    return weighed, share, close
