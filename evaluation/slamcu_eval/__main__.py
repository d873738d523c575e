"""The program `slamcu-eval`, also as `python -m slamcu_eval`."""

from __future__ import annotations

import sys

from slamcu_core import program


def main() -> int:
    """Run the command line of this process and return the exit code."""
    return program.run("slamcu_eval.cli")


if __name__ == "__main__":
    sys.exit(main())
