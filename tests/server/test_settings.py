"""Settings come from the environment, are all documented, and a bad one is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcu_server.settings import Settings, SettingsError, default_data_dir

DOCUMENT = Path(__file__).parents[2] / "docs" / "server.md"


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.delenv(f"SLAMCU_{name.upper()}", raising=False)


def test_every_setting_is_documented_with_its_default() -> None:
    rows = [
        [cell.strip().strip("`") for cell in line.split("|")[1:3]]
        for line in DOCUMENT.read_text(encoding="utf-8").splitlines()
        if line.startswith("| `SLAMCU_")
    ]
    documented = dict(rows)
    assert list(documented) == [f"SLAMCU_{name.upper()}" for name in Settings.model_fields]
    for name, field in Settings.model_fields.items():
        if field.default_factory is None:
            default = "unset" if field.default is None else str(field.default)
            assert documented[f"SLAMCU_{name.upper()}"] == default


def test_the_environment_counts_and_options_count_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMCU_PORT", "9000")
    monkeypatch.setenv("SLAMCU_HOST", "0.0.0.0")
    settings = Settings.load(port=9001, host=None)
    assert (settings.port, settings.host) == (9001, "0.0.0.0")


@pytest.mark.parametrize("scheme", ["postgresql", "postgres", "postgresql+asyncpg"])
def test_a_database_url_is_taken_as_others_write_it(scheme: str) -> None:
    settings = Settings.load(database_url=f"{scheme}://user:password@host:5432/name")
    assert settings.database_url == "postgresql+asyncpg://user:password@host:5432/name"
    assert not settings.embedded
    assert not settings.migrates_on_start


def test_a_secret_comes_from_a_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "password").write_text("p@ss/word:?\n")
    monkeypatch.setenv("SLAMCU_DATABASE_URL", "postgresql://user@host/name")
    monkeypatch.setenv("SLAMCU_DATABASE_PASSWORD_FILE", str(tmp_path / "password"))
    settings = Settings.load()
    assert settings.connection_url == "postgresql+asyncpg://user:p%40ss%2Fword%3A%3F@host/name"
    assert "p@ss" not in repr(settings)


def test_any_setting_may_come_from_a_file_and_is_checked_as_ever(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "port").write_text("many")
    monkeypatch.setenv("SLAMCU_PORT_FILE", str(tmp_path / "port"))
    with pytest.raises(SettingsError, match=r"^SLAMCU_PORT: "):
        Settings.load()
    (tmp_path / "port").write_text("9000\n")
    assert Settings.load().port == 9000
    monkeypatch.setenv("SLAMCU_PORT", "9001")
    with pytest.raises(SettingsError, match=r"^SLAMCU_PORT and SLAMCU_PORT_FILE are both set"):
        Settings.load()
    monkeypatch.delenv("SLAMCU_PORT")
    monkeypatch.setenv("SLAMCU_PORT_FILE", str(tmp_path / "none"))
    with pytest.raises(SettingsError, match=r"^SLAMCU_PORT_FILE: .* cannot be read: No such file"):
        Settings.load()


def test_two_passwords_are_one_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMCU_DATABASE_URL", "postgresql://user:one@host/name")
    monkeypatch.setenv("SLAMCU_DATABASE_PASSWORD", "two")
    with pytest.raises(SettingsError, match=r"^SLAMCU_DATABASE_PASSWORD: ") as told:
        _ = Settings.load().connection_url
    assert "two" not in str(told.value)


def test_without_a_database_the_server_owns_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMCU_DATABASE_URL", "")  # as unset: compose files write it so
    settings = Settings.load()
    assert settings.embedded
    assert settings.migrates_on_start


def test_the_data_directory_is_the_user_s(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_data_dir() == tmp_path / "slamcu"
    monkeypatch.delenv("XDG_DATA_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_data_dir() == tmp_path / ".local" / "share" / "slamcu"
    monkeypatch.setattr("os.geteuid", lambda: 0)
    assert default_data_dir() == Path("/var/lib/slamcu")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("port", "-1"),
        ("port", "many"),
        ("max_body_bytes", "0"),
        ("log_level", "loud"),
        ("message_retention_days", "0"),
        ("embedded_worker", "perhaps"),
        ("database_url", "sqlite:///x"),
        ("database_url", "postgresql://user:secret@host:many/name"),
        ("database_url", "postgresql://user:secret@host:70000/name"),
        ("database_url", "postgresql://user:secret@host/name?sslmode=perhaps"),
        ("database_url", "postgresql://user:secret@host/name?sslrootcert=/x"),
        ("database_url", "postgresql://user:secret@host/name?statement_cache_size=none"),
    ],
)
def test_a_bad_setting_is_named_in_one_line(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(f"SLAMCU_{name.upper()}", value)
    with pytest.raises(SettingsError, match=f"^SLAMCU_{name.upper()}: ") as told:
        Settings.load()
    assert "\n" not in str(told.value)
    assert "secret" not in str(told.value)
