"""The counters and timers of one application."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from sqlalchemy import Row

from slamcu_server.database import migrate

CHORES = ("correcting", "fading", "forgetting", "trusting")
"""What a worker does beside fusing."""


class Instruments:
    """What one application counts, in a registry of its own (so that tests can have several)."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "slamcu_http_requests", "Requests answered.", ("method", "route", "status"), registry=self.registry
        )
        self.latency = Histogram(
            "slamcu_http_request_seconds", "Time to the end of the answer.", ("method", "route"), registry=self.registry
        )
        self.messages = Counter(
            "slamcu_ingest_messages", "Messages by outcome: accepted, duplicate, rejected.", ("outcome",),
            registry=self.registry,
        )  # fmt: skip
        self.rejections = Counter(
            "slamcu_ingest_rejections", "Messages rejected, by reason.", ("reason",), registry=self.registry
        )
        self.pending = Gauge(
            "slamcu_aggregation_pending_messages", "Messages logged and not yet aggregated.", registry=self.registry
        )
        self.quarantined = Gauge(
            "slamcu_aggregation_quarantined_messages", "Messages that could not be aggregated.", registry=self.registry
        )
        self.put_aside = Gauge(
            "slamcu_put_aside", "Work that failed for a lasting reason and is tried again, by kind.", ("work",),
            registry=self.registry,
        )  # fmt: skip
        self.chores_failed = Counter(
            "slamcu_worker_chores_failed", "What a worker does beside fusing and could not do, by chore.", ("chore",),
            registry=self.registry,
        )  # fmt: skip
        self.lag = Gauge(
            "slamcu_aggregation_lag_seconds", "Age of the oldest message not yet aggregated.", registry=self.registry
        )
        self.fused = Counter(
            "slamcu_aggregation_messages", "Messages processed by outcome: fused, quarantined.", ("outcome",),
            registry=self.registry,
        )  # fmt: skip
        self.batch_seconds = Histogram(
            "slamcu_aggregation_batch_seconds", "Time to fuse a batch, of this process.", registry=self.registry
        )
        self.changes = Gauge(
            "slamcu_changes", "Changes, by what they are now.", ("kind", "state"), registry=self.registry
        )
        self.mapped = Gauge(
            "slamcu_change_to_map_seconds_count", "Changes that a map version has taken up.", ("kind",),
            registry=self.registry,
        )  # fmt: skip
        self.mapped_after = Gauge(
            "slamcu_change_to_map_seconds_sum", "Of these, the time from the first evidence to the map, summed.",
            ("kind",), registry=self.registry,
        )  # fmt: skip
        self.fuse_latency = Gauge(
            "slamcu_aggregation_latency_seconds", "Time from acknowledged to fused, of the newest messages.",
            ("quantile",), registry=self.registry,
        )  # fmt: skip
        self.feed_sequence = Gauge(
            "slamcu_feed_last_sequence", "Number of the newest entry of the change feed.", registry=self.registry
        )
        self.pool = Gauge(
            "slamcu_database_connections", "Connections of this process to the database, by what they do.", ("state",),
            registry=self.registry,
        )  # fmt: skip
        self.pool_size = Gauge(
            "slamcu_database_pool_size", "Most connections that this process may have.", registry=self.registry
        )
        self.worker_healthy = Gauge(
            "slamcu_worker_healthy", "1 if this process has a worker and it runs, else 0.", registry=self.registry
        )
        self.build = Gauge(
            "slamcu_build", "1, with the version of the server and the schema that it was made for.",
            ("version", "schema"), registry=self.registry,
        )  # fmt: skip
        self.build.labels(version("slamcu-server"), migrate.head()).set(1)
        for chore in CHORES:
            self.chores_failed.labels(chore)
        for outcome in ("accepted", "duplicate", "rejected"):
            self.messages.labels(outcome)

    def tell_changes(self, counted: Sequence[Row[Any]]) -> None:
        """Set how many changes there are, given as (kind, state, changes, mapped, seconds)."""
        self.changes.clear()
        for row in counted:
            self.changes.labels(row.kind, row.state).set(row.changes)
        for kind in {row.kind for row in counted}:
            mine = [row for row in counted if row.kind == kind]
            self.mapped.labels(kind).set(sum(row.mapped for row in mine))
            self.mapped_after.labels(kind).set(float(sum(row.seconds for row in mine)))
