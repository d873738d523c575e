"""The place of a feature from the passes of many cars: robust over contributors, and honest about common bias.

Each pass gives x, Σ. What a vehicle's passes share (mounting, range scale) does not average out over them, so Σ is read
as Σ = B + W: B = floor² I common to the contributor's passes, W independent from pass to pass. A contributor's estimate
then has the covariance B + (Σ W⁻¹)⁻¹, which for a single pass is its own Σ and never falls below B. What all cars have
wrong together, because the map around the place leads all of them astray, no number of them averages out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.errors import EvidenceError

Array = NDArray[np.float64]

_INDEPENDENT_SHARE = 0.1  # least part of a pass's variance that is its own: keeps W positive where Σ is below the floor
_LARGEST_CONDITION = 1e8  # ratio of axes beyond which a covariance is rounder than it says


@dataclass(frozen=True, slots=True)
class FusedPosition:
    """A fused place in the local frame of its observations."""

    xy: Array  # (2,), m
    covariance: Array  # (2, 2), m²
    inlier: NDArray[np.bool_]  # (N,), in the order of the observations
    contributors: int  # different contributors among the inliers


def fuse_positions(xy: ArrayLike, covariance: ArrayLike, contributor: ArrayLike, policy: ClassPolicy) -> FusedPosition:
    """Fuse the places that N passes gave for one feature (design, section 2, "Position").

    The contributor whom most others second is the first centre; then each pass is gated against what the *other*
    contributors say together, until nothing changes. The inliers are weighted by information within a
    contributor, and again over contributors. Where no two agree, nobody can tell who is wrong: those that come nearest
    to each other are kept, and the covariance grows by as much as they disagree.

    Parameters
    ----------
    xy : (N, 2) m, N >= 1, in a local frame.
    covariance : (N, 2, 2) m², symmetric and positive definite.
    contributor : (N,) ids.

    Raises EvidenceError on wrong shapes, numbers that are not finite, or a covariance that is not positive definite.
    """
    places, covariances, who = _checked(xy, covariance, contributor)
    # a canonical order makes the result the same to the last bit whatever order the passes come in
    order = np.lexsort((*covariances.reshape(-1, 4).T, *places.T, who))
    places, own, who = places[order], own_covariance(covariances[order], policy), who[order]
    _, who = np.unique(who, return_inverse=True)
    common = policy.position_floor_m**2 * np.eye(2)

    inlier, agreed = np.ones(len(who), bool), False
    if who.max() >= 2:
        inlier, agreed = _consistent(places, own, who, common, policy.gate)
    means, spreads, present = per_contributor(places[inlier], own[inlier], who[inlier], common)
    centre, fused = information_mean(means, spreads)
    if not agreed and present.size >= 2:
        ratio = float(_mahalanobis(means - centre, spreads).sum()) / (2 * present.size - 2)
        fused = fused * (ratio if 2.0 * ratio > policy.gate else 1.0)
    # each Σ has what all have wrong together in it, and the mean has divided it by their number: put it back
    fused = fused + (1.0 - 1.0 / present.size) * policy.position_common_m**2 * np.eye(2)
    unsorted = np.empty_like(inlier)
    unsorted[order] = inlier
    return FusedPosition(centre, fused, unsorted, int(present.size))


def own_covariance(covariance: Array, policy: ClassPolicy) -> Array:
    """Return W, (N, 2, 2): what of each Σ is independent from pass to pass once the common B is taken out."""
    values, axes = np.linalg.eigh(covariance)
    values = np.maximum(values, values[:, 1:] / _LARGEST_CONDITION)
    values = np.maximum(values - policy.position_floor_m**2, _INDEPENDENT_SHARE * values)
    return np.asarray((axes * values[:, None, :]) @ axes.swapaxes(1, 2))


def _consistent(
    places: Array, own: Array, who: NDArray[np.intp], common: Array, gate: float
) -> tuple[NDArray[np.bool_], bool]:
    """Return (N,), which passes agree with what the other contributors say together, and whether any two do."""
    total = own + common
    means, spreads, _ = per_contributor(places, own, who, common)
    # the voice that most others second starts it; every contributor has one, and none can shout
    distance = _mahalanobis(means[:, None] - means, spreads[:, None] + spreads)
    nearest_two = float(distance[~np.eye(len(means), dtype=bool)].min())
    agreed = nearest_two <= gate
    gate = gate if agreed else nearest_two * (1.0 + 1e-9)
    seed = int(np.minimum(distance, gate).sum(axis=1).argmin())
    inlier = _mahalanobis(places - means[seed], total + spreads[seed]) <= gate
    if np.unique(who[inlier]).size < 2:
        return np.ones_like(inlier), False
    seen: set[bytes] = set()
    while inlier.tobytes() not in seen:
        seen.add(inlier.tobytes())
        means, spreads, present = per_contributor(places[inlier], own[inlier], who[inlier], common)
        information = np.linalg.inv(spreads)
        vector = np.einsum("cij,cj->ci", information, means)
        # leave each pass's own contributor out: nobody is measured against himself
        mine = who[:, None] == present
        rest = information.sum(axis=0) - np.einsum("nc,cij->nij", mine, information)
        others = np.linalg.inv(rest)
        centres = np.einsum("nij,nj->ni", others, vector.sum(axis=0) - mine @ vector)
        near = _mahalanobis(places - centres, total + others) <= gate
        if np.unique(who[near]).size < 2:
            return inlier, False
        inlier = near
    return inlier, agreed


def per_contributor(
    places: Array, own: Array, who: NDArray[np.intp], common: Array
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return each contributor's mean (C, 2), its covariance (C, 2, 2) with the common bias, and who they are (C,)."""
    present, index = np.unique(who, return_inverse=True)
    weights = np.linalg.inv(own)
    information = np.zeros((present.size, 2, 2))
    vector = np.zeros((present.size, 2))
    np.add.at(information, index, weights)
    np.add.at(vector, index, np.einsum("nij,nj->ni", weights, places))
    inverse = np.asarray(np.linalg.inv(information), float)
    return np.einsum("cij,cj->ci", inverse, vector), _symmetric(inverse) + common, present


def information_mean(means: Array, spreads: Array) -> tuple[Array, Array]:
    """Return the information-weighted mean (2,) of means (C, 2) with covariances (C, 2, 2), and its covariance."""
    information = np.linalg.inv(spreads)
    covariance = _symmetric(np.linalg.inv(information.sum(axis=0)))
    return covariance @ np.einsum("cij,cj->i", information, means), covariance


def _mahalanobis(difference: Array, covariance: Array) -> Array:
    return np.asarray(np.einsum("...i,...ij,...j->...", difference, np.linalg.inv(covariance), difference))


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.swapaxes(-1, -2)))


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
