"""The fold over arrays: many features side by side, each with exactly the numbers that it has alone.

`law` folds lists of contributions through here, a simulation of millions of passes its arrays: the law stands once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.doubt import HAS_LOOKED
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.errors import EvidenceError
from slamcu_core.evidence import masses_from_weights, weights_from_masses

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Histories:
    """The contributions of N features in K steps, oldest first; after its last a feature has vacuous ones."""

    weight_for: Array  # (K, N), f >= 0, discounted
    weight_against: Array  # (K, N), a >= 0, discounted
    informativeness: Array  # (K, N), w in [0, 1]
    contributor: Indices  # (K, N), codes from 0 that tell the contributors of one feature apart
    proven: Flags | None = None  # (K, N), whether the contributor had a record then; None: all had


@dataclass(frozen=True, slots=True)
class Course:
    """How N features fared over K steps, and who still speaks at the end."""

    weight_for: Array  # (K, N), F after each step
    weight_against: Array  # (K, N), A as it is told: more than decides where one alone has seen it (`fold_histories`)
    standing: Flags  # (K, N)
    contributors_for: Indices  # (N,), contributors whose weight for the feature is still in the fold
    contributors_against: Indices  # (N,)


def discounted(
    weight_for: ArrayLike, weight_against: ArrayLike, trust: ArrayLike, policy: ClassPolicy
) -> tuple[Array, Array, Array]:
    """Discount the summed weights of contributors once, and return f, a and the informativeness w.

    w = (1 - u)/α with the policy's α: a contributor trusted less than that can neither say nor erase much. Arguments of
    any shape that broadcasts; trust α in [0, 1).
    """
    alpha = np.asarray(trust, float)
    e, n, u = masses_from_weights(weight_for, weight_against)
    f, a = weights_from_masses(alpha * e, alpha * n, 1.0 - alpha + alpha * u)
    return f, a, np.minimum(alpha * (1.0 - u) / policy.trust, 1.0)


def fold_histories(histories: Histories, prior_weight: ArrayLike, policy: ClassPolicy, *, deleted: bool) -> Course:
    """Fold: F ← γ^w F + f, A ← γ^w A + a, F from the prior, A from 0, and say where the change stands.

    It stands from the step at which its mass reaches `enter` with enough different contributors until the mass is
    below `leave` with enough different contributors on the other side: as little as one car makes it stand can one car
    make it fall. Every number of a feature is the same to the last bit whatever features it is folded with.

    A new feature that one contributor alone has seen does not stand, whatever a lie could add. As long as that is so, A
    is told with misses discounted by `trust_against_one`; from the second who sees it on, and for what stands, as it
    decides.

    Parameters
    ----------
    prior_weight : f of the maps' priors, broadcast to (N,).
    deleted : whether absence is what stands; else existence.

    Raises EvidenceError if a prior is out of range.
    """
    features = histories.weight_for.shape[1]
    F = np.array(np.broadcast_to(np.asarray(prior_weight, float), (features,)))
    if not (np.isfinite(F).all() and (F >= 0.0).all()):
        raise EvidenceError(
            f"the prior's weight must be finite and at least 0, not {F[~(np.isfinite(F) & (F >= 0.0))][0]}"
        )
    kept = policy.forgetting**histories.informativeness
    course_for = _summed(kept, histories.weight_for, F)
    course_against = _summed(kept, histories.weight_against, np.zeros(features))
    standing = _standing(histories, course_for, course_against, policy, deleted=deleted)
    left = _left(kept)
    counted = (
        _count(_speaking(histories.contributor, left * histories.weight_for, policy)),
        _count(_speaking(histories.contributor, left * histories.weight_against, policy)),
    )
    if not deleted:
        by_one = _seen_by_one(histories, policy)
        # where nobody misses it before a second sees it both are the same
        apart = np.flatnonzero((by_one & (histories.weight_against > histories.weight_for)).any(axis=0))
        if apart.size:
            told = _summed(kept[:, apart], _against_one(histories, apart, policy), np.zeros(apart.size))
            alone = by_one[:, apart] & ~standing[:, apart]
            course_against[:, apart] = np.where(alone, told, course_against[:, apart])
    return Course(course_for, course_against, standing, *counted)


def turns(course: Course, histories: Histories, times: Array, counts: Indices) -> tuple[Array, Array, Array]:
    """Return since when each of N features stands, and between which contributions what A > F says came about.

    The last that denied it, and the first that said it after that; s of POSIX time, (N,) each. NaN where it does not
    stand, where nothing in the histories denied it, and for both where F >= A at the end.

    Parameters
    ----------
    times : (K, N), s of POSIX time of the contributions.
    counts : (N,), how many of the steps are contributions.
    """
    since, after, at = (np.full(len(counts), np.nan) for _ in range(3))
    if not len(times):
        return since, after, at
    step = np.arange(len(times))[:, None]

    def begin(breaks: Flags, end: Indices) -> Indices:
        """Return the step after the last before `end` at which something breaks."""
        return np.asarray(np.where(breaks & (step < end), step + 1, 0).max(axis=0, initial=0), np.intp)

    stands = np.flatnonzero(course.standing[-1])
    since[stands] = times[begin(~course.standing[:, stands], counts[stands]), stands]
    gone = np.flatnonzero(course.weight_against[-1] > course.weight_for[-1])
    run = begin(course.weight_against[:, gone] <= course.weight_for[:, gone], counts[gone])
    first = begin(histories.weight_for[:, gone] > histories.weight_against[:, gone], run)
    at[gone] = times[first, gone]
    denied = gone[first > 0]
    after[denied] = times[first[first > 0] - 1, denied]
    return since, after, at


def moments(seconds: Array) -> list[float | None]:
    """Return times (N,) in s one by one, None for NaN."""
    return [each if each == each else None for each in seconds.tolist()]  # noqa: PLR0124  (NaN)


def _summed(kept: Array, said: Array, begin: Array) -> Array:
    """Return (K, N), what a weight that begins at (N,) is after each step: X ← γ^w X + x."""
    course = np.empty(said.shape)
    for step in range(len(said)):
        begin = kept[step] * begin + said[step]
        course[step] = begin
    return course


def _against_one(histories: Histories, features: Indices, policy: ClassPolicy) -> Array:
    """Return (K, M), the weights against M features where misses are discounted by `trust_against_one`."""
    f, a = histories.weight_for[:, features], histories.weight_against[:, features]
    e, n, u = masses_from_weights(f, a)
    # what α has discounted another α' discounts instead if the masses grow by α'/α; nobody is trusted more than α'
    more = np.maximum(policy.trust_against_one / np.maximum(policy.trust, 1.0 - u), 1.0)
    unknown = np.maximum(1.0 - more * (1.0 - u), np.finfo(float).eps)
    return np.where((a > f) & (more > 1.0), weights_from_masses(more * e, more * n, unknown)[1], a)


def _seen_by_one(histories: Histories, policy: ClassPolicy) -> Flags:
    """Return (K, N), whether at most one contributor has seen a feature until then."""
    sees = histories.weight_for >= policy.contributor_weight
    if not sees.size:
        return sees
    first = np.take_along_axis(histories.contributor, sees.argmax(axis=0)[None], axis=0)
    return np.asarray(~np.logical_or.accumulate(sees & (histories.contributor != first), axis=0))


def _standing(
    histories: Histories, course_for: Array, course_against: Array, policy: ClassPolicy, *, deleted: bool
) -> Flags:
    quorum = policy.contributors_deleted if deleted else policy.contributors_new
    # a sign is missed now and then, and what is not there is hardly ever seen: only who misses can be outvoted
    outvote = np.inf if deleted else 1
    result = np.zeros(course_for.shape, bool)
    # A mass is at most 1 - exp(-weight): few of the features that are there can come to stand as deleted.
    most = (course_against if deleted else course_for).max(axis=0, initial=0.0)
    able = np.flatnonzero(most >= (1.0 - 1e-6) * -np.log1p(-policy.enter))
    exists, not_exists, _ = masses_from_weights(course_for[:, able], course_against[:, able])
    mass = not_exists if deleted else exists
    reached = mass >= policy.enter
    if not reached.any():
        return result
    stands = np.zeros(able.size, bool)
    for step in range(len(reached)):
        asking = np.flatnonzero(reached[step] & ~stands)
        if asking.size:
            stands[asking] = _quorate(
                histories, step + 1, able[asking], policy, sees=not deleted, quorum=quorum, outvote=outvote
            )
        leaving = np.flatnonzero(stands & (mass[step] < policy.leave))
        if leaving.size:
            stands[leaving] = ~_quorate(
                histories, step + 1, able[leaving], policy, sees=deleted, quorum=policy.contributors_leave, outvote=0
            )
        result[step, able] = stands
    return result


def _quorate(
    histories: Histories,
    steps: int,
    features: Indices,
    policy: ClassPolicy,
    *,
    sees: bool,
    quorum: int,
    outvote: float,
) -> Flags:
    """Say after a number of steps, for M features, whether enough contributors speak on a side.

    What two others have refuted since does not count: one may err, and one alone must not keep anything from standing.
    Where none of them has a record it takes more of them, unless one alone decides anyway or none of them is a stranger
    (`strangers_more` is 0); and yet more of them, if one has refuted them.

    Parameters
    ----------
    sees : whether the side is that of those who see it; else of those who miss it.
    outvote : strangers that it takes more where one has refuted them.
    """
    after_any, after_two = _refuted(histories, steps, features, policy, sees=sees)
    step, who = np.arange(steps)[:, None], histories.contributor[:steps, features]
    said = (histories.weight_for if sees else histories.weight_against)[:steps, features]
    said = said * _left(policy.forgetting ** histories.informativeness[:steps, features])
    said[step < after_two] = 0.0
    count = _count(_speaking(who, said, policy))
    enough = count >= quorum
    if histories.proven is None or quorum == 1 or not policy.strangers_more or not enough.any():
        return np.asarray(enough)
    known = _count(_speaking(who, np.where(histories.proven[:steps, features], said, 0.0), policy)) > 0
    least = quorum + policy.strangers_more
    many = _count(_speaking(who, np.where(step >= after_any, said, 0.0), policy)) >= least
    return np.asarray(enough & (known | many | (count >= least + outvote)))


def _refuted(
    histories: Histories, steps: int, features: Indices, policy: ClassPolicy, *, sees: bool
) -> tuple[Indices, Indices]:
    """Return from which step on nobody has refuted who sees (or misses), and nobody but one contributor; (M,) each."""
    who = histories.contributor[:steps, features]
    f, a = histories.weight_for[:steps, features], histories.weight_against[:steps, features]
    if sees:
        # whose view was blocked but for a frame has missed nothing that counts, while a glimpse is a sight
        speaks = (a > f) & (histories.informativeness[:steps, features] >= HAS_LOOKED)
    else:
        speaks = (f > a) & (f >= policy.contributor_weight)
    after = np.where(speaks, np.arange(1, steps + 1)[:, None], 0)
    any_ = after.max(axis=0)
    last = np.take_along_axis(who, np.maximum(any_ - 1, 0)[None], axis=0)
    return np.asarray(any_, np.intp), np.asarray(np.where(who == last, 0, after).max(axis=0), np.intp)


def _count(speak: Flags) -> Indices:
    return np.asarray(np.count_nonzero(speak, axis=1), np.intp)


def _left(kept: Array) -> Array:
    """Return (K, M), what the later ones leave of each contribution, of what each leaves of the older ones."""
    left = np.ones_like(kept)
    for step in range(len(kept) - 1, 0, -1):
        np.multiply(left[step], kept[step], out=left[step - 1])
    return left


def _speaking(who: Indices, left: Array, policy: ClassPolicy) -> Flags:
    """Return (M, C), which contributors of M features still speak, of what is left of each contribution, (K, M).

    A contributor is counted while at least `contributor_weight` of what it said on that side is left: misses that
    everyone has forgotten must not help one car to a quorum.
    """
    if not left.size:
        return np.zeros((left.shape[1], 0), bool)
    features, width = left.shape[1], int(who.max()) + 1
    # a contributor that speaks twice has one sum
    rows = np.arange(features) * width + who
    sums = np.bincount(rows.ravel(), left.ravel(), minlength=features * width)
    return np.asarray(sums.reshape(features, width) >= policy.contributor_weight)
