"""Alerts, dashboard and documentation speak of the metrics that there are."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from slamcu_server.metrics.instruments import Instruments

ROOT = Path(__file__).parents[2]
METRIC = re.compile(r"\bslamcu_[a-z_]+\b")
OPERATIONS = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
ALERTS = (ROOT / "monitoring" / "alerts.yml").read_text(encoding="utf-8")


def _exported() -> dict[str, set[str]]:
    """Return the names under which each instrument is exported, by the name that people know it by."""
    names = {}
    for family in Instruments().registry.collect():
        known = f"{family.name}_total" if family.type == "counter" else family.name
        series = {"_bucket", "_count", "_sum"} if family.type == "histogram" else {""}
        names[known] = {known + suffix for suffix in series}
    return names


def _series() -> set[str]:
    return set().union(*_exported().values())


def test_the_dashboard_names_only_what_is_exported_and_all_of_it() -> None:
    dashboard: dict[str, Any] = json.loads((ROOT / "monitoring" / "dashboard.json").read_text(encoding="utf-8"))
    asked = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    named = {name for expression in asked for name in METRIC.findall(expression)}
    assert named <= _series()
    shown = {known for known, series in _exported().items() if series & named}
    assert set(_exported()) == shown
    assert all(expression.count("(") == expression.count(")") for expression in asked)
    places = [(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in dashboard["panels"]]
    assert len(places) == len(set(places))


def test_alerts_name_only_what_is_exported() -> None:
    expressions = re.findall(r"^        expr: (.*)$", ALERTS, re.MULTILINE)
    assert expressions
    assert {name for one in expressions for name in METRIC.findall(one)} <= _series()


def test_every_alert_and_every_metric_is_explained() -> None:
    alerts = re.findall(r"- alert: (\w+)", ALERTS)
    assert alerts == re.findall(r"^\| `(Slamcu\w+)` \|", OPERATIONS, re.MULTILINE)
    assert set(_exported()) == {
        name for row in re.findall(r"^\| (`slamcu_[^|]*) \|", OPERATIONS, re.MULTILINE) for name in METRIC.findall(row)
    }


@pytest.mark.parametrize("reason", ["quantile", "state", "outcome"])
def test_labels_that_are_asked_for_exist(reason: str) -> None:
    instruments = Instruments()
    labels = {label for one in vars(instruments).values() for label in getattr(one, "_labelnames", ())}
    assert reason in labels
