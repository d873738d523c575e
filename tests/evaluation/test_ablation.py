"""The ablation: parts are really replaced and really put back, and changes are paired by drive."""

from __future__ import annotations

import re
from importlib import import_module

import numpy as np
import pytest

from slamcu_core.errors import SlamcuError
from slamcu_core.filter import FilterParameters
from slamcu_eval.ablation import FULL, VARIANTS, Cell, ablation_figures, run_ablation
from slamcu_eval.ablation.parts import each_by_itself, replaced
from slamcu_eval.cli import run
from slamcu_eval.highway import HighwayParameters
from slamcu_eval.paper import Outcome, Run, run_filter
from slamcu_eval.score import Score

SHORT = HighwayParameters().having(length_m=1_200.0, normal=4, deleted=2, new=3, encounter_interval_s=8.0)
# On a simulated motorway, and in so short a drive, these need not change anything.
MAY_CHANGE_NOTHING = {"motion_prior", "greedy_association", "deleted_weigh", "moving_signs", "no_jitter"}
MAY_CHANGE_NOTHING |= {"no_riders", "no_recovery", "per_particle_association"}


def _part(where: str, name: str) -> object:
    module, _, owner = where.partition(":")
    holder = import_module(module)
    return getattr(getattr(holder, owner) if owner else holder, name)


@pytest.fixture(scope="module")
def short() -> tuple[Run, Outcome]:
    drive = Run.simulate(4, 0, SHORT)
    return drive, run_filter(drive, FilterParameters(particles=30))


@pytest.mark.parametrize("name", [name for name in VARIANTS if name not in {FULL, "particles_500"}])
def test_each_variant_runs_and_leaves_the_filter_as_it_was(name: str, short: tuple[Run, Outcome]) -> None:
    drive, full = short
    variant = VARIANTS[name]
    before = [_part(where, part) for where, part, _ in variant.swaps]
    with replaced(variant.swaps):
        assert [_part(where, part) for where, part, _ in variant.swaps] == [part for _, _, part in variant.swaps]
        outcome = run_filter(drive, variant.change(FilterParameters(particles=30)))
    assert [_part(where, part) for where, part, _ in variant.swaps] == before
    assert len(outcome.score.said) == 9
    assert np.isfinite(outcome.pose_errors_m).all()
    if name not in MAY_CHANGE_NOTHING:
        assert outcome.pose_errors_m != full.pose_errors_m or outcome.records != full.records


def test_after_an_ablation_the_filter_gives_what_it_gave_before(short: tuple[Run, Outcome]) -> None:
    drive, full = short
    for variant in VARIANTS.values():
        with replaced(variant.swaps):
            pass
    assert run_filter(drive, FilterParameters(particles=30)).records == full.records


def test_a_part_that_the_filter_does_not_have_is_an_error_and_nothing_stays_replaced() -> None:
    first = ("slamcu_core.filter.proposal", "pays", None)
    pays = _part(*first[:2])
    unknown = ("slamcu_core.filter.proposal", "pays_off", None)
    with pytest.raises(SlamcuError, match=r"no slamcu_core\.filter\.proposal\.pays_off"), replaced((first, unknown)):
        pytest.fail("the block must not run")
    assert _part(*first[:2]) is pays


def test_the_printed_association_lets_two_detections_claim_one_feature() -> None:
    score = np.array([[2.0, 1.0], [3.0, -np.inf], [-1.0, -2.0]])
    assert each_by_itself(score).tolist() == [0, 0, -1]
    assert each_by_itself(np.empty((2, 0))).tolist() == [-1, -1]


def _cell(variant: str, drive: str, right: int) -> Cell:
    said = tuple(("normal", "normal" if i < right else "deleted") for i in range(10))
    return Cell(variant, "motorway", drive, Score(said, (), (), 0), 1.0, False, 0.5)


def test_a_change_is_measured_drive_by_drive() -> None:
    cells = [_cell(FULL, "a", 10), _cell("no_jitter", "a", 8), _cell(FULL, "b", 4), _cell("no_jitter", "b", 2)]
    figures = ablation_figures(cells)["motorway"]
    assert figures[FULL]["accuracy"] == pytest.approx(0.7)
    assert figures[FULL]["accuracy_change"] == 0.0
    assert figures["no_jitter"]["accuracy_change"] == pytest.approx(-0.2)
    # the drives differ by far, the change does not
    assert figures["no_jitter"]["accuracy_change_ci95"] == pytest.approx([-0.2, -0.2])


def test_the_number_of_jobs_changes_nothing() -> None:
    options = {"drives": 2, "seed": 5, "particles": 20, "parameters": SHORT}
    one = run_ablation([FULL, "no_jitter"], jobs=1, **options)
    two = run_ablation([FULL, "no_jitter"], jobs=2, **options)
    assert [(c.variant, c.drive, c.score, c.pose_rmse_m) for c in one] == [
        (c.variant, c.drive, c.score, c.pose_rmse_m) for c in two
    ]


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--only", "magic"], "--only takes full, .*; not magic"),
        (["--drives", "0"], "leaves nothing to run"),
    ],
)
def test_bad_options_get_one_clear_line(options: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ablation", *options]) == 1
    assert re.search(complaint, capsys.readouterr().err.replace("\n", " "))
