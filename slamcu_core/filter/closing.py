"""The end of passes: what is worth a report, and where it was seen."""

from __future__ import annotations

from slamcu_core.filter.beliefs import Beliefs
from slamcu_core.filter.beside import Beside
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.passes import PassReporter
from slamcu_core.filter.reunion import Reunion
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.reports import PassReport


class PassClosing:
    """Ends the passes of one drive and reports them."""

    def __init__(
        self,
        table: FeatureTable,
        *,
        management: MapManagement,
        beliefs: Beliefs,
        beside: Beside,
        reporter: PassReporter,
    ) -> None:
        self._table, self._management, self._beliefs = table, management, beliefs
        self._beside, self._reporter = beside, reporter
        self._reunion = Reunion(table, beliefs, beside, management)

    def out_of_view(self, t: float) -> list[PassReport]:
        """End the passes of what has been out of view at t s for the gap that ends a pass."""
        return self._close(self._management.out_of_view(t))

    def all(self) -> list[PassReport]:
        """End every open pass."""
        return self._close(sorted(self._management.open))

    def _close(self, rows: list[int]) -> list[PassReport]:
        if not rows:
            return []
        table, reports = self._table, []
        for row in self._management.end_passes(self._reunion.join(rows)):
            seen = table.detected[row] or table.kind[row] == Kind.NEW
            place = self._beliefs.place(row) if seen else None
            position = None if place is None else self._beliefs.position(place)
            beside = self._beside.weight(row, place)
            if place is not None and position is not None and beside and not self._beside.is_told(row, place[0]):
                reports.append(self._reporter.report_beside(row, position, beside))
            report = self._reporter.report(row, position, beside=beside)
            if self._beside.is_another(row):
                report = None
            if table.kind[row] == Kind.WATCH:
                table.slot[row] = -1
            if report is not None:
                reports.append(report)
        return reports
