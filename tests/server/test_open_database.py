"""Opening the database: whatever becomes of the start, what has started is left in order."""

from __future__ import annotations

import asyncio
import gc
import threading
from pathlib import Path
from typing import Any

import pytest

from slamcu_server import runtime
from slamcu_server.database.postgres_tools import EmbeddedDatabaseError
from slamcu_server.runtime import open_database
from slamcu_server.settings import Settings

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("starts", [True, False], ids=["starts", "fails"])
async def test_an_interrupted_start_of_the_cluster_is_waited_for_and_undone(
    starts: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    starting, go_on, told, left = threading.Event(), threading.Event(), [], []

    class Cluster(runtime.EmbeddedCluster):
        def __enter__(self) -> Any:
            starting.set()
            go_on.wait(20)
            if not starts:
                raise EmbeddedDatabaseError("the disk is full")
            return self

        def __exit__(self, *_: object) -> None:
            left.append(go_on.is_set())

    async def open_it() -> None:
        async with open_database(Settings.load(data_dir=tmp_path), application_name="test"):
            pytest.fail("it was interrupted")

    monkeypatch.setattr(runtime, "EmbeddedCluster", Cluster)
    monkeypatch.delenv("SLAMCU_DATABASE_URL", raising=False)
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    opening = asyncio.create_task(open_it())
    assert await asyncio.to_thread(starting.wait, 20)
    opening.cancel()
    await asyncio.sleep(0.05)
    assert not opening.done()
    go_on.set()
    with pytest.raises(asyncio.CancelledError):
        await opening
    gc.collect()
    assert left == ([True] if starts else [])
    assert told == []
