"""The roads of the experiment: the paper's motorway, shorter and more changed, with cars that see a lot of nothing.

What differs from the paper's road (docs/simulator.md) is here and nowhere else.
"""

from __future__ import annotations

import numpy as np

from slamcu_eval.highway import HighwayParameters

LENGTH_M = 10_000.0
# signs on a road: the map lacks as many as the paper's road for what it has, and is right about three in four of these,
# for a car that finds less than that as mapped has too little to find its way by
SIGNS = {"normal": 100, "new": 40, "deleted": 12, "moved": 12, "modified": 12}
MOVED_M = (3.0, 15.0)  # how far along the road a moved sign went
GHOSTS_PER_S = 0.35  # false alarms that last: a reflection or a poster held for a sign, by one car on one day
GHOST_FRAMES = 25  # at most, 1.7 s
GHOST_FIXED_SHARE = 0.6  # of them stand still in the world, as a sign does
COMMON_RANGE_BIAS = 0.02  # with --common-bias on


def road_parameters(*, common_bias: bool, length_m: float = LENGTH_M) -> HighwayParameters:
    """Return the parameters of a road and of the cars on it; a shorter road has its signs as dense."""
    share = length_m / LENGTH_M
    return HighwayParameters().having(
        length_m=length_m,
        **{kind: max(1, round(share * count)) for kind, count in SIGNS.items()},
        moved_min_m=MOVED_M[0],
        moved_max_m=MOVED_M[1],
        ghosts_per_s=GHOSTS_PER_S,
        ghost_frames_max=GHOST_FRAMES,
        ghost_fixed_share=GHOST_FIXED_SHARE,
        common_range_bias=COMMON_RANGE_BIAS if common_bias else 0.0,
        road_name="fleet",
    )


def road_seed(seed: int, road: int) -> int:
    """Return the seed of a road of the experiment."""
    return int(np.random.SeedSequence([seed, 4, road]).generate_state(1)[0])
