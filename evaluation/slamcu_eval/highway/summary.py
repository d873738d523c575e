"""What the simulated sensor turned out to be, measured from drives rather than read from the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import DetectionFrame
from slamcu_eval.highway.camera import FALSE_ALARM, GHOST, PAINTED_SIGN
from slamcu_eval.highway.drive import Drive
from slamcu_eval.highway.world import World
from slamcu_eval.oracle import oracle_errors, single_sighting_errors
from slamcu_eval.statistics import summarize

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DriveSummary:
    """What one drive contributes to the figures."""

    seconds: float
    frames: int
    passes: int
    hidden_passes: int  # wholly behind trucks
    looks: int  # frames in which a sign was in view and not hidden, over all signs
    hits: int  # of those, frames in which it was detected
    misses_after_miss: tuple[int, int]  # how often a miss followed a miss, and how often it could have
    false_alarms: int
    ghosts: int
    painted: int
    range_scale: float
    single_m: Array
    oracle_m: Array


def summarize_drive(world: World, drive: Drive) -> DriveSummary:
    """Measure one drive."""
    looks, source = drive.looks, drive.sightings.source
    open_ = ~looks.hidden
    signs = np.unique(looks.sign)
    follows = (np.diff(looks.sign) == 0) & (np.diff(looks.frame) == 1) & open_[1:] & open_[:-1]
    after_miss = follows & ~looks.detected[:-1]
    return DriveSummary(
        seconds=float(drive.reference.t[-1]),
        frames=sum(isinstance(record, DetectionFrame) for record in drive.records),
        passes=signs.size,
        hidden_passes=sum(bool(looks.hidden[looks.sign == sign].all()) for sign in signs),
        looks=int(open_.sum()),
        hits=int(looks.detected.sum()),
        misses_after_miss=(int((after_miss & ~looks.detected[1:]).sum()), int(after_miss.sum())),
        false_alarms=int((source == FALSE_ALARM).sum()),
        ghosts=int((source == GHOST).sum()),
        painted=int((source == PAINTED_SIGN).sum()),
        range_scale=drive.camera_errors.range_scale,
        single_m=single_sighting_errors(world, drive),
        oracle_m=np.array(list(oracle_errors(world, drive, None).values()), dtype=np.float64),
    )


def simulation_figures(drives: Sequence[DriveSummary]) -> dict[str, Any]:
    """Return the figures of a simulation, over all its drives."""
    frames, passes, looks = (sum(getattr(d, name) for d in drives) for name in ("frames", "passes", "looks"))
    repeated = [sum(d.misses_after_miss[i] for d in drives) for i in (0, 1)]
    return {
        "drives": len(drives),
        "minutes_per_drive": sum(d.seconds for d in drives) / 60.0 / len(drives),
        "passes": passes,
        "frames_per_pass": looks / passes if passes else float("nan"),
        "detection_probability": sum(d.hits for d in drives) / looks if looks else float("nan"),
        "miss_after_miss": repeated[0] / repeated[1] if repeated[1] else float("nan"),
        "wholly_hidden_passes": sum(d.hidden_passes for d in drives) / passes if passes else float("nan"),
        "false_alarms_per_frame": sum(d.false_alarms for d in drives) / frames,
        "ghost_detections_per_drive": sum(d.ghosts for d in drives) / len(drives),
        "painted_detections_per_drive": sum(d.painted for d in drives) / len(drives),
        "range_bias_rms": float(np.sqrt(np.mean([d.range_scale**2 for d in drives]))),
        "single_sighting_error_m": summarize(np.concatenate([d.single_m for d in drives])),
        "oracle_error_m": summarize(np.concatenate([d.oracle_m for d in drives])),
    }
