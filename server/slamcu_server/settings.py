"""What can be configured, each from the environment variable of its name with the prefix SLAMCU_.

A variable with `_FILE` at its end names a file that holds the value: so secrets come into containers.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, SecretStr, ValidationError, field_validator
from pydantic.fields import FieldInfo
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from slamcu_core.errors import SlamcuError
from slamcu_server.database.url import parse_url


class SettingsError(SlamcuError):
    """A setting has a value that cannot be used."""


def default_data_dir() -> Path:
    """Return where a server of this user keeps its data: /var/lib/slamcu for root, else the XDG data directory."""
    if os.geteuid() == 0:
        return Path("/var/lib/slamcu")
    home = os.environ.get("XDG_DATA_HOME")
    return (Path(home) if home else Path.home() / ".local" / "share") / "slamcu"


class _Files(PydanticBaseSettingsSource):
    """Values from the files that SLAMCU_<NAME>_FILE names; a newline at the end is not part of a value."""

    def get_field_value(self, field: FieldInfo, field_name: str) -> tuple[Any, str, bool]:  # noqa: ARG002
        """Return the content of the file that is named for a field, or None."""
        variable = f"SLAMCU_{field_name.upper()}"
        path = os.environ.get(f"{variable}_FILE")
        if not path or f"{field_name}_file" in self.settings_cls.model_fields:
            return None, field_name, False
        if os.environ.get(variable):
            raise SettingsError(f"{variable} and {variable}_FILE are both set: which one counts?")
        try:
            return Path(path).read_text(encoding="utf-8").removesuffix("\n"), field_name, False
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not text"
            raise SettingsError(f"{variable}_FILE: {path} cannot be read: {reason}") from None

    def __call__(self) -> dict[str, Any]:
        """Return the values that come from files."""
        values = {name: self.get_field_value(field, name)[0] for name, field in self.settings_cls.model_fields.items()}
        return {name: value for name, value in values.items() if value is not None}


class Settings(BaseSettings):
    """The server's settings; sizes in bytes, times in seconds unless the name says otherwise."""

    model_config = SettingsConfigDict(env_prefix="SLAMCU_", frozen=True, extra="ignore")

    # Where the data are
    database_url: str | None = Field(
        None,
        description="PostgreSQL with PostGIS, as postgresql://user:password@host/name. "
        "Unset: the server starts and owns a private cluster in data_dir.",
    )
    database_password: SecretStr | None = Field(
        None, description="The password of database_url, where the URL does not hold it."
    )
    data_dir: Path = Field(default_factory=default_data_dir, description="Home of the private cluster.")
    postgres_bin_dir: Path | None = Field(None, description="Where initdb and pg_ctl are, if not in a usual place.")
    migrate_on_start: bool | None = Field(
        None, description="Bring the database to the newest schema on start. Unset: only the private cluster."
    )
    database_pool_size: int = Field(10, ge=2, le=500, description="Connections per process.")

    # How it is served
    host: str = "127.0.0.1"
    port: int = Field(8000, ge=0, le=65535, description="0 takes any free port.")
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    shutdown_grace_s: float = Field(5.0, gt=0, le=60, description="How long requests under way may take at shutdown.")
    keep_alive_s: int = Field(
        75,
        ge=1,
        le=3600,
        description="How long an idle connection is kept: longer than clients and proxies keep theirs, which send on a "
        "connection that is just being closed.",
    )

    worker_port: int | None = Field(
        None, ge=0, le=65535, description="Where a worker process answers /livez, /readyz and /metrics; unset: nowhere."
    )

    # What may be sent
    max_body_bytes: int = Field(4 * 2**20, ge=1024, description="Of a request body, as sent.")
    max_decompressed_bytes: int = Field(8 * 2**20, ge=1024, description="Of a request body, decompressed.")
    max_json_bytes: int = Field(
        2**20, ge=1024, description="Of a body in JSON, decompressed: it costs some fifty times its protobuf to parse."
    )
    max_messages_per_batch: int = Field(1000, ge=1, le=10_000)
    passes_per_s: float = Field(
        50.0,
        ge=0,
        description="Passes that an account may report in the long run, to one process; 0: no limit. "
        "A car has about one in five seconds.",
    )
    passes_burst: float = Field(
        50_000.0, ge=1, description="Passes that an account may report at once: what has waited for a network."
    )
    max_clock_ahead_s: float = Field(
        300.0, ge=0, description="How far in the future a report may lie before its clock counts as wrong."
    )

    # What is done with it
    embedded_worker: bool = Field(True, description="Aggregate in the serving process.")
    policy_file: Path | None = Field(None, description="The aggregation policy; unset: the built-in one.")
    trust_interval_s: float = Field(
        3600.0,
        ge=0,
        description="How often a worker recomputes the trust in contributors from their records; 0: never.",
    )
    message_retention_days: float = Field(
        30.0, gt=0, description="How long the body of an aggregated message is kept; of its identity only digests stay."
    )
    archive_retention_days: float = Field(
        365.0, gt=0, description="How long passes that no belief is folded from any more are kept to explain changes."
    )

    @field_validator("database_url")
    @classmethod
    def _asyncpg(cls, url: str | None) -> str | None:
        if not url:
            return None
        return parse_url(url).render_as_string(hide_password=False)

    @field_validator("data_dir")
    @classmethod
    def _absolute(cls, path: Path) -> Path:
        return path.expanduser().absolute()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Read what is given, then the environment, then the files that it names."""
        return init_settings, env_settings, _Files(settings_cls)

    @property
    def connection_url(self) -> str | None:
        """The SQLAlchemy URL of the configured database, its password included; None: the private cluster."""
        if self.database_url is None or self.database_password is None:
            return self.database_url
        url = parse_url(self.database_url)
        if url.password is not None:
            raise SettingsError("SLAMCU_DATABASE_PASSWORD: SLAMCU_DATABASE_URL holds a password already")
        return url.set(password=self.database_password.get_secret_value()).render_as_string(hide_password=False)

    @property
    def embedded(self) -> bool:
        """Whether the server owns its database cluster."""
        return self.database_url is None

    @property
    def migrates_on_start(self) -> bool:
        """Whether starting brings the database to the newest schema."""
        return self.embedded if self.migrate_on_start is None else self.migrate_on_start

    @classmethod
    def load(cls, **overrides: Any) -> Self:
        """Read the environment, with `overrides` (None: not given) on top; raise SettingsError naming what is wrong."""
        try:
            return cls(**{name: value for name, value in overrides.items() if value is not None})
        except ValidationError as error:
            first = error.errors()[0]
            name = str(first["loc"][0]) if first["loc"] else "settings"
            message = str(first["msg"]).removeprefix("Value error, ")
            shown = "" if name.startswith("database_") else f" (not {first['input']!r})"  # a URL may hold a password
            raise SettingsError(f"SLAMCU_{name.upper()}: {message}{shown}") from None
