"""The program `slamcu-vehicle`, beside the package that it runs: to import anything of that takes half a second."""

from __future__ import annotations

import sys

from slamcu_core import program


def main() -> int:
    """Run the command line of this process and return the exit code."""
    return program.run("slamcu_client.cli")


if __name__ == "__main__":
    sys.exit(main())
