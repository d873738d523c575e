from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_eval.picture import CloseUp, Mark, Outcome, draw_road, stack

KINDS = ("normal", "new", "deleted", "moved", "modified")
marks = st.builds(
    Mark,
    along=st.floats(0.0, 19_999.0),
    left=st.sampled_from([-9.0, 9.0]),
    kind=st.sampled_from(KINDS),
    outcome=st.sampled_from(Outcome),
)


@given(st.lists(marks, max_size=30))
def test_marks_beside_each_other_never_cover_each_other(drawn: list[Mark]) -> None:
    heights = stack(drawn, 4_000.0)
    for i, one in enumerate(drawn):
        assert (heights[i] > 0) == (one.left > 0)
        for j in range(i):
            other = drawn[j]
            if one.along // 4_000 == other.along // 4_000 and abs(one.along - other.along) < 75.0:
                assert heights[i] != heights[j]


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_every_kind_and_outcome_can_be_drawn(suffix: str, tmp_path: Path) -> None:
    drawn = [
        Mark(100.0 * n, 9.0 * (-1) ** n, kind, outcome)
        for n, (kind, outcome) in enumerate((k, o) for k in KINDS for o in Outcome)
    ]
    s = np.linspace(0.0, 2_000.0, 50)
    plan = np.stack([s, 100.0 * np.sin(s / 500.0)], axis=1)
    views = [
        CloseUp("80", (0.1, -0.2), (0.04, 0.01, 0.02), np.array([[0.5, 0.5], [-4.0, 1.0]])),
        CloseUp("none", (0.0, 0.0), (0.0, 0.0, 0.0)),
    ]
    path = tmp_path / "deep" / f"map.{suffix}"
    draw_road(path, drawn, title="t", subtitle="s", plan=plan, length_m=2_000.0, close_ups=views, rows=2)
    assert path.stat().st_size > 10_000
    if suffix == "svg":
        text = path.read_text(encoding="utf-8")
        assert "<svg" in text


def test_a_road_without_close_ups_can_be_drawn(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    draw_road(path, [], title="t", subtitle="s", plan=np.array([[0.0, 0.0], [0.0, 500.0]]), length_m=500.0, rows=1)
    assert path.stat().st_size > 1_000
