"""The document of a change: what a map provider reads about it."""

from __future__ import annotations

import math
from datetime import datetime
from typing import TYPE_CHECKING, Any

from slamcu_core.evidence import conflict, masses_from_weights
from slamcu_server.changes.belief import Belief, Kind

if TYPE_CHECKING:
    from slamcu_server.changes.transitions import Claim, Published

Document = dict[str, Any]

_CHI2_95_2DOF = 5.991464547107979  # the 95 % quantile of the chi-squared distribution with 2 degrees of freedom


def ellipse95(covariance_m2: tuple[float, float, float]) -> dict[str, float]:
    """Return the 95 % ellipse of a covariance [xx, xy, yy] in m² east-north.

    Semi-axes are in metres, the orientation is the compass direction of the longer one in [0, 180) degrees.
    """
    xx, xy, yy = covariance_m2
    mean, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    # the angle from east to the longer axis; a circle has none, and north is as good as any
    angle = 90.0 - math.degrees(0.5 * math.atan2(2.0 * xy, xx - yy)) if half > 0.0 else 0.0
    return {
        "semi_major_m": math.sqrt((mean + half) * _CHI2_95_2DOF),
        "semi_minor_m": math.sqrt(max(mean - half, 0.0) * _CHI2_95_2DOF),
        "orientation_deg": angle % 180.0,
    }


def evidence(weight_for: float, weight_against: float) -> dict[str, float]:
    """Return the weights, the masses they stand for (eq. 1-7) and their conflict, by the documents' names."""
    exists, not_exists, unknown = masses_from_weights(weight_for, weight_against)
    return {
        "weight_for": weight_for,
        "weight_against": weight_against,
        "mass_exists": float(exists),
        "mass_not_exists": float(not_exists),
        "mass_unknown": float(unknown),
        "conflict": float(conflict(weight_for, weight_against)),
    }


def timestamp(value: datetime | None) -> str | None:
    """Return a time as RFC 3339 text, or None."""
    return None if value is None else value.isoformat()


def claim_document(claim: Claim, map_source: str, before: Document | None) -> Document:
    """Build what is published about a claim, all but its id, kind, state, revision and versions.

    What stands at the place leads: the place, sign, value and masses are the candidate's where there is one. A moved
    sign is where it went to; a modified one stays where the map has it, which is surveyed.

    Parameters
    ----------
    before : what was published, if anything was.
    """
    leading = claim.leading.belief
    halves = [voice.belief for voice in (claim.feature, claim.candidate) if voice is not None]
    both = claim.feature is not None and claim.candidate is not None
    shown = claim.feature.belief if claim.feature is not None and claim.kind is Kind.MODIFIED else leading
    since = [belief.stood_since for belief in halves]
    begun = [belief.first_evidence for belief in halves] + [_time((before or {}).get("first_evidence"))]
    return {
        "map": map_source,
        "map_object_id": None if claim.feature is None else claim.feature.subject.map_object_id,
        "watch_id": None if claim.candidate is None else claim.candidate.subject.candidate_id,
        **_thing(leading),
        **_place(shown),
        **_support(leading),
        "passes": sum(belief.passes for belief in halves),
        "first_seen": timestamp(leading.first_seen),
        "last_seen": timestamp(leading.last_seen),
        "last_looked": timestamp(max((b.last_looked for b in halves if b.last_looked), default=None)),
        "first_evidence": timestamp(min((time for time in begun if time is not None), default=None)),
        "confirmed_at": timestamp(max((time for time in since if time is not None), default=None))
        if claim.standing
        else None,
        "from": _half(claim.feature.belief) if both and claim.feature is not None else None,
        "to": _half(claim.candidate.belief) if both and claim.candidate is not None else None,
        "merged_into": None,
        "joined_into": None,
        "withdrawn_because": None,
        "mapped_at": None,
        "mapped_in": None,
        "review": None,
    }


def withdrawn_document(published: Published, claim: Claim | None, why: Document) -> Document:
    """Build the document of a change that is withdrawn: as it was told, with the evidence that ended it."""
    document = {**published.document, **why}
    if claim is None:
        return document
    last = claim.leading.belief
    if (claim.kind, claim.ends) == (published.kind, published.ends):
        document |= {**_support(last), "last_seen": timestamp(last.last_seen)}
    document["last_looked"] = timestamp(last.last_looked)
    return document


def _thing(belief: Belief) -> Document:
    return {"class": belief.feature_class, "sign": belief.sign, "value": belief.value}


def _place(belief: Belief) -> Document:
    return {
        "geometry": {"type": "Point", "coordinates": [belief.lon, belief.lat]},
        "covariance_m2": list(belief.covariance_m2),
        "ellipse95": ellipse95(belief.covariance_m2),
    }


def _support(belief: Belief) -> Document:
    return {
        **evidence(belief.weight_for, belief.weight_against),
        "contributors_for": belief.contributors_for,
        "contributors_against": belief.contributors_against,
    }


def _half(belief: Belief) -> Document:
    return {
        **_thing(belief),
        **_place(belief),
        **_support(belief),
        "passes": belief.passes,
        "last_seen": timestamp(belief.last_seen),
        "last_looked": timestamp(belief.last_looked),
    }


def _time(told: str | None) -> datetime | None:
    return None if told is None else datetime.fromisoformat(told)
