"""How large and how long the story is."""

from __future__ import annotations

from dataclasses import dataclass

from slamcu_eval.highway import HighwayParameters


@dataclass(frozen=True, slots=True)
class Plan:
    """The road, the cars and the faults.

    The faults come at shares of the time that the first fleet is on the road, the last while it is still driving.
    """

    seed: int = 7
    cars: int = 6  # of the first fleet
    second_cars: int = 3  # of the second
    length_km: float = 2.0
    normal: int = 8
    deleted: int = 2
    new: int = 3
    moved: int = 1
    modified: int = 1
    pace: float = 3.5  # times the speed at which the drives were recorded
    second_pace: float = 5.0  # of the second fleet
    kills: tuple[tuple[float, str], ...] = ((0.35, "api-1"), (0.45, "worker-1"), (0.55, "database"))
    cut_at: float = 0.65
    cut_s: float = 4.0
    patience_s: float = 180.0  # for anything to become so

    @property
    def road(self) -> HighwayParameters:
        """The simulation's parameters."""
        return HighwayParameters().having(
            length_m=1e3 * self.length_km,
            normal=self.normal,
            deleted=self.deleted,
            new=self.new,
            moved=self.moved,
            modified=self.modified,
        )
