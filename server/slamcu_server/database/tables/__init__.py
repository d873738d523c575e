"""The tables, in SQLAlchemy Core. `migrations/` makes them; a test holds the two together."""

from __future__ import annotations

from slamcu_server.database.tables.accounts import accounts, api_keys
from slamcu_server.database.tables.believed import feature_states, policies, trust, trust_versions
from slamcu_server.database.tables.columns import metadata
from slamcu_server.database.tables.mapped import feature_versions, features, map_versions, maps
from slamcu_server.database.tables.published import change_entries, changes, feed_position
from slamcu_server.database.tables.reported import candidates, forgetting, forgotten_messages, messages, passes
from slamcu_server.database.tables.retracted import corrections, put_aside, retractions

__all__ = [
    "accounts",
    "api_keys",
    "candidates",
    "change_entries",
    "changes",
    "corrections",
    "feature_states",
    "feature_versions",
    "features",
    "feed_position",
    "forgetting",
    "forgotten_messages",
    "map_versions",
    "maps",
    "messages",
    "metadata",
    "passes",
    "policies",
    "put_aside",
    "retractions",
    "trust",
    "trust_versions",
]
