"""A disk that takes nothing for a moment, as a limit on the size of files makes one without any privileges."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

_DRIVE = """
import json, resource, sys, time
from slamcu_client import Outbox, OutboxError, Response, RetryPolicy, Server, Uploader, UploadPolicy
from slamcu_core.sensoris.wire import fields
import gzip

class Accepts:
    sent = 0
    def send(self, request):
        count = sum(number == 2 for number, _ in fields(gzip.decompress(request.content)))
        self.sent += 1
        return Response(202, {}, b'{"accepted": %d, "duplicates": 0, "rejected": []}' % count)
    def close(self):
        pass

def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

def wait_for(condition):
    until = time.monotonic() + 20.0
    while not condition() and time.monotonic() < until:
        time.sleep(0.01)

transport = Accepts()
outbox = Outbox(sys.argv[1])
outbox.put("s", [lambda i: bytes(200)] * 7)
uploader = Uploader(outbox, Server("http://localhost", "key", transport), UploadPolicy(idle_s=0.01))
limit(0)
try:
    outbox.put("s", [lambda i: b"x"])
    raise SystemExit("the disk took something")
except OutboxError:
    pass
with uploader.in_background():
    wait_for(lambda: uploader.health.failures >= 3)
    full = transport.sent, outbox.stats().pending, uploader.health.failing, uploader.health.last_failure
    limit(resource.RLIM_INFINITY)
    wait_for(lambda: not outbox.stats().pending)
    stats = outbox.stats()
print(json.dumps([full, [transport.sent, stats.pending, stats.acknowledged, uploader.health.failing]]))
"""


def test_a_disk_that_was_full_for_a_moment_does_not_end_the_upload(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _DRIVE, str(tmp_path / "outbox")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    full, after = json.loads(done.stdout)
    sent, pending, failing, why = full
    assert sent == 1, "sent although it could not be noted, and not again and again while the answer cannot be either"
    assert (pending, failing) == (7, True)
    assert "outbox: " in why
    assert after == [1, 0, 7, False], "with room again what was answered is settled, and nothing was sent twice"
