"""The vehicle side of slamcu: runs the filter beside the car's own software and reports map changes.

The public API is what `__all__` names; the modules below are free to change.
"""

from slamcu_client.errors import (
    AnswerError,
    AuthenticationError,
    ClientError,
    ConnectionSettingsError,
    MapUnavailableError,
    OutboxError,
    SessionClockError,
    SessionClosedError,
    SessionError,
    TransportError,
)
from slamcu_client.map_cache import MapCache, MapSnapshot
from slamcu_client.outbox import MessageKey, Outbox, OutboxMessage, OutboxStats, RejectedMessage, SessionState
from slamcu_client.reporter import ReportPolicy
from slamcu_client.results import result_features
from slamcu_client.retry import RetryPolicy
from slamcu_client.server import Server
from slamcu_client.session import VehicleSession
from slamcu_client.transport import HttpxTransport, Request, Response, Transport
from slamcu_client.upload_health import UploadHealth, UploadResult
from slamcu_client.uploader import Uploader, UploadPolicy

__all__ = [
    "AnswerError",
    "AuthenticationError",
    "ClientError",
    "ConnectionSettingsError",
    "HttpxTransport",
    "MapCache",
    "MapSnapshot",
    "MapUnavailableError",
    "MessageKey",
    "Outbox",
    "OutboxError",
    "OutboxMessage",
    "OutboxStats",
    "RejectedMessage",
    "ReportPolicy",
    "Request",
    "Response",
    "RetryPolicy",
    "Server",
    "SessionClockError",
    "SessionClosedError",
    "SessionError",
    "SessionState",
    "Transport",
    "TransportError",
    "UploadHealth",
    "UploadPolicy",
    "UploadResult",
    "Uploader",
    "VehicleSession",
    "result_features",
]
