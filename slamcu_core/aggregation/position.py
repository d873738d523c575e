"""The place of a feature from the passes of many cars: robust over contributors, and honest about common bias.

Each pass gives x, Σ. What a vehicle's passes share (mounting, range scale) does not average out over them, so Σ is read
as Σ = B + W: B = floor² I common to the contributor's passes, W independent from pass to pass. A contributor's estimate
then has the covariance B + (Σ W⁻¹)⁻¹, which for a single pass is its own Σ and never falls below B. How far the
contributors lie apart tells whether these covariances are true (Birge 1932): the more of them, the more does it count.
What all cars have wrong together, because the map around the place leads all of them astray, no number of them averages
out, and no scatter shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.aggregation.voices import Layout, Said, first_of, inverses, mahalanobis
from slamcu_core.errors import EvidenceError

Array = NDArray[np.float64]

_INDEPENDENT_SHARE = 0.1  # least part of a pass's variance that is its own: keeps W positive where Σ is below the floor
_AS_TOLD = 6.0  # degrees of freedom that the given covariances weigh against how places scatter: three contributors'
_MANY = 3  # contributors from whom on one can be told to be wrong
_LARGEST_CONDITION = 1e8  # ratio of axes beyond which a covariance is rounder than it says


@dataclass(frozen=True, slots=True)
class FusedPosition:
    """A fused place in the local frame of its observations."""

    xy: Array  # (2,), m
    covariance: Array  # (2, 2), m²
    inlier: NDArray[np.bool_]  # (N,), in the order of the observations
    contributors: int  # different contributors among the inliers


@dataclass(frozen=True, slots=True)
class FusedPositions:
    """The fused places of T things, each in the frame of its observations."""

    xy: Array  # (T, 2), m
    covariance: Array  # (T, 2, 2), m²
    inlier: NDArray[np.bool_]  # (N,), in the order of the observations
    contributors: NDArray[np.intp]  # (T,)


def fuse_positions(xy: ArrayLike, covariance: ArrayLike, contributor: ArrayLike, policy: ClassPolicy) -> FusedPosition:
    """Fuse the places that N passes gave for one feature (design, section 2, "Position").

    The contributor whom most others second is the first centre; then each pass is gated against what the *other*
    contributors say together, until nothing changes. The inliers are weighted by information within a
    contributor, and again over contributors; the covariance is scaled by how they scatter, with the given ones as a
    prior. Where no two agree, nobody can tell who is wrong: those that come nearest to each other are kept, and the
    covariance grows by as much as they disagree.

    Parameters
    ----------
    xy : (N, 2) m, N >= 1, in a local frame.
    covariance : (N, 2, 2) m², symmetric and positive definite.
    contributor : (N,) ids.

    Raises EvidenceError on wrong shapes, numbers that are not finite, or a covariance that is not positive definite.
    """
    one = fuse_positions_each(xy, covariance, contributor, np.zeros(np.shape(contributor), np.intp), policy)
    return FusedPosition(one.xy[0], one.covariance[0], one.inlier, int(one.contributors[0]))


def fuse_positions_each(
    xy: ArrayLike, covariance: ArrayLike, contributor: ArrayLike, thing: ArrayLike, policy: ClassPolicy
) -> FusedPositions:
    """Fuse the places of T things at once: for each what `fuse_positions` says of it alone.

    Parameters
    ----------
    thing : (N,), which thing each pass is of, from 0 to T - 1; each has one.
    """
    places, covariances, who = _checked(xy, covariance, contributor)
    of_thing = np.asarray(thing, np.intp)
    # a canonical order makes the result the same to the last bit whatever order the passes come in
    order = np.lexsort((*covariances.reshape(-1, 4).T, *places.T, who, of_thing))
    of_thing, who = of_thing[order], who[order]
    speaks = (np.diff(of_thing, prepend=-1) != 0) | (np.diff(who, prepend=who[0]) != 0)
    common = policy.position_floor_m**2 * np.eye(2)
    own = own_covariance(covariances[order], policy)
    layout = Layout(places[order], own, common, np.cumsum(speaks) - 1, of_thing[speaks])

    inlier, agreed = np.ones(len(who), bool), np.zeros(int(of_thing[-1]) + 1, bool)
    disputed = np.bincount(layout.thing) >= _MANY
    if disputed.any():
        many, passes = layout.some(disputed)
        inlier[passes], agreed[disputed] = _consistent(many, policy.gate)
    said = layout.said(inlier)
    count = _speaking(layout, inlier)
    centre, fused = _information_mean(layout, said)
    apart = np.where(said.present, mahalanobis(said.means - centre[layout.thing], said.spreads), 0.0)
    scatter, freedom = np.add.reduceat(apart, first_of(layout.thing)), 2 * count - 2
    ratio = scatter / np.maximum(freedom, 1)
    grows = ~agreed & (count >= 2) & (2.0 * ratio > policy.gate)
    scale = np.where(grows, ratio, (_AS_TOLD + scatter) / (_AS_TOLD + freedom))
    fused = fused * scale[:, None, None]
    # each Σ has what all have wrong together in it, and the mean has divided it by their number: put it back
    fused = fused + (1.0 - 1.0 / count)[:, None, None] * policy.position_common_m**2 * np.eye(2)
    unsorted = np.empty_like(inlier)
    unsorted[order] = inlier
    return FusedPositions(centre, fused, unsorted, count)


def own_covariance(covariance: Array, policy: ClassPolicy) -> Array:
    """Return W, (N, 2, 2): what of each Σ is independent from pass to pass once the common B is taken out."""
    values, axes = np.linalg.eigh(covariance)
    values = np.maximum(values, values[:, 1:] / _LARGEST_CONDITION)
    values = np.maximum(values - policy.position_floor_m**2, _INDEPENDENT_SHARE * values)
    return np.asarray((axes * values[:, None, :]) @ axes.swapaxes(1, 2))


def _consistent(layout: Layout, gate: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which passes agree with what the other contributors say together, (N,), and of which things any two do.

    The things (T,) have three contributors or more.
    """
    total, begins = layout.own + layout.common, first_of(layout.thing)
    said = layout.said(np.ones(len(layout.voice), bool))
    # the voice that most others second starts it; every contributor has one, and none can shout
    one, other = layout.pairs()
    distance = mahalanobis(said.means[one] - said.means[other], said.spreads[one] + said.spreads[other])
    of_pair = first_of(layout.thing[one])
    nearest_two = np.minimum.reduceat(np.where(one == other, np.inf, distance), of_pair)
    agreed = nearest_two <= gate
    gates = np.where(agreed, gate, nearest_two * (1.0 + 1e-9))
    # of two who have but each other the first is meant, and not whom the rounding favours
    dissent = np.add.reduceat(np.minimum(distance / gates[layout.thing[one]], 1.0), first_of(one)).round(11)
    seed = np.lexsort((dissent, layout.thing))[begins][layout.thing_of_pass]
    shift = layout.places - said.means[seed]
    inlier = mahalanobis(shift, total + said.spreads[seed]) <= gates[layout.thing_of_pass]

    alone = _speaking(layout, inlier) < 2
    agreed &= ~alone
    inlier |= alone[layout.thing_of_pass]
    _settle(layout, inlier, agreed, gates, at_work=~alone)
    return inlier, agreed


