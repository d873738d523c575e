"""The figures of the experiment: precision and recall by kind, places, passes to decide, and calibration.

A claim of a new sign is right if a truly new one stands within 3 m, one to one; of a moved one also if it is placed
there, of a modified one if it says what the sign says now. Every sign of the roads counts, also those never in view.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from slamcu_eval.many.experiment import RoadResult
from slamcu_eval.many.reading import Reading, Statement
from slamcu_eval.paper import facts_of
from slamcu_eval.score import HIGHWAY_RADIUS_M, Claim, Fact, Score, score
from slamcu_eval.statistics import cluster_interval, summarize

KINDS = ("new", "deleted", "moved", "modified")
_BINS = 10
_VERIFIED = 2  # vehicles that have looked at a candidate before its belief is called one
_STANDS_ELSEWHERE = {"moved", "modified"}

Counts = list[tuple[int, int, int]]  # per road: right, claimed, true


def fleet_figures(results: Sequence[RoadResult], *, common_bias: bool) -> dict[str, Any]:
    """Return every figure of the evaluation contract's `fleet`."""
    sizes = [reading.vehicles for reading in results[0].readings]
    vehicles = {str(size): _of_size([(r, _at(r, size)) for r in results]) for size in sizes}
    cars = _cars_alone(results)
    return {
        "roads": len(results),
        "features_of_each_kind": {
            kind: sum(sign.truth.value == kind for r in results for sign in r.world.signs)
            for kind in ("normal", *KINDS)
        },
        "vehicles": vehicles,
        "single_new_precision": vehicles["1"]["new"]["precision"] if "1" in vehicles else cars["new"]["precision"],
        "car_alone": cars,
        "common_bias": common_bias,
    }


def _at(result: RoadResult, size: int) -> Reading:
    return next(reading for reading in result.readings if reading.vehicles == size)


def _of_size(pairs: Sequence[tuple[RoadResult, Reading]]) -> dict[str, Any]:
    counts: dict[str, Counts] = {kind: [] for kind in KINDS}
    errors: list[float] = []
    inside: list[bool] = []
    oracle: list[float] = []
    decided: dict[str, list[float]] = {"new": [], "deleted": []}
    beliefs: dict[str, list[tuple[float, bool]]] = {kind: [] for kind in KINDS}
    phantoms = 0
    for result, reading in pairs:
        facts = facts_of(result.world)
        claims = [one.claim for one in reading.statements]
        told = score(facts, claims, radius_m=HIGHWAY_RADIUS_M)
        for kind in KINDS:
            counts[kind].append(_count(kind, told, facts, claims))
        new = [match for match in told.matches if facts[match.fact].kind == "new"]
        phantoms += _phantoms(facts, claims)
        errors += [match.error_m for match in new]
        inside += [match.inside for match in new if match.inside is not None]
        oracle += _oracle_errors(result, facts, [match.fact for match in new], reading.vehicles)
        for kind, passes in _decisions(facts, reading.statements, told).items():
            decided[kind] += passes
        for kind, pairs_of_kind in _beliefs(facts, reading.statements).items():
            beliefs[kind] += pairs_of_kind
    summary = summarize(errors)
    return {
        **{kind: precision_and_recall(counts[kind]) for kind in KINDS},
        "new_position_error_m": {name: summary[name] for name in ("mean", "median", "p95")},
        "oracle_position_error_m": float(np.mean(oracle)) if oracle else float("nan"),
        "ellipse95_coverage": float(np.mean(inside)) if inside else float("nan"),
        "passes_to_decision": {
            kind: {
                "median": float(np.median(passes)) if passes else float("nan"),
                "p95": float(np.quantile(passes, 0.95, method="higher")) if passes else float("nan"),
            }
            for kind, passes in decided.items()
        },
        "ece": {kind: balanced_ece(beliefs[kind]) for kind in KINDS},
        "unverified_candidates": sum(_unverified(reading.statements) for _, reading in pairs),
        "new_phantoms": phantoms,
    }


def precision_and_recall(counts: Counts) -> dict[str, Any]:
    """Return precision and recall over roads, with intervals by road."""
    right, claimed, true = ([one[i] for one in counts] for i in range(3))
    return {
        "precision": sum(right) / sum(claimed) if sum(claimed) else float("nan"),
        "recall": sum(right) / sum(true) if sum(true) else float("nan"),
        "precision_ci95": list(cluster_interval(right, claimed)),
        "recall_ci95": list(cluster_interval(right, true)),
        "right": sum(right),
        "claimed": sum(claimed),
        "true": sum(true),
    }


def _count(kind: str, told: Score, facts: Sequence[Fact], claims: Sequence[Claim]) -> tuple[int, int, int]:
    claimed = sum(claim.state == kind for claim in claims)
    true = sum(fact.kind == kind for fact in facts)
    if kind == "new":
        right = sum(facts[match.fact].kind == "new" for match in told.matches)
    else:
        right = sum(pair == (kind, kind) for pair in told.said)
    return right, claimed, true


