"""The counters and timers of one application."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram


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
        for outcome in ("accepted", "duplicate", "rejected"):
            self.messages.labels(outcome)
