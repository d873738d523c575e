"""Hold the feed against the truth: what was false in it, how long that stood, and when the truth was told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from slamcu_eval.attack.world import FRAME, Truth, World
from slamcu_eval.fleet import Cloud

NEAR_M = 3.0
"""A new sign is the true one within this (evaluation of the motorway)."""


@dataclass
class Flip:
    """Something false that the feed said: a change that is none, or that a true one is none."""

    kind: str
    published_after: int  # honest drives until then
    healed_after: int | None = None  # honest drives until it was taken back


@dataclass(frozen=True, slots=True)
class Decision:
    """A true change when it was first confirmed."""

    kind: str
    contributors: int
    drives: int  # from the first


class Feed:
    """The feed of one world's changes, read after every drive."""

    def __init__(self, cloud: Cloud, world: World) -> None:
        self._cloud, self._world = cloud, world
        self._after = 0
        self._honest = self._drives = 0
        self._confirmed: dict[int, bool] = {}  # changes that were confirmed before, and whether they are true
        self._open: dict[int, Flip] = {}  # by change
        self.flips: list[Flip] = []
        self.decisions: list[Decision] = []

    @property
    def standing(self) -> int:
        """How many flips stand now."""
        return len(self._open)

    def read(self, *, honest: bool) -> None:
        """Read what has been said since, after one more drive."""
        self._drives += 1
        self._honest += honest
        query = {"map": self._world.name, "after": str(self._after), "limit": "1000"}
        for page in self._cloud.pages("/v1/changes", query):
            for entry in page["entries"]:
                self._take(entry["change"])
            self._after = page["last_sequence"]

    def _take(self, change: dict[str, Any]) -> None:
        number, state = change["id"], change["state"]
        true = self._is_true(change)
        if state == "confirmed":
            if true and number not in self._confirmed:
                self._decide(change)
            self._confirmed[number] = true
        flipped = state == "confirmed" if not true else self._taken_back(change)
        if flipped and number not in self._open:
            self._open[number] = Flip(change["kind"] if not true else "withdrawn", self._honest)
            self.flips.append(self._open[number])
        elif not flipped and number in self._open:
            self._open.pop(number).healed_after = self._honest

    def _taken_back(self, change: dict[str, Any]) -> bool:
        merged = change.get("merged_into") is not None
        return change["state"] == "withdrawn" and self._confirmed.get(change["id"], False) and not merged

    def _is_true(self, change: dict[str, Any]) -> bool:
        if change["kind"] == "deleted":
            gone = {site.object_id for site in self._world.of(Truth.DELETED)}
            return change["map_object_id"] in gone
        if change["kind"] == "new":
            place = FRAME.to_local(*change["geometry"]["coordinates"][:2])
            return any(np.hypot(*(place - site.xy)) <= NEAR_M for site in self._world.of(Truth.NEW))
        return False  # nothing has moved here, or been modified

    def _decide(self, change: dict[str, Any]) -> None:
        spoke = change["contributors_for" if change["kind"] == "new" else "contributors_against"]
        self.decisions.append(Decision(change["kind"], spoke, self._drives))
