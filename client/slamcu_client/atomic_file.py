"""Write a file whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the path of an empty temporary file beside `path`, which takes its place if the block succeeds.

    The temporary file keeps the ending of the name. It is synced to disk before it is renamed, so that not even a power
    cut leaves half a file; if the block fails, it is removed and `path` stays as it was.

    Raises OSError about `path` if it cannot be written.
    """
    temporary = path.with_name(f".{secrets.token_hex(8)}{''.join(path.suffixes)}")
    try:
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in {None, str(temporary)}:
            raise _about(path, error) from error
        raise


def _about(path: Path, error: OSError) -> OSError:
    """Return an error about a temporary file as one about the file that it would have become."""
    return OSError(error.errno, error.strerror, str(path))
