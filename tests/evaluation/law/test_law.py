"""The law by numbers: the bound is what theory says, the defaults meet their goals, and the server does the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence

from slamcu_core.aggregation import ClassPolicy, Policy, Side
from slamcu_eval.cli import run
from slamcu_eval.law import curves
from slamcu_eval.law.bound import least_delay
from slamcu_eval.law.confirm import confirm
from slamcu_eval.law.curves import Setting, point
from slamcu_eval.law.passes import delays, false_changes, stands

POLICY = ClassPolicy()


@pytest.mark.parametrize("run_length", [2, 3])
def test_where_one_sighting_resets_it_cusum_waits_for_a_run_of_misses(run_length: int) -> None:
    # a run of k misses with probability p comes after (1 - p^k) / ((1 - p) p^k) passes on average (Feller)
    p = 0.05
    mean = (1.0 - p**run_length) / ((1.0 - p) * p**run_length)
    assert least_delay(p, 1.0 - 1e-12, 1.0 / mean) == pytest.approx(run_length, rel=1e-6)


def test_fewer_false_alarms_cost_cusum_more_passes() -> None:
    taken = [least_delay(0.05, 0.98, rate) for rate in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)]
    assert taken == sorted(taken)
    assert np.isnan(least_delay(0.05, 0.98, 0.0))


def test_the_default_policy_is_near_the_bound_and_rarely_wrong() -> None:
    figures = point(Setting(Side.DELETED, POLICY, 0.05, 0.02), passes=400_000, stream=SeedSequence(3))
    assert figures["false_per_10000"]["long"] < 0.1
    assert figures["detection_delay_over_bound"] <= 1.3
    assert figures["passes_to_decision"]["long"]["median"] <= 5
    new = point(Setting(Side.NEW, POLICY, 0.05, 0.02), passes=50_000, stream=SeedSequence(3))
    assert new["passes_to_decision"]["fresh"]["median"] <= 3


def test_no_policy_beats_the_bound() -> None:
    for enter in (0.7, 0.8, 0.9):
        setting = Setting(Side.DELETED, replace(POLICY, enter=enter), 0.1, 0.02)
        assert point(setting, passes=200_000, stream=SeedSequence(4))["detection_delay_over_bound"] >= 1.0


def test_rows_and_neighbouring_seeds_share_no_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    loud = Setting(Side.NEW, POLICY, 0.05, 0.05)
    monkeypatch.setattr(curves, "settings", lambda default: [loud, loud, loud])
    monkeypatch.setattr(curves, "_FEATURES", 100)
    rows = [row for seed in (0, 1) for row in curves.law_curves(POLICY, passes=2_000, seed=seed)]
    counted = [(row["false_per_10000"]["fresh"], row["passes_to_decision"]["fresh"]["mean"]) for row in rows]
    assert len(set(counted)) == len(counted)
    again = next(curves.law_curves(POLICY, passes=2_000, seed=0))
    assert again == rows[0]


def test_false_changes_are_counted_once_each_from_where_they_count() -> None:
    everything = false_changes(POLICY, Side.DELETED, 1.0, passes=500, after=0, length=10, stream=SeedSequence(0))
    assert (everything.events, everything.passes) == (50, 500)  # each feature once: it stands on
    assert false_changes(POLICY, Side.DELETED, 1.0, passes=500, after=10, length=10, stream=SeedSequence(0)).events == 0
    assert false_changes(POLICY, Side.NEW, 0.0, passes=500, after=0, length=10, stream=SeedSequence(0)).events == 0


def test_a_change_that_never_stands_is_waited_for_in_vain() -> None:
    deaf = replace(POLICY, enter=0.99, trust=0.5, forgetting=0.5)
    taken = delays(deaf, Side.DELETED, miss_rate=0.05, phantom_rate=0.02, before=5, features=20, stream=SeedSequence(0))
    assert np.isinf(taken).all()


def test_a_candidate_begins_with_nothing_and_a_map_feature_with_its_prior() -> None:
    missed = np.zeros((3, 1), bool)
    assert stands(missed, POLICY, Side.NEW)[-1].all()
    assert not stands(~missed, POLICY, Side.NEW).any()
    assert not stands(~missed[:2], POLICY, Side.DELETED).any()


def test_the_server_says_what_the_fold_says() -> None:
    told = confirm(Policy(), vehicles=6, features=24, seed=2)
    assert told["agree"] == told["features"] == 24
    assert told["largest_difference_of_masses"] <= 1e-9


def test_the_command_writes_the_contracts_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(curves, "ENTERS", (0.8,))
    monkeypatch.setattr(curves, "TRUSTS", (0.7,))
    monkeypatch.setattr(curves, "FORGETTINGS", (0.8,))
    monkeypatch.setattr(curves, "PHANTOM_RATES", (0.02,))
    monkeypatch.setattr(curves, "_FEATURES", 100)
    policy = tmp_path / "policy.json"
    policy.write_text(json.dumps({"default": {"enter": 0.85}}))
    out = tmp_path / "law.json"
    options = ["--passes", "2000", "--confirm", "0", "--policy", str(policy), "--json", str(out)]
    assert run(["law", *options]) == 0
    figures = json.loads(out.read_text())
    assert figures["default"]["enter"] == 0.85
    assert figures["detection_delay_over_bound"] > 1.0
    assert {point["side"] for point in figures["points"]} == {"new", "deleted"}

    policy.write_text("{")
    assert run(["law", "--policy", str(policy)]) == 1
    assert "no JSON" in capsys.readouterr().err