def _settle(
    layout: Layout,
    inlier: NDArray[np.bool_],
    agreed: NDArray[np.bool_],
    gates: Array,
    *,
    at_work: NDArray[np.bool_],
) -> None:
    """Gate each pass of some things against what the others say, until nothing changes, and write who agrees."""
    seen: dict[int, set[bytes]] = {number: set() for number in np.flatnonzero(at_work).tolist()}
    while at_work.any():
        part, passes = layout.some(at_work)
        now, numbers = inlier[passes], np.flatnonzero(at_work)
        near = _near(part, now, gates[at_work])
        too_few = _speaking(part, near) < 2
        agreed[numbers[too_few]] = False
        kept = np.where(too_few[part.thing_of_pass], now, near)
        inlier[passes] = kept
        done = too_few
        ends = [*first_of(part.thing_of_pass).tolist(), len(kept)]
        for index, number in enumerate(numbers.tolist()):
            begin, end = ends[index], ends[index + 1]
            seen[number].add(now[begin:end].tobytes())
            done[index] |= kept[begin:end].tobytes() in seen[number]
        at_work = at_work.copy()
        at_work[numbers[done]] = False


def _near(layout: Layout, inlier: NDArray[np.bool_], gates: Array) -> NDArray[np.bool_]:
    """Return (N,), which passes are near what the contributors other than their own say with those that agree."""
    said, begins = layout.said(inlier), first_of(layout.thing)
    information = inverses(said.spreads) * said.present[:, None, None]
    vector = np.einsum("vij,vj->vi", information, said.means)
    # leave each pass's own contributor out: nobody is measured against himself
    rest = np.add.reduceat(information, begins)[layout.thing] - information
    others = inverses(rest)
    centres = np.einsum("vij,vj->vi", others, np.add.reduceat(vector, begins)[layout.thing] - vector)
    spreads = layout.own + layout.common + others[layout.voice]
    return np.asarray(mahalanobis(layout.places - centres[layout.voice], spreads) <= gates[layout.thing_of_pass])


def _speaking(layout: Layout, inlier: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return (T,), how many contributors have a pass that agrees."""
    heard = np.logical_or.reduceat(inlier, first_of(layout.voice))
    return np.add.reduceat(heard.astype(np.intp), first_of(layout.thing))


def _information_mean(layout: Layout, said: Said) -> tuple[Array, Array]:
    """Return the information-weighted means (T, 2) of what is said of things, and their covariances (T, 2, 2)."""
    information, begins = inverses(said.spreads) * said.present[:, None, None], first_of(layout.thing)
    covariance = inverses(np.add.reduceat(information, begins))
    vector = np.add.reduceat(np.einsum("vij,vj->vi", information, said.means), begins)
    return np.einsum("tij,tj->ti", covariance, vector), covariance


def _checked(xy: ArrayLike, covariance: ArrayLike, contributor: ArrayLike) -> tuple[Array, Array, NDArray[np.int64]]:
    places, covariances = np.asarray(xy, float), np.asarray(covariance, float)
    who = np.asarray(contributor, np.int64)
    if who.ndim != 1 or not who.size or places.shape != (who.size, 2) or covariances.shape != (who.size, 2, 2):
        raise EvidenceError(
            "positions need the shapes (N, 2), (N, 2, 2) and (N,) with N >= 1, "
            f"not {places.shape}, {covariances.shape} and {who.shape}"
        )
    check_positions(places, covariances)
    return places, covariances, who


def check_positions(places: Array, covariances: Array) -> None:
    """Raise EvidenceError unless places are finite and covariances symmetric and positive definite."""
    if not (np.isfinite(places).all() and np.isfinite(covariances).all()):
        raise EvidenceError("positions and their covariances must be finite")
    xx, xy, yx, yy = covariances.reshape(-1, 4).T
    if not (np.all(xx > 0.0) and np.all(xx * yy - xy * yx > 0.0) and np.allclose(xy, yx, rtol=1e-6, atol=1e-12)):
        raise EvidenceError("the covariance of a position must be symmetric and positive definite")
