"""Passes: one continuous stay of a feature in a sensor's view, and the report that ends it (design: evidence law)."""

from __future__ import annotations

from datetime import datetime, timedelta

from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.hd_map import HDMap
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport


def pass_status(kind: int, weight_for: float, weight_against: float, detected: int, missed: int) -> DetectionStatus:
    """Return how SENSORIS calls the outcome of a pass."""
    if detected and weight_for >= weight_against:
        if kind == Kind.NEW:
            return DetectionStatus.NOT_EXPECTED_AND_DETECTED
        return DetectionStatus.EXPECTED_AND_DETECTED
    if missed or detected:
        return DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
    return DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED


class PassReporter:
    """Turns closed passes of the feature table into reports."""

    def __init__(self, table: FeatureTable, hd_map: HDMap, start_time: datetime, names: Vocabulary) -> None:
        self._table, self._map, self._start, self._names = table, hd_map, start_time, names

    def report(self, row: int, place: MeasuredPosition | None, *, beside: float = 0.0) -> PassReport | None:
        """Return the report of a row's open pass and close it; None if a find of our own was hidden throughout.

        Where what it saw stands beside the row's place, by a weight of evidence `beside`, that speaks against the row.

        A pass in which the feature was hidden throughout is vacuous: the little that its chance of being seen left as
        evidence against it is dropped.
        """
        table = self._table
        table.open[row] = False
        kind = int(table.kind[row])
        f, a = float(table.pass_for[row]), float(table.pass_against[row])
        if beside:
            f, a = 0.0, a + min(f, beside)
        detected, missed = int(table.detected[row]), int(table.missed[row])
        status = pass_status(kind, f, a, detected, missed)
        if status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED:
            if kind == Kind.NEW:
                return None
            f = a = 0.0
        reference = None
        sign, value = self._names.name(int(table.sign[row])), self._names.name(int(table.value[row]))
        if kind != Kind.NEW:
            feature = self._map.features[int(table.source[row])]
            reference = MapReference(feature.tile_id, feature.object_id)
            sign, value = feature.sign, feature.value
        return PassReport(
            started_at=self._start + timedelta(seconds=float(table.pass_start[row])),
            ended_at=self._start + timedelta(seconds=float(table.pass_last[row])),
            status=status,
            weight_for=f,
            weight_against=a,
            feature_class=self._names.name(int(table.feature_class[row])) or "",
            sign=sign,
            value=value,
            reference=reference,
            position=place,
            frames_detected=detected,
            frames_missed=missed,
            frames_blocked=int(table.blocked[row]),
        )

    def report_beside(self, row: int, place: MeasuredPosition, weight: float) -> PassReport:
        """Return the report of what the last pass of a row saw beside the row's place, as a find of our own.

        Its evidence is at most the weight of evidence that it stands there and not in the row's place.
        """
        table = self._table
        return PassReport(
            started_at=self._start + timedelta(seconds=float(table.pass_start[row])),
            ended_at=self._start + timedelta(seconds=float(table.pass_last[row])),
            status=DetectionStatus.NOT_EXPECTED_AND_DETECTED,
            weight_for=min(float(table.pass_for[row]), weight),
            weight_against=0.0,
            feature_class=self._names.name(int(table.feature_class[row])) or "",
            sign=self._names.name(int(table.sign[row])),
            value=self._names.name(int(table.value[row])),
            position=place,
            frames_detected=int(table.detected[row]),
        )
