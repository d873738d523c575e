"""The robots of recorded sessions as vehicles: which ones there are, what each drives, and with what filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slamcu_core.filter import FilterParameters
from slamcu_core.hd_map import HDMap
from slamcu_eval.fleet import Account, OpenDrive, VehicleJob
from slamcu_eval.mrclam.edits import TrueFeature, edit_map
from slamcu_eval.mrclam.files import ROBOTS, read_landmarks, session_folder
from slamcu_eval.mrclam.runs import ARENA, load_run
from slamcu_eval.score import Fact


@dataclass(frozen=True, slots=True)
class Setting:
    """What is evaluated: the options of the command."""

    directory: Path
    sessions: tuple[int, ...] = (2, 4)
    duration: float = 600.0  # s
    begin: float = 0.0  # s into the recording
    edits: int = 3  # wrong maps per session
    seed: int = 0
    particles: int = 100


@dataclass(frozen=True, slots=True)
class Edit:
    """One wrong map of one session: what a fleet of robots is scored on."""

    session: int
    number: int
    hd_map: HDMap
    truth: tuple[TrueFeature, ...]

    @property
    def name(self) -> str:
        """The map's name on the server."""
        return self.hd_map.identity.source

    @property
    def facts(self) -> list[Fact]:
        """What is true, in the frame of the arena."""
        return [Fact(feature.truth, (feature.x, feature.y), feature.object_id) for feature in self.truth]


@dataclass(frozen=True, slots=True)
class RobotDrive:
    """A robot's recording, opened in the process that drives it."""

    setting: Setting
    session: int
    robot: int
    edit: int

    def open(self) -> OpenDrive:
        """Load the recording, with a start error of its own."""
        rng = np.random.default_rng((self.setting.seed, self.session, self.edit, self.robot))
        header, records, reference = load_run(
            self.setting.directory,
            self.session,
            self.robot,
            self.setting.duration,
            begin=self.setting.begin,
            rng=rng,
        )
        header = replace(header, session_id=f"{header.session_id}-edit-{self.edit}")
        truth = np.column_stack([reference[:, 0], *ARENA.to_geographic(reference[:, 1:3])])
        return OpenDrive(header, records, truth)

    def __str__(self) -> str:
        return f"session {self.session}, edit {self.edit}, robot {self.robot}"


def edits_of(setting: Setting) -> list[Edit]:
    """Draw the wrong maps of all sessions; raise FormatError if a session is not there or not readable."""
    found = []
    for session in setting.sessions:
        landmarks = read_landmarks(session_folder(setting.directory, session))
        for number in range(1, setting.edits + 1):
            name = f"mrclam-{session}-edit-{number}"
            found.append(Edit(session, number, *edit_map(landmarks, (setting.seed, session, number), source=name)))
    return found


def robots_of(setting: Setting, session: int) -> tuple[int, ...]:
    """Return which robots took part in a session."""
    folder = session_folder(setting.directory, session)
    return tuple(robot for robot in ROBOTS if (folder / f"Robot{robot}_Measurement.dat").exists())


def job_of(setting: Setting, edit: Edit, robot: int, hd_map: HDMap, account: Account | None) -> VehicleJob:
    """Return what one robot is to do with one wrong map."""
    drive = RobotDrive(setting, edit.session, robot, edit.number)
    entropy = np.random.SeedSequence([setting.seed, edit.session, edit.number, robot])
    parameters = FilterParameters.robot(particles=setting.particles)
    return VehicleJob(drive, int(entropy.generate_state(1)[0]), hd_map, account, parameters)
