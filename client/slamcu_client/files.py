"""Open drive logs and maps, plain or gzipped, and know how far they have been read."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from slamcu_client.atomic_file import replacing
from slamcu_core.errors import FormatError
from slamcu_core.formats import load_hd_map
from slamcu_core.formats.packing import pieces, unpacked, unpacking
from slamcu_core.hd_map import HDMap

_BUFFER = 64 * 1024
_LONGEST_LINE = 16 * 2**20


class InputFile:
    """A file that is read from its start, unpacked if it is gzipped, whatever its name.

    Parameters
    ----------
    path : the file.

    Raises OSError if it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.size = path, path.stat().st_size
        self._file: io.BufferedReader = io.BufferedReader(path.open("rb", buffering=0), _BUFFER)
        self._stream = unpacked(self._file)

    @property
    def position(self) -> int:
        """Bytes of the file on disk that have been read, of `size`."""
        return self._file.raw.tell()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def lines(self) -> Iterator[bytes]:
        """Iterate over the lines; raises FormatError where a line has no end or the packing is broken."""
        number = 0
        with unpacking(str(self.path)):
            while line := self._stream.readline(_LONGEST_LINE):
                number += 1
                if len(line) == _LONGEST_LINE:
                    raise FormatError(f"longer than {_LONGEST_LINE} bytes", source=str(self.path), line=number)
                yield line

    def pieces(self) -> Iterator[bytes]:
        """Iterate over the content in pieces; raises FormatError where the packing is broken."""
        return pieces(self._stream, str(self.path))


@contextmanager
def opened(path: Path) -> Iterator[InputFile]:
    """Open a file for reading; raises OSError if that fails."""
    file = InputFile(path)
    try:
        yield file
    finally:
        file.close()


def load_map_file(path: Path) -> HDMap:
    """Read an HD map from a file; raises FormatError or OSError."""
    with opened(path) as file:
        return load_hd_map(file.pieces(), source=str(path))


def write_text(path: Path, pieces: Iterable[str]) -> None:
    """Write a text file whole or not at all; raises OSError."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(pieces)
