"""The commands that make, list and end keys."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest

Command = Callable[..., subprocess.CompletedProcess[str]]


def test_the_commands(command: Command) -> None:
    made = command("create-key", "--role", "provider", "--label", "town")
    assert made.returncode == 0, made.stderr
    key = made.stdout.strip()
    assert key.startswith("slamcu_")
    key_id = key.split("_")[1]
    listed = command("list-keys", COLUMNS="200").stdout
    assert key_id in listed
    assert "town" in listed
    assert "valid" in listed
    assert key.split("_", 2)[2] not in listed

    again = command("create-key", "--role", "provider", "--label", "town")
    assert again.returncode == 1
    assert again.stderr.count("\n") == 1
    assert "--account town" in again.stderr
    assert command("create-key", "--account", "town").stdout.startswith("slamcu_")

    assert command("revoke-key", key_id).returncode == 0
    assert "revoked" in command("list-keys", COLUMNS="200").stdout
    unknown = command("revoke-key", "nokey")
    assert (unknown.returncode, unknown.stderr.count("\n")) == (1, 1)
    assert command("rotate-key", key_id).returncode == 1


def test_a_fleet_gets_its_keys_at_once(command: Command) -> None:
    made = command("create-key", "--role", "vehicle", "--label", "van", "--count", "12")
    lines = [line.split("\t") for line in made.stdout.splitlines()]
    assert [label for label, _ in lines] == [f"van-{number:02}" for number in range(1, 13)]
    assert len({key for _, key in lines}) == 12
    # All or none: the second fleet collides at its first vehicle.
    again = command("create-key", "--role", "vehicle", "--label", "van", "--count", "13")
    assert again.returncode == 1
    assert again.stdout == ""


def test_an_account_is_bound_to_maps(command: Command) -> None:
    made = command("create-key", "--role", "provider", "--label", "[town]", "--map", "town", "--map", "city")
    assert made.returncode == 0, made.stderr
    assert "not here yet: city, town" in made.stderr, "a name may be mistyped"
    row = next(line for line in command("list-keys", COLUMNS="200").stdout.splitlines() if "provider" in line)
    assert "city, town" in row
    assert "[town]" in row, "a label is no markup"
    assert "road" in command("bind-account", "[town]", "--map", "road").stderr
    assert " road " in command("list-keys", COLUMNS="200").stdout
    assert command("bind-account", "[town]", "--all-maps").returncode == 0
    assert " all " in command("list-keys", COLUMNS="200").stdout
    refused = command("create-key", "--role", "admin", "--label", "root", "--map", "town")
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["create-key"], "--role"),
        (["create-key", "--role", "king"], "king"),
        (["create-key", "--role", "vehicle", "--account", "x"], "--account"),
        (["create-key", "--account", "nobody"], "nobody"),
        (["create-key", "--account", "nobody", "--map", "town"], "bind-account"),
        (["bind-account", "nobody", "--map", "town"], "nobody"),
        (["bind-account", "nobody"], "--all-maps"),
        (["bind-account", "nobody", "--map", "town", "--all-maps"], "--all-maps"),
        (["create-key", "--role", "vehicle", "--count", "0"], "count"),
        (["rotate-key", "x", "--grace-hours", "99999999"], "grace"),
        (["rotate-key", "x", "--grace-hours", "nan"], "grace"),
    ],
)
def test_mistakes_on_the_command_line_are_told(command: Command, arguments: list[str], expected: str) -> None:
    done = command(*arguments)
    assert done.returncode != 0
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
