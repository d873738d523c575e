"""Files: drive logs, HD maps, truth and results. Readers take lines or chunks; opening files is the caller's."""

from slamcu_core.formats.drive_log import read_drive_log, write_drive_log
from slamcu_core.formats.hd_map import HDMapReader, load_hd_map, map_properties, read_hd_map, write_hd_map
from slamcu_core.formats.lanelet2 import Lanelet2Reader, read_lanelet2
from slamcu_core.formats.results import (
    ChangeState,
    ResultFeature,
    TruthFeature,
    read_results,
    read_truth,
    write_results,
    write_truth,
)

__all__ = [
    "ChangeState",
    "HDMapReader",
    "Lanelet2Reader",
    "ResultFeature",
    "TruthFeature",
    "load_hd_map",
    "map_properties",
    "read_drive_log",
    "read_hd_map",
    "read_lanelet2",
    "read_results",
    "read_truth",
    "write_drive_log",
    "write_hd_map",
    "write_results",
    "write_truth",
]
