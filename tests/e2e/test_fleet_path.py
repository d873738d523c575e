"""The whole path with a small fleet: real sessions, outboxes and uploaders, a real server, PostGIS."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamcu_client import Outbox, ReportPolicy, RetryPolicy, Server, Uploader, UploadPolicy, VehicleSession
from slamcu_eval.demo.drive import prepare_fleet, road_of, run_fleet
from slamcu_eval.demo.review import accept_best
from slamcu_eval.fleet import Cloud, VehicleJob

VEHICLES, SEED = 4, 3
ROAD = road_of(2.5)


@pytest.mark.slow
def test_a_fleet_s_reports_are_stored_once_and_fused_as_they_fold(look_into: Callable[[Cloud], Any]) -> None:
    with Cloud() as cloud:
        world, jobs = prepare_fleet(cloud, SEED, ROAD, VEHICLES, cloud.scratch)
        result = run_fleet(cloud, world, jobs, lambda _vehicle, _share: None)
        stored = look_into(cloud)
        acknowledged = sum(outcome.upload.accepted for outcome in result.outcomes if outcome.upload)

        assert acknowledged == len(stored.messages) > VEHICLES
        assert set(stored.messages.values()) == {1}
        assert stored.states == {"fused": acknowledged}
        assert stored.contributors == VEHICLES
        assert stored.passes == sum(outcome.passes for outcome in result.outcomes)
        assert stored.differences == []

        # what one car cannot decide, four can; and everything told has its evidence behind it
        told = dict.fromkeys(("normal", "deleted", "new"), 0)
        for truth, said in result.fused.score.said:
            told[truth] += truth == said
        assert result.fused.score.false_new == ()
        assert result.fused.score.right >= len(result.facts) - 1
        assert min(told.values()) >= 1

        acceptance = accept_best(cloud, world.name)
        assert acceptance.version_after != acceptance.version_before
        assert acceptance.features_after == acceptance.features_before + 1
        assert acceptance.feature is not None
        assert acceptance.feature["properties"]["sign"] == acceptance.change["sign"]
        assert look_into(cloud).differences == []


@dataclass(frozen=True)
class Uploaded:
    """What one vehicle's uploader was told, and what its outbox held before."""

    keys: frozenset[tuple[str, int]]
    accepted: int
    duplicates: int
    rejected: int
    remaining: int


@pytest.mark.slow
@pytest.mark.parametrize("own_worker", [False, True], ids=["the server", "the server and its worker"])
def test_nothing_is_lost_or_doubled_when_processes_are_killed_in_the_middle_of_an_upload(
    own_worker: bool, look_into: Callable[[Cloud], Any], driven: list[Path]
) -> None:
    with Cloud(own_worker=own_worker) as cloud:
        _, jobs = prepare_fleet(cloud, SEED, road_of(2.0), VEHICLES, cloud.scratch)
        for job, kept in zip(jobs, driven, strict=True):
            assert job.account is not None
            if not kept.exists():
                _drive_offline(job, kept)
            shutil.copyfile(kept, job.account.folder / "outbox.sqlite")
        uploads = _Uploads(jobs)
        for quota in (3, 3):
            uploads.wait_for_more(quota)
            cloud.kill()
            if own_worker:
                cloud.worker.kill()
            cloud.start()
            if own_worker:
                cloud.worker.start()
        done = uploads.finish()
        cloud.wait_until_fused()
        stored = look_into(cloud)

        sent = frozenset().union(*(upload.keys for upload in done))
        assert all(upload.remaining == upload.rejected == 0 for upload in done)
        assert all(upload.accepted + upload.duplicates == len(upload.keys) for upload in done)
        assert stored.messages == dict.fromkeys(sent, 1)
        assert stored.states == {"fused": len(sent)}
        assert stored.differences == []


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The outboxes of the fleet after its drives, as whoever drives first leaves them."""
    folder = tmp_path_factory.mktemp("driven")
    return [folder / f"{number}.sqlite" for number in range(VEHICLES)]


def _drive_offline(job: VehicleJob, path: Path) -> None:
    """Drive into an outbox alone, in many small messages."""
    drive = job.drive.open()
    policy = ReportPolicy(interval_s=1.0, max_passes=1)
    with (
        Outbox(path) as outbox,
        VehicleSession(job.hd_map, drive.header, outbox, seed=job.seed, report_policy=policy) as session,
    ):
        for record in drive.records:
            session.feed(record)


class _Uploads:
    """The uploads of a fleet, each in a thread, one message a request and none of them in a hurry to give up."""

    def __init__(self, jobs: Sequence[VehicleJob]) -> None:
        self._outboxes = [Outbox(job.account.folder / "outbox.sqlite") for job in jobs if job.account]
        self._keys = [frozenset(tuple(m.key) for m in outbox.pending(10_000)) for outbox in self._outboxes]
        self._results: dict[int, Any] = {}
        self._threads = [
            threading.Thread(target=self._upload, args=(number, job, outbox))
            for number, (job, outbox) in enumerate(zip(jobs, self._outboxes, strict=True))
        ]
        for thread in self._threads:
            thread.start()

    def _upload(self, number: int, job: VehicleJob, outbox: Outbox) -> None:
        assert job.account is not None
        policy = UploadPolicy(max_messages=1, retry=RetryPolicy(first_wait_s=0.05, longest_wait_s=0.5))
        with Server(job.account.url, job.account.key) as server:
            uploader = Uploader(outbox, server, policy, rng=np.random.default_rng(number))
            self._results[number] = uploader.flush(timeout_s=120.0)

    def acknowledged(self) -> int:
        return sum(outbox.stats().acknowledged for outbox in self._outboxes)

    def wait_for_more(self, quota: int) -> None:
        """Wait until so many more messages are acknowledged, with others still on their way."""
        target = self.acknowledged() + quota
        while self.acknowledged() < target:
            assert any(thread.is_alive() for thread in self._threads)
            time.sleep(0.002)
        assert any(outbox.stats().pending for outbox in self._outboxes)

    def finish(self) -> list[Uploaded]:
        for thread in self._threads:
            thread.join()
        for outbox in self._outboxes:
            outbox.close()
        return [
            Uploaded(keys, r.accepted, r.duplicates, r.rejected, r.remaining)
            for keys, r in zip(self._keys, (self._results[n] for n in range(len(self._keys))), strict=True)
        ]
