"""The variants of an ablation: the filter as it is, and with one part at a time changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from slamcu_core.filter import FilterParameters
from slamcu_eval.ablation import parts
from slamcu_eval.ablation.parts import CORE, Swap
from slamcu_eval.ablation.per_particle import PerParticle

Change = Callable[[FilterParameters], FilterParameters]

FULL = "full"


@dataclass(frozen=True, slots=True)
class Variant:
    """The filter with one part changed: by its parameters, or by a part that takes the place of its own."""

    name: str
    label: str
    change: Change = lambda parameters: parameters
    swaps: tuple[Swap, ...] = ()
    on_robots: bool = True  # False: a matter of roads, with GNSS, trucks and a camera's range bias


def _set(**fields: Any) -> Change:
    return lambda parameters: replace(parameters, **fields)


def _motion(**fields: Any) -> Change:
    return lambda parameters: replace(parameters, motion=replace(parameters.motion, **fields))


_ALL = (
    Variant(FULL, "the filter as it is"),
    # section 4.3: what exists
    Variant(
        "full_misses",
        "a miss counts the full λ (eq. 2 as printed), not λ · P(visible) · P_D",
        swaps=(
            (f"{CORE}.existence", "detectability", parts.certain_detection),
            (f"{CORE}.view", "visibility_probability", parts.whole_visibility),
        ),
    ),
    Variant(
        "fixed_detectability",
        "P_D is the data sheet's, however a pass goes",
        _set(detection_concentration=1e9),
    ),
    Variant(
        "no_occlusion",
        "trucks hide nothing",
        swaps=((f"{CORE}.view", "occlusion_probability", parts.nothing_hides),),
        on_robots=False,
    ),
    Variant(
        "moving_signs",
        "a find need not prove that it stands still",
        swaps=((f"{CORE}.standing", "stands_still", parts.all_stand),),
        on_robots=False,
    ),
    Variant(
        "no_riders",
        "what rides along with traffic is not looked for",
        swaps=((f"{CORE}.riders:Riders", "flag", parts.nothing_rides),),
        on_robots=False,
    ),
    # sections 4.3.1 and 4.3.4: what goes with what
    Variant(
        "greedy_association",
        "each detection takes its likeliest feature (4.3.1 as printed), not one to one",
        swaps=((f"{CORE}.association", "assign", parts.each_by_itself),),
    ),
    Variant(
        "per_particle_association",
        "each particle associates for itself",
        swaps=((f"{CORE}.frame_handling", "FrameUpdate", PerParticle),),
    ),
    Variant(
        "deleted_weigh",
        "Deleted features weigh the particles too",
        swaps=((f"{CORE}.frame_handling", "FrameUpdate", parts.WeighsDeleted),),
    ),
    # section 5: the particles
    Variant("particles_50", "50 particles", _set(particles=50)),
    Variant("particles_500", "500 particles", _set(particles=500)),
    Variant("no_tempering", "frames count as independent (6.2 as printed)", _set(correlation_time_s=0.0)),
    Variant(
        "assumed_correlation",
        "how much of the noise of near frames is common is assumed, not learned",
        swaps=((f"{CORE}.whiteness:Whiteness", "learn", parts.nothing_learned),),
        on_robots=False,
    ),
    Variant(
        "motion_prior",
        "poses are sampled from the motion prior (eq. 12), never with the measurement",
        swaps=((f"{CORE}.proposal", "pays", parts.never_pays),),
    ),
    Variant("no_jitter", "copies of a particle are not spread", _set(jitter=0.0)),
    Variant(
        "no_recovery",
        "a lost filter does not look for the way back",
        swaps=((f"{CORE}.recovery", "search", parts.no_way_back),),
    ),
    Variant("no_outliers", "weights take no association for wrong", _set(outlier_share=0.0), on_robots=False),
    # what differs between vehicles
    Variant(
        "no_odometry_constants",
        "odometry scale and gyro bias are not estimated",
        _motion(speed_scale_std=0.0, yaw_scale_std=0.0, yaw_bias_std=0.0),
    ),
    Variant(
        "no_calibration",
        "range scale and bearing bias are not estimated",
        _set(range_scale_std=0.0, bearing_bias_std=0.0),
        on_robots=False,
    ),
    Variant(
        "no_pass_bias",
        "nothing is constant within a pass",
        _set(pass_range_std=0.0, pass_bearing_std=0.0),
        on_robots=False,
    ),
    Variant("gnss_white", "GNSS errors are white noise, not a slow bias", _set(gnss_white_share=1.0), on_robots=False),
    Variant(
        "no_gnss",
        "no GNSS after the start",
        swaps=(
            (f"{CORE}.calibration:GnssBias", "update", parts.no_fix),
            (f"{CORE}.fixes:FixWatch", "note", parts.no_contradiction),
        ),
        on_robots=False,
    ),
)

VARIANTS: dict[str, Variant] = {variant.name: variant for variant in _ALL}
