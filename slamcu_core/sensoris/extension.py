"""Our extension in SENSORIS envelopes: packed as `google.protobuf.Any`, found among those of others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from google.protobuf.any_pb2 import Any
from google.protobuf.message import DecodeError, Message

from slamcu_core.errors import WireError
from slamcu_core.sensoris.proto import extension_pb2

TYPE_URL_PREFIX = "types.slamcu"
EXTENSION_TYPES: tuple[type[Message], ...] = (extension_pb2.PassEvidence, extension_pb2.MessageHealth)
TYPE_URLS: tuple[str, ...] = tuple(f"{TYPE_URL_PREFIX}/{t.DESCRIPTOR.full_name}" for t in EXTENSION_TYPES)

M = TypeVar("M", bound=Message)


def pack(message: Message) -> Any:
    """Wrap an extension message with its type's URL."""
    wrapped = Any()
    wrapped.Pack(message, type_url_prefix=TYPE_URL_PREFIX, deterministic=True)
    return wrapped


def find(extensions: Iterable[Any], wanted: type[M]) -> M | None:
    """Return the one extension of a type, None if there is none; those of others are passed over.

    Raises WireError if it stands twice or does not parse.
    """
    name = wanted.DESCRIPTOR.full_name
    own = [extension for extension in extensions if extension.type_url.rpartition("/")[2] == name]
    if len(own) > 1:
        raise WireError("bad-extension", f"{name} stands {len(own)} times, expected once at most")
    if not own:
        return None
    try:
        return wanted.FromString(own[0].value)
    except DecodeError as error:
        raise WireError("bad-extension", f"an extension says that it is a {name}, but does not parse as one") from error
