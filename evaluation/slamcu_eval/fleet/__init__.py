"""A fleet and its cloud: real vehicles' software in processes of their own, and a real server that they report to."""

from slamcu_eval.fleet.cloud import Cloud
from slamcu_eval.fleet.highway import HighwayDrive
from slamcu_eval.fleet.processes import VehicleError, drive_fleet
from slamcu_eval.fleet.program import Program, ProgramError
from slamcu_eval.fleet.provider import CloudError, Provider
from slamcu_eval.fleet.readback import fused_result, standing_changes
from slamcu_eval.fleet.vehicle import (
    Account,
    DriveSource,
    OpenDrive,
    VehicleJob,
    VehicleOutcome,
    drive_vehicle,
    fetch_map,
)

__all__ = [
    "Account",
    "Cloud",
    "CloudError",
    "DriveSource",
    "HighwayDrive",
    "OpenDrive",
    "Program",
    "ProgramError",
    "Provider",
    "VehicleError",
    "VehicleJob",
    "VehicleOutcome",
    "drive_fleet",
    "drive_vehicle",
    "fetch_map",
    "fused_result",
    "standing_changes",
]
