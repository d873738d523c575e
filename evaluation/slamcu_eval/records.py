"""One record per feature of a drive: what it was, what was said of it, how it was seen, and how far off it was placed.

The records are what plots and questions of one's own start from; the figures of the contract do not need them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slamcu_core.errors import FormatError
from slamcu_core.filter import FeatureEstimate
from slamcu_eval.highway import Drive
from slamcu_eval.score import Claim, Fact, Score, mahalanobis_square

NOTHING = "nothing"  # the truth behind a claim of a new feature that stands for nothing


@dataclass(frozen=True, slots=True)
class FeatureRecord:
    """A feature of the world, or a claim that stands for nothing, at the end of one drive."""

    drive: int
    truth: str  # normal, deleted, new, or nothing
    predicted: str  # normal, deleted, new, or unclassified
    frames_in_view: int  # camera frames in whose field of view its place was, hidden or not
    hidden_share: float | None  # of those frames, the share in which traffic hid it; None: never in view
    closest_m: float | None  # least true range in view
    sightings: int  # detections of it
    first_detection_m: float | None  # true range of the first detection
    closest_detection_m: float | None  # least true range of a detection
    exists: float | None  # masses with the map's prior; None: nothing was said of it
    not_exists: float | None
    unknown: float | None
    position_error_m: float | None  # of a new feature that was found
    mahalanobis_square: float | None  # of that error in the claimed covariance: chi-square, 2 degrees of freedom
    oracle_error_m: float | None  # of least squares over the same detections with the true poses


def feature_records(
    number: int,
    drive: Drive,
    told: tuple[Sequence[Fact], Sequence[FeatureEstimate], Sequence[Claim]],
    *,
    score: Score,
    oracle: dict[int, float],
) -> tuple[FeatureRecord, ...]:
    """Return the records of a drive: every feature of the world, then every claim that stands for nothing.

    Parameters
    ----------
    number : of the drive.
    told : facts, and of the same length estimates of the filter and the claims made of them.
    oracle : errors of least squares with the true poses, by index into the world's signs.
    """
    facts, estimates, claims = told
    by_id = {claim.object_id: index for index, claim in enumerate(claims)}
    matches = {match.fact: match for match in score.matches}
    records = []
    for index, (fact, (truth, said)) in enumerate(zip(facts, score.said, strict=True)):
        match = matches.get(index)
        claimed = match.claim if match is not None else _claim_on(fact, by_id)
        records.append(
            FeatureRecord(
                drive=number,
                truth=truth,
                predicted=said,
                **_seen(drive, index),
                **_masses(None if claimed is None else estimates[claimed]),
                position_error_m=None if match is None else match.error_m,
                mahalanobis_square=None if match is None else mahalanobis_square(fact.place, claims[match.claim]),
                oracle_error_m=oracle.get(index),
            )
        )
    return (*records, *(_false_new(number, estimates[index]) for index in score.false_new))


def _claim_on(fact: Fact, by_id: dict[int | None, int]) -> int | None:
    return None if fact.object_id is None else by_id.get(fact.object_id)


def _seen(drive: Drive, index: int) -> dict[str, Any]:
    exposure, looks = drive.exposure, drive.looks
    frames = int(exposure.frames[index])
    detected = looks.range[(looks.sign == index) & looks.detected]
    return {
        "frames_in_view": frames,
        "hidden_share": float(exposure.hidden[index] / frames) if frames else None,
        "closest_m": float(exposure.closest_m[index]) if frames else None,
        "sightings": len(detected),
        "first_detection_m": float(detected[0]) if len(detected) else None,
        "closest_detection_m": float(detected.min()) if len(detected) else None,
    }


def _masses(estimate: FeatureEstimate | None) -> dict[str, Any]:
    if estimate is None:
        return dict.fromkeys(("exists", "not_exists", "unknown"))
    return asdict(estimate.masses)


def _false_new(number: int, estimate: FeatureEstimate) -> FeatureRecord:
    return FeatureRecord(
        drive=number,
        truth=NOTHING,
        predicted=estimate.state,
        frames_in_view=0,
        hidden_share=None,
        closest_m=None,
        sightings=0,
        first_detection_m=None,
        closest_detection_m=None,
        **_masses(estimate),
        position_error_m=None,
        mahalanobis_square=None,
        oracle_error_m=None,
    )


def write_records(path: Path, records: Iterable[FeatureRecord]) -> None:
    """Write records as JSON lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8") as out:
        out.writelines(json.dumps(asdict(record)) + "\n" for record in records)


def read_records(path: Path) -> list[FeatureRecord]:
    """Read records; raises FormatError naming the line that is none."""
    records = []
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, 1):
            try:
                records.append(FeatureRecord(**json.loads(line)))
            except (ValueError, TypeError) as error:
                raise FormatError(f"expected a feature record: {error}", source=path.name, line=number) from error
    return records
