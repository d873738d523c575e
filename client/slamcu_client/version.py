"""What the client calls itself, in HTTP and in its messages."""

from __future__ import annotations

from importlib.metadata import version

SOFTWARE_VERSION = f"slamcu-client/{version('slamcu-client')}"
"""Name and version of this software."""