def _oracle_errors(result: RoadResult, facts: Sequence[Fact], found: Iterable[int], vehicles: int) -> list[float]:
    """Return how far the mean of the cars' own least squares with true poses is from each sign that was found."""
    errors = []
    for index in found:
        places = [car.oracle[index] for car in result.cars[:vehicles] if index in car.oracle]
        if places:
            errors.append(float(np.linalg.norm(np.mean(places, axis=0) - facts[index].place)))
    return errors


def _unverified(statements: Sequence[Statement]) -> int:
    return sum(one.claim.object_id is None and one.looked < _VERIFIED for one in statements)


def _phantoms(facts: Sequence[Fact], claims: Sequence[Claim]) -> int:
    """Count claims of new signs where nothing stands that the map lacks: neither new, nor moved there, nor modified."""
    there = np.array([f.place for f in facts if f.kind in {"new", *_STANDS_ELSEWHERE}], float).reshape(-1, 2)
    return sum(
        not (np.hypot(*(there - claim.place).T) <= HIGHWAY_RADIUS_M).any() for claim in claims if claim.state == "new"
    )


def _decisions(facts: Sequence[Fact], statements: Sequence[Statement], told: Score) -> dict[str, list[float]]:
    by_id = {one.claim.object_id: one for one in statements if one.claim.object_id is not None}
    found = {match.fact: statements[match.claim] for match in told.matches}
    taken: dict[str, list[float]] = {"new": [], "deleted": []}
    for index, fact in enumerate(facts):
        one = found.get(index) if fact.object_id is None else by_id.get(fact.object_id)
        if fact.kind in taken and one is not None and one.decided_after is not None:
            taken[fact.kind].append(float(one.decided_after))
    return taken


def _beliefs(facts: Sequence[Fact], statements: Sequence[Statement]) -> dict[str, list[tuple[float, bool]]]:
    """Return for each kind of change beliefs in existence, and whether the thing exists: changed and unchanged ones.

    Of deleted, moved and modified signs the belief is in the sign as the map has it, beside all unchanged signs; of new
    ones it is in the candidates, beside those where no sign stands. A candidate of which only the car that found it has
    told yet is a question to the next cars: those are counted apart (`_unverified`).
    """
    by_id = {one.claim.object_id: one for one in statements if one.claim.object_id is not None}
    unchanged = [(by_id[f.object_id].belief, True) for f in facts if f.kind == "normal" and f.object_id in by_id]
    result = {
        kind: [(by_id[f.object_id].belief, False) for f in facts if f.kind == kind and f.object_id in by_id] + unchanged
        for kind in ("deleted", "moved", "modified")
    }
    candidates = [one for one in statements if one.claim.object_id is None and one.looked >= _VERIFIED]
    as_new = [Claim("new", one.claim.place) for one in candidates]
    stands = {match.claim: facts[match.fact].kind for match in score(facts, as_new, radius_m=HIGHWAY_RADIUS_M).matches}
    changed = np.array([f.place for f in facts if f.kind in _STANDS_ELSEWHERE], float).reshape(-1, 2)
    result["new"] = []
    for index, one in enumerate(candidates):
        kind = stands.get(index)
        near = np.hypot(*(changed - one.claim.place).T) <= HIGHWAY_RADIUS_M
        if kind == "new":
            result["new"].append((one.belief, True))
        elif kind is None and not near.any():
            result["new"].append((one.belief, False))
    return result


def balanced_ece(beliefs: Sequence[tuple[float, bool]]) -> float:
    """Return the expected calibration error of beliefs, what exists and what does not weighing half each.

    NaN if there is nothing of one of the two.
    """
    belief = np.array([one for one, _ in beliefs], float)
    exists = np.array([one for _, one in beliefs], bool)
    if not exists.any() or exists.all():
        return float("nan")
    weight = np.where(exists, 0.5 / exists.sum(), 0.5 / (~exists).sum())
    bins = np.minimum((belief * _BINS).astype(int), _BINS - 1)
    gaps = [abs(float(weight[bins == b] @ (belief - exists)[bins == b])) for b in range(_BINS)]
    return float(sum(gaps))


def _cars_alone(results: Sequence[RoadResult]) -> dict[str, Any]:
    """Return what the cars say each by itself, before any cloud: over all drives."""
    counts: dict[str, Counts] = {kind: [] for kind in ("new", "deleted")}
    errors: list[float] = []
    for result in results:
        facts = facts_of(result.world)
        scores = [(score(facts, car.claims, radius_m=HIGHWAY_RADIUS_M), car.claims) for car in result.cars]
        for kind, rows in counts.items():
            mine = [_count(kind, told, facts, claims) for told, claims in scores]
            rows.append((sum(m[0] for m in mine), sum(m[1] for m in mine), sum(m[2] for m in mine)))
        errors += [m.error_m for told, _ in scores for m in told.matches if facts[m.fact].kind == "new"]
    rmse = [car.pose_rmse_m for result in results for car in result.cars]
    return {
        **{kind: precision_and_recall(counts[kind]) for kind in counts},
        "new_position_error_m": summarize(errors)["mean"],
        "pose_rmse_m": {"median": float(np.median(rmse)), "largest": float(np.max(rmse))},
    }
