"""What all tests share: examples of property tests have no deadline, for the machine may be busy."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("slamcu", deadline=None)
settings.load_profile("slamcu")
