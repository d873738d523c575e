from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from slamcu_core.errors import SlamcuError
from slamcu_core.formats import write_hd_map
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_eval.fleet import Cloud, CloudError, ProgramError

FEATURES = [MapFeature(object_id=n, lon=2.0 + 0.001 * n, lat=48.9, sign="SPEED_LIMIT", value="80") for n in (1, 2, 3)]


@pytest.fixture(scope="module")
def cloud() -> Iterator[Cloud]:
    with pytest.MonkeyPatch.context() as patch:
        # the user's own server, which an evaluation must not touch
        patch.setenv("SLAMCU_DATABASE_URL", "postgresql://nobody@nowhere.invalid/none")
        with Cloud() as cloud:
            yield cloud


def test_maps_are_imported_and_read_over_http(cloud: Cloud) -> None:
    path = cloud.scratch / "town.geojson"
    path.write_text("".join(write_hd_map(MapIdentity("a town: centre", "1"), FEATURES)))
    cloud.import_map(path)
    assert [feature["id"] for feature in cloud.features("a town: centre")] == [1, 2, 3]
    assert cloud.pending() == 0


def test_each_key_is_an_account_of_its_own(cloud: Cloud) -> None:
    keys = [*cloud.create_keys("vehicle", 3), *cloud.create_keys("vehicle", 1)]
    assert len(set(keys)) == 4


def test_what_the_server_refuses_is_told_in_its_words(cloud: Cloud) -> None:
    path = cloud.scratch / "wrong.geojson"
    path.write_text('{"type": "FeatureCollection", "features": [{"type": "Feature"}]}')
    with pytest.raises(SlamcuError, match=r"wrong\.geojson"):
        cloud.import_map(path)
    with pytest.raises(CloudError, match="GET /v1/maps/nowhere/features: 404"):
        cloud.features("nowhere")


def test_a_killed_server_comes_back_at_its_address_with_its_data(cloud: Cloud) -> None:
    path = cloud.scratch / "kept.geojson"
    path.write_text("".join(write_hd_map(MapIdentity("kept", "1"), FEATURES)))
    cloud.import_map(path)
    url, pid = cloud.url, cloud.pid
    cloud.kill()
    with pytest.raises(ProgramError, match="not running"):
        _ = cloud.pid
    cloud.start()
    assert cloud.url == url
    assert cloud.pid != pid
    assert len(cloud.features("kept")) == 3


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_nothing_is_left_behind_when_the_evaluation_is_stopped(number: signal.Signals) -> None:
    script = (
        "import time\nfrom slamcu_eval.fleet import Cloud\n"
        "with Cloud() as cloud:\n"
        "    lines = (cloud.data_dir / 'cluster' / 'data' / 'postmaster.pid').read_text().splitlines()\n"
        "    print(cloud.pid, lines[0], cloud.data_dir, flush=True)\n"
        "    time.sleep(600)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        server, postmaster, home = process.stdout.readline().split()
        process.send_signal(number)
        process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode != 0
    assert not _alive(int(server))
    assert not _alive(int(postmaster))
    assert not Path(home).parent.exists()


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
