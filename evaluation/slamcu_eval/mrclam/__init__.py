"""Recorded robots: UTIAS MRCLAM drives against maps that are wrong on purpose."""

from slamcu_eval.mrclam.edits import TrueFeature, edit_map
from slamcu_eval.mrclam.files import MissingRecordingError, read_landmarks, session_folder
from slamcu_eval.mrclam.runs import ARENA, RunParameters, load_run

__all__ = [
    "ARENA",
    "MissingRecordingError",
    "RunParameters",
    "TrueFeature",
    "edit_map",
    "load_run",
    "read_landmarks",
    "session_folder",
]
