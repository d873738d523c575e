"""Memory that a frame's arithmetic uses again from frame to frame.

The large arrays of a frame, rows by particles, live for microseconds. Taken anew each time, they make the allocator
hand pages back to the system and fault them in again at every frame, which can cost more than the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Scratch:
    """One block of memory that grows to the largest frame."""

    def __init__(self) -> None:
        self._block: Array = np.empty(0)

    def array(self, *shape: int) -> Array:
        """Return an array of the given shape with anything in it, to be used until the next call."""
        size = math.prod(shape)
        if size > len(self._block):
            self._block = np.empty(size + size // 2)
        return self._block[:size].reshape(shape)

    def __getstate__(self) -> dict[str, Array]:
        return {"_block": np.empty(0)}  # what is in it is nobody's

    def __setstate__(self, state: dict[str, Array]) -> None:
        self._block = state["_block"]
