"""The text of API keys: `slamcu_<key id>_<secret>`, of which the server keeps the id and a hash of the secret."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets

# A secret of 256 random bits cannot be guessed from its hash, so a slow password hash would only slow the requests.
_KEY = re.compile(r"slamcu_([0-9a-f]{16})_([A-Za-z0-9_-]{43})")


def generate() -> tuple[str, str, bytes]:
    """Make a key and return its text, its id and the SHA-256 of its secret."""
    key_id, secret = secrets.token_hex(8), secrets.token_urlsafe(32)
    return f"slamcu_{key_id}_{secret}", key_id, digest(secret)


def parse(key: str) -> tuple[str, str] | None:
    """Split a key's text into its id and its secret; None if it is no key."""
    match = _KEY.fullmatch(key)
    return (match[1], match[2]) if match else None


def digest(secret: str) -> bytes:
    """Hash a secret."""
    return hashlib.sha256(secret.encode()).digest()


def matches(secret: str, secret_sha256: bytes) -> bool:
    """Tell in constant time whether `secret` is the one that was hashed."""
    return hmac.compare_digest(digest(secret), secret_sha256)
