"""Drives of the default motorway, each in a world of its own, shared by the tests that measure them."""

from __future__ import annotations

import pytest

from slamcu_eval.highway import Drive, World, simulate

DRIVES = 14


@pytest.fixture(scope="session")
def motorway_drives() -> list[tuple[World, Drive]]:
    result = []
    for seed in range(DRIVES):
        world, drives = simulate(seed)
        result.append((world, drives[0]))
    return result
