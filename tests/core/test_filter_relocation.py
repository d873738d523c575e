"""The search for the way back: right in a crowd, and never long."""

from __future__ import annotations

import numpy as np
import pytest

from slamcu_core.filter import relocation
from slamcu_core.filter.relocation import Constellation, Motion, same, search


def test_a_search_among_hundreds_of_things_finds_the_motion_and_ends_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, compared = np.random.default_rng(3), 0
    agreement = relocation.agreement

    def counted(seen: Constellation, motion: Motion, places: relocation.Array, fits: np.ndarray) -> int:
        nonlocal compared
        compared += fits.size
        return agreement(seen, motion, places, fits)

    monkeypatch.setattr(relocation, "agreement", counted)
    truth = Motion(0.7, np.array([40.0, -12.0]))
    things = rng.uniform(0.0, 200.0, (80, 2))
    places = np.concatenate([truth.apply(things[:60]), rng.uniform(-150.0, 200.0, (100, 2))])
    codes = np.zeros(80, dtype=np.intp)
    seen = Constellation(things + 0.02 * rng.normal(size=(80, 2)), np.full(80, 0.1), codes, codes)
    motion, agreed, rival = search(seen, places, np.ones((80, 160), dtype=bool))
    assert motion is not None
    assert same(motion, truth, things.mean(axis=0))
    assert agreed > 30 > rival
    assert compared <= 2 * relocation._COMPARISONS
