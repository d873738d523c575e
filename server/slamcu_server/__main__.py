"""The program `slamcu-server`, also as `python -m slamcu_server`."""

from __future__ import annotations

import sys

from slamcu_core import program


def main() -> int:
    """Run the command line of this process and return the exit code."""
    return program.run("slamcu_server.cli")


if __name__ == "__main__":
    sys.exit(main())
