"""The attack experiment: it finds what is false, honest cars are as bad as the model says, liars lie as they agreed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcu_core.hd_map import MapFeature
from slamcu_core.reports import DetectionStatus
from slamcu_eval.attack.cars import Car, PassModel
from slamcu_eval.attack.experiment import COUNTS
from slamcu_eval.attack.judging import Feed
from slamcu_eval.attack.liars import ATTACKS, LIE, TARGETS, denying, hiding, honest, inventing
from slamcu_eval.attack.operator import Operator
from slamcu_eval.attack.run import Driver, Road
from slamcu_eval.attack.world import FRAME, Truth, World, make_world
from slamcu_eval.cli import run
from slamcu_eval.fleet import Cloud

BEGIN = datetime(2026, 5, 1, tzinfo=UTC)


@pytest.fixture
def world() -> World:
    return make_world("w", COUNTS, np.random.default_rng(1))


def test_honest_cars_err_as_often_as_the_model_says(world: World) -> None:
    car = Car("car", np.random.default_rng(2))
    passes = [item for _ in range(300) for item in car.drive(world, [], BEGIN)]
    there = {site.object_id for site in world.of(Truth.UNCHANGED)}
    about = [item for item in passes if item.reference is not None and item.reference.object_id in there]
    missed = [item for item in about if item.status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE]
    hidden = [item for item in about if item.status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED]
    assert len(missed) / len(about) == pytest.approx(0.05, abs=0.008)
    assert len(hidden) / len(about) == pytest.approx(0.02, abs=0.005)
    places = np.array([FRAME.to_local(p.position.lon, p.position.lat) for p in passes if p.position and p.reference])
    nearest = [min(np.hypot(*(place - site.xy)) for site in world.sites) for place in places[:2000]]
    assert np.mean(nearest) > 0.5


def test_a_car_answers_for_each_watch_feature_once(world: World) -> None:
    new, empty = world.of(Truth.NEW)[0], world.of(Truth.EMPTY)[0]
    watches = []
    for number, site in enumerate((new, empty), 1):
        lon, lat = FRAME.to_geographic(site.xy)
        watches.append(MapFeature(number, float(lon), float(lat), tile_id=-1))
    passes = Car("car", np.random.default_rng(3)).drive(world, watches, BEGIN)
    watched = [item for item in passes if item.reference is not None and item.reference.watched]
    assert sorted(item.reference.object_id for item in watched if item.reference) == [1, 2]


def test_liars_say_the_same_of_the_same_targets_and_the_truth_elsewhere(world: World) -> None:
    cars = [Car(f"liar-{number}", np.random.default_rng(number)) for number in range(2)]
    targets = {site.object_id for site in world.of(Truth.UNCHANGED)[:TARGETS]}
    for car in cars:
        (sent,) = denying(car, world, [], BEGIN, "drive")
        said = [item for item in sent.passes if item.reference and item.reference.object_id in targets]
        assert len(said) == TARGETS
        assert all(item.weight_against > 4.0 and item.weight_for == 0.0 for item in said)
        assert len(sent.passes) > 2 * TARGETS
    assert {name: len(script(cars[0], world, [], BEGIN, "d")) for name, script in ATTACKS.items()} == {
        "inventing": 1,
        "denying": 1,
        "hiding": 1,
        "shifting": 1,
        "flooding": 48,
        "replaying": 144,
        "minting": 48,
        "doubting": 1,
        "lost": 1,
        "astray": 1,
    }


def test_who_hides_new_signs_misses_what_is_watched_of_them_and_finds_none(world: World) -> None:
    new, empty = world.of(Truth.NEW), world.of(Truth.EMPTY)[0]
    watches = []
    for number, site in enumerate((*new, empty), 1):
        lon, lat = FRAME.to_geographic(site.xy)
        watches.append(MapFeature(number, float(lon), float(lat), tile_id=-1))
    for told in ([], watches):
        (sent,) = hiding(Car("liar", np.random.default_rng(5), PassModel(clutter=0.0)), world, told, BEGIN, "drive")
        assert not [item for item in sent.passes if item.status is DetectionStatus.NOT_EXPECTED_AND_DETECTED]
        about = [item for item in sent.passes if item.reference and item.reference.watched]
        lies = [item for item in about if item.weight_against == LIE]
        assert len(about) == len(told)
        assert [item.reference.object_id for item in lies if item.reference] == list(range(1, len(told)))


class _Told:
    """A feed that was told before."""

    def __init__(self) -> None:
        self.changes: list[dict[str, Any]] = []

    def pages(self, *_: object) -> Iterator[dict[str, Any]]:
        yield {"entries": [{"change": change} for change in self.changes], "last_sequence": 0}


def test_false_changes_and_true_ones_taken_back_are_flips_until_they_heal(world: World) -> None:
    told = _Told()
    feed = Feed(told, world)  # type: ignore[arg-type]
    gone, there = world.of(Truth.DELETED)[0].object_id, world.of(Truth.UNCHANGED)[0].object_id

    def say(number: int, object_id: int | None, state: str) -> dict[str, Any]:
        return {"id": number, "kind": "deleted", "state": state, "map_object_id": object_id, "contributors_against": 4}

    for changes, standing in (
        ([say(1, gone, "candidate"), say(2, there, "candidate")], 0),
        ([say(1, gone, "confirmed"), say(2, there, "confirmed")], 1),
        ([say(1, gone, "withdrawn")], 2),
        ([say(2, there, "withdrawn"), say(1, gone, "confirmed")], 0),
    ):
        told.changes = changes
        feed.read(honest=True)
        assert feed.standing == standing
    assert [(flip.kind, flip.published_after, flip.healed_after) for flip in feed.flips] == [
        ("deleted", 2, 4),
        ("withdrawn", 3, 4),
    ]
    assert [(one.contributors, one.drives) for one in feed.decisions] == [(4, 2)]


def test_three_strangers_can_publish_what_honest_cars_then_take_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a real server: the experiment is able to find a flip, and to see it heal."""
    # the user's own server, which an evaluation must not touch
    monkeypatch.setenv("SLAMCU_DATABASE_URL", "postgresql://nobody@nowhere.invalid/none")
    rng = np.random.default_rng(4)
    few = make_world("few", {Truth.UNCHANGED: 2, Truth.NEW: 1, Truth.EMPTY: 2}, rng)
    with Cloud() as cloud, Operator(cloud) as operator:
        keys = cloud.create_keys("vehicle", 7)
        scripts = [*[inventing] * 3, *[honest] * 4]
        drivers = [
            Driver(Car(f"car-{number}", rng.spawn(1)[0]), key, script)
            for number, (key, script) in enumerate(zip(keys, scripts, strict=True))
        ]
        road = Road(cloud, operator, few, len(drivers))
        for driver in drivers:
            road.drive(driver)
    assert [(flip.kind, flip.healed_after is not None) for flip in road.feed.flips] == [("new", True)] * 2
    assert road.feed.standing == 0
    assert [one.kind for one in road.feed.decisions] == ["new"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("--only", "bribing"), "there is no attack 'bribing'"), (("--colluding", "40"), "at most half may lie")],
)
def test_what_cannot_be_run_is_said_in_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(["attack", *arguments, "--json", str(tmp_path / "out.json")]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out.json").exists()


def test_the_committed_results_are_of_the_stated_size() -> None:
    figures = json.loads((Path(__file__).parents[3] / "docs/results/attack.json").read_text(encoding="utf-8"))
    assert figures["vehicles"] >= 60
    assert figures["colluding"] >= 3
    assert figures["attacks"].keys() == ATTACKS.keys()
    assert all(orders.keys() == {"random", "liars_first"} for orders in figures["attacks"].values())
