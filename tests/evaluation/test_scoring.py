"""Scoring by hand-made cases: who found what, what was invented, and what counts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.errors import SlamcuError
from slamcu_eval.score import Claim, Fact, confusion, figures, inside_ellipse, score
from slamcu_eval.statistics import cluster_interval, summarize

NORMAL = Fact("normal", (0.0, 0.0), object_id=1)
DELETED = Fact("deleted", (50.0, 0.0), object_id=2)
NEW = Fact("new", (100.0, 0.0))


def test_all_right() -> None:
    claims = [
        Claim("normal", (0.0, 0.1), object_id=1),
        Claim("deleted", (50.0, 0.0), object_id=2),
        Claim("new", (101.0, 0.0), covariance=(1.0, 0.0, 1.0)),
    ]
    result = score([NORMAL, DELETED, NEW], claims)
    assert result.said == (("normal", "normal"), ("deleted", "deleted"), ("new", "new"))
    assert result.false_new == ()
    (match,) = result.matches
    assert (match.fact, match.claim, match.error_m, match.inside) == (2, 2, pytest.approx(1.0), True)
    assert figures([result])["accuracy"] == 1.0


def test_a_map_feature_that_nobody_mentions_is_unclassified() -> None:
    assert score([NORMAL], []).said == (("normal", "unclassified"),)


def test_a_new_feature_must_be_claimed_within_the_radius() -> None:
    claim = Claim("new", (103.5, 0.0))
    assert score([NEW], [claim], radius_m=3.0).said == (("new", "unclassified"),)
    assert score([NEW], [claim], radius_m=3.0).false_new == (0,)
    assert score([NEW], [claim], radius_m=4.0).said == (("new", "new"),)


def test_one_claim_never_stands_for_two_signs_and_a_second_claim_is_false() -> None:
    pair = [NEW, Fact("new", (102.0, 0.0))]
    one = score(pair, [Claim("new", (101.0, 0.0))])
    assert sorted(said for _, said in one.said) == ["new", "unclassified"]
    three = score([NEW], [Claim("new", (x, 0.0)) for x in (99.5, 100.2, 101.5)])
    assert [match.claim for match in three.matches] == [1]
    assert three.false_new == (0, 2)


def test_as_many_as_possible_are_matched_before_as_near_as_possible() -> None:
    # Taking the nearest first (0.1 m) would leave the second sign without a claim.
    facts = [Fact("new", (0.0, 0.0)), Fact("new", (2.0, 0.0))]
    claims = [Claim("new", (0.1, 0.0)), Claim("new", (-2.5, 0.0))]
    assert len(score(facts, claims, radius_m=3.0).matches) == 2


def test_a_new_claim_on_a_mapped_sign_is_false() -> None:
    result = score([NORMAL], [Claim("normal", (0.0, 0.0), object_id=1), Claim("new", (0.5, 0.0))])
    assert result.said == (("normal", "normal"),)
    assert result.false_new == (1,)


def test_a_moved_sign_counts_with_its_new_place() -> None:
    fact = Fact("moved", (10.0, 0.0), object_id=3)
    assert score([fact], [Claim("moved", (11.0, 0.0), object_id=3)]).said == (("moved", "moved"),)
    assert score([fact], [Claim("moved", (20.0, 0.0), object_id=3)]).said == (("moved", "unclassified"),)
    both_ends = score([fact], [Claim("deleted", (0.0, 0.0), object_id=3), Claim("new", (10.5, 0.0))])
    assert both_ends.said == (("moved", "deleted"),)
    assert both_ends.false_new == ()  # a sign does stand there
    assert math.isnan(figures([both_ends])["new_position_error_m"]["mean"])


def test_a_modified_sign_counts_with_its_new_content() -> None:
    fact = Fact("modified", (0.0, 0.0), object_id=4, sign="SPEED_LIMIT", value="90")
    right = Claim("modified", (0.0, 0.0), object_id=4, sign="SPEED_LIMIT", value="90")
    wrong = Claim("modified", (0.0, 0.0), object_id=4, sign="SPEED_LIMIT", value="110")
    assert score([fact], [right]).said == (("modified", "modified"),)
    assert score([fact], [wrong]).said == (("modified", "unclassified"),)


def test_never_in_view_comes_from_the_truth_or_else_from_the_passes() -> None:
    facts = [
        Fact("normal", (0.0, 0.0), object_id=1, in_view=False),
        Fact("normal", (0.0, 0.0), object_id=2, in_view=True),
        Fact("normal", (0.0, 0.0), object_id=3),
        Fact("normal", (0.0, 0.0), object_id=4),
        Fact("new", (9.0, 9.0)),
    ]
    claims = [Claim("normal", (0.0, 0.0), object_id=i, passes=passes) for i, passes in ((1, 1), (2, 0), (3, 0), (4, 2))]
    result = score(facts, claims)
    assert result.never_in_view == 2
    assert figures([result])["features"] == 5  # they count all the same


def test_the_confusion_has_moved_and_modified_only_where_they_occur() -> None:
    plain = confusion([score([NORMAL, NEW], [Claim("deleted", (0.0, 0.0), object_id=1)])])
    assert list(plain) == ["normal", "deleted", "new"]
    assert plain["normal"] == {"normal": 0, "deleted": 1, "new": 0, "unclassified": 0}
    assert plain["new"]["unclassified"] == 1
    assert sum(plain["deleted"].values()) == 0
    wide = confusion([score([NORMAL], [Claim("modified", (0.0, 0.0), object_id=1)])])
    assert list(wide["normal"]) == ["normal", "deleted", "new", "modified", "unclassified"]


def test_two_claims_about_one_map_feature_are_refused() -> None:
    claim = Claim("normal", (0.0, 0.0), object_id=1)
    with pytest.raises(SlamcuError, match="two claims have the map object id 1"):
        score([NORMAL], [claim, claim])


def test_nothing_claimed_of_nothing_has_no_accuracy() -> None:
    assert math.isnan(figures([score([], [])])["accuracy"])


@given(st.integers(0, 10_000))
def test_ellipses_hold_95_percent_of_gaussian_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 2)) + 2.0 * np.eye(2)
    covariance = root @ root.T
    claim = Claim("new", (0.0, 0.0), (covariance[0, 0], covariance[0, 1], covariance[1, 1]))
    places = rng.normal(size=(400, 2)) @ root.T
    inside = np.mean([bool(inside_ellipse((x, y), claim)) for x, y in places.tolist()])
    assert 0.88 < inside <= 1.0


def test_a_covariance_that_is_none_covers_nothing() -> None:
    assert inside_ellipse((0.1, 0.0), Claim("new", (0.0, 0.0), (0.0, 0.0, 0.0))) is False
    assert inside_ellipse((0.1, 0.0), Claim("new", (0.0, 0.0))) is None


def test_summaries_of_errors() -> None:
    assert summarize([1.0, 2.0, 3.0]) == pytest.approx({"mean": 2.0, "median": 2.0, "p95": 2.9, "std": 0.8164965809})
    assert all(math.isnan(value) for value in summarize([]).values())


def test_intervals_are_as_wide_as_drives_differ_not_as_features_do() -> None:
    equal = cluster_interval([96] * 20, [100] * 20)
    assert equal == (0.96, 0.96)
    unequal = cluster_interval([100] * 18 + [60] * 2, [100] * 20)
    by_feature = 1.96 * math.sqrt(0.96 * 0.04 / 2_000)
    assert unequal[1] - unequal[0] > 2 * 2 * by_feature
    assert unequal[0] <= 0.96 <= unequal[1]
    assert all(math.isnan(bound) for bound in cluster_interval([], []))
