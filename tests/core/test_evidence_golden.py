"""The errata's golden sequence, and the scenarios of the paper's Figure 8."""

from __future__ import annotations

from fractions import Fraction

import pytest

from slamcu_core.evidence import Existence, Masses, dempster, support

Triple = tuple[Fraction, Fraction, Fraction]

# m(not exists) after each of 17 misses that follow 20 confirmations, all at λ = 0.9 on λ_HD = 0.95: exactly
# (10ᵏ - 1) / (2·10²¹ + 10ᵏ - 1)
GOLDEN_NOT_EXISTS = (
    4.5e-21,
    4.95e-20,
    4.995e-19,
    4.9995e-18,
    4.99995e-17,
    4.999994999999998e-16,
    4.999999499999975e-15,
    4.99999994999975e-14,
    4.9999999949975e-13,
    4.999999999475e-12,
    4.9999999997e-11,
    4.999999997495e-10,
    4.9999999749995e-09,
    4.9999997499999625e-08,
    4.999997500001245e-07,
    4.999975000124999e-06,
    4.999750012499375e-05,
)


def _exact(one: Triple, other: Triple) -> Triple:
    """Combine by eq. 5-7 as printed, in rational arithmetic, where nothing cancels."""
    e = one[0] * other[0] + one[0] * other[2] + one[2] * other[0]
    n = one[1] * other[1] + one[1] * other[2] + one[2] * other[1]
    u = one[2] * other[2]
    not_empty = 1 - (one[0] * other[1] + one[1] * other[0])
    return e / not_empty, n / not_empty, u / not_empty


def _golden_reports() -> list[tuple[Masses, Triple]]:
    lam = Fraction(9, 10)
    seen = (Masses.detected(0.9), (lam, Fraction(0), 1 - lam))
    missed = (Masses.missed(0.9), (Fraction(0), lam, 1 - lam))
    return [seen] * 20 + [missed] * 17


def test_twenty_confirmations_and_seventeen_misses_stay_legal_and_exact() -> None:
    by_rule, exact = Masses.detected(0.95), (Fraction(19, 20), Fraction(0), Fraction(1, 20))
    f, a = float(support(0.95)), 0.0
    not_exists = []
    for report, exact_report in _golden_reports():
        by_rule, exact = dempster(by_rule, report), _exact(exact, exact_report)
        f, a = f + report.weights[0], a + report.weights[1]
        for masses in (by_rule, Masses.from_weights(f, a)):
            assert 0.0 <= masses.exists <= 1.0
            assert 0.0 <= masses.not_exists <= 1.0
            assert 0.0 < masses.unknown <= 1.0
            assert (masses.exists, masses.not_exists, masses.unknown) == pytest.approx(
                tuple(map(float, exact)), rel=1e-12, abs=0.0
            )
        if report.not_exists:
            not_exists.append(by_rule.not_exists)
    assert not_exists == pytest.approx(GOLDEN_NOT_EXISTS, rel=1e-12, abs=0.0)
    assert float(exact[2]) == pytest.approx(4.999750012499375e-22, rel=1e-15)


def test_the_rule_as_printed_would_lose_nearly_all_mass_on_the_golden_sequence() -> None:
    # why eq. 6 is not implemented with 1 - m(∅): in doubles the difference is mostly rounding error by then
    masses = (0.95, 0.0, 1.0 - 0.95)
    for report, _ in _golden_reports():
        other = (report.exists, report.not_exists, report.unknown)
        not_empty = 1.0 - (masses[0] * other[1] + masses[1] * other[0])
        masses = (
            (masses[0] * other[0] + masses[0] * other[2] + masses[2] * other[0]) / not_empty,
            (masses[1] * other[1] + masses[1] * other[2] + masses[2] * other[1]) / not_empty,
            masses[2] * other[2] / not_empty,
        )
    assert abs(sum(masses) - 1.0) > 0.5


def _course(start: Masses, reports: list[Masses]) -> list[Existence]:
    masses, states = start, [start.state]
    for report in reports:
        masses = dempster(masses, report)
        states.append(masses.state)
    return states


def test_figure_8_deletion_is_not_changed_by_an_outlier_at_step_4() -> None:
    reports = [Masses.missed(0.9)] * 10
    clean = _course(Masses.detected(0.95), reports)
    outlier = _course(Masses.detected(0.95), [*reports[:3], Masses.detected(0.9), *reports[4:]])
    assert clean[:2] == [Existence.EXISTENT, Existence.EXISTENT]  # one miss does not delete a mapped feature
    assert clean[2:] == [Existence.NON_EXISTENT] * 9
    assert outlier[-1] is clean[-1] is Existence.NON_EXISTENT


def test_figure_8_creation_is_not_changed_by_an_outlier_at_step_4() -> None:
    reports = [Masses.detected(0.9)] * 10
    clean = _course(Masses.vacuous(), reports)
    outlier = _course(Masses.vacuous(), [*reports[:3], Masses.missed(0.9), *reports[4:]])
    assert clean == [Existence.TENTATIVE] + [Existence.EXISTENT] * 10
    assert outlier == clean


def test_figure_8_masses_around_the_outlier() -> None:
    # closed form: deletion after three misses (Z = 20 + 10³ - 1), then one detection (Z = 200 + 10³ - 1)
    masses = Masses.detected(0.95)
    for _ in range(3):
        masses = dempster(masses, Masses.missed(0.9))
    assert masses.not_exists == pytest.approx(999 / 1019, abs=1e-12)
    masses = dempster(masses, Masses.detected(0.9))
    assert masses.not_exists == pytest.approx(999 / 1199, abs=1e-12)
    assert masses.exists == pytest.approx(199 / 1199, abs=1e-12)


def test_a_tie_is_tentative() -> None:
    assert Masses.from_weights(3.0, 3.0).state is Existence.TENTATIVE
    assert Masses(0.5, 0.0, 0.5).state is Existence.TENTATIVE
