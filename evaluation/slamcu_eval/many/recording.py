"""What a car told the cloud, kept on disk: a car that has driven need not drive again to be heard by another server.

A recording holds the messages as they went over the wire, the watch features that the car had with its map, and what
it believed by itself at the end. Watch features have ids of their server, so in another server's terms a report about
one is about the candidate at the same place; where there is none the report is left out.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from slamcu_client import Outbox, Server, Uploader
from slamcu_client.outbox import Encode
from slamcu_core.errors import SlamcuError
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import MapFeature
from slamcu_core.reports import PassReport, ReportMessage
from slamcu_core.sensoris import decode_message, encode_batch, serialize_message, split_batch
from slamcu_eval.fleet import Account
from slamcu_eval.score import Claim

_SAME_M = 3.0  # a watch feature of another server within this is the same one
_UPLOAD_TIMEOUT_S = 300.0


@dataclass(frozen=True, slots=True)
class Recording:
    """One car's drive, as far as the cloud and the score are concerned."""

    messages: tuple[ReportMessage, ...]
    watched: tuple[MapFeature, ...]
    claims: tuple[Claim, ...]  # what it says by itself
    oracle: dict[int, tuple[float, float]]  # least squares with the true poses, by index of the sign, m
    pose_rmse_m: float

    def write(self, path: Path) -> None:
        """Write it to `path` with the suffixes .pb and .json; the latter appears last."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_suffix(".pb").write_bytes(encode_batch(self.messages))
        document = {
            "watched": [asdict(feature) for feature in self.watched],
            "claims": [asdict(claim) for claim in self.claims],
            "oracle": self.oracle,
            "pose_rmse_m": self.pose_rmse_m,
        }
        part = path.with_suffix(".part")
        part.write_text(json.dumps(document), encoding="utf-8")
        part.replace(path.with_suffix(".json"))

    @classmethod
    def read(cls, path: Path) -> Recording | None:
        """Read a recording; None if there is none. Raises SlamcuError where it is damaged."""
        if not path.with_suffix(".json").exists():
            return None
        try:
            document = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
            reports = [decode_message(body) for body in split_batch(path.with_suffix(".pb").read_bytes())]
            return cls(
                messages=tuple(reports),
                watched=tuple(MapFeature(**entry) for entry in document["watched"]),
                claims=tuple(claim_from(entry) for entry in document["claims"]),
                oracle={int(key): (xy[0], xy[1]) for key, xy in document["oracle"].items()},
                pose_rmse_m=document["pose_rmse_m"],
            )
        except (SlamcuError, ValueError, TypeError, KeyError, OSError) as error:
            raise SlamcuError(f"{path}: no usable recording ({error}); remove it to drive again") from error

    def tell(self, account: Account, now_watched: Sequence[MapFeature]) -> int:
        """Send the messages through a client's outbox and return how many passes they hold."""
        account.folder.mkdir(parents=True, exist_ok=True)
        names = translation(self.watched, now_watched)
        messages = [
            replace(message, passes=tuple(one for one in (_translated(p, names) for p in message.passes) if one))
            for message in self.messages
        ]
        with (
            Server(account.url, account.key) as server,
            Outbox(account.folder / "outbox.sqlite") as outbox,
        ):
            for message in messages:
                outbox.put(message.session_id, [_encoder(message)])
            result = Uploader(outbox, server, rng=np.random.default_rng(0)).flush(_UPLOAD_TIMEOUT_S)
        if result.remaining or result.rejected:
            raise SlamcuError(f"{result.remaining} messages were not taken, {result.rejected} were refused")
        return sum(len(message.passes) for message in messages)


def _encoder(message: ReportMessage) -> Encode:
    return lambda number: serialize_message(replace(message, message_id=number))


def translation(before: Sequence[MapFeature], now: Sequence[MapFeature]) -> dict[int, MapFeature]:
    """Return by id which watch feature of another server each one is: the nearest of its type within reach."""
    if not before or not now:
        return {}
    frame = LocalFrame(before[0].lon, before[0].lat)
    there = frame.to_local([one.lon for one in now], [one.lat for one in now])
    names = {}
    for one in before:
        same = np.array([other.sign in (None, one.sign) and other.value in (None, one.value) for other in now])
        distance = np.where(same, np.hypot(*(there - frame.to_local(one.lon, one.lat)).T), np.inf)
        if distance.min() <= _SAME_M:
            names[one.object_id] = now[int(distance.argmin())]
    return names


def _translated(report: PassReport, names: dict[int, MapFeature]) -> PassReport | None:
    if report.reference is None or not report.reference.watched:
        return report
    other = names.get(report.reference.object_id)
    if other is None:
        return None
    return replace(report, reference=replace(report.reference, tile_id=other.tile_id, object_id=other.object_id))


def claim_from(entry: dict[str, Any]) -> Claim:
    """Read a claim that `dataclasses.asdict` wrote."""
    xy, covariance = entry["place"], entry["covariance"]
    spread = None if covariance is None else (covariance[0], covariance[1], covariance[2])
    return Claim(**{**entry, "place": (xy[0], xy[1]), "covariance": spread})
