"""The search for the way back: right in a crowd, and never long."""

from __future__ import annotations

import numpy as np
import pytest

from slamcu_core.filter import relocation
from slamcu_core.filter.relocation import Constellation, Memory, Motion, Sightings, same, search


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


def test_a_constellation_holds_each_thing_once_and_nothing_that_was_seen_once() -> None:
    memory, rng = Memory(20.0), np.random.default_rng(1)
    # two things a metre apart, a third of another sign between them, and clutter that never comes again
    things, signs = np.array([[10.0, 2.0], [11.0, 2.0], [10.5, 2.0]]), np.array([1, 1, 2])
    for frame in range(6):
        seen = rng.random(3) < 0.8 if frame > 1 else np.ones(3, dtype=bool)
        place = np.concatenate(
            [things[seen] + rng.normal(0.0, 0.05, (int(seen.sum()), 2)), rng.uniform(50.0, 1e4, (1, 2))]
        )
        sign = np.append(signs[seen], 1)
        heading = 0.3 * frame  # the car turns where it stands
        cos, sin = np.cos(heading), np.sin(heading)
        ahead_left = np.array([[cos, sin], [-sin, cos]]) @ (place - [4.0, 5.0]).T
        std, kind = np.full(len(sign), 0.1), np.zeros(len(sign), dtype=np.intp)
        memory.add(Sightings(float(frame), np.array([4.0, 5.0, heading]), ahead_left, std, kind, sign))
    found = memory.constellation()
    order = np.lexsort([found.place[:, 0], found.sign])
    assert found.sign[order].tolist() == [1, 1, 2]
    assert found.place[order] == pytest.approx(things, abs=0.15)
    assert (found.std < 0.1).all()  # several sightings know it better than one


def test_a_memory_without_sightings_has_no_constellation() -> None:
    assert not len(Memory(20.0).constellation().place)


def test_a_motion_fitted_to_places_is_the_one_that_moved_them() -> None:
    truth, places = Motion(-0.4, np.array([3.0, 7.0])), np.random.default_rng(5).uniform(-10.0, 10.0, (6, 2))
    fitted = Motion.fitted(places, truth.apply(places))
    assert fitted.angle == pytest.approx(truth.angle)
    assert fitted.shift == pytest.approx(truth.shift)
    pose = np.array([*truth.apply(places[0]), truth.angle + 0.2])
    between = Motion.between(np.array([*places[0], 0.2]), pose)
    assert (between.angle, *between.shift) == pytest.approx((truth.angle, *truth.shift))
