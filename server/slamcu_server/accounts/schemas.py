"""Who is who: roles, accounts and keys."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from slamcu_server.accounts.times import TimesTold


class Role(StrEnum):
    """What an account may do."""

    VEHICLE = "vehicle"  # report and fetch maps
    PROVIDER = "provider"  # read maps, features and changes, and review changes
    ADMIN = "admin"  # all


@dataclass(frozen=True, slots=True)
class MapScope:
    """The maps that an account is bound to, by name; those that it is not bound to are none to it."""

    sources: frozenset[str] | None = None  # None: bound to none in particular, it has to do with all

    def __contains__(self, source: object) -> bool:
        return self.sources is None or source in self.sources

    def names(self) -> list[str] | None:
        """Return the names in order, as the database takes them; None: all."""
        return None if self.sources is None else sorted(self.sources)


ALL_MAPS = MapScope()


@dataclass(frozen=True, slots=True)
class Principal:
    """The account behind a request; a vehicle's account is one contributor, whatever keys it uses."""

    account_id: int
    role: Role
    label: str
    key_id: str
    scope: MapScope = ALL_MAPS

    @property
    def times(self) -> TimesTold:
        """How exactly it is told when vehicles were where."""
        return TimesTold(exact=self.role is Role.ADMIN)


@dataclass(frozen=True, slots=True)
class StoredKey:
    """A key as the database knows it: its holder and the hash of its secret."""

    principal: Principal
    secret_sha256: bytes
    expires_at: datetime | None
    revoked_at: datetime | None

    def valid_at(self, now: datetime) -> bool:
        """Tell whether the key may be used at `now`."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)


@dataclass(frozen=True, slots=True)
class IssuedKey:
    """A new key; its text is shown once and kept nowhere."""

    key: str
    key_id: str
    role: Role
    label: str
