"""Drives along a simulated motorway for a fleet's vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np

from slamcu_eval.fleet.vehicle import OpenDrive
from slamcu_eval.highway import HighwayParameters, make_drive, make_world


@dataclass(frozen=True, slots=True)
class HighwayDrive:
    """A drive along a simulated motorway, simulated in the process that drives it."""

    seed: int
    vehicle: int
    parameters: HighwayParameters
    departure: datetime | None = None  # None: 20 s after the vehicle before it

    def open(self) -> OpenDrive:
        """Simulate the drive."""
        world = make_world(self.seed, self.parameters.world)
        drive = make_drive(world, self.seed, self.vehicle, self.parameters, departure=self.departure)
        truth = np.column_stack([drive.reference.t, drive.reference.lon, drive.reference.lat])
        return OpenDrive(drive.header, drive.records, truth)

    @property
    def filter_seed(self) -> int:
        """The seed of this vehicle's filter."""
        return int(np.random.SeedSequence([self.seed, 2, self.vehicle]).generate_state(1)[0])

    def __str__(self) -> str:
        return f"car {self.vehicle + 1}"
