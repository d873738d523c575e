"""Lets `python -m slamcu_client` be the command `slamcu-vehicle`."""

from __future__ import annotations

import sys

from slamcu_core import program

if __name__ == "__main__":
    sys.exit(program.run("slamcu_client.cli"))
