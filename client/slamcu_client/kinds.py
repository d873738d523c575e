"""What one car's two halves of a change are together: a sign that says something else now, or that has moved.

The filter tells that a mapped sign is gone and that another one stands there; the cloud pairs the two, and so does the
car for its own result, by the same rule (`slamcu_core.aggregation.pairing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation import Half, Policy, pair
from slamcu_core.filter import FeatureEstimate
from slamcu_core.formats import ChangeState
from slamcu_core.geometry import LocalFrame

_NEAR_DEG = 0.005  # nothing moves so far: hundreds of metres wherever there are roads


def with_kinds(estimates: Sequence[FeatureEstimate], policy: Policy | None = None) -> list[FeatureEstimate]:
    """Join each deleted feature with the new one that took its place, or is the same elsewhere, into one estimate.

    The joined estimate is about the feature of the map, says `modified` or `moved`, and has place, masses and sign of
    what stands there now. So it is with a watch feature that the car has seen: it is no estimate of its own then, for
    what is one change must not become two because the cloud has heard of it. What has no sign type looks like any other
    of its class, and is not joined.
    """
    gone = [i for i, one in enumerate(estimates) if _mapped(one) and one.state == ChangeState.DELETED and one.sign]
    found = [i for i, one in enumerate(estimates) if not _mapped(one) and one.state == ChangeState.NEW and one.sign]
    if not gone or not found:
        return list(estimates)
    rules = policy or Policy()
    places = np.array([(one.lon, one.lat) for one in estimates])
    near = [i for i in found if (np.abs(places[gone] - places[i]) < _NEAR_DEG).all(axis=1).any()]

    def difference(feature: Half, candidate: Half) -> NDArray[np.float64] | None:
        (lon, lat), there = places[feature.order[0]], places[candidate.order[0]]
        if np.abs(there - (lon, lat)).max() > _NEAR_DEG:
            return None
        return LocalFrame(lon, lat).to_local(*there)

    pairs = pair([_half(estimates, i) for i in gone], [_half(estimates, i) for i in near], difference, rules)
    joined = {_index(one.feature): (_index(one.candidate), one.modified) for one in pairs}
    taken = {candidate for candidate, _ in joined.values()}
    result = []
    for index, one in enumerate(estimates):
        if index in joined:
            candidate, modified = joined[index]
            there = estimates[candidate]
            state = (ChangeState.MODIFIED if modified else ChangeState.MOVED).value
            result.append(replace(there, feature=one.feature, state=state, passes=max(one.passes, there.passes)))
        elif index not in taken:
            result.append(one)
    return result


def _mapped(one: FeatureEstimate) -> bool:
    return one.feature is not None and not one.feature.watched


def _half(estimates: Sequence[FeatureEstimate], index: int) -> Half:
    one = estimates[index]
    xx, xy, yy = one.covariance_m2
    covariance = np.array([[xx, xy], [xy, yy]])
    # both were looked at on this one drive: nothing is known of which came first
    return Half(index, (index,), one.feature_class, one.sign, one.value, covariance, (None, None))


def _index(key: object) -> int:
    assert isinstance(key, int)  # noqa: S101 - `_half` gave it
    return key
